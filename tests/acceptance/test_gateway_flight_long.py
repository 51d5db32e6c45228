"""The flight recorder: what it keeps, when it writes, what is in the file, and that a bad disk
harms nobody.
"""

from pathlib import Path

import pytest
from support.recorded import RecordedFlight
from test_gateway_flight import written

from hapticd.protocol import flight
from hapticd.protocol.flight import flights_folder


@pytest.fixture
def folder(runtime: Path) -> Path:
    return flights_folder("test")


def test_only_the_last_seconds_are_kept(folder: Path) -> None:
    with RecordedFlight(flight_s=2.0) as flown:
        flown.fly(20_000)
        flown.publisher.flight.dump("asked")
        (path,) = written(flown, folder)
        found = flight.read_flight(path)
    assert 12_000 <= len(found.records) < 12_100  # 2 s, and the 10 s within which a checkpoint lies
    assert found.records["tick"][-1] == 19_999
    assert all(tick >= found.records["tick"][0] for tick, _ in found.header["checkpoints"])
    assert len(found.header["checkpoints"]) >= 1


def test_gap_is_noted_with_its_row(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.fly(1000)
        flown.stack.run(9000)  # the gateway does not look: the ring is overwritten
        flown.look()
        flown.fly(100)
        flown.publisher.flight.dump("asked")
        (path,) = written(flown, folder)
        header, records = flight.read_flight(path)
        ((row, lost),) = header["gaps"]
        assert int(records["tick"][row]) - int(records["tick"][row - 1]) - 1 == lost > 0
