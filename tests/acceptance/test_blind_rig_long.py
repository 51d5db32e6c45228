"""The first day at rigs whose truth is hidden from the steps: what they find is true, what is
broken is refused by name, and the path knows no simulated board.
"""

import pytest
from support.blind_rig import REFUSED, STEPS, BlindRig, first_day
from support.blind_rig_helpers import QUICK, SEED, seen

MORE_SEEDS = (2, 5)
pytestmark = pytest.mark.timeout(1800)  # a whole day on a machine with other work


def agrees(seed, until=""):
    """Within twice the interval: one chance in 10 000, and the seed makes it none."""
    day, known, _, worst_share = seen(seed, until)
    assert day.refused is None
    assert not day.error
    for one, true in known:
        half = (one.high - one.low) / 2.0
        assert abs(one.value - true) <= 2.0 * half, f"{one}, true {true}"
    assert 0.0 < worst_share <= 0.1


def test_what_the_first_day_finds_is_what_is_true():
    agrees(SEED, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("seed", MORE_SEEDS)
def test_the_first_day_comes_to_its_end(seed):
    """Every step is done; how often intervals hold the truth is what benchmarks/blind.py counts."""
    day, known, _, worst_share = seen(seed)
    assert day.refused is None
    assert not day.error
    assert len(day.results) == len(STEPS)
    assert sum(one.low <= true <= one.high for one, true in known) >= 0.6 * len(known)
    assert 0.0 < worst_share <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize("broken", REFUSED)
def test_a_broken_rig_is_refused_by_name(broken):
    with BlindRig(4, broken) as rig:
        day = first_day(rig)
    assert day.refused is not None
    step, finding = day.refused
    expected, word = REFUSED[broken]
    assert step == expected
    assert word in f"{finding.what}; {finding.remedy}"


def test_a_push_stays_below_a_tenth_also_with_a_stronger_motor_that_sticks():
    with BlindRig(1, force_gain=1.3, coulomb_n=2.0) as rig:
        day = first_day(rig)
        assert day.refused is not None
        assert 0.05 < rig.worst_share <= 0.1
