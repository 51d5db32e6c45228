"""The force path against an unkind board: what arrives late, authority that is taken away, a
board that starts anew. Everything runs in lock-step and is judged at the simulated motor.
"""

import numpy as np
import pytest
from support.boards import BOARD, board_params
from support.flight import HEALTHY, Flight
from support.models import COUNT_M, device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.params import HomeParams, ScaleParams
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import HandParams, InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import AMPLIFIER_TOLD
from hapticd.servo.safety import State
from hapticd.usb.frames import StatusBit

pytestmark = pytest.mark.usefixtures("either_way")


FIG_WALL = {Value.STIFFNESS: 200.0, Value.VIRTUAL_DAMPING: 3.0, Value.RAMP_S: 0.0}
SPRING = {Value.STIFFNESS: 500.0, Value.VIRTUAL_DAMPING: 2.0, Value.RAMP_S: 0.0}


def enable(stack, settings):
    stack.run(5)
    assert stack.do(Command.SET, settings).result is Result.APPLIED
    assert stack.do(Command.ENABLE).result is Result.APPLIED
    stack.run(520)


def perturbed(stack, amplitude=1000, seed=3):
    noise = np.random.default_rng(seed).integers(-amplitude, amplitude + 1, 8000)
    stack.load_waveform(noise.tolist())
    wave = {Value.SAMPLES: 8000.0, Value.LOOP: 1.0}
    assert stack.do(Command.PERTURB_START, wave).result is Result.APPLIED


# --- an old frame is known to be old --------------------------------------------------------------
@pytest.mark.parametrize("depth", [1, 2, 4])
def test_one_late_delivery_does_not_leave_the_link_behind(depth):
    """K = 200 N/m, B = 3 N s/m is passive at the delay of an eighth and a limit cycle at 1.125."""
    late = (InjectionParams("delay_in", tick=1500, value=0.0031),)
    board = board_params(in_queue_depth=depth, injections=late)
    with LockStep(servo_params(), board) as stack:
        enable(stack, FIG_WALL)
        perturbed(stack)
        before = as_records(stack.run(900))
        stack.run(100)
        after = as_records(stack.run(2000))
    assert set(after["state"]) == {State.ENABLED}
    assert set(after["delay_us"]) == {125}
    assert set(after["arrival"]) == {0}
    assert after["position_m"].std() < 2.0 * before["position_m"].std()


TWO_LATE = (
    InjectionParams("delay_in", tick=848, value=0.002),
    InjectionParams("delay_in", tick=849, value=0.0031),
)
TWICE_AND_LATE = (
    InjectionParams("duplicate_in", tick=836),
    InjectionParams("delay_in", tick=837, value=0.002),
)


@pytest.mark.parametrize("faults", [TWO_LATE, TWICE_AND_LATE], ids=["late", "twice"])
@pytest.mark.parametrize("depth", [1, 4])
@pytest.mark.parametrize("way_us", [75.0, 200.0])
def test_a_link_behind_a_slow_bus_catches_up(faults, depth, way_us):
    board = board_params(
        in_queue_depth=depth,
        injections=faults,
        out_transport_us=way_us,
        in_transport_us=way_us,
    )
    with LockStep(servo_params(), board) as stack:
        enable(stack, {Value.STIFFNESS: 0.0})
        flown = as_records(stack.run(1500))
        assert set(flown["arrival"][-1000:]) == {0}
        assert stack.do(Command.RESET).result in (Result.APPLIED, Result.REFUSED_STATE)


def test_catching_up_costs_no_slot():
    late = (InjectionParams("burst_in", tick=1500, value=0.0031),)
    with LockStep(servo_params(), board_params(in_queue_depth=4, injections=late)) as stack:
        enable(stack, FIG_WALL)
        flown = as_records(stack.run(2000))
        slots = np.diff(flown["time_ns"]) / 1e6
        late_slots = int(flown["lost_slots"][-1])
    caught = np.flatnonzero(flown["arrival"] > 0)
    assert caught.size == 1
    assert slots[caught[0] :].max() == pytest.approx(1.0, abs=0.3)
    assert late_slots <= 6  # the time-outs while nothing came


# --- enabled means that the board grants torque ---------------------------------------------------
OFF = ScaleParams(COUNT_M, offset_count=-round(0.010 / COUNT_M))
HOLD = HandParams("hold", stiffness_n_per_m=2e4, damping_ns_per_m=50.0)


def held_off(press_s, bounce_ms=0.0):
    """K = 500 N/m, the handle held by a strong hand 10 mm off; the emergency stop is pressed at
    tick 1200.
    """
    device = device_params(position=OFF)
    press = (InjectionParams("emergency_stop", tick=1200, value=press_s),)
    board = board_params(
        injections=press, touch=TouchParams(hands=(HOLD,)), emergency_stop_bounce_ms=bounce_ms
    )
    return LockStep(servo_params(device=device), board)


