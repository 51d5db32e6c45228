"""An enable or a change of parameters never steps the force further than the device file says."""

from itertools import pairwise

import pytest
from support.boards import board_params
from support.flight import Flight, enabled, masked
from support.models import COUNT_M, COUNT_N, device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.params import SafetyParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import FAULT_EVENT, LATCHED

FAR = 38_000  # counts = 19 mm
ROUNDING_N = 1.001 * COUNT_N  # of the force as sent, up on one tick and down on the next
SOLID = {Value.WALL_STIFFNESS: 5000.0, Value.WALL_VIRTUAL_DAMPING: 5.0, Value.WALL_SIDE: 1.0}


def params_with(step_n, enable_ramp_s=0.5):
    return servo_params(
        device=device_params(force_step_n=step_n), safety=SafetyParams(enable_ramp_s=enable_ramp_s)
    )


def largest_step(forces):
    return max(abs(b - a) for a, b in pairwise(forces))


@pytest.mark.parametrize("step_n", [0.1, 1.0])
@pytest.mark.parametrize("enable_ramp_s", [0.0, 0.01, 0.5])
@pytest.mark.parametrize(
    "settings",
    [{Value.STIFFNESS: 1e5}, {Value.STIFFNESS: 400.0}, {**SOLID, Value.WALL_POSITION: -0.01}],
)
def test_enable_far_from_the_handle_steps_no_further_than_the_device_allows(
    settings, enable_ramp_s, step_n
):
    flight = Flight(params_with(step_n, enable_ramp_s), FAR)
    flight.do(Command.SET, {**settings, Value.RAMP_S: 0.0})
    forces = [flight.fly()[8]]
    assert flight.do(Command.ENABLE) is Result.APPLIED
    forces += [flight.out[8], *(flight.fly()[8] for _ in range(700))]
    assert largest_step(forces) <= step_n + ROUNDING_N
    expected = -7.6 if settings == {Value.STIFFNESS: 400.0} else -8.0
    assert forces[-1] == pytest.approx(expected, abs=COUNT_N)


