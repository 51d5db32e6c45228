"""One tick: receipts, ramps, schedules, gaps, zero, homing, and numbers that are not numbers."""

import math
from itertools import pairwise

import pytest
from support.flight import Flight, enabled, masked
from support.models import COUNT_M, COUNT_N, device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.params import HomeParams, ScaleParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.render.law import render
from hapticd.servo.safety import State
from hapticd.usb.device import SEED

STIFF = {Value.STIFFNESS: 100.0}
HOME = HomeParams(
    method="stop", direction=-1, speed_m_per_s=0.01, force_n=0.5, position_m=-0.02, timeout_s=2.0
)


def test_force_is_stiffness_times_position_in_counts():
    flight = enabled(servo_params(), STIFF, 20_000)
    torque, x, *_, force, _, _ = flight.fly()
    assert x == pytest.approx(20_000 * COUNT_M)
    assert torque == math.floor(-100.0 * x / COUNT_N + 0.5)
    assert force == torque * COUNT_N


def test_force_limit_is_the_last_thing_before_the_wire():
    flight = enabled(servo_params(), {Value.STIFFNESS: 1e5}, 0)
    for encoder in (1000, 30_000, 0, -30_000, 0, 10_000):
        out = flight.fly(3, encoder=encoder)
        assert abs(out[0]) <= 32767
        assert abs(out[8]) <= 8.0
    assert flight.fly(1, encoder=12_000)[9] & Flag.CLAMPED


@pytest.mark.parametrize("offset_count", [0.0, 12.0, -12.0])
@pytest.mark.parametrize("law_n", [100.0, -100.0])
def test_count_is_held_inside_the_limit_whatever_the_law_gives(monkeypatch, law_n, offset_count):
    """A law that clamps nothing, and a scale on which the whole limit does not fit 16 bits."""

    def unclamped(x, law, environment, coefficients):
        _, _, *rest = render(x, law, environment, coefficients)
        return law_n, law_n, *rest

    monkeypatch.setattr("hapticd.servo.step.render", unclamped)
    force = ScaleParams(COUNT_N, offset_count=offset_count)
    flight = Flight(servo_params(device=device_params(force=force, force_limit_n=4.0)))
    torque, *_ = flight.fly()
    assert torque == force.to_count(math.copysign(4.0, law_n), -32767, 32767)


def test_configured_limit_below_the_device_limit_wins():
    flight = enabled(
        servo_params(device=device_params(force_limit_n=2.0)), {Value.STIFFNESS: 1e4}, 10_000
    )
    assert flight.fly()[8] == pytest.approx(-2.0, abs=COUNT_N)
    assert abs(flight.fly()[8]) <= 2.0 + 0.5 * COUNT_N


@pytest.mark.parametrize("sign", [1, -1])
def test_calibration_turns_sign_and_offset(sign):
    force = ScaleParams(COUNT_N, sign=sign, offset_count=12.0)
    position = ScaleParams(COUNT_M, sign=sign, offset_count=100.0)
    flight = Flight(servo_params(device=device_params(force=force, position=position)), 100)
    assert flight.fly()[0] == 12
    flight.do(Command.SET, {**STIFF, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    out = flight.fly(600, encoder=20_100)
    assert out[1] == pytest.approx(sign * 0.01)
    assert out[8] == pytest.approx(-sign * 1.0, abs=COUNT_N)
    assert out[0] == pytest.approx(12 - 1.0 / COUNT_N, abs=1)


def test_every_set_gets_its_own_receipt():
    flight = Flight(servo_params())
    first = flight.do(Command.SET, {Value.STIFFNESS: 50.0, Value.RAMP_S: 0.1})
    second = flight.do(Command.SET, {Value.STIFFNESS: 70.0})
    assert first is second is Result.APPLIED
    (_, _, _, revision1, ticks1, values1), (_, _, _, revision2, ticks2, values2) = flight.answers
    assert (revision1, revision2) == (1, 2)
    assert ticks1 == (1, 101)
    assert ticks2 == (2, 52)  # the configured default of 50 ms
    assert (values1[Value.STIFFNESS], values2[Value.STIFFNESS]) == (50.0, 70.0)


def test_receipt_tells_damping_after_quantisation():
    flight = Flight(servo_params())
    flight.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
    level = flight.answers[-1][5][Value.ACTIVE_DAMPING]
    assert level == pytest.approx(1.74, abs=0.5 * 10.0 / 65535)
    assert level != 1.74


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (Value.STIFFNESS, math.nan),
        (Value.STIFFNESS, 1e6),
        (Value.VIRTUAL_DAMPING, math.inf),
        (Value.MASS, -2.0),
        (Value.VELOCITY_FILTER_HZ, 451.0),
        (Value.VELOCITY_FILTER_ZETA, 0.0),
        (Value.WALL_SIDE, 2.0),
        (Value.ACTIVE_DAMPING, 10.1),
        (Value.ACTIVE_DAMPING, -0.1),
        (Value.RAMP_S, 61.0),
    ],
)
def test_values_out_of_range_change_nothing(place, value):
    flight = enabled(servo_params(), STIFF, 20_000)
    before = flight.fly()
    revision = flight.plan.revision
    assert flight.do(Command.SET, {place: value}) is Result.REFUSED_RANGE
    assert flight.fly()[:9] == before[:9]
    assert flight.plan.revision == revision