def motor_force_n(flown):
    return flown["current_a"] * BOARD.torque_constant_n_per_a


@pytest.mark.parametrize("bounce_ms", [0.0, 3.0])
def test_authority_that_comes_back_brings_the_force_back_along_the_gain_ramp(bounce_ms):
    with held_off(0.004, bounce_ms) as stack:
        enable(stack, SPRING)
        flown = as_records(stack.run(2000))
    force_n = motor_force_n(flown)
    pressed = np.flatnonzero(flown["status"] & StatusBit.EMERGENCY_STOP)
    assert pressed.size >= 3
    assert set(flown["state"]) == {State.ENABLED}
    assert force_n[pressed[0] - 1] == pytest.approx(-4.88, abs=0.05)
    assert force_n[pressed] == pytest.approx(0.0, abs=1e-3)
    back = force_n[pressed[-1] :]
    assert np.abs(np.diff(back)).max() < 2.0 * 5.0 / 500
    assert back[-1] == pytest.approx(-4.88, abs=0.05)
    assert np.flatnonzero(back < -4.8)[0] > 450


def test_authority_that_stays_away_is_a_fault_and_no_force_comes_back():
    with held_off(0.5) as stack:
        enable(stack, SPRING)
        flown = as_records(stack.run(1000))
        assert stack.do(Command.RESET).result is Result.REFUSED_CAUSE
        stack.run(300)
        assert stack.do(Command.RESET).result is Result.APPLIED
        stack.run(5)
    pressed = np.flatnonzero(flown["status"] & StatusBit.EMERGENCY_STOP)
    fault = np.flatnonzero(flown["state"] == State.FAULT)
    assert fault[0] - pressed[0] == servo_params().safety.no_authority_limit
    assert flown["fault"][-1] == BY_CODE["no_authority"].number
    everything = as_records(b"".join(stack.blocks))
    after = everything[everything["tick"] >= flown["tick"][pressed[0]]]
    assert motor_force_n(after) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("command", [Command.ENABLE, Command.HOME])
def test_enable_is_refused_while_the_board_would_not_grant_torque(command):
    home = HomeParams(method="stop")
    press = (InjectionParams("emergency_stop", tick=10, value=0.2),)
    params = servo_params(device=device_params(home=home))
    with LockStep(params, board_params(injections=press)) as stack:
        stack.run(30)
        assert stack.do(command).result is Result.REFUSED_NO_AUTHORITY
        stack.run(250)
        assert stack.do(command).result is Result.APPLIED


def test_an_amplifier_that_is_not_ready_is_told_from_one_that_says_nothing():
    ready = int(StatusBit.AMPLIFIER_READY)
    silent = Flight(servo_params())
    assert silent.do(Command.ENABLE, status=0) is Result.APPLIED
    tells = Flight(servo_params())
    host = HEALTHY | AMPLIFIER_TOLD
    assert tells.do(Command.ENABLE, status=0, host=host) is Result.REFUSED_NO_AUTHORITY
    assert tells.do(Command.ENABLE, status=ready, host=host) is Result.APPLIED


def test_a_perturbation_does_not_come_back_with_the_authority():
    with held_off(0.004) as stack:
        enable(stack, {Value.STIFFNESS: 0.0})
        perturbed(stack)
        flown = as_records(stack.run(1000))
    pressed = np.flatnonzero(flown["status"] & StatusBit.EMERGENCY_STOP)
    assert flown["perturbing"][pressed[0] - 1]
    assert not flown["perturbing"][pressed[0] :].any()


# --- silence is no authority ----------------------------------------------------------------------
SILENCES = [
    (0.004, InjectionParams("drop_in", tick=1200, count=5)),
    (0.006, InjectionParams("drop_in", tick=1200, count=7)),
    (0.004, InjectionParams("burst_in", tick=1200, value=0.0055)),
    (0.004, InjectionParams("corrupt_in", tick=1200, count=5)),
]


def forces_about(silence, press_s, stop_at=0, ticks=560):
    """Force [N] at the motor in every tick from 1190 on, the emergency stop pressed at 1200 while
    frames are lost, and the stack's records of them.
    """
    injections = (silence,)
    if press_s:
        injections += (InjectionParams("emergency_stop", tick=1200, value=press_s),)
    board = board_params(injections=injections, touch=TouchParams(hands=(HOLD,)))
    with LockStep(servo_params(device=device_params(position=OFF)), board) as stack:
        enable(stack, SPRING)
        stack.run(1190 - stack.loop.tick)
        axis = stack.backend._port.board._axis
        forces = []
        flown = b""
        for _ in range(ticks):
            if stack.loop.tick == stop_at:
                stack.command(Command.STOP)
            flown += stack.run(1)
            forces.append(axis.force_n)
    return np.array(forces), as_records(flown)