def test_enable_brings_a_force_at_its_limit_along_the_whole_ramp():
    flight = Flight(params_with(1.0), FAR)
    flight.do(Command.SET, {Value.STIFFNESS: 1e5, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    forces = [flight.fly()[8] for _ in range(500)]
    assert forces[249] == pytest.approx(-4.0, abs=0.02)
    assert largest_step(forces) <= 8.0 / 500 + ROUNDING_N


def test_stop_takes_a_force_at_its_limit_away_along_its_ramp():
    flight = enabled(params_with(1.0), {Value.STIFFNESS: 1e5}, FAR)
    flight.do(Command.STOP)
    forces = [flight.fly()[8] for _ in range(22)]
    assert forces[9] == pytest.approx(-4.0, abs=0.01)
    assert largest_step([-8.0, *forces]) <= 8.0 / 20 + ROUNDING_N
    assert forces[20] == 0.0


@pytest.mark.parametrize("ending", ["stop", "fault", "fault after lost slots"])
@pytest.mark.parametrize("enable_ramp_s", [0.0, 0.02, 0.5])
def test_an_enable_that_is_ended_on_its_way_never_pushes_harder_than_it_did(enable_ramp_s, ending):
    """The gain that fades is the one that was in force, not where its ramp would have been."""
    flight = Flight(params_with(0.1, enable_ramp_s), FAR)
    flight.do(Command.SET, {Value.STIFFNESS: 1e5, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    acted_n = flight.fly(40)[8]
    assert -5.0 < acted_n < -0.5
    if ending == "stop":
        flight.do(Command.STOP)
    else:
        flight.tick += 7 * ending.endswith("lost slots")
        flight.event(FAULT_EVENT, BY_CODE["lost_slots"].number)
    assert flight.plan.state in LATCHED
    forces = [flight.out[8], *(flight.fly()[8] for _ in range(25))]
    assert forces[0] == pytest.approx(acted_n, abs=ROUNDING_N)
    assert all(abs(b) <= abs(a) for a, b in pairwise(forces))
    assert forces[-1] == 0.0


CHANGES = [
    ({Value.STIFFNESS: 0.0}, {Value.STIFFNESS: 1e5}),
    ({Value.STIFFNESS: 1e5}, {Value.STIFFNESS: 0.0}),
    ({Value.STIFFNESS: 400.0}, {Value.STIFFNESS: -400.0}),
    ({**SOLID, Value.WALL_POSITION: 1.0}, {Value.WALL_POSITION: 0.0}),
    ({**SOLID, Value.WALL_POSITION: -1.0}, {Value.WALL_POSITION: 0.02}),
    (SOLID, {Value.WALL_SIDE: -1.0}),
    ({}, {**SOLID, Value.STIFFNESS: 200.0, Value.VIRTUAL_DAMPING: 50.0, Value.MASS: 1.0}),
]


@pytest.mark.parametrize("step_n", [0.1, 1.0])
@pytest.mark.parametrize("ramp_s", [0.0, 0.02])
@pytest.mark.parametrize(("first", "change"), CHANGES)
def test_no_change_steps_the_force_further_than_the_device_allows(first, change, ramp_s, step_n):
    flight = enabled(params_with(step_n), {Value.STIFFNESS: 0.0, **first}, FAR)
    flight.fly(300)
    forces = [flight.fly()[8]]
    flight.do(Command.SET, {**change, Value.RAMP_S: ramp_s})
    forces += [flight.out[8], *(flight.fly()[8] for _ in range(1500))]
    assert largest_step(forces) <= step_n + ROUNDING_N
    assert all(flight.plan.values[place].value(flight.tick) == change[place] for place in change)
    assert not flight.fly()[9] & (Flag.EASED | Flag.RAMPING)


def test_a_stiff_wall_that_is_hit_steps_as_it_must():
    flight = enabled(params_with(0.1), {**SOLID, Value.WALL_VIRTUAL_DAMPING: 0.0})
    assert flight.fly(1, encoder=2000)[8] == pytest.approx(-5.0, abs=COUNT_N)


@pytest.mark.parametrize("late", [0, 5])
def test_a_change_in_a_stop_waits_until_the_force_is_gone(late):
    """In the tick of the stop, or while it fades: what acted goes on, and nothing else."""
    flight = enabled(params_with(0.5), {Value.STIFFNESS: 20.0}, 1000)
    change = (7, int(Command.SET), 9, 0, masked({Value.STIFFNESS: 1e5, Value.RAMP_S: 0.0}))
    forces = [flight.out[8]]
    for n in range(40):
        stops = [(0, int(Command.STOP), 9, 0, masked({}))] if n == 0 else []
        flight._one((*([change] if n == late else []), *stops))
        forces.append(flight.out[8])
    assert largest_step(forces) <= 0.5 + ROUNDING_N
    assert min(forces) == forces[0] == pytest.approx(-20.0 * 1000 * COUNT_M, abs=COUNT_N)
    assert forces[-1] == 0.0
    assert flight.blob["stiffness_n_per_m"] == 1e5


@pytest.mark.parametrize("ramp_s", [0.0, 0.01])
def test_parameters_wait_while_the_force_is_held_for_want_of_a_sample(ramp_s):
    """Else all that they did meanwhile would come at once with the next sample."""
    flight = enabled(params_with(0.5), None, 20_000)
    forces = [flight.out[8]]
    flight.do(Command.SET, {Value.STIFFNESS: 600.0, Value.RAMP_S: ramp_s})
    forces.append(flight.out[8])
    for n in range(60):
        lost = 2 <= n < 4  # more in a row take the force away as a whole
        flight.fly(1, arrival=1 - n if lost else 2 if n == 4 else 0)
        forces.append(flight.out[8])
    assert largest_step(forces) <= 0.5 + ROUNDING_N
    assert forces[-1] == pytest.approx(-6.0, abs=COUNT_N)


def test_records_show_the_values_that_were_in_force():
    flight = enabled(params_with(0.5), None, FAR)
    flight.do(Command.SET, {Value.STIFFNESS: 300.0, Value.RAMP_S: 0.0})
    shown = []
    for _ in range(30):
        out = flight.fly()
        assert out[4] == pytest.approx(-flight.blob["stiffness_n_per_m"] * 0.019, rel=1e-12)
        shown.append(bool(out[9] & Flag.EASED))
    assert shown[0]
    assert not shown[-1]
    assert shown == sorted(shown, reverse=True)


def test_force_at_the_motor_steps_no_further_at_enable_and_change():
    """A heavy handle that a leaking mass keeps 10 mm off, enabled at once and changed at once."""
    params = params_with(0.5, enable_ramp_s=0.0)
    with LockStep(params, board_params(mass_kg=100.0)) as stack:
        stack.run(5)
        stack.load_waveform([32767] * 4000)
        stack.do(Command.ENABLE)
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 4000.0, Value.LOOP: 1.0})
        stack.run(1000)
        axis = stack.backend._port._axis
        forces = [axis.force_n]
        for stiffness in (1e5, 100.0, 1e5, 0.0):
            stack.command(Command.SET, {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.0})
            for _ in range(40):
                stack.run(1)
                forces.append(axis.force_n)
    assert min(forces) == pytest.approx(-8.0, abs=0.01)
    assert largest_step(forces) <= 0.5 + 0.05  # the handle goes on moving