def test_mask_that_is_no_mask_is_refused():
    flight = Flight(servo_params())
    for mask in (math.nan, -1.0, float(1 << 40)):
        out = flight._one(((5, Command.SET, 1, 0, (mask, *[0.0] * 19)),))
        assert out[10][0][1] == Result.REFUSED_RANGE


def test_set_ramps_without_a_jump():
    flight = enabled(servo_params(), {Value.STIFFNESS: 100.0}, 20_000)
    flight.do(Command.SET, {Value.STIFFNESS: 300.0, Value.RAMP_S: 0.2})
    forces = [flight.fly()[8] for _ in range(202)]
    assert forces[0] == pytest.approx(-1.0, abs=0.02)
    assert forces[-1] == pytest.approx(-3.0, abs=1e-3)
    assert max(abs(b - a) for a, b in pairwise(forces)) < 2.0 / 200 + 3e-4


def test_parameters_ramp_each_on_its_own_clock():
    flight = enabled(servo_params())
    flight.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 0.1})
    flight.fly(49)
    flight.do(Command.SET, {Value.MASS: 0.01, Value.RAMP_S: 0.1})
    flight.fly(49)
    assert flight.blob["stiffness_n_per_m"] == pytest.approx(99.0)
    assert flight.blob["mass_kg"] == pytest.approx(0.0049)
    flight.fly(60)
    assert (flight.blob["stiffness_n_per_m"], flight.blob["mass_kg"]) == (100.0, 0.01)


OTHER_FILTERS = [
    {Value.VELOCITY_FILTER_HZ: 0.1},
    {Value.ACCELERATION_FILTER_HZ: 0.1},
    {Value.VELOCITY_FILTER_ZETA: 2.0},
    {Value.ACCELERATION_FILTER_ZETA: 2.0, Value.STIFFNESS: 50.0},
]


def swing(tick):
    """Encoder count of a hand that swings the handle by 10 mm, twice a second."""
    return round(20_000 * math.sin(2.0 * math.pi * 2.0 * tick / 1000.0))


def swung(flight, ticks):
    """Outputs of `ticks` ticks of that hand."""
    return [flight.fly(1, encoder=swing(flight.tick)) for _ in range(ticks)]


@pytest.mark.parametrize("change", OTHER_FILTERS)
@pytest.mark.parametrize(
    "felt", [{Value.VIRTUAL_DAMPING: 5.0}, {Value.MASS: 0.05}, {Value.WALL_VIRTUAL_DAMPING: 3.0}]
)
def test_filters_that_are_felt_are_not_changed(felt, change):
    """Neither while B, M or the wall's damping act, nor while they come or go, nor on a stop's way
    out, nor at a later tick, nor while homing.
    """
    (place,) = felt
    calm = {place: 0.0}
    flight = enabled(servo_params(device=device_params(home=HOME)), felt)
    swung(flight, 300)
    first = flight.plan.filters
    assert flight.do(Command.SET, change) is Result.REFUSED_FILTER
    flight.do(Command.SET, change, at_tick=flight.tick + 5)
    swung(flight, 6)
    assert flight.answers[-1][1] == Result.REFUSED_FILTER
    flight.do(Command.SET, {**calm, Value.RAMP_S: 0.1})
    swung(flight, 50)
    assert flight.do(Command.SET, change) is Result.REFUSED_FILTER
    flight.do(Command.SET, {**felt, Value.RAMP_S: 0.1})
    flight.do(Command.STOP)
    assert flight.do(Command.SET, change) is Result.REFUSED_FILTER
    swung(flight, 50)
    flight.do(Command.RESET)
    assert flight.do(Command.HOME) is Result.APPLIED
    flight.do(Command.SET, {**calm, Value.RAMP_S: 0.0})
    assert flight.do(Command.SET, change) is Result.REFUSED_FILTER
    assert flight.plan.filters == first
    assert flight.plan.values[Value.STIFFNESS].end == 0.0


