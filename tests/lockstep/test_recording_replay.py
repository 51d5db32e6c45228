"""A recording is replayed bit by bit, or with settings held at other values."""

from pathlib import Path

import numpy as np
import pytest
from support.recorded import RecordedFlight, recorded_into

from hapticd.core.errors import ConfigError
from hapticd.mailbox.layout import Value
from hapticd.recording.file import open_recording, replay_recording


def test_recording_is_replayed_bit_by_bit(recording_file: Path) -> None:
    with open_recording(recording_file) as recording:
        same = replay_recording(recording)
        other = replay_recording(recording, {Value.VIRTUAL_DAMPING: 5.0})
    assert same.to_json()["bit_exact"] is True
    assert len(same.segments) == 1
    assert len(same.replayed) > 2500
    plain = other.to_json()
    assert plain["bit_exact"] is False
    assert list(plain["first_difference"]) == ["tick", "field", "recorded", "replayed"]
    assert plain["force_rms_n"]["replayed"] > plain["force_rms_n"]["recorded"]
    assert other.time_s[0] == 0.0


def test_ticks_before_the_first_checkpoint_are_counted(recording_file: Path) -> None:
    with open_recording(recording_file) as recording:
        result = replay_recording(recording)
        ticks = recording.column("servo", "tick")
    assert result.left_out == int(np.searchsorted(ticks, result.recorded["tick"][0])) > 0


def test_short_recording_has_nothing_to_replay(
    recorded_run: RecordedFlight, tmp_path: Path
) -> None:
    recorded_into(tmp_path / "short.h5", recorded_run, seconds=0.1)
    with (
        open_recording(tmp_path / "short.h5") as recording,
        pytest.raises(ConfigError, match="holds no checkpoint"),
    ):
        replay_recording(recording)
