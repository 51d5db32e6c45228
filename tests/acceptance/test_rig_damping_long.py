"""`rig damping`: the balance of momentum against closed forms, intervals, and a board whose damping
is another than its device file's.
"""

import json
from contextlib import nullcontext

import numpy as np
import pytest
from support.models import COUNT_M, COUNT_N
from support.rig_damping import FREE, FRICTION, RATE_HZ, TRUTH, made_up, nothing
from support.rig_hand import Hand

from hapticd.cli.app import main
from hapticd.cli.rig import steps
from hapticd.core.errors import AnalysisError, HapticdError
from hapticd.core.params import ScaleParams
from hapticd.core.units import COPPER_PER_K
from hapticd.model.compose import board_fields, compose_device
from hapticd.model.effects import (
    Amplifier,
    Coulomb,
    DampingCircuit,
    Masses,
    Motor,
    Viscous,
    WindingTemperature,
)
from hapticd.protocol.view import as_records
from hapticd.rig.experiment import push, ready
from hapticd.rig.steps.coast_down import fit_momentum
from hapticd.rig.steps.damping import measure
from hapticd.settings.load import load
from hapticd.settings.toml import shipped

LIMIT_N = 0.8


def values_of(result):
    return {one.name: one for one in result.values}


def holds(value, truth):
    return value.low <= truth <= value.high


def test_gain_and_physical_damping_lie_in_their_intervals():
    with Hand(touch=FRICTION, **FREE) as hand:
        hand.axis.active_damping_gain = 1.17
        result = measure(hand.bench, nothing)
        assert hand.bench.status().state == "disabled"
        hand.settle()
        assert hand.bench.newest["active_damping_ns_per_m"] == 0.0
    found = values_of(result)
    gain = found["active_damping.full_scale_ns_per_m"]
    assert result.settled
    assert holds(gain, 11.7)
    assert gain.high - gain.low < 0.06 * gain.value
    assert holds(found["physical damping"], 0.4)
    assert holds(found["friction seen"], 0.03)
    assert holds(found["residual resistance"], 0.0)
    least = {(one.table, one.key): one.value for one in result.changes}
    assert least["limits", "physical_damping_ns_per_m"] <= 2.0 / 3.0 * 0.4
    assert np.abs(result.arrays["force_n"]).max() <= LIMIT_N + COUNT_N


def test_the_verb_writes_the_table_with_its_record(tmp_path, monkeypatch, capsys):
    """A gain below the file's brings the limit down with it: no converter makes more."""
    (tmp_path / "devices").mkdir()
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    (tmp_path / "devices" / "own.toml").write_text(text)
    config = tmp_path / "hapticd.toml"
    config.write_text('device = "own"\n')
    with Hand({"emf_velocity": ScaleParams(2.0 / 32767)}, touch=FRICTION, **FREE) as hand:
        hand.axis.active_damping_gain = 0.9
        monkeypatch.setattr(steps, "connect", lambda instance: nullcontext(hand.bench))
        monkeypatch.setattr(steps, "PAUSE_S", 0.0)
        assert main(["rig", "damping", "--yes", "--json", "--config", str(config)]) == 0
    assert json.loads(capsys.readouterr().out)["ok"]
    device = load(config).device
    assert device.active_damping.full_scale_ns_per_m == pytest.approx(9.0, rel=0.02)
    assert device.limits.active_damping_ns_per_m == device.active_damping.full_scale_ns_per_m
    assert 0.2 < device.limits.physical_damping_ns_per_m <= 2.0 / 3.0 * 0.4
    (record,) = (tmp_path / "devices" / "rig").iterdir()
    assert record.name in device.active_damping.source
    half = device.active_damping.half_width_95["full_scale_ns_per_m"]
    assert 0.003 < half / device.active_damping.full_scale_ns_per_m < 0.03


def composed(residual_ohm):
    """A board whose winding is warmer than its compensation believes."""
    ohm = 1.6
    colder_k = residual_ohm / (ohm * COPPER_PER_K)
    effects = (
        Masses(rotor_kg=0.007),
        Viscous(rotor_ns_per_m=0.3),
        Coulomb(rotor_n=0.04),
        Amplifier(bandwidth_hz=5000.0),
        DampingCircuit(bandwidth_hz=1000.0),
        Motor(torque_constant_nm_per_a=1.65, lever_m=1.0, resistance_ohm=ohm),
        WindingTemperature(temperature_c=20.0, compensated_c=20.0 - colder_k),
    )
    return board_fields(compose_device("made", effects, RATE_HZ), (), 12.0)


def test_a_warm_winding_is_told_from_weak_damping():
    """Whatever the sign of the current is."""
    wrong = {"current": ScaleParams(10.0 / 32767, -1)}
    with Hand(wrong, **composed(0.08)) as hand:
        result = measure(hand.bench, nothing)
    found = values_of(result)
    assert holds(found["active_damping.full_scale_ns_per_m"], 10.0)
    assert holds(found["residual resistance"], 0.08)
    assert found["residual resistance"].low > 0.0
    assert holds(found["force per ampere"], 1.65)