@pytest.mark.parametrize("change", OTHER_FILTERS)
def test_filters_that_nothing_is_felt_of_may_change(change):
    flight = enabled(servo_params(), {Value.STIFFNESS: 50.0})
    assert flight.do(Command.SET, change) is Result.APPLIED
    assert flight.do(Command.SET, {Value.VIRTUAL_DAMPING: 1.0, Value.RAMP_S: 0.0}) is Result.APPLIED
    same = {place: value for place, value in change.items() if place is not Value.STIFFNESS}
    assert flight.do(Command.SET, same) is Result.APPLIED  # they are what they were
    for leave in (Command.DISABLE, Command.STOP):
        flight.do(leave)
        flight.fly(30)
        assert flight.do(Command.SET, {Value.VELOCITY_FILTER_HZ: 80.0}) is Result.APPLIED
        flight.do(Command.SET, change)


@pytest.mark.parametrize("hz", [0.1, 1.0, 400.0])
def test_new_filters_do_not_carry_on_a_slope_of_the_old_ones(hz):
    """A slow filter that went on with the old one's slope would show several times the speed of the
    hand for seconds.
    """
    flight = Flight(servo_params())
    fastest = 0.01 * 2.0 * math.pi * 2.0
    for moment in range(5):
        swung(flight, 100 + 37 * moment)
        flight.do(Command.SET, {Value.VELOCITY_FILTER_HZ: 100.0}, encoder=swing(flight.tick))
        swung(flight, 500)
        before = swung(flight, 1)[0]
        change = {Value.VELOCITY_FILTER_HZ: hz, Value.ACCELERATION_FILTER_HZ: hz}
        assert flight.do(Command.SET, change, encoder=swing(flight.tick)) is Result.APPLIED
        after = swung(flight, 4000)
        assert max(abs(out[2]) for out in after) < 1.1 * fastest
        assert after[0][2] == pytest.approx(before[2], abs=0.1 * fastest)


def test_scheduled_set_acts_on_its_very_tick():
    flight = enabled(servo_params(), {Value.STIFFNESS: 100.0}, 20_000)
    target = flight.tick + 10
    assert (
        flight.do(Command.SET, {Value.STIFFNESS: 200.0, Value.RAMP_S: 0.0}, at_tick=target)
        is Result.SCHEDULED
    )
    first = flight.tick
    forces = dict(enumerate((flight.fly()[8] for _ in range(15)), first))
    assert forces[target - 1] == pytest.approx(-1.0, abs=COUNT_N)
    assert forces[target] == pytest.approx(-2.0, abs=COUNT_N)
    assert flight.answers[-1][1] == Result.APPLIED
    assert flight.answers[-1][4][0] == target


def test_later_set_for_the_same_tick_supersedes():
    flight = Flight(servo_params())
    target = flight.tick + 20
    flight.do(Command.SET, {Value.STIFFNESS: 200.0}, at_tick=target)
    flight.do(
        Command.SET, {Value.STIFFNESS: 300.0, Value.MASS: 0.01, Value.RAMP_S: 0.0}, at_tick=target
    )
    results = [(answer[0], Result(answer[1])) for answer in flight.answers]
    assert (1, Result.SUPERSEDED) in results
    flight.fly(30)
    assert flight.blob["stiffness_n_per_m"] == 300.0
    assert [(a[0], a[1]) for a in flight.answers if a[1] == Result.APPLIED] == [(2, Result.APPLIED)]


