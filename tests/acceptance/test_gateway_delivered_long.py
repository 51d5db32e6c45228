"""Intervals of the delivered active damping hold the truth in many flights, and the guard acts on
them (tests/lockstep/test_gateway_delivered.py has the single cases).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.boards import board_params
from support.delivered import (
    DISPLAY,
    FREE,
    HAND,
    LEVEL,
    SCENES,
    begun,
    circuit,
    damped,
    flown,
    followed,
    holds,
    parts,
    rendered,
    shaken,
)
from support.guard_device import shipped_setup
from support.guard_stub import StubWorker, verdict
from support.models import device_params, servo_params
from support.recorded import RecordedFlight
from test_gateway_delivered import changed, failed

from hapticd.core.faults import BY_CODE
from hapticd.core.params import RealtimeParams
from hapticd.guard.delivered import Delivered
from hapticd.guard.judge import Judge
from hapticd.mailbox.layout import Command, State, Value
from hapticd.model.params import InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep, scene_params


def scene_at(folder: Path, winding_c: float) -> Path:
    """The scene of figure 4 with a winding of this temperature."""
    text = (SCENES / "fig4.toml").read_text().replace("seconds = 90.0", "seconds = 9.0")
    winding = f"[model.winding]\ntemperature_c = {winding_c}\n"
    path = folder / "warm.toml"
    path.write_text(f'{text}\n{winding}sources = {{ temperature_c = "inferred" }}\n')
    return path


@pytest.mark.parametrize("environment", [FREE, DISPLAY, (50.0, 2.0, 0.0), (0.0, 2.0, 0.0)])
@pytest.mark.parametrize("level", [0.5, LEVEL, 5.0])
def test_interval_holds_what_the_circuit_delivers(level, environment):
    """The residual resistance weakens damping and force alike; the back-EMF alone shows neither."""
    found, lows = followed(*flown(environment, level))
    assert holds(found, circuit(level))
    assert found.estimate_ns_per_m == pytest.approx(circuit(level), rel=0.05)
    assert found.commanded == pytest.approx(level, abs=1e-3)
    assert found.basis == "current, back-EMF and encoder"
    assert not lows


@pytest.mark.parametrize("winding_c", [20.0, 80.0, 120.0])
def test_hot_winding_delivers_less_and_it_is_seen(tmp_path, winding_c):
    """From 80 degC on, 15 % and more of the damping are lost, which the back-EMF cannot show."""
    servo, board = scene_params(scene_at(tmp_path, winding_c))
    with LockStep(servo, board) as stack:
        begun(stack, DISPLAY, 5.0)
        shaken(stack, 1, 0.21, 8000)
        stack.run(8000)
        found, lows = followed(servo, as_records(b"".join(stack.blocks)))
    truth = circuit(5.0, 1.6 * 0.00393 * (winding_c - 20.0))
    assert holds(found, truth)
    assert found.estimate_ns_per_m == pytest.approx(truth, rel=0.05)
    assert len(lows) == (found.high < 0.8 * 5.0)


@pytest.mark.parametrize("level", [0.5, LEVEL, 5.0])
@pytest.mark.parametrize("environment", [FREE, (0.0, 2.0, 0.0), (200.0, 1.0, 0.005)])
def test_interval_holds_under_a_moving_hand(level, environment):
    found, lows = followed(*flown(environment, level, 0.0, touch=TouchParams(hands=(HAND,))))
    assert holds(found, circuit(level))
    assert not lows


@pytest.mark.parametrize("limit_n", [0.5, 2.0])
@pytest.mark.parametrize("environment", [(1500.0, 0.0, 0.0), (0.0, 12.0, 0.0), (0.0, 0.0, -0.03)])
def test_interval_holds_in_a_limit_cycle(environment, limit_n):
    """Everything has one frequency, and the force stands at its limit."""
    servo, records = flown(environment, ticks=4000, shaken_ticks=1000, limit_n=limit_n)
    assert np.abs(records["force_n"][-1000:]).max() > 0.99 * limit_n
    found, lows = followed(servo, records)
    assert holds(found, circuit(LEVEL))
    assert not lows


def test_force_that_follows_the_velocity_is_not_taken_for_damping():
    """At 47 Hz the smoothed force of K = 4000 N/m is nearly in phase with the velocity."""
    servo, records = flown((4000.0, 0.0, 0.0), 5.0, ticks=6000, shaken_ticks=1000, limit_n=2.0)
    assert np.abs(records["force_n"][-1000:]).max() > 1.98
    found, _ = followed(servo, records)
    assert found.low is None or holds(found, circuit(5.0))


def test_what_was_seen_at_another_level_does_not_count():
    """Damping is switched at 4 s, and slewed: unknown for 2 s, then what is delivered now."""
    servo, board = parts()
    slewed = replace(servo, safety=replace(servo.safety, active_damping_slew_ns_per_m_s=5.0))
    with LockStep(slewed, board) as stack:
        begun(stack, DISPLAY, 4.0)
        shaken(stack, 1, 0.21, 9000)
        stack.run(4000)
        damped(stack, 0.5)
        stack.run(5000)
        records = as_records(b"".join(stack.blocks))
    delivered = Delivered(slewed, lambda: None)
    known = []
    for start in range(0, len(records), 256):
        assert not delivered.take(records[start : start + 256])
        if delivered.estimate.low is not None:
            known.append(start)
            assert holds(delivered.estimate, circuit(4.0 if start < 4200 else 0.5))
    assert not [start for start in known if 4200 < start < 6000]
    assert [start for start in known if 6000 < start < 7500]
    assert holds(delivered.estimate, circuit(0.5))


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 2000.0])
def test_rigid_device_delivers_what_is_commanded_at_every_rate(rate_hz):
    """Without smoothing and without lag; seconds are seconds."""
    motor = device_params(motor_n_per_a=board_params().torque_constant_n_per_a)
    servo = servo_params(device=motor, realtime=RealtimeParams(rate_hz=rate_hz, mode="off"))
    board = board_params(rate_hz=rate_hz, emf_velocity_m_per_s_per_count=1.0 / 32767)
    with LockStep(servo, board) as stack:
        begun(stack, DISPLAY, 1.0)
        shaken(stack, 1, 0.21, 6000)
        stack.run(round(6 * rate_hz))
        found, lows = followed(servo, as_records(b"".join(stack.blocks)))
    assert holds(found, 1.0)
    assert found.seconds == pytest.approx(4.0, rel=0.1)
    assert not lows


@pytest.mark.parametrize("seed", range(10))
def test_healthy_device_is_never_warned_of(seed):
    """Random levels, environments and shaking."""
    random = np.random.default_rng(seed)
    level = random.uniform(0.3, 5.0)
    environment = (random.uniform(0, 200), random.uniform(0, 2), random.uniform(0, 0.01))
    found, lows = followed(*flown(environment, level, random.uniform(0.03, 0.3), seed))
    assert not lows
    assert found.low is None or holds(found, circuit(level))


def counted_on(least: float | None) -> StubWorker:
    """A worker by which the environment needs `least` N s/m."""
    found = verdict(least_active_damping_ns_per_m=least)
    return StubWorker(lambda asked: {"verdict": found} if asked["ask"] == "look" else None)


def flown_with_gateway(
    policy: str, worker: StubWorker, gain: float, environment: Sequence[float] = DISPLAY
) -> RecordedFlight:
    """10 s, the circuit fails at 3 s."""
    injections = (InjectionParams("active_damping_gain", tick=3000, count=100_000, value=gain),)
    flight = RecordedFlight(*parts(injections=injections), policy=policy, worker=worker)
    with flight:
        flight.stack.run(5)
        flight.stack.command(Command.SET, rendered(environment))
        flight.stack.command(Command.ENABLE)
        flight.fly(20)
        on = {Value.ACTIVE_DAMPING: LEVEL, Value.ACTIVE_DAMPING_ON: 1.0}
        flight.stack.command(Command.DAMPING, on)
        flight.fly(20)
        noise = np.random.default_rng(1).integers(-6000, 6001, 40_000)
        flight.stack.load_waveform(noise.tolist())
        flight.stack.command(Command.PERTURB_START, {Value.SAMPLES: 40_000.0, Value.LOOP: 0.0})
        flight.fly(20)
        assert flight.view.answers()
        flight.fly(10_000)
    return flight


@pytest.mark.parametrize(
    ("policy", "least", "ends"),
    [
        ("refuse", 1.5, True),
        ("follow", 1.5, True),
        ("clamp", 0.2, False),
        ("refuse", None, False),
        ("warn", 1.5, False),
    ],
)
def test_servo_ends_force_where_the_guard_counts_on_the_damping(policy, least, ends):
    """Half of the damping is lost: told in any case, a fault where the policy would have refused
    the environment without it.
    """
    flight = flown_with_gateway(policy, counted_on(least), 0.5)
    warnings = [one for one in flight.journal.recent if one["kind"] == "warning"]
    assert len(warnings) == 1
    assert "N s/m commanded" in warnings[0]["text"]
    state, fault = (int(flight.records[name][-1]) for name in ("state", "fault"))
    lost = BY_CODE["damping_not_delivered"].number
    assert (state, fault) == ((State.FAULT, lost) if ends else (State.ENABLED, 0))


def test_healthy_damping_that_is_counted_on_ends_nothing():
    flight = flown_with_gateway("refuse", counted_on(1.5), 1.0)
    assert int(flight.records["state"][-1]) == State.ENABLED
    found = flight.publisher.state(0)["delivered_active_damping"]
    assert found["low"] <= circuit(LEVEL) <= found["high"]
    assert found["ratio"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("stiffness", "ends"), [(200.0, True), (20.0, False)])
def test_judge_itself_says_what_is_needed(stiffness, ends):
    """Of 1.74 N s/m 0.3 are left: too little for K = 200 N/m, enough for 20."""
    judge = Judge(shipped_setup())
    worker = StubWorker(lambda asked: judge.answer({**asked, "n": 0}))
    flight = flown_with_gateway("refuse", worker, 0.3, (stiffness, 0.0, 0.0))
    assert any(asked["ask"] == "look" for asked in worker.asked)
    last = flight.records[-1]
    assert int(last["state"]) == (State.FAULT if ends else State.ENABLED)
    assert [one["kind"] for one in flight.journal.recent].count("warning") == 1


@pytest.mark.parametrize("gain", [0.0, 0.3, 0.6])
def test_circuit_that_delivers_less_is_found_and_told_once(gain):
    found, lows = followed(*failed((("active_damping_gain", gain),)))
    assert holds(found, circuit(gain * LEVEL))
    assert found.high < 0.8 * LEVEL
    assert [(low.warn, low.fault) for low in lows] == [(True, False)]
    assert lows[0].estimate.commanded == pytest.approx(1.74, abs=1e-3)


def test_amplifier_that_stands_still_delivers_no_damping():
    found, lows = followed(*failed((("amplifier_stuck", 0.2), ("active_damping_gain", 0.0))))
    assert holds(found, 0.0)
    assert len(lows) == 1


@pytest.mark.parametrize("gain", [0.5, 1.5])
def test_gain_of_the_force_is_not_taken_for_damping(gain):
    found, lows = followed(*failed((("amplifier_gain", gain),)))
    assert holds(found, circuit(LEVEL))
    assert not lows


@pytest.mark.parametrize("name", ["position_m", "force_n"])
def test_position_or_force_that_is_no_number_is_left_out(name):
    servo, records = flown(ticks=6000, shaken_ticks=6000)
    values = records[name].copy()
    values[4000:4100:31] = np.nan
    found, lows = followed(servo, changed(records, **{name: values}))
    assert holds(found, circuit(LEVEL))
    assert not lows


def test_what_is_known_gets_old():
    """At 3 s the current sensor stays at its end; 4 s later nothing is known any more."""
    servo, records = flown(ticks=8000, shaken_ticks=8000)
    current = records["current_a"].copy()
    current[3000:] = 32767 * servo.device.current.per_count
    stuck = changed(records, current_a=current)
    assert holds(followed(servo, stuck[:3000])[0], circuit(LEVEL))
    assert followed(servo, stuck)[0].estimate_ns_per_m is None


def test_lost_frames_and_gaps_in_the_records_are_left_out():
    losses = tuple(InjectionParams(kind, probability=0.01) for kind in ("drop_in", "drop_out"))
    servo, records = flown(ticks=6000, shaken_ticks=6000, injections=losses)
    delivered = Delivered(servo, lambda: None)
    for start in range(0, 6000, 20):
        if start % 1000 == 500:
            delivered.forget()
            continue
        assert not delivered.take(records[start : start + 20])
    assert holds(delivered.estimate, circuit(LEVEL))
    assert delivered.estimate.seconds < 4.0


@pytest.mark.parametrize(("relied_on", "faults"), [(0.5, 0), (1.2, 1), (None, 0)])
def test_fault_is_asked_for_once_and_only_where_the_damping_is_relied_on(relied_on, faults):
    """0.6 of 1.74 are about 1.1 N s/m."""
    _, lows = followed(*failed((("active_damping_gain", 0.6),)), relied_on=relied_on)
    assert sum(low.warn for low in lows) == 1
    assert sum(low.fault for low in lows) == faults


def test_low_damping_is_told_after_it_was_low_for_three_seconds():
    servo, records = failed((("active_damping_gain", 0.3),))
    delivered = Delivered(servo, lambda: None)
    since = None
    for start in range(0, len(records), 256):
        lows = delivered.take(records[start : start + 256])
        high = delivered.estimate.high
        if since is None and high is not None and high < 0.8 * LEVEL:
            since = start
        if lows:
            break
    assert since is not None
    assert start - since == 11 * 256


def test_without_current_the_voltage_over_a_known_resistance_serves():
    servo, records = flown()
    blind = changed(records, current_a=0.0)
    found, _ = followed(servo, blind)
    assert holds(found, circuit(LEVEL))
    assert found.basis == "voltage, resistance and encoder, no current"
    nothing = replace(servo, device=replace(servo.device, winding_ohm=0.0))
    assert followed(nothing, blind)[0].basis.startswith("unknown: the board sends no current")
