"""The live file: columns in the types and units of their channels, and what is not written."""

from itertools import pairwise
from pathlib import Path

import pytest
from support.recorded import RecordedFlight

from hapticd.core.errors import HapticdError
from hapticd.recording import live
from hapticd.recording.file import open_recording, udunits
from hapticd.recording.live import GROUPS, channels, columns, event_row, table
from hapticd.recording.pack import pack


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


def test_columns_hold_the_bytes_of_the_records(recorded_run: RecordedFlight) -> None:
    """Also where they are joined from blocks of any length."""
    records = recorded_run.recorded  # type: ignore[attr-defined]
    edges = [0, 0, 1, 700, 700, len(records)]
    found = columns([records[begin:end] for begin, end in pairwise(edges)])
    assert list(found) == [channel.name for channel in channels(GROUPS["servo"])]
    assert "excess_j" in found
    for channel in channels(records.dtype):
        values = records[channel.field]
        values = values if channel.place is None else values[:, channel.place]
        column = found[channel.name]
        assert len(column) == len(records)
        for begin, end in ((0, len(records)), (0, 1), (699, 702), (5, 5), (len(records), None)):
            kept = column[begin:end]
            assert kept.shape == (len(values[begin:end]), channel.width)[: 1 + bool(channel.width)]
            assert kept.tobytes() == values[begin:end].tobytes()


def test_event_of_a_lease_names_its_holder() -> None:
    """Also where the rest of its text is cut."""
    event = {"what": "perturbation", "actor": 17, "name": "trial", "by": "x" * 64, "text": "x" * 99}
    row = event_row({"timestamp": 1.0, "kind": "lease", "code": "lease_taken_over", **event})
    start = b"code=lease_taken_over, what=perturbation, actor=17, name=trial, by=x"
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


def test_rows_of_a_growing_file_are_there_as_soon_as_they_are_handed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.part.h5"
    groups = {name: GROUPS[name] for name in ("life", "break")}
    file = live.LiveFile(path, {"schema": "hapticd-recording/1"}, groups)
    for row in range(3):
        life = {"row": row, "epoch": 7, "mono_unix_offset_ns": 0}
        file.append({"life": table("life", [life]).tobytes()})
        with open_recording(path) as recording:
            assert recording.column("life", "row").tolist() == list(range(row + 1))
            assert (recording.rows["break"], recording.dropped_bytes) == (0, 0)
    file.close()


def test_live_file_is_not_opened_twice(tmp_path: Path) -> None:
    file = live.LiveFile(tmp_path / "a.part.h5", {}, {"servo": GROUPS["servo"]})
    with pytest.raises(HapticdError, match="choose another name"):
        live.LiveFile(tmp_path / "a.part.h5", {}, {})
    file.close()


def test_a_file_that_is_being_recorded_is_not_recovered(tmp_path: Path) -> None:
    """The recorder would write on into a file without a name."""
    path = tmp_path / "run.part.h5"
    growing = live.LiveFile(path, {}, {})
    with pytest.raises(HapticdError, match="is being recorded"):
        pack(path, tmp_path / "run.h5")
    assert path.exists()
    growing.close()
    live.require_finished(path)
