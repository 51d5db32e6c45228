"""The safety table, cell by cell, and what torque and damping do in each state."""

from itertools import pairwise

import pytest
from support.flight import Flight, enabled
from support.models import device_params, servo_params

from hapticd.core.faults import BY_CODE, FAULTS
from hapticd.core.params import HomeParams, SafetyParams, ScaleParams
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.servo import safety
from hapticd.servo.plan import GATEWAY_ALIVE, LINK_UP, SETTLED
from hapticd.servo.safety import FAULT_EVENT, State
from hapticd.usb.frames import OutFlag, StatusBit

STIFF = {Value.STIFFNESS: 100.0}
DENTED = 20_000  # counts = 10 mm: -1 N at 100 N/m
NO = Result.REFUSED_STATE
D = State.DISABLED
E = State.ENABLED
S = State.STOPPED
F = State.FAULT
H = State.HOMING

CELLS = {
    # state: enable, disable, stop, reset, zero, home, perturb, fault
    D: (E, D, S, D, D, H, NO, F),
    E: (E, D, S, NO, NO, NO, E, F),
    S: (NO, S, S, D, NO, NO, NO, F),
    F: (NO, F, F, D, NO, NO, NO, F),
    H: (NO, D, S, NO, NO, NO, NO, F),
}
KINDS = (
    Command.ENABLE,
    Command.DISABLE,
    Command.STOP,
    Command.RESET,
    Command.ZERO,
    Command.HOME,
    Command.PERTURB_START,
    FAULT_EVENT,
)


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("column", range(len(KINDS)))
def test_every_cell_of_the_table(state, column):
    assert safety.transition(state, KINDS[column]) == CELLS[state][column]


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("kind", [Command.SET, Command.DAMPING, Command.PERTURB_STOP])
def test_settings_never_change_the_state(state, kind):
    assert safety.transition(state, kind) is state


def test_fault_numbers_and_codes_are_unique():
    assert (
        len({fault.number for fault in FAULTS})
        == len({fault.code for fault in FAULTS})
        == len(FAULTS)
    )
    assert all(fault.cause and fault.action and fault.remedy for fault in FAULTS)


def test_start_comes_up_disabled_without_torque():
    flight = Flight(servo_params(), DENTED)
    out = flight.fly(10)
    assert flight.plan.state is D
    assert out[0] == 0
    assert not flight.state[SETTLED].out_flags & OutFlag.ENABLE


def test_disabled_renders_no_force_even_with_stiffness_set():
    flight = Flight(servo_params(), DENTED)
    flight.do(Command.SET, {**STIFF, Value.RAMP_S: 0.0})
    out = flight.fly(10)
    assert (out[0], out[8]) == (0, 0.0)


def test_enable_ramps_the_force_in_over_half_a_second():
    flight = Flight(servo_params(), DENTED)
    flight.do(Command.SET, {**STIFF, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    forces = [flight.fly()[8] for _ in range(501)]
    assert forces[249] == pytest.approx(-0.5, abs=2e-3)
    assert forces[-1] == pytest.approx(-1.0, abs=2e-4)
    steps = [abs(b - a) for a, b in pairwise(forces)]
    assert max(steps) < 1.0 / 500 + 3e-4


def test_disable_takes_the_torque_away_at_once():
    flight = enabled(servo_params(), STIFF, DENTED)
    flight.do(Command.DISABLE)
    assert flight.plan.state is D
    assert flight.fly()[0] == 0
    assert not flight.state[SETTLED].out_flags & OutFlag.ENABLE


def test_stop_takes_the_force_to_zero_in_twenty_ticks():
    flight = enabled(servo_params(), STIFF, DENTED)
    assert flight.do(Command.STOP) is Result.APPLIED
    forces = [abs(flight.fly()[8]) for _ in range(25)]
    assert forces == sorted(forces, reverse=True)
    assert 0.3 < forces[9] < 0.6
    assert forces[20] == 0.0
    assert not flight.state[SETTLED].out_flags & OutFlag.ENABLE


def test_stop_latches_until_reset():
    flight = enabled(servo_params(), STIFF, DENTED)
    flight.do(Command.STOP)
    assert flight.do(Command.ENABLE) is Result.REFUSED_STATE
    assert flight.do(Command.STOP) is Result.APPLIED
    flight.fly(5000)
    assert flight.plan.state is S
    assert flight.blob["fault"] == BY_CODE["stop"].number
    assert flight.blob["actor"] == 9
    assert flight.do(Command.RESET) is Result.APPLIED
    assert flight.plan.state is D


def test_reset_never_enables():
    flight = enabled(servo_params())
    flight.do(Command.STOP)
    flight.do(Command.RESET)
    flight.fly(2000)
    assert flight.plan.state is D


def test_stop_wins_over_enable_in_the_same_tick():
    flight = Flight(servo_params())
    empty = (0.0,) * 20
    commands = ((1, Command.STOP, 9, 0, empty), (2, Command.ENABLE, 9, 0, empty))
    flight._one(commands)
    assert flight.plan.state is S


def test_damping_is_held_two_seconds_then_released_in_half_a_second():
    params = servo_params(safety=SafetyParams(safe_active_damping_ns_per_m=1.0))
    flight = enabled(params)
    flight.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
    flight.fly(200)
    flight.do(Command.STOP)
    start = flight.tick - 1
    levels = {}
    for _ in range(2600):
        flight.fly()
        levels[flight.tick - 1 - start] = flight.blob["active_damping_ns_per_m"]
    assert levels[1] == pytest.approx(1.74, abs=1e-4)
    assert levels[2000] == pytest.approx(1.74, abs=1e-4)
    assert levels[2250] == pytest.approx(0.87, abs=1e-3)
    assert levels[2500] == 0.0


def test_stop_raises_damping_to_the_safe_level():
    params = servo_params(safety=SafetyParams(safe_active_damping_ns_per_m=1.0))
    flight = enabled(params)
    flight.do(Command.STOP)
    flight.fly(100)
    assert flight.blob["active_damping_ns_per_m"] == pytest.approx(1.0, abs=1e-4)


def test_damping_acts_while_disabled_when_asked():
    flight = Flight(servo_params())
    flight.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 2.0, Value.ACTIVE_DAMPING_ON: 1.0})
    flight.fly(200)
    assert flight.state[SETTLED].damping_count == round(2.0 / 10.0 * 65535)
    assert flight.fly()[0] == 0