def test_sixteen_may_wait_and_no_more():
    flight = Flight(servo_params())
    for index in range(16):
        assert flight.do(Command.SET, STIFF, at_tick=10_000 + index) is Result.SCHEDULED
    assert flight.do(Command.SET, STIFF, at_tick=20_000) is Result.REFUSED_FULL


def test_tick_in_the_past_is_refused():
    flight = Flight(servo_params())
    flight.fly(10)
    assert flight.do(Command.SET, STIFF, at_tick=3) is Result.REFUSED_LATE


def test_stop_cancels_what_was_scheduled():
    flight = enabled(servo_params())
    flight.do(Command.SET, STIFF, at_tick=flight.tick + 1000)
    flight.do(Command.STOP)
    assert Result.CANCELLED in [answer[1] for answer in flight.answers]
    assert flight.plan.scheduled == ()


@pytest.mark.parametrize("lost", [1, 3, 8])
def test_lost_frames_never_make_a_multiple_velocity(lost):
    flight = enabled(servo_params(), {Value.VIRTUAL_DAMPING: 1.0})
    speed = 40  # counts a tick = 0.02 m/s
    for n in range(400):
        flight.fly(1, encoder=speed * n)
    out = flight.fly(1, encoder=speed * (400 + lost), arrival=lost)
    assert out[2] == pytest.approx(0.02, rel=1e-3)
    assert out[9] & Flag.INTERPOLATED


def test_long_gap_seeds_at_rest_and_ramps_the_force_in():
    flight = enabled(servo_params(), STIFF, 20_000)
    flight.fly(100)
    out = flight.fly(1, encoder=24_000, arrival=9)
    assert out[9] & Flag.SEEDED
    assert out[9] & Flag.QUIET_RAMP
    assert out[2] == 0.0
    assert abs(out[8]) < 0.02
    assert flight.fly(501)[8] == pytest.approx(-1.2, abs=1e-3)


def test_first_frame_seeds_the_filters_where_the_device_is():
    flight = Flight(servo_params(), 1_000_000)
    out = flight.fly()
    assert (out[2], out[3]) == (0.0, 0.0)


def test_zero_moves_the_origin_without_a_velocity():
    flight = Flight(servo_params(), 12_345)
    assert flight.do(Command.ZERO) is Result.APPLIED
    out = flight.fly()
    assert (out[1], out[2]) == (0.0, 0.0)
    assert flight.blob["homed"] == 1


def test_zero_is_refused_while_enabled():
    flight = enabled(servo_params(), STIFF, 20_000)
    assert flight.do(Command.ZERO) is Result.REFUSED_STATE
    assert flight.fly()[1] == pytest.approx(0.01)


def test_homing_is_refused_where_the_device_has_no_method():
    assert Flight(servo_params()).do(Command.HOME) is Result.REFUSED_STATE


def test_law_that_overflows_is_a_fault_and_never_a_force():
    flight = enabled(servo_params(), STIFF, 20_000)
    law = (0.01, 0.0, math.inf, math.inf, 0.0, 0.0)
    settled, _, ledger, held, signs = flight.state
    flight.state = settled, law, ledger, held, signs
    out = flight.fly()
    assert flight.plan.fault == BY_CODE["not_finite"].number
    assert out[9] & Flag.NOT_FINITE
    assert abs(out[8]) <= 1.0 + COUNT_N
    assert flight.fly(30)[0] == 0
    _, law, _, _, _ = flight.state
    assert all(math.isfinite(value) for value in law)


def test_step_is_a_function_of_its_arguments():
    flight = enabled(servo_params(), {**STIFF, Value.VIRTUAL_DAMPING: 1.0, Value.MASS: 0.01}, 2000)
    state = flight.state
    sample = (2040, 0, 2500, 0, 3, 0, 0.125, 0, 0)
    command = ((77, Command.SET, 1, 0, masked({Value.STIFFNESS: 400.0})),)
    assert flight.step(state, command, sample, 900) == flight.step(state, command, sample, 900)
    assert state == flight.state


