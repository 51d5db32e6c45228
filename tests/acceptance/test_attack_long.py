"""The attack of `make bench`: it commands, strikes and judges as it says, on a few flights."""

from benchmarks.attack import fly


def test_a_flight_is_its_seed() -> None:
    assert fly(5) == fly(5)
