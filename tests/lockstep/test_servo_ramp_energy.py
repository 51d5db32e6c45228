"""No rhythm of changes pumps a hand: what they bring in within a second has a budget."""

import dataclasses
import json
import math

import numpy as np
import pytest
from support.flight import Flight, enabled
from support.models import COUNT_M, device_params, servo_params
from support.pump import HeldFlight, toggled

from hapticd.core.params import RAMP_ENERGY_J, SafetyParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.servo.plan import Booking, flatten, unflatten
from hapticd.servo.safety import FAULT_EVENT, State

TEN_MM = 20_000  # counts
SOFT = {Value.STIFFNESS: 40.0, Value.RAMP_S: 0.0}
# of K = 40 and 380 N/m for 1 kg: Mathieu-Hill, integrated by Runge-Kutta in 4400 steps
MULTIPLIERS = ((0.0, 2.085), (2.0, 1.676))


def budgeted(budget_j=RAMP_ENERGY_J, **changes):
    return servo_params(device=device_params(ramp_energy_j=budget_j), **changes)


def hand(budget_j, virtual_damping_ns_per_m, start_m):
    """1 kg under 40 N/m, at rest at `start_m`."""
    flight = HeldFlight(budgeted(budget_j), 1.0, virtual_damping_ns_per_m)
    assert flight.do(Command.SET, SOFT) is Result.APPLIED
    flight.do(Command.ENABLE)
    flight.fly(520)
    flight.position_m = start_m
    return flight


@pytest.mark.parametrize(("damping", "multiplier"), MULTIPLIERS)
def test_toggled_spring_pumps_a_hand_where_there_is_no_budget(damping, multiplier):
    """The hold of the force adds a damping of -K T / 2: 1.2 % more in 220 ms."""
    amplitude = np.sqrt(toggled(hand(math.inf, damping, 2e-4), 6))
    assert amplitude[-1] / amplitude[-2] == pytest.approx(multiplier * 1.012, rel=0.003)


def test_single_change_and_enable_at_a_normal_deflection_are_not_delayed():
    """K = 500 N/m at 10 mm: 25 mJ, as without a budget in every tick."""
    shown = []
    for budget_j in (RAMP_ENERGY_J, math.inf):
        flight = Flight(budgeted(budget_j), TEN_MM)
        flight.do(Command.SET, {Value.STIFFNESS: 250.0, Value.RAMP_S: 0.0})
        flight.do(Command.ENABLE)
        forces = [flight.fly()[8] for _ in range(502)]
        flight.do(Command.SET, {Value.STIFFNESS: 500.0, Value.RAMP_S: 0.05})
        forces += [flight.fly()[8] for _ in range(51)]
        assert forces[-1] == pytest.approx(-5.0, abs=1e-3)
        shown.append(forces)
    assert shown[0] == shown[1]


def stiffened(params=None, after_j=0.025):
    """A flight 10 mm off in whose last second `after_j` were brought in, the last just now."""
    flight = enabled(params or budgeted(), {Value.STIFFNESS: 0.0}, TEN_MM)
    flight.do(Command.SET, {Value.STIFFNESS: 2.0 * after_j / 1e-4, Value.RAMP_S: 0.05})
    flight.fly(51)
    assert not flight.out[9] & (Flag.PAUSED | Flag.RAMPING)
    return flight


def test_ramp_that_pauses_neither_jumps_nor_ends_and_goes_on():
    flight = stiffened()
    flight.do(Command.SET, {Value.STIFFNESS: 700.0, Value.RAMP_S: 0.1})
    shown = []
    for _ in range(1200):
        flags = flight.fly()[9]
        shown.append((flight.blob["stiffness_n_per_m"], bool(flags & Flag.PAUSED)))
        assert flags & Flag.RAMPING or shown[-1][0] == 700.0
    stiffness = np.array([value for value, _ in shown])
    waiting = np.array([pause for _, pause in shown])
    # 2 N/m a tick, also behind the pause: 5 mJ are 100 N/m at 10 mm
    assert set(np.round(np.diff(stiffness), 6)) == {0.0, 2.0}
    assert np.unique(stiffness[waiting]) == pytest.approx([600.0])
    assert 900 <= waiting.sum() <= 1051
    assert stiffness[-1] == 700.0


