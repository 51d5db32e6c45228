"""Homing finds the stop or the index, or says that it did not: over stiffness, friction, hands, a
motor without power, and 50 seeds of all of them.
"""

from dataclasses import replace

import pytest
from support.homing_rig import HOME, Rig, seeded

from hapticd.servo.safety import State

# --- all of it by seed ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 50, 10))
def test_homing_finds_the_stop_or_says_that_it_did_not(first):
    """No seed is falsely homed; most of those that nobody touches are homed."""
    quick = replace(HOME, timeout_s=7.0)
    undisturbed = []
    for seed in range(first, first + 10):
        case = seeded(seed)
        board = {"mass_kg": case.mass_kg, "lower_stop_m": case.stop_m, "upper_stop_m": 0.022}
        found = Rig(quick, case.touch, **board).home(case.stop_m)
        assert found.state is (State.DISABLED if found.homed else State.FAULT), (seed, case.what)
        assert not found.homed or abs(found.error_m) <= 100e-6, (seed, case.what)
        if " none " in case.what:
            undisturbed.append(found.homed)
    assert undisturbed.count(True) >= 0.6 * len(undisturbed)
