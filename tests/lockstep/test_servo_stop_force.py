"""A stop without force makes none: what a latched state fades is what acted by authority, whatever
else was asked for in the same tick.
"""

from itertools import pairwise, product

import pytest
from support.boards import board_params
from support.flight import Flight, enabled
from support.models import COUNT_N, device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.params import HomeParams, SafetyParams, ScaleParams
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, Value
from hapticd.run.lockstep import LockStep
from hapticd.servo import safety
from hapticd.servo.plan import SETTLED
from hapticd.servo.safety import FAULT_EVENT, LATCHED, State
from hapticd.usb.frames import OutFlag, StatusBit

pytestmark = pytest.mark.usefixtures("either_way")


PRESSED = {Value.STIFFNESS: 200.0}
DENTED = 38_000  # counts = 19 mm: -3.8 N at 200 N/m
FADE_TICKS = 20
FRACTION = ScaleParams(COUNT_N, offset_count=12.4)
HOME = HomeParams(method="stop", force_n=0.5)
KINDS = (
    Command.ENABLE,
    Command.DISABLE,
    Command.STOP,
    Command.RESET,
    Command.HOME,
    FAULT_EVENT,
)
GATHERED = [*product(KINDS, repeat=2), *product(KINDS, repeat=3)]


def params_of(enable_ramp_s=0.5):
    return servo_params(
        device=device_params(home=HOME, force=FRACTION),
        safety=SafetyParams(enable_ramp_s=enable_ramp_s),
    )


def flight_in(begin, params):
    """A flight in the named state, with all the force that this state can have."""
    if begin in ("disabled", "homing"):
        flight = Flight(params, DENTED)
        flight.do(Command.SET, {**PRESSED, Value.RAMP_S: 0.0})
        if begin == "homing":
            flight.do(Command.HOME)
            flight.fly(100)
        return flight
    flight = enabled(params, PRESSED, DENTED)
    if begin != "enabled":
        flight.do(Command.STOP)
        flight.fly(5 if begin == "stopping" else 40)
    return flight


def requests(kinds):
    values = (float(BY_CODE["lost_slots"].number), *(0.0,) * 19)
    return tuple((0, int(kind), 9, 0, values) for kind in kinds)


def acts_after(state, lost, acting, kinds):
    """State after `kinds`, and whether the force that acted before may go on: only through states
    that grant torque or fade it, one after the other. `lost`: there is no origin to enable at.
    """
    in_order = [kind for kind in kinds if kind != Command.STOP]
    in_order += [kind for kind in kinds if kind == Command.STOP]
    for kind in in_order:
        target = safety.transition(state, kind)
        if isinstance(target, State) and not (lost and kind == Command.ENABLE):
            state = target
        lost = lost or state is State.HOMING
        acting = acting and state is not State.DISABLED
    return state, acting


@pytest.mark.parametrize("enable_ramp_s", [0.5, 0.0])
@pytest.mark.parametrize("begin", ["disabled", "enabled", "homing", "stopping", "stopped"])
def test_commands_of_one_tick_leave_a_latched_state_no_force_but_what_acted(begin, enable_ramp_s):
    start = flight_in(begin, params_of(enable_ramp_s))
    acting = bool(start.state[SETTLED].out_flags & OutFlag.ENABLE)
    before = abs(start.fly()[8])
    kept = start.state, start.tick
    for kinds in GATHERED:
        start.state, start.tick = kept
        state, acts = acts_after(start.plan.state, start.plan.origin_lost, acting, kinds)
        out = start._one(requests(kinds))
        assert start.plan.state is state
        if state not in LATCHED:
            continue
        forces = [abs(out[8])]
        granted = [start.state[SETTLED].out_flags & OutFlag.ENABLE]
        for _ in range(FADE_TICKS):
            forces.append(abs(start.fly()[8]))
            granted.append(start.state[SETTLED].out_flags & OutFlag.ENABLE)
        assert forces[-1] < COUNT_N, kinds
        assert not granted[-1], kinds
        assert all(b <= a + COUNT_N for a, b in pairwise([before, *forces])), kinds
        if not acts:
            assert max(forces) < COUNT_N, kinds
            assert not any(granted), kinds


PAIRS = [*product(KINDS[:4], repeat=2)]
REPEATED = [(kinds, True) for kinds in PAIRS]
REPEATED += [(kinds, False) for kinds in PAIRS if Command.STOP in kinds]


@pytest.mark.parametrize(("kinds", "page"), REPEATED)
def test_commands_repeated_every_tick_never_renew_a_fading_force(kinds, page):
    """Force at the simulated motor; the stop is pressed by its page in every tick as well, or by
    whoever gives the other commands, whose reset is then obeyed.
    """
    with LockStep(servo_params(), board_params(mass_kg=1.0)) as stack:
        stack.run(5)
        stack.do(Command.SET, {**PRESSED, Value.RAMP_S: 0.0})
        stack.do(Command.ENABLE)
        stack.load_waveform([32767] * 600)
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 600.0, Value.LOOP: 0.0})
        stack.run(700)
        axis = stack.backend._port._axis
        before = abs(axis.force_n)
        assert before > 0.1
        forces = []
        for _ in range(FADE_TICKS + 30):
            for kind in kinds:
                stack.command(kind)
            if page:
                press_stop(stack.mailbox.folder)
            stack.run(1)
            stack.gateway.answers()
            forces.append(abs(axis.force_n))
    assert max(forces) < before * 1.1
    assert not any(forces[FADE_TICKS + 1 :])


def test_stop_from_disabled_grants_no_torque_though_zero_force_lies_between_two_counts():
    flight = Flight(params_of())
    assert 0.0 < abs(flight.fly()[8]) < COUNT_N
    flight.do(Command.STOP)
    granted = 0
    for _ in range(FADE_TICKS):
        granted += bool(flight.state[SETTLED].out_flags & OutFlag.ENABLE)
        flight.fly()
    assert granted == 0


@pytest.mark.parametrize("taken", [0, StatusBit.EMERGENCY_STOP, StatusBit.AMPLIFIER_FAULT])
def test_a_stop_in_the_tick_in_which_the_board_takes_the_torque_fades_nothing(taken):
    """A contact that bounces gives it back in the next tick."""
    flight = enabled(params_of(), PRESSED, DENTED)
    assert flight.out[8] == pytest.approx(-3.8, abs=COUNT_N)
    flight.do(Command.STOP, status=int(taken))
    assert flight.plan.state in LATCHED
    assert not flight.state[SETTLED].out_flags & OutFlag.ENABLE
    forces = [flight.out[8]]
    for _ in range(FADE_TICKS):
        forces.append(flight.fly(status=int(StatusBit.ENABLED))[8])
    assert max(map(abs, forces)) < COUNT_N


def test_a_fade_that_the_board_interrupts_does_not_go_on():
    flight = enabled(params_of(), PRESSED, DENTED)
    flight.do(Command.STOP)
    assert flight.fly(3)[8] < -3.0
    flight.fly(status=int(StatusBit.EMERGENCY_STOP))
    forces = [flight.out[8]]
    for _ in range(FADE_TICKS):
        forces.append(flight.fly(status=int(StatusBit.ENABLED))[8])
    assert max(map(abs, forces)) < COUNT_N
