"""The attack of `make bench`: it commands, strikes and judges as it says, on a few flights."""

import pytest

from benchmarks.attack import fly


def test_a_flight_is_its_seed() -> None:
    assert fly(5) == fly(5)


@pytest.mark.parametrize("seed", [3, 17, 57])
def test_nothing_that_must_not_happen_happens_in_some_flights(seed: int) -> None:
    """Those in which the first attacks found something."""
    found = fly(seed)
    assert not found.violations
    assert found.forced > 0.1 * found.ticks
