"""What a host that stood still has missed does not come at once when it goes on."""

import numpy as np
import pytest
from support.boards import board_params
from support.flight import enabled
from support.models import COUNT_M, device_params, servo_params
from support.winding_table import TABLE

from benchmarks.thermal import device as heated_device
from hapticd.core.params import SafetyParams, ScaleParams
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.model.params import HandParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.compensation import UNKNOWN_S
from hapticd.servo.plan import SETTLED

pytestmark = pytest.mark.usefixtures("either_way")


OFF = ScaleParams(COUNT_M, offset_count=-round(0.010 / COUNT_M))
HELD = TouchParams(hands=(HandParams("hold", stiffness_n_per_m=2e4, damping_ns_per_m=50.0),))
STEP_N = 0.5


def paused(stack, pause_ms):
    """The host stands still; the simulated board goes on."""
    for _ in range(pause_ms):
        stack.clock.sleep_until_ns(stack.clock.now_ns() + NS_PER_MS)
        stack.backend._port.advance(stack.clock.now_ns())


@pytest.mark.parametrize("pause_ms", [4, 6, 8])
@pytest.mark.parametrize("change", ["enable", "ramp"])
def test_easing_is_bounded_behind_lost_slots(change, pause_ms):
    """5 N come within 20 ms, of which the host sleeps through a part: as many samples are lost as
    the filters can bridge.
    """
    servo = servo_params(
        device=device_params(position=OFF, force_step_n=STEP_N),
        safety=SafetyParams(enable_ramp_s=0.02),
    )
    stiff = {Value.STIFFNESS: 500.0, Value.RAMP_S: 0.0 if change == "enable" else 0.02}
    with LockStep(servo, board_params(touch=HELD)) as stack:
        axis = stack.backend._port._axis
        stack.run(1200)
        if change == "ramp":
            stack.do(Command.ENABLE)
            stack.run(100)
        assert stack.do(Command.SET, stiff).result is Result.APPLIED
        if change == "enable":
            stack.do(Command.ENABLE)
        forces = []
        for tick in range(120):
            if tick == 4:
                paused(stack, pause_ms)
            stack.run(1)
            forces.append(axis.force_n)
        ticks = as_records(b"".join(stack.blocks[-120:]))
    assert np.diff(ticks["slot"].astype(int)).max() >= pause_ms
    assert np.abs(np.diff(forces)).max() <= STEP_N + 0.01
    assert forces[-1] == pytest.approx(-4.88, abs=0.05)
    assert (ticks["flags"] & Flag.EASED).any()
    assert not (ticks["flags"] & Flag.QUIET_RAMP).any()


@pytest.mark.parametrize("pause_ms", [300, 2_000, 60_000])
def test_the_resistance_trim_never_steps_after_a_pause_of_the_host(pause_ms):
    """It is on its way up from 0, and goes on with its slew."""
    with LockStep(*heated_device()) as stack:
        stack.run(60)
        before = stack.loop.state[SETTLED].plan.winding.trim_ohm
        stack.clock.time_ns += pause_ms * NS_PER_MS
        trims = [before]
        for _ in range(400):
            stack.run(1)
            trims.append(stack.loop.state[SETTLED].plan.winding.trim_ohm)
        counts = as_records(b"".join(stack.blocks))["resistance_count"].astype(int)
        slew = stack.loop.params.device.resistance.slew_ohm_per_s
    most_ohm = slew * min(UNKNOWN_S, 1e-3 * pause_ms + 0.15)
    assert 0.0 < np.abs(np.diff(trims)).max() <= 1.01 * most_ohm
    assert np.abs(np.diff(counts)).max() <= 1.01 * most_ohm / TABLE.trim.per_count + 1


def test_damping_that_is_asked_behind_lost_slots_has_not_missed_them():
    """A ramp of K was running while 8 slots were lost."""
    flight = enabled(servo_params())
    flight.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 1.0})
    flight.fly(10)
    flight.tick += 8
    on = {Value.ACTIVE_DAMPING: 2.0, Value.ACTIVE_DAMPING_ON: 1.0}
    assert flight.do(Command.DAMPING, on, arrival=8) is Result.APPLIED
    slew = 1e-3 * flight.params.safety.active_damping_slew_ns_per_m_s
    assert flight.plan.added == pytest.approx(slew)
    flight.tick += 8
    flight.fly(arrival=8)
    assert flight.plan.added == pytest.approx(10 * slew)  # it was on its way
    flight.tick += 8
    off = {Value.ACTIVE_DAMPING_ON: 0.0}
    assert flight.do(Command.DAMPING, off, arrival=8) is Result.APPLIED
    assert flight.plan.added == pytest.approx(9 * slew)  # it turns back
