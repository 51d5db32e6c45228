"""A recording is replayed bit by bit, or with settings held at other values."""

from pathlib import Path

from hapticd.recording.file import open_recording, replay_recording
from hapticd.zwidth.report.trial import replay_figure


def test_both_forces_are_seen_where_they_are_equal(recording_file: Path) -> None:
    with open_recording(recording_file) as recording:
        figure = replay_figure(replay_recording(recording), "title")
    below, above = figure.axes[1].lines[:2]
    assert below.get_linewidth() > 2 * above.get_linewidth()
    assert below.get_color() != above.get_color()
