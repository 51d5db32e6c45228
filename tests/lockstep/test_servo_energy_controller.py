"""What leaks is ended by damping and by less stiffness, in time and only then.

The balance is that of the simulated motor: work on the device + change of stored energy - credited
damping x int v^2 dt - what changes brought in.
"""

import json
import math

import numpy as np
import pytest
from support.boards import BOARD, board_params
from support.flight import HEALTHY
from support.leaking import CREDITED_NS_PER_M, LeakFlight, T, wander
from support.models import device_params, servo_params
from support.recorded import RecordedFlight
from support.servo_energy_controller import (
    BALANCE_J,
    CASES,
    CEILING,
    HANDS,
    SMOOTHED_HZ,
    against_a_wall,
    flight,
    passive_limit,
    wall,
)

from hapticd.core.params import ENERGY_LIMIT_J, SafetyParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.recording import replay
from hapticd.render.law import EXCESS, Ramp, ledger_at_rest
from hapticd.servo.energy import SHARE, halved, lag
from hapticd.servo.plan import GATEWAY_ALIVE, SETTLED, Control, flatten, unflatten
from hapticd.servo.safety import State


@pytest.mark.parametrize(("lag_hz", "delay", "hand"), CASES)
def test_without_the_controller_it_diverges(lag_hz, delay, hand):
    """Up to the clamp of the law, which alone ends the growth."""
    free = against_a_wall(False, 0, lag_hz, delay, hand, ticks=2000)
    assert max(free.leaks) > 4.0 * BALANCE_J
    assert any(flags & Flag.CLAMPED for flags in free.flags)


@pytest.mark.parametrize(("lag_hz", "delay", "hand"), CASES)
def test_board_that_does_not_report_its_damping_is_cut_after_a_trial(lag_hz, delay, hand):
    """More leaks meanwhile, but not so much that the fault has to end it."""
    held = against_a_wall(True, 0, lag_hz, delay, hand, damps=False)
    assert held.plan.state is State.ENABLED
    assert max(held.leaks) < 0.9 * ENERGY_LIMIT_J
    assert held.blob["wall_stiffness_n_per_m"] < 1.3 * passive_limit(delay, lag_hz)


def leaking(**others):
    """A flight in which the controller has just acted."""
    found = flight(**others)
    found.begun(wall(5.0 * passive_limit(found.delay, found.lag_hz)))
    for push in wander(found.hand, 1200, 0):
        found.pushed([push])
        if found.acted:
            return found
    raise AssertionError("it did not act")


def test_it_is_a_change_that_the_servo_gives_itself():
    found = leaking()
    before = found.plan
    blob = found.blob
    assert blob["actor"] == 0
    assert (blob["revision"], blob["environment_revision"]) == (before.revision, 2)
    assert blob["active_damping_asked_ns_per_m"] == pytest.approx(CEILING)
    found.fly(3)
    assert found.blob["active_damping_ns_per_m"] >= 3 * 500.0 * T  # a slew of its own
    assert found.out[9] & Flag.CONTROLLED


def test_what_it_did_stays_until_a_change_asks_for_it_again():
    found = against_a_wall(True, 0, 0.0, 0.125, "bare", damps=False)
    cut = found.blob["wall_stiffness_n_per_m"]
    found.push_n = 0.0
    found.do(Command.DISABLE)
    found.fly(50)
    assert found.out[9] & Flag.CONTROLLED
    assert found.blob["wall_stiffness_n_per_m"] == cut
    assert found.do(Command.SET, {Value.WALL_STIFFNESS: 100.0}) is Result.APPLIED
    assert found.out[9] & Flag.CONTROLLED  # the damping
    assert found.do(Command.DAMPING, {Value.ACTIVE_DAMPING_ON: 0.0}) is Result.APPLIED
    assert not found.fly()[9] & Flag.CONTROLLED


def test_it_does_not_act_in_a_measurement():
    found = flight(True)
    found.begun(wall(5.0 * passive_limit(0.125, 0.0)) | {Value.LIMIT_CYCLE_FAULTS: 0.0})
    found.pushed(wander(found.hand, 600, 0))
    assert max(found.leaks) > 4.0 * BALANCE_J
    assert not found.acted


def test_a_stiffness_that_is_held_back_on_its_way_up_is_cut_from_where_it_is():
    """One tick is left of its ramp: a half of where that would lead is more than acted."""
    tick = 700
    plan = flight().plan
    values = plan.values | {Value.STIFFNESS: Ramp(100.0, 1000.0, tick - 1, 1)}
    cut = halved(plan._replace(values=values), Control((), tick, 0.0), tick - 1)
    assert cut.values[Value.STIFFNESS].value(tick) == 50.0


def test_it_is_off_by_default_and_without_a_known_damping():
    assert not SafetyParams().energy_controller
    found = flight(True, physical_damping_ns_per_m=None)
    found.begun(wall(5.0 * passive_limit(0.125, 0.0)))
    found.pushed(wander(found.hand, 100, 0))
    assert not found.acted