@pytest.mark.parametrize(("press_s", "silence"), SILENCES)
def test_an_emergency_stop_that_no_frame_tells_of_brings_no_force_back_at_once(press_s, silence):
    force_n, flown = forces_about(silence, press_s)
    assert not (flown["status"][8:20] & StatusBit.EMERGENCY_STOP).any()
    assert force_n[5] == pytest.approx(-4.88, abs=0.05)
    gone = int(np.flatnonzero(force_n == 0.0)[0])
    assert gone <= 10
    assert np.abs(np.diff(force_n[gone:])).max() < 2.0 * 5.0 / 500
    assert force_n[-1] == pytest.approx(-4.88, abs=0.05)


@pytest.mark.parametrize(("press_s", "silence"), SILENCES)
def test_an_emergency_stop_that_no_frame_tells_of_ends_what_fades(press_s, silence):
    force_n, _ = forces_about(silence, press_s, stop_at=1198, ticks=50)
    gone = int(np.flatnonzero(force_n == 0.0)[0])
    assert gone <= 10
    assert force_n[gone:] == pytest.approx(0.0, abs=1e-3)


def test_a_single_lost_frame_leaves_the_force_as_it_is():
    force_n, flown = forces_about(InjectionParams("drop_in", tick=1200, count=1), 0.0, ticks=50)
    assert flown["arrival"].min() == -1
    assert set(flown["gain"]) == {1.0}
    assert force_n == pytest.approx(-4.88, abs=0.05)


# --- a restarted board is another life ------------------------------------------------------------
@pytest.mark.parametrize("board_time_s", [0.0, 36 * 60.0, 2**31 * 1e-6, 71 * 60.0, 2**32 * 1e-6])
def test_a_restarted_board_is_another_life(board_time_s):
    restart = (InjectionParams("restart", tick=1200, value=board_time_s),)
    board = board_params(board_time_us=round(1e6), injections=restart)
    with LockStep(servo_params(), board) as stack:
        enable(stack, SPRING)
        stack.do(Command.ZERO)
        flown = as_records(stack.run(1500))
    struck = int(np.flatnonzero(flown["tick"] >= 1200)[0])
    assert set(flown["state"][:struck]) == {State.ENABLED}
    assert flown["state"][-1] == State.FAULT
    assert flown["fault"][-1] == BY_CODE["board_restarted"].number
    assert not flown["homed"][-1]
    assert np.abs(flown["force_n"][struck + 30 :]).max() == 0.0


@pytest.mark.parametrize("stopped", [False, True], ids=["enabled", "stopped"])
def test_nothing_is_rendered_from_the_origin_of_another_life(stopped):
    """Zeroed 10 mm off there is no force, whose fading cannot bring any either."""
    restart = (InjectionParams("restart", tick=1200, value=0.0),)
    device = device_params(position=OFF)
    board = board_params(injections=restart, touch=TouchParams(hands=(HOLD,)))
    with LockStep(servo_params(device=device), board) as stack:
        stack.run(5)
        assert stack.do(Command.ZERO).result is Result.APPLIED
        enable(stack, SPRING)
        stack.run(1196 - stack.loop.tick)
        if stopped:
            stack.command(Command.STOP)
        flown = as_records(stack.run(60))
    assert stack.device.counts["lives"] == 1
    assert motor_force_n(flown) == pytest.approx(0.0, abs=1e-3)


def test_a_gap_ends_the_fading_of_what_came_before_it():
    """After frames were lost for longer than the filters can bridge, the law would begin at rest
    and step to another force.
    """
    gap = (InjectionParams("drop_in", tick=1200, count=12),)
    board = board_params(injections=gap, touch=TouchParams(hands=(HOLD,)))
    with LockStep(servo_params(device=device_params(position=OFF)), board) as stack:
        enable(stack, {**SPRING, Value.RAMP_S: 0.0})
        flown = as_records(stack.run(1250 - stack.loop.tick))
    back = np.flatnonzero(flown["arrival"] > 8)
    assert back.size == 1
    assert flown["fault"][-1] == BY_CODE["frames_lost"].number
    assert flown["force_n"][back[0] :] == pytest.approx(0.0, abs=1e-3)


def test_a_reset_does_not_bring_back_what_the_board_has_taken():
    """A fault of the board that heals and is cleared while the servo still fades the force."""
    fault = (InjectionParams("amplifier_fault", tick=1200, value=0.002),)
    board = board_params(injections=fault, touch=TouchParams(hands=(HOLD,)))
    with LockStep(servo_params(device=device_params(position=OFF)), board) as stack:
        enable(stack, SPRING)
        stack.run(1204 - stack.loop.tick)
        axis = stack.backend._port.board._axis
        stack.command(Command.RESET)
        forces = []
        for _ in range(30):
            stack.run(1)
            forces.append(axis.force_n)
    assert stack.loop.state[0].plan.state is State.DISABLED
    assert set(forces) == {0.0}
