"""The live file: columns in the types and units of their channels, and what is not written."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from support.recorded import RecordedFlight

from hapticd.core.errors import HapticdError
from hapticd.recording import live
from hapticd.recording.file import open_recording
from hapticd.recording.live import GROUPS, as_channel, channels, columns, event_row, udunits


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("acceleration_m_per_s2", "m s-2"),
        ("stiffness_n_per_m", "N m-1"),
        ("excess_j", "J"),
        ("wake_ns", "ns"),
        ("winding_c", "degC"),
    ],
)
def test_unit_of_a_channel(name: str, unit: str) -> None:
    assert udunits(name) == unit


def test_channels_and_columns_agree(recorded_run: RecordedFlight) -> None:
    records = recorded_run.recorded  # type: ignore[attr-defined]
    known = channels(records.dtype.descr)
    found = columns(records)
    assert (
        list(found)
        == [channel.name for channel in known]
        == [channel.name for channel in GROUPS["servo"]]
    )
    assert "excess_j" in found
    for channel in known:
        values = as_channel(channel, found[channel.name])
        assert values.shape == (len(records), channel.width)[: 1 + bool(channel.width)]
        assert values.tobytes() == found[channel.name].tobytes()


def test_event_of_a_lease_names_its_holder() -> None:
    """Also where the rest of its text is cut."""
    event = {"what": "perturbation", "change": "taken over", "actor": 17, "name": "trial"}
    row = event_row({"timestamp": 1.0, "kind": "lease", **event, "by": "x" * 64, "text": "x" * 99})
    start = b"what=perturbation, change=taken over, actor=17, name=trial, by=x"
    assert row["text"].startswith(start)


def test_event_text_is_cut_to_its_column() -> None:
    row = event_row({"timestamp": 1.0, "kind": "warning", "text": "x" * 500})
    assert (len(row["text"]), row["tick"], row["fault"]) == (128, -1, "")


def test_events_are_in_fixed_columns(recording_file: Path) -> None:
    with open_recording(recording_file) as recording:
        kinds = recording.column("event", "kind")
        faults = recording.column("event", "fault")
        text = recording.column("event", "text")
    assert b"state" in kinds
    assert b"stop" in faults
    assert any(b"before=enabled, state=stopped" in one for one in text)


def test_standing_column_is_not_written_until_it_moves(tmp_path: Path) -> None:
    file = live.LiveFile(
        tmp_path / "a.part.h5", {"schema": "hapticd-recording/1"}, {"life": GROUPS["life"]}
    )
    rows = np.array([1, 1, 2, 2, 2, 3], "<i8")
    for begin in range(0, 6, 2):
        block = rows[begin : begin + 2]
        file.append(
            "life", {"row": block, "epoch": np.full(2, 7, "<i8"), "mono_unix_offset_ns": block}
        )
        file.flush()
    with open_recording(tmp_path / "a.part.h5") as recording:
        assert len(recording._groups["life"]["epoch"]) == 2
        assert recording.column("life", "row").tolist() == rows.tolist()
        assert recording.column("life", "epoch").tolist() == [7] * 6
    file.close()
    with h5py.File(tmp_path / "a.part.h5") as content:
        assert [len(content["life"][name]) for name in ("row", "epoch")] == [6, 6]
        assert content["flushed/rows"][:].tolist() == [[2], [4], [6]]


def test_live_file_is_not_opened_twice(tmp_path: Path) -> None:
    file = live.LiveFile(tmp_path / "a.part.h5", {}, {"servo": GROUPS["servo"]})
    with pytest.raises(HapticdError, match="choose another name"):
        live.LiveFile(tmp_path / "a.part.h5", {}, {})
    file.close()