def test_perturbation_runs_only_where_the_table_lets_it():
    flight = enabled(servo_params())
    wave = {Value.SAMPLES: 400.0, Value.LOOP: 1.0}
    assert flight.do(Command.PERTURB_START, wave) is Result.APPLIED
    assert flight.plan.wave[1:] == (400, True)
    flight.do(Command.STOP)
    assert flight.plan.wave[0] == 0
    assert flight.do(Command.PERTURB_START, wave) is Result.REFUSED_STATE


def test_perturbation_of_no_samples_is_refused():
    assert (
        enabled(servo_params()).do(Command.PERTURB_START, {Value.SAMPLES: 0.0, Value.LOOP: 0.0})
        is Result.REFUSED_RANGE
    )


def test_seed_after_replug_keeps_the_servo_disabled():
    flight = Flight(servo_params(), 500)
    flight.fly(1, arrival=SEED, encoder=-77_000)
    assert flight.plan.state is State.DISABLED
    assert flight.fly()[2] == 0.0


@pytest.mark.parametrize("samples", [math.nan, -5.0, 1e300, 400.0])
def test_perturbation_must_say_what_it_plays(samples):
    flight = enabled(servo_params())
    values = [0.0] * 20
    values[Value.SAMPLES] = samples  # not in the mask, and so never checked
    out = flight._one(((5, int(Command.PERTURB_START), 1, 0, tuple(values)),))
    assert out[10][0][1] == Result.REFUSED_RANGE
    assert flight.plan.wave[0] == 0


@pytest.mark.parametrize("sign", [1, -1])
def test_encoder_counter_goes_round_without_a_jump(sign):
    position = ScaleParams(COUNT_M, sign=sign)
    flight = enabled(
        servo_params(device=device_params(position=position)),
        {Value.VIRTUAL_DAMPING: 1.0},
        2**31 - 500,
    )
    there = [2**31 - 500 + 10 * n for n in range(101)]
    flown = [
        flight.fly(1, encoder=(count + 2**31) % 2**32 - 2**31) for count in (*there, *there[-2::-1])
    ]
    assert flight.plan.state is State.ENABLED
    assert {round(abs(b[1] - a[1]) / COUNT_M) for a, b in pairwise(flown)} == {10}
    assert flown[-1][1] == pytest.approx(flown[0][1], abs=1e-9)


def test_jump_of_less_than_a_turn_is_a_sensor_fault():
    flight = enabled(servo_params())
    flight.fly(1, encoder=2**31 - 1)
    assert flight.blob["fault"] == BY_CODE["sensor_range"].number


def test_wall_changes_sides_without_a_jump():
    flight = enabled(servo_params(), {Value.WALL_STIFFNESS: 1000.0}, 4000)
    forces = [flight.fly()[8]]
    for side in (1.0, -1.0):
        flight.do(Command.SET, {Value.WALL_SIDE: side, Value.RAMP_S: 0.05})
        forces += [flight.fly()[8] for _ in range(60)]
        assert flight.answers[-1][5][Value.WALL_SIDE] == side
    assert forces[60] == pytest.approx(-2.0, abs=COUNT_N)
    assert forces[-1] == 0.0
    assert max(abs(b - a) for a, b in pairwise(forces)) < 2.0 * 0.1


def test_new_life_of_the_board_forgets_origin_and_homing():
    home = HomeParams(method="stop", required=True)
    flight = Flight(
        servo_params(
            device=device_params(home=home, position=ScaleParams(COUNT_M, offset_count=40.0))
        ),
        1000,
    )
    flight.do(Command.ZERO)
    assert flight.blob["homed"] == 1
    assert flight.fly(1, arrival=9)[1] == 0.0  # a gap is no new life
    out = flight.fly(1, arrival=SEED, encoder=100)
    assert out[1] == pytest.approx(60 * COUNT_M)
    assert flight.do(Command.ENABLE) is Result.REFUSED_NOT_HOMED


def test_change_that_was_judged_for_another_environment_is_refused():
    flight = enabled(servo_params(), {Value.STIFFNESS: 100.0})
    judged = flight.plan.environment_revision
    softer = {Value.STIFFNESS: 50.0, Value.ENVIRONMENT_REVISION: judged}
    assert flight.do(Command.SET, softer) is Result.APPLIED
    before = flight.plan.values
    assert flight.do(Command.SET, softer) is Result.REFUSED_REVISION
    assert flight.plan.values == before
    assert flight.do(Command.DAMPING, {**softer, Value.ACTIVE_DAMPING_ON: 1.0}) is (
        Result.REFUSED_REVISION
    )
    assert not flight.plan.active_damping_on


