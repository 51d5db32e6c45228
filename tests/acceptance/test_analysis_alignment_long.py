"""A record of another system beside the own one: offset, clock and gaps against those it was made
with.
"""

import pytest
from support.foreign import MARK_AT, own, played, recorded, without
from test_analysis_alignment import OFFSET, ROWS, SECONDS, noisy

from hapticd.zwidth.alignment import align


@pytest.fixture(scope="module")
def force():
    return played(SECONDS)


def test_many_single_samples_lost_do_not_turn_the_clock(force):
    """One in two quarters of a second, each half a sample off the line where it lies in a piece."""
    rows = range(9000, 52_000, 2111)
    heard = noisy(recorded(force, OFFSET, 180.0, ROWS), 3.0)
    found = align(own(force), MARK_AT, without(heard, tuple((row, 1) for row in rows)))
    assert sum(gap.lost for gap in found.gaps) == len(rows)
    assert {gap.lost for gap in found.gaps} == {1}
    assert found.clock.ppm == pytest.approx(180.0, abs=4.0 * found.clock.ppm_sd)
