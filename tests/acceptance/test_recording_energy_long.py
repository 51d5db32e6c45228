"""The energy ledger of recordings: in the finished file, of unfinished ones, of old ones."""

from pathlib import Path

import numpy as np
import pytest
from support.recorded import RecordedFlight, recorded_into

from hapticd.protocol.ledger import NAMES, Ledger
from hapticd.recording.file import DATASETS, GROUP, energies, open_recording, total_j


@pytest.fixture(scope="module")
def shaken() -> RecordedFlight:
    with RecordedFlight() as flight:
        flight.move()
        flight.fly(1500)
        return flight


def test_finished_recording_holds_the_energy_of_every_tick(
    shaken: RecordedFlight, tmp_path: Path
) -> None:
    recorded_into(tmp_path / "one.h5", shaken)
    expected = Ledger(shaken.params).take(shaken.records)
    with open_recording(tmp_path / "one.h5") as recording:
        found = np.stack([recording.column(GROUP, name) for name in DATASETS], axis=1)
        ticks = recording.column("servo", "tick")
        total = total_j(recording)
        again = np.concatenate([part for _, part in energies(recording)])
    flown = expected[ticks - int(shaken.records["tick"][0])]
    assert found[-1] - found[0] == pytest.approx(flown[-1] - flown[0], rel=1e-9, abs=1e-15)
    assert found == pytest.approx(again, rel=1e-9, abs=1e-18)
    assert [total[name] for name in NAMES] == pytest.approx(found[-1].tolist())
    assert total["hold_delay"] > 1e-6
