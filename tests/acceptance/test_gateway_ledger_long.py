"""The energy ledger of a whole stack on virtual time, against the simulated device itself."""

import pytest
from test_gateway_ledger import EVERYTHING, LOSSES, flown, sums

from hapticd.protocol.ledger import NAMES, Ledger


def test_sums_do_not_depend_on_how_records_come():
    params, records = flown(EVERYTHING, 800, injections=LOSSES)
    one = sums(params, records, len(records))
    for at_once in (1, 7, 20):
        other = sums(params, records, at_once)
        for name in NAMES:
            assert other[name][-1] == pytest.approx(one[name][-1], rel=1e-9, abs=1e-18), name
    late = Ledger(params)
    for start in range(0, 700, 20):
        late.defer(records[start : start + 20])
    assert late.take(records[700:])[-1] == pytest.approx(
        [one[name][-1] for name in NAMES], rel=1e-9, abs=1e-18
    )
