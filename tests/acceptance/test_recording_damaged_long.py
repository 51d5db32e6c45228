"""Damaged recordings: bounded time, one clear error, and the source stays as it is."""

import random
from pathlib import Path

import pytest
from support.attacks.documents import crashed_recording, damaged_bytes, pack_damaged
from support.recorded import RecordedFlight

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def crashed(recorded_run: RecordedFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A live file as a killed recorder leaves it."""
    return crashed_recording(recorded_run, tmp_path_factory.mktemp("crashed"))


def test_bytes_at_random_are_packed_or_refused(crashed: Path, tmp_path: Path) -> None:
    source = crashed.read_bytes()
    for seed in range(30):
        pack_damaged(tmp_path, damaged_bytes(source, random.Random(seed)))