def test_only_what_is_rendered_and_damped_makes_a_verdict_old():
    flight = Flight(servo_params())
    flight.do(Command.SET, {Value.STIFFNESS: 100.0})
    judged = flight.plan.environment_revision
    flight.do(Command.SET, {Value.LIMIT_CYCLE_FAULTS: 0.0})
    flight.do(Command.ZERO)
    assert flight.plan.environment_revision == judged
    for values in ({Value.ACTIVE_DAMPING_ON: 1.0}, {Value.VELOCITY_FILTER_HZ: 90.0}):
        flight.do(Command.SET, values)
        judged += 1
        assert flight.plan.environment_revision == judged


def test_enable_that_was_judged_for_another_environment_is_refused():
    flight = Flight(servo_params())
    flight.do(Command.SET, {Value.STIFFNESS: 100.0})
    judged = {Value.ENVIRONMENT_REVISION: float(flight.plan.environment_revision)}
    flight.do(Command.SET, {Value.STIFFNESS: 200.0})
    assert flight.do(Command.ENABLE, judged) is Result.REFUSED_REVISION
    assert flight.plan.state is State.DISABLED


def test_scheduled_change_is_refused_at_its_tick_when_another_came_between():
    flight = enabled(servo_params(), {Value.STIFFNESS: 100.0})
    judged = float(flight.plan.environment_revision)
    at = flight.tick + 50
    later = {Value.STIFFNESS: 50.0, Value.ENVIRONMENT_REVISION: judged}
    assert flight.do(Command.SET, later, at_tick=at) is Result.SCHEDULED
    flight.do(Command.SET, {Value.VIRTUAL_DAMPING: 1.0})
    flight.fly(60)
    assert flight.answers[-1][1] == Result.REFUSED_REVISION
    assert flight.plan.values[Value.STIFFNESS].end == 100.0


def test_gateway_may_ask_for_its_own_fault_alone_and_only_under_force():
    flight = Flight(servo_params())
    lost = {Value.FAULT_NUMBER: float(BY_CODE["damping_not_delivered"].number)}
    assert flight.do(Command.FAULT, lost) is Result.REFUSED_STATE
    flight.do(Command.ENABLE)
    overspeed = {Value.FAULT_NUMBER: float(BY_CODE["overspeed"].number)}
    assert flight.do(Command.FAULT, overspeed) is Result.REFUSED_RANGE
    assert flight.plan.state is State.ENABLED
    assert flight.do(Command.FAULT, lost) is Result.APPLIED
    assert flight.plan.state is State.FAULT
    assert flight.blob["fault"] == BY_CODE["damping_not_delivered"].number


def test_cancel_takes_what_others_scheduled_of_its_places_and_moves_nothing():
    flight = enabled(servo_params(), {Value.STIFFNESS: 100.0})
    at = flight.tick + 50
    flight.do(
        Command.SET, {Value.STIFFNESS: 300.0, Value.ACTIVE_DAMPING: 0.5}, at_tick=at, actor=16
    )
    flight.do(Command.SET, {Value.MASS: 0.02}, at_tick=at + 1, actor=17)
    flight.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.0}, at_tick=at + 2, actor=16)
    revision = flight.plan.revision
    places = {Value.STIFFNESS: 0.0, Value.MASS: 0.0}
    assert flight.do(Command.CANCEL, places, actor=17) is Result.APPLIED
    assert flight.plan.revision == revision
    assert Result.CANCELLED in [answer[1] for answer in flight.answers]
    flight.fly(60)
    ends = [flight.plan.values[place].end for place in (Value.STIFFNESS, Value.MASS)]
    assert ends == [100.0, 0.02]
    assert flight.plan.active_damping_asked == 1.0


@pytest.mark.parametrize("mask", [math.nan, math.inf, -1.0, 2.0**60])
def test_cancel_of_no_places_is_refused(mask):
    flight = Flight(servo_params())
    assert flight.do(Command.CANCEL, {Value.MASK: mask}) is Result.REFUSED_RANGE
