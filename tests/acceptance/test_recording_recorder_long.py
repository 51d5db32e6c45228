"""A recorder ends in order, says gaps, and loses little when it is killed or crowded."""

from pathlib import Path

import msgpack
from support.recorded import RecordedFlight, Source, room

from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.recording import replay
from hapticd.recording.file import open_recording
from hapticd.recording.recorder import RecordingParams, record


def test_another_servo_life_is_no_gap(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    clock = VirtualClock(NS_PER_S)
    source = Source(recorded_run, clock)
    for topic, payload in recorded_run.messages[:200]:
        content = msgpack.unpackb(payload, strict_map_key=False)
        if topic != "event":
            source.played.append((topic, msgpack.packb(content | {"epoch": 99})))
    result = record(
        source, RecordingParams(tmp_path / "lives.h5"), lambda: False, clock=clock, free_bytes=room
    )
    assert (result["lives"], result["missing"]["servo"]) == (2, 0)
    with open_recording(tmp_path / "lives.h5") as recording:
        assert len(recording.segments()) == 2
        assert all(
            replay.difference(one.records, replay.replay(recording.params, one)) is None
            for one in recording.segments()
        )