def test_damping_is_slew_limited():
    flight = Flight(servo_params())
    levels = [flight.blob["active_damping_ns_per_m"]]
    flight.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 2.0, Value.ACTIVE_DAMPING_ON: 1.0})
    levels.append(flight.blob["active_damping_ns_per_m"])
    for _ in range(150):
        flight.fly()
        levels.append(flight.blob["active_damping_ns_per_m"])
    steps = [b - a for a, b in pairwise(levels)]
    assert max(steps) <= 20.0 / 1000 + 10.0 / 65535
    assert levels[-1] == pytest.approx(2.0, abs=1e-4)


def test_enable_needs_a_gateway():
    flight = Flight(servo_params())
    assert flight.do(Command.ENABLE, host=LINK_UP) is Result.REFUSED_NO_GATEWAY
    assert flight.plan.state is D


def test_enable_needs_homing_when_the_device_says_so():
    params = servo_params(device=device_params(home=HomeParams(method="stop", required=True)))
    flight = Flight(params)
    assert flight.do(Command.ENABLE) is Result.REFUSED_NOT_HOMED
    assert flight.do(Command.ZERO) is Result.APPLIED
    assert flight.do(Command.ENABLE) is Result.APPLIED


def test_lost_gateway_is_a_fault_while_enabled():
    flight = enabled(servo_params(), STIFF, DENTED)
    flight.fly(1, host=LINK_UP)
    assert flight.plan.state is F
    assert flight.blob["fault"] == BY_CODE["gateway_lost"].number
    flight.fly(25, host=LINK_UP)
    assert flight.fly(host=LINK_UP)[0] == 0


def test_lost_gateway_may_be_held_by_configuration():
    flight = enabled(servo_params(safety=SafetyParams(on_gateway_loss="hold")), STIFF, DENTED)
    flight.fly(100, host=LINK_UP)
    assert flight.plan.state is E


def test_lost_gateway_means_nothing_while_disabled():
    flight = Flight(servo_params())
    flight.fly(100, host=LINK_UP)
    assert flight.plan.state is D


@pytest.mark.parametrize(
    ("sample", "code"),
    [
        ({"status": int(StatusBit.AMPLIFIER_FAULT)}, "board_fault"),
        ({"status": int(StatusBit.ENCODER_FAULT)}, "board_fault"),
        ({"status": int(StatusBit.OVER_TEMPERATURE)}, "over_temperature"),
        ({"celsius": 120.5}, "over_temperature"),
        ({"status": int(StatusBit.WATCHDOG)}, "board_watchdog"),
        ({"host": GATEWAY_ALIVE, "arrival": -1}, "usb_lost"),
        ({"arrival": -9}, "frames_lost"),
        ({"encoder": DENTED + 50_000}, "sensor_range"),
    ],
)
def test_every_loss_leads_to_a_latched_fault_with_its_cause(sample, code):
    flight = enabled(servo_params(), STIFF, DENTED)
    flight.fly(1, **sample)
    assert flight.plan.state is F
    assert flight.blob["fault"] == BY_CODE[code].number
    flight.fly(30, **{**sample, "encoder": DENTED, "arrival": min(sample.get("arrival", 0), 0)})
    out = flight.fly(**{**sample, "encoder": DENTED})
    assert out[0] == 0
    flight.fly(10)
    assert flight.plan.state is F


@pytest.mark.parametrize(
    "sample",
    [
        {"status": int(StatusBit.AMPLIFIER_FAULT)},
        {"celsius": 121.0},
        {"host": GATEWAY_ALIVE, "arrival": -3},
    ],
)
def test_reset_is_refused_while_the_cause_persists(sample):
    flight = enabled(servo_params())
    flight.fly(1, **sample)
    assert flight.do(Command.RESET, **sample) is Result.REFUSED_CAUSE
    assert flight.do(Command.RESET) is Result.APPLIED
    assert flight.plan.state is D


