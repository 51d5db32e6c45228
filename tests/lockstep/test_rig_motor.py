"""`rig motor` on a board whose true sign, gain and offset are others than its device file's."""

from datetime import date

import numpy as np
import pytest
from support.models import COUNT_M, device_params
from support.rig_hand import Hand
from support.rig_motor import FREE, FRICTION, HUNG, nothing
from support.tree import ROOT

from hapticd.core.errors import AnalysisError, CommandError
from hapticd.core.params import ScaleParams, to_plain
from hapticd.model.params import TouchParams
from hapticd.protocol.view import as_records
from hapticd.rig.certificate import write_changes
from hapticd.rig.experiment import push
from hapticd.rig.steps.motor import (
    Masses,
    analyse,
    measure_gain,
    measure_sign,
)
from hapticd.settings.build import device_params as device_params_of
from hapticd.settings.load import load_device

DEVICES = ROOT / "config" / "devices"


def test_the_sign_waits_for_the_encoder():
    """The position's sign is still that of the template: a push would be seen the wrong way."""
    file = {"position": ScaleParams(COUNT_M, serial="CHANGE-ME"), "commissioning": True}
    with Hand(file, **FREE) as hand, pytest.raises(AnalysisError, match="first `hapticd rig enc"):
        measure_sign(hand.bench, nothing)


def test_ctrl_c_ends_the_force():
    with Hand({"commissioning": True}, touch=FRICTION) as hand:

        def interrupted(topics, look_s=0.05):
            if hand.bench.status().state == "enabled":
                raise KeyboardInterrupt
            return type(hand.bench).messages(hand.bench, topics, look_s)

        hand.bench.messages = interrupted
        with pytest.raises(KeyboardInterrupt):
            measure_sign(hand.bench, nothing)
        assert hand.bench.status().state == "disabled"


def test_a_device_that_is_enabled_is_left_alone():
    with Hand() as hand:
        hand.bench.enable()
        with pytest.raises(CommandError, match="disabled"):
            measure_sign(hand.bench, nothing)


def test_gain_waits_for_the_signs():
    with Hand({"commissioning": True}) as hand, pytest.raises(AnalysisError, match="signs"):
        measure_gain(hand.bench, nothing, HUNG)


def test_a_mass_in_grams_is_refused_before_it_hangs():
    with Hand() as hand, pytest.raises(AnalysisError, match="grams"):
        measure_gain(hand.bench, nothing, Masses((0.0, 50.0, 100.0)))


def readings(weights_n, scale=1.0, offset_n=0.0):
    forces = (weights_n - offset_n) / scale
    return np.stack([forces + 0.02, forces - 0.02], axis=1)


DEVICE = to_plain(device_params())


def test_one_mass_typed_ten_times_wrong_is_refused():
    masses = Masses((0.0, 0.05, 0.1, 0.15))
    truth = 9.80665 * np.array([0.0, 0.05, 0.01, 0.15])
    result = analyse(masses.weights_n, readings(truth), masses, DEVICE)
    assert not result.settled
    assert not result.changes
    assert "typed wrong" in result.findings[0].remedy


def test_all_masses_typed_ten_times_wrong_are_refused():
    masses = Masses((0.0, 0.5, 1.0))
    result = analyse(masses.weights_n, readings(masses.weights_n / 10), masses, DEVICE)
    assert not result.settled
    assert "kg" in result.findings[1].remedy


@pytest.mark.parametrize("home_n", [0.5, 1.9])
def test_a_weaker_motor_leaves_the_device_file_valid(tmp_path, home_n):
    file = tmp_path / "device.toml"
    text = (DEVICES / "example-board.toml").read_text()
    file.write_text(text.replace("force_n = 0.5 ", f"force_n = {home_n} "))
    device = device_params_of(load_device(file))
    masses = Masses((0.0, 0.05, 0.1))
    told = readings(masses.weights_n, scale=0.7)
    result = analyse(masses.weights_n, told, masses, to_plain(device))
    written = write_changes(file, result.changes, "rig motor", date(2026, 11, 22))
    assert written.limits.force_n < 0.7 * device.force_limit_n
    assert written.home.force_n == min(home_n, written.limits.force_n)


def test_a_push_ends_though_nobody_is_there_any_more():
    """The process is killed as soon as it has asked for the push."""
    with Hand({"commissioning": True}, touch=TouchParams(coulomb_n=5.0, static_n=5.0)) as hand:
        bench = hand.bench
        asked = []

        def killed(cmd, **fields):
            asked.append(cmd)
            if asked.count("set") == 1:  # its end is in it
                answer = type(bench).call(bench, cmd, **fields)
                del bench.call
                raise SystemExit(answer)
            return type(bench).call(bench, cmd, **fields)

        bench.enable()
        bench.call = killed
        with pytest.raises(SystemExit):
            push(bench, 0.5, 0.02)
        records = as_records(bench.run(600))
        pushed = np.flatnonzero(records["force_n"])
        assert len(pushed) == 20
        assert np.ptp(pushed) == 19