def test_a_board_without_current_is_measured_by_friction():
    deaf = ScaleParams(1e3)
    with Hand({"current": deaf}, **composed(0.08) | {"current_a_per_count": 1e3}) as hand:
        result = measure(hand.bench, nothing)
    found = values_of(result)
    assert "force per ampere" not in found
    assert holds(found["active_damping.full_scale_ns_per_m"], 10.0)
    assert holds(found["residual back-EMF"], 0.08 / 1.65**2)


def test_wrong_polarity_is_refused_before_it_can_grow():
    with Hand(touch=FRICTION, **FREE) as hand:
        hand.axis.active_damping_gain = -1.0
        result = measure(hand.bench, nothing)
        assert hand.bench.status().state == "disabled"
        assert hand.bench.newest["active_damping_ns_per_m"] == 0.0
    assert not result.settled
    assert not result.changes
    assert "polarity" in result.findings[0].what
    on = result.arrays["active_damping_effect_ns_per_m"] > 0.0
    moving = np.abs(np.diff(result.arrays["position_m"], prepend=0.0)) > 2 * COUNT_M
    lengths = np.diff(np.flatnonzero(np.diff((on & moving).astype(int))))[::2]
    assert 0 < lengths.max() <= 20
    assert result.arrays["active_damping_effect_ns_per_m"].max() < 0.4  # the physical damping


def test_damping_that_does_nothing_is_refused():
    with Hand(touch=FRICTION, **FREE) as hand:
        hand.axis.active_damping_gain = 0.0
        result = measure(hand.bench, nothing)
    assert not result.settled
    assert "no damping is seen" in result.findings[0].what


def test_ctrl_c_ends_force_and_damping():
    with Hand(touch=FRICTION, **FREE) as hand:

        def interrupted(topics, look_s=0.05):
            if hand.bench.newest["active_damping_ns_per_m"] > 0.0:
                raise KeyboardInterrupt
            return type(hand.bench).messages(hand.bench, topics, look_s)

        hand.bench.messages = interrupted
        with pytest.raises(KeyboardInterrupt):
            measure(hand.bench, nothing)
        records = as_records(hand.bench.run(200))
        assert hand.bench.status().state == "disabled"
        assert not records["force_n"].any()
        assert not records["active_damping_ns_per_m"][-1]


@pytest.mark.parametrize("current", [1.0, 0.0])
def test_intervals_hold_nineteen_times_in_twenty(current):
    random = np.random.default_rng(5)
    truth = np.array([TRUTH["gain"], TRUTH["loop"], TRUTH["physical"], TRUTH["friction"]])
    inside = np.zeros(4)
    for _ in range(300):
        found = fit_momentum(made_up(random, current), 1e-5)
        assert bool(found.n_per_a) is bool(current)
        seen = np.array(
            [found.gain, found.loop_per_ns_per_m, found.physical_ns_per_m, found.coulomb_n]
        )
        half = np.array([found.gain_half, found.loop_half, found.physical_half, found.coulomb_half])
        inside += np.abs(seen - truth) <= half
    assert (inside >= 0.93 * 300).all()


def test_a_hand_that_does_not_let_go_ends_the_step():
    """It is on the handle again after the first pushes, and draws it away."""
    with Hand(touch=FRICTION, **FREE) as hand:
        pushes = []

        def counted(**fields):
            pushes.append(fields.get("at_tick"))
            hand.pull_n = 0.0 if len(pushes) < 30 else 0.06
            return type(hand.bench).set(hand.bench, **fields)

        hand.bench.set = counted
        with pytest.raises(AnalysisError, match="take your hand off"):
            measure(hand.bench, nothing)
        assert hand.bench.status().state == "disabled"


def test_authority_that_is_lost_ends_the_step():
    with Hand(touch=FRICTION, **FREE) as hand:
        pressed = []

        def stopped(**fields):
            if fields.get("active_damping") and not pressed:
                pressed.append(True)
                hand.axis.press_stop(True)
            return type(hand.bench).set(hand.bench, **fields)

        hand.bench.set = stopped
        with pytest.raises(HapticdError):
            measure(hand.bench, nothing)
        assert pressed
        assert not as_records(hand.bench.run(50))["force_n"].any()


def test_a_handle_that_is_held_is_refused():
    with Hand(touch=FRICTION, **FREE) as hand:
        hand.held_m = 0.0
        result = measure(hand.bench, nothing)
        assert hand.bench.status().state == "disabled"
    assert not result.settled
    assert "release the handle" in result.findings[0].remedy


def test_a_host_that_takes_its_time_gets_more_of_it():
    """Each request takes a third of a second, which is more than the shortest lead."""
    with Hand(touch=FRICTION, **FREE) as hand:
        bench = hand.bench

        def slow(**fields):
            bench.run(333)
            return type(bench).set(bench, **fields)

        with ready(bench):
            bench.set = slow
            found = push(bench, 0.2, 0.02, 0.3)
        assert np.count_nonzero(found.records["force_n"]) == 20
        assert found.moved_m > 1e-4
