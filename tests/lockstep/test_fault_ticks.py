"""From the physical cause of a fault to no force at the motor: what its page promises holds."""

import pytest

from benchmarks.fault_ticks import CASES, RAMP_TICKS, stated_ticks, ticks_of
from hapticd.core.faults import FAULTS

MOST_TICKS = 10
# ADR-0014 says why these take longer
LONGER = {"gateway_lost", "lost_slots", "force_at_limit"}
# of a cause: a number, sums, an estimate over seconds, a defect of the servo; and homing's verdicts
# on a search
NO_MOMENT = {"not_finite", "energy", "commissioning", "damping_not_delivered", "device_differs"}


@pytest.mark.parametrize("code", CASES)
def test_no_force_is_left_when_the_faults_page_says(code: str) -> None:
    assert ticks_of(CASES[code], seed=0) <= stated_ticks(code) + RAMP_TICKS


@pytest.mark.parametrize("code", CASES)
def test_fault_is_noticed_within_ten_ticks_or_a_decision_says_why_not(code: str) -> None:
    assert (stated_ticks(code) > MOST_TICKS) == (code in LONGER)


def test_every_fault_that_has_a_moment_is_measured() -> None:
    codes = {one.code for one in FAULTS[1:] if not one.code.startswith("home_")}
    assert codes - NO_MOMENT == set(CASES)