def test_receipt_tells_the_earliest_end_of_a_ramp_that_pauses():
    flight = stiffened()
    flight.do(Command.SET, {Value.STIFFNESS: 700.0, Value.RAMP_S: 0.1})
    _, _, _, _, (first, end), _ = flight.answers[-1]
    assert end - first == 100
    flight.fly(101)
    assert flight.blob["stiffness_n_per_m"] < 700.0
    assert flight.out[9] & Flag.RAMPING


def test_step_without_a_ramp_waits_as_well():
    flight = stiffened()
    flight.do(Command.SET, {Value.STIFFNESS: 1000.0, Value.RAMP_S: 0.0})
    flight.fly(10)
    assert flight.out[9] & Flag.PAUSED
    assert flight.blob["stiffness_n_per_m"] < 600.0
    flight.fly(2200)
    assert flight.blob["stiffness_n_per_m"] == 1000.0


RISING = [
    {Value.WALL_STIFFNESS: 3000.0, Value.WALL_POSITION: 0.005, Value.WALL_SIDE: 1.0},
    {Value.MASS: 5.0, Value.RAMP_S: 0.05},
    {Value.STIFFNESS: 900.0},
]


@pytest.mark.parametrize("change", RISING)
def test_each_element_that_stores_energy_is_booked(change):
    """The mass at 0.5 m/s."""
    flight = stiffened()
    flags = 0
    for n in range(60):
        at = TEN_MM + (1000 * n if Value.MASS in change else 0)
        if n == 20:
            flight.do(Command.SET, change, encoder=at)
        flags |= flight.fly(1, encoder=at)[9]
    assert flags & Flag.PAUSED


def test_wall_that_moves_into_the_handle_is_booked_and_may_move_away():
    flight = enabled(
        budgeted(),
        {Value.WALL_STIFFNESS: 1000.0, Value.WALL_POSITION: 0.01, Value.WALL_SIDE: 1.0},
        TEN_MM,
    )
    paused = 0
    for _ in range(8):  # 5 mm in: 12.5 mJ each time
        flight.do(Command.SET, {Value.WALL_POSITION: 0.005, Value.RAMP_S: 0.02})
        paused += sum(bool(flight.fly()[9] & Flag.PAUSED) for _ in range(30))
        flight.do(Command.SET, {Value.WALL_POSITION: 0.01, Value.RAMP_S: 0.02})
        flight.fly(21)
        assert flight.blob["wall_position_m"] == 0.01
        assert not flight.out[9] & Flag.PAUSED
    assert paused > 100


def test_gain_of_an_enable_is_booked():
    """Enabled and disabled again and again, 10 mm off."""
    params = budgeted(safety=SafetyParams(enable_ramp_s=0.02))
    flight = Flight(params, TEN_MM)
    flight.do(Command.SET, {Value.STIFFNESS: 400.0, Value.RAMP_S: 0.0})
    reached = []
    for _ in range(6):
        flight.do(Command.ENABLE)
        flight.fly(40)
        reached.append(flight.blob["gain"])
        flight.do(Command.DISABLE)
        assert flight.fly()[8] == 0.0
    assert reached[0] == 1.0
    assert sum(reached) * 0.02 <= RAMP_ENERGY_J
    assert reached[-1] < 0.1


def waiting_flight():
    flight = stiffened()
    asked = {
        Value.STIFFNESS: 2000.0,
        Value.VIRTUAL_DAMPING: 4.0,
        Value.MASS: 0.01,
        Value.RAMP_S: 0.1,
    }
    flight.do(Command.SET, asked)
    flight.fly(60)
    assert flight.out[9] & Flag.PAUSED
    return flight


