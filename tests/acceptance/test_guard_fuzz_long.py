"""No order of requests, leases, restarts and stalls leads past a strict guard."""

import pytest
from support.guard_fuzz import flown


@pytest.mark.parametrize("seed", [37, 51, 62, 63])
def test_nothing_unsafe_acts_whatever_three_clients_do(seed: int) -> None:
    fuzz = flown(seed)
    assert len(fuzz.acted) > 300
    assert fuzz.unsafe() == []