def test_damping_at_its_ceiling_already_leaves_only_the_cut():
    found = flight(True, damps=False)
    level = {Value.ACTIVE_DAMPING: CEILING, Value.ACTIVE_DAMPING_ON: 1.0}
    found.begun(wall(5.0 * passive_limit(0.125, 0.0)) | level)
    found.pushed(wander(found.hand, 1200, 0))
    assert max(found.leaks) <= BALANCE_J
    assert Value.ACTIVE_DAMPING not in found.plan.control.places
    assert found.blob["wall_stiffness_n_per_m"] < passive_limit(0.125, 0.0)


def test_stop_in_the_middle_ends_force_as_ever():
    found = leaking()
    found.do(Command.STOP)
    found.fly(21)
    assert found.plan.state is State.STOPPED
    assert found.out[8] == 0.0
    entry = found.plan.added_entry
    stiffness = found.blob["wall_stiffness_n_per_m"]
    found.fly(1000)
    assert found.blob["active_damping_ns_per_m"] == pytest.approx(entry, abs=1e-3)
    assert found.blob["wall_stiffness_n_per_m"] == stiffness


def test_it_needs_no_gateway():
    """Where the loss of the gateway is no fault."""
    safety = SafetyParams(energy_controller=True, on_gateway_loss="hold")
    device = device_params(physical_damping_ns_per_m=CREDITED_NS_PER_M)
    found = LeakFlight(servo_params(device=device, safety=safety), HANDS["bare"])
    found.begun(wall(5.0 * passive_limit(0.125, 0.0)))
    for push in wander(found.hand, 1200, 0):
        found.push_n = push
        found.fly(1, host=HEALTHY & ~GATEWAY_ALIVE)
    assert max(found.leaks) <= BALANCE_J
    assert found.acted


def test_lost_slots_count_as_time():
    """The damping goes as far in one tick behind two lost slots as in three ticks."""
    found = leaking()
    level = found.blob["active_damping_ns_per_m"]
    found.tick += 2
    found.fly()
    assert found.blob["active_damping_ns_per_m"] - level == pytest.approx(6.0, rel=0.01)


def test_excess_that_is_not_a_number_is_a_fault_and_is_forgotten():
    found = flight(True)
    found.begun(wall(100.0))
    settled, law, ledger, held, signs = found.state
    broken = (*ledger[:EXCESS], math.nan, *ledger[EXCESS + 1 :])
    found.state = settled, law, broken, held, signs
    found.fly(3)
    assert found.plan.state is State.FAULT
    assert not found.acted
    assert ledger_at_rest(broken)[EXCESS] == 0.0


def test_what_damping_and_cuts_do_not_end_is_still_a_fault():
    """A motion that is forced and gives away energy whatever K is: at twice the delay reported."""
    found = flight(True)
    found.begun({Value.STIFFNESS: 50.0})
    settled, law, ledger, held, signs = found.state
    found.state = settled, law, (ledger[0], 1.01 * ENERGY_LIMIT_J, *ledger[2:]), held, signs
    found.fly(2)
    assert found.plan.state is State.FAULT


def test_lag_of_the_force_is_booked_as_it_is():
    """A force that goes on and off behind 31.8 Hz: mean of each period against integration."""
    found = lag(flight(True, lag_hz=SMOOTHED_HZ).params)
    assert found is not None
    of_before, of_newest, of_last = found
    commands = np.repeat([0.0, 3.0, -2.0, 1.0], 7)
    parts = 2000
    corner = math.tau * SMOOTHED_HZ
    force = 0.0
    mean = 0.0
    last = 0.0
    for command in commands:
        sums = 0.0
        for _ in range(parts):
            after = command + (force - command) * math.exp(-corner * T / parts)
            sums += 0.5 * (force + after) / parts
            force = after
        mean = of_before * mean + of_newest * command + of_last * last
        last = command
        assert mean == pytest.approx(sums, abs=1e-6)


def test_checkpoint_carries_what_it_did():
    found = leaking(damps=False)
    found.pushed(wander(found.hand, 20, 1))
    again = unflatten(json.loads(json.dumps(flatten(found.state))))
    assert again == found.state
    assert isinstance(again[SETTLED].plan.control, Control)
    assert again[SETTLED].flags & Flag.CONTROLLED


def test_what_it_did_is_replayed_bit_by_bit_and_told_once():
    """The whole stack: K = 800 N/m without damping, which a push sets off."""
    device = device_params(physical_damping_ns_per_m=CREDITED_NS_PER_M)
    params = servo_params(device=device, safety=SafetyParams(energy_controller=True))
    with RecordedFlight(params, board_params()) as flown:
        flown.set_off(1500.0, [3000] * 40)
        flown.fly(1000)
        records = flown.records
        leg = flown.leg()
        told = [event for event in flown.journal.recent if event["kind"] == "controlled"]
    assert BOARD.mass_kg < 0.01
    assert records["state"][-1] == State.ENABLED
    assert records["flags"][-1] & Flag.CONTROLLED
    assert records["excess_j"].max() < 2.0 * SHARE * ENERGY_LIMIT_J + BALANCE_J
    changes = np.diff(records["environment_revision"])[-1000:].sum()
    assert len(told) == changes >= 1
    assert replay.difference(leg.records, replay.replay(params, leg)) is None
