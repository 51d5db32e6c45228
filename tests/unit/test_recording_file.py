"""Opening recordings: every value is there, torn files are cut, foreign ones refused."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.recorded import RecordedFlight

from hapticd.core.errors import ConfigError
from hapticd.recording.file import open_recording


def test_every_value_of_every_tick_is_there(
    recording_file: Path, recorded_run: RecordedFlight
) -> None:
    with open_recording(recording_file) as recording:
        records = recording.records(0, recording.rows["servo"])
    assert records.tobytes() == recorded_run.recorded[: len(records)].tobytes()  # type: ignore[attr-defined]
    assert len(records) > 2900


def test_probe_samples_of_lost_frames_are_a_gap(recording_file: Path) -> None:
    with open_recording(recording_file) as recording:
        index = recording.column("probe", "index")
        assert recording.missing == {"servo": 0, "probe": int(np.sum(np.diff(index) - 1))}
        assert recording.missing["probe"] > 0


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_text("not HDF5")
    with pytest.raises(ConfigError, match="it is not a valid HDF5 file, or damaged"):
        open_recording(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w"):
        pass
    with pytest.raises(ConfigError, match="is not a hapticd recording"):
        open_recording(tmp_path / "b.h5")
    with pytest.raises(ConfigError, match="no such file"):
        open_recording(tmp_path / "c.h5")


def test_records_of_another_version_are_not_replayed(recording_file: Path, tmp_path: Path) -> None:
    other = shutil.copy(recording_file, tmp_path / "old.h5")
    with h5py.File(other, "a") as content:
        del content["servo/stiffness_force_n"]
    with (
        open_recording(other) as recording,
        pytest.raises(
            ConfigError, match=r"was recorded by hapticd 0\.1\.0 and lacks 'stiffness_force_n'"
        ),
    ):
        recording.segments()