def test_fault_keeps_its_first_cause():
    flight = enabled(servo_params())
    flight.event(FAULT_EVENT, BY_CODE["lost_slots"].number)
    flight.fly(1, status=int(StatusBit.AMPLIFIER_FAULT))
    assert flight.blob["fault"] == BY_CODE["lost_slots"].number


def test_fault_while_frames_are_missing_still_ramps_the_force_down():
    flight = enabled(servo_params(), STIFF, DENTED)
    for missing in range(1, 40):
        out = flight.fly(1, arrival=-missing)
    assert flight.plan.state is F
    assert out[0] == 0


def test_one_missing_frame_holds_the_force_and_is_flagged():
    flight = enabled(servo_params(), STIFF, DENTED)
    before = flight.fly()
    out = flight.fly(1, arrival=-1)
    assert out[0] == before[0]
    assert out[9] & 1
    assert flight.plan.state is E


def test_stop_lets_the_spring_follow_the_motion():
    """The force of a stop is the law's on its way out, not a push that ignores where the device
    is.
    """
    flight = enabled(servo_params(), STIFF, DENTED)
    flight.do(Command.STOP)
    flight.fly(4)
    through_the_origin = [flight.fly(1, encoder=DENTED - 2500 * n)[8] for n in range(1, 13)]
    assert through_the_origin[0] < -0.5
    assert through_the_origin[7] == pytest.approx(0.0, abs=1e-3)
    assert through_the_origin[-1] > 0.0


def test_encoder_that_stays_off_needs_homing_again_and_can_be_reset():
    params = servo_params(device=device_params(home=HomeParams(method="stop", required=True)))
    flight = Flight(params)
    flight.do(Command.ZERO)
    assert flight.do(Command.ENABLE) is Result.APPLIED
    flight.fly(600)
    flight.fly(50, encoder=1_000_000)
    assert flight.blob["fault"] == BY_CODE["sensor_range"].number
    assert flight.do(Command.RESET) is Result.APPLIED
    flight.fly(10)
    assert flight.plan.state is D
    assert flight.do(Command.ENABLE) is Result.REFUSED_NOT_HOMED


@pytest.mark.parametrize("sample", [{"arrival": -9}, {"status": int(StatusBit.WATCHDOG)}])
def test_enable_and_reset_are_refused_for_what_would_fault_at_once(sample):
    flight = Flight(servo_params())
    flight.fly(1, **sample)
    assert flight.plan.state is D
    assert flight.do(Command.ENABLE, **sample) is Result.REFUSED_CAUSE
    flight.do(Command.STOP)
    assert flight.do(Command.RESET, **sample) is Result.REFUSED_CAUSE
    assert flight.do(Command.RESET) is Result.APPLIED
    assert flight.do(Command.ENABLE) is Result.APPLIED


def test_damping_may_be_released_at_once_after_the_hold():
    flight = enabled(
        servo_params(
            safety=SafetyParams(safe_active_damping_ns_per_m=1.0, active_damping_release_s=0.0)
        )
    )
    flight.do(Command.STOP)
    flight.fly(1999)
    assert flight.blob["active_damping_ns_per_m"] == pytest.approx(1.0, abs=1e-4)
    flight.fly(3)
    assert flight.blob["active_damping_ns_per_m"] == 0.0


def test_stop_cancels_what_is_scheduled_also_when_stopped_already():
    flight = enabled(servo_params())
    flight.do(Command.STOP)
    assert flight.do(Command.SET, STIFF, at_tick=flight.tick + 100) is Result.SCHEDULED
    flight.do(Command.STOP)
    assert Result.CANCELLED in [answer[1] for answer in flight.answers]
    assert flight.plan.scheduled == ()


def test_fault_that_persists_leaves_later_schedules_alone():
    flight = enabled(servo_params())
    flight.fly(1, celsius=121.0)
    assert (
        flight.do(Command.SET, STIFF, at_tick=flight.tick + 20, celsius=121.0) is Result.SCHEDULED
    )
    flight.fly(10, celsius=121.0)
    assert len(flight.plan.scheduled) == 1


@pytest.mark.parametrize("offset_count", [0.0, 1000.5])
@pytest.mark.parametrize("sign", [1, -1])
def test_temperature_is_judged_in_degrees_whatever_the_sign_of_its_scale(sign, offset_count):
    scale = ScaleParams(0.01, sign=sign, offset_count=offset_count)
    device = device_params(temperature=scale, temperature_limit_c=120.0)
    for celsius, state in ((-20.0, E), (22.0, E), (119.9, E), (120.1, F), (121.0, F)):
        count = scale.to_count(celsius, -32768, 32767)
        flight = Flight(servo_params(device=device))
        flight.fly(1, celsius=scale.to_count(22.0, -32768, 32767) / 100)
        flight.do(Command.ENABLE, celsius=scale.to_count(22.0, -32768, 32767) / 100)
        for arrival in (0, 2):
            flight.fly(1, celsius=count / 100, arrival=arrival)
            assert flight.plan.state is state, (celsius, arrival)