def test_what_falls_is_never_held():
    flight = waiting_flight()
    damping = flight.blob["virtual_damping_ns_per_m"]
    flight.do(Command.SET, {Value.VIRTUAL_DAMPING: 0.0, Value.RAMP_S: 0.02})
    flight.fly(10)
    assert flight.out[9] & Flag.PAUSED  # the spring
    assert flight.blob["virtual_damping_ns_per_m"] == pytest.approx(0.5 * damping)
    flight.do(Command.SET, {Value.STIFFNESS: 0.0, Value.MASS: 0.0, Value.RAMP_S: 0.02})
    flight.fly(20)
    assert flight.blob["stiffness_n_per_m"] == flight.blob["mass_kg"] == 0.0
    assert flight.fly()[8] == 0.0


def test_stop_fault_and_disable_are_not_delayed():
    flight = waiting_flight()
    flight.do(Command.STOP)
    flight.fly(20)
    assert (flight.plan.state, flight.out[8]) == (State.STOPPED, 0.0)
    flight = waiting_flight()
    flight.event(FAULT_EVENT, 3)
    flight.fly(20)
    assert (flight.plan.state, flight.out[8]) == (State.FAULT, 0.0)
    flight = waiting_flight()
    flight.do(Command.DISABLE)
    assert flight.fly()[8] == 0.0


def test_stop_and_reset_do_not_free_the_window():
    flight = stiffened()
    flight.do(Command.STOP)
    flight.fly(21)
    flight.do(Command.RESET)
    flight.do(Command.ENABLE)
    flight.fly(300)
    assert flight.out[9] & Flag.PAUSED


def test_checkpoint_carries_the_window():
    flight = waiting_flight()
    again = Flight(flight.params)
    again.state = unflatten(json.loads(json.dumps(flatten(flight.state))))
    again.tick = flight.tick
    again.encoder = flight.encoder
    assert isinstance(again.plan.bookings[0], Booking)
    for _ in range(1100):
        assert flight.fly() == again.fly()
        assert flight.state[0].blob == again.state[0].blob


def test_parameters_of_earlier_versions_have_no_budget():
    flight = enabled(servo_params(), {Value.STIFFNESS: 100.0}, TEN_MM)
    assert dataclasses.asdict(servo_params())["device"]["ramp_energy_j"] == math.inf
    for stiffness in (2000.0, 0.0, 2000.0):
        flight.do(Command.SET, {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.05})
        flight.fly(51)
        assert flight.blob["stiffness_n_per_m"] == stiffness
    assert flight.plan.bookings == ()
    assert flight.encoder * COUNT_M == 0.01


@pytest.mark.parametrize("actor", ["stop", "fault"])
def test_force_of_a_gain_that_waits_never_rises_when_it_has_to_end(actor):
    """What waits at the end of its ramp would arrive in the next tick: up by a third, once."""
    flight = Flight(budgeted(safety=SafetyParams(enable_ramp_s=0.001)), TEN_MM)
    flight.do(Command.SET, {Value.STIFFNESS: 700.0, Value.RAMP_S: 0.0})
    for _ in range(3):
        flight.do(Command.ENABLE)
        flight.fly(60)
        if flight.out[9] & Flag.PAUSED:
            break
        flight.do(Command.DISABLE)
        flight.fly()
    assert flight.out[9] & Flag.PAUSED
    before_n = abs(flight.out[8])
    assert 0.0 < before_n < 6.0
    forces = []
    flight.do(Command.STOP) if actor == "stop" else flight.event(FAULT_EVENT, 3)
    forces = [abs(flight.out[8]), *(abs(flight.fly()[8]) for _ in range(20))]
    assert forces[0] <= before_n
    assert (np.diff(forces) <= 0.0).all()
    assert forces[-1] == 0.0
