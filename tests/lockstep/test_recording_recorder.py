"""A recorder ends in order, says gaps, and loses little when it is killed or crowded."""

import os
from pathlib import Path

import msgpack
import numpy as np
import pytest
from support.recorded import RecordedFlight, Source, recorded_into, room

from hapticd.client.blocks import BlockDecoder
from hapticd.core.errors import ConfigError, DaemonDown, HapticdError
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.recording import pack, recorder
from hapticd.recording.file import open_recording
from hapticd.recording.live import Writer
from hapticd.recording.recorder import RecordingParams, record


def test_seconds_are_recorded_time(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    result = recorded_into(tmp_path / "one.h5", recorded_run, seconds=1.0)
    assert (result["ended"], result["records"]) == ("complete", 1000)
    assert result["seconds"] == pytest.approx(0.999)
    assert not (tmp_path / "one.part.h5").exists()


def test_what_was_changed_is_an_event_at_its_tick(
    recorded_run: RecordedFlight, tmp_path: Path
) -> None:
    recorded_into(tmp_path / "one.h5", recorded_run)
    with open_recording(tmp_path / "one.h5") as recording:
        kinds = recording.column("event", "kind")
        ticks, texts, unix_s = (
            recording.column("event", name)[kinds == b"damping"].tolist()
            for name in ("tick", "text", "timestamp")
        )
        tick, time_ns, asked = (
            recording.column("servo", name)
            for name in ("tick", "time_ns", "active_damping_asked_ns_per_m")
        )
        offset_ns = int(recording.column("life", "mono_unix_offset_ns")[0])
        values = recording.column("request", "value_14_active_damping_on")
    changed = np.flatnonzero(np.diff(asked)) + 1
    assert ticks == tick[changed].tolist()
    np.testing.assert_allclose(unix_s, (time_ns[changed] + offset_ns) / 1e9, atol=1.5e-3)
    for text, level in zip(texts, asked[changed].tolist(), strict=True):
        assert "active_damping_on=1" in text.decode()
        assert f"active_damping={level:.6g} N s/m" in text.decode()
    assert 1.0 in values


def test_checkpoint_that_comes_before_the_first_records_is_kept(
    recorded_run: RecordedFlight, tmp_path: Path
) -> None:
    """It is published at once, and records when a batch of them is whole."""
    clock = VirtualClock(NS_PER_S)
    source = Source(recorded_run, clock)
    flights = [payload for topic, payload in source.played if topic == "flight"]
    first = next(one for one in flights if msgpack.unpackb(one)["checkpoint"] is not None)
    tick = msgpack.unpackb(first)["checkpoint"][0]
    streams = [one for one in source.played if one[0] != "flight"]
    from_there = next(
        place
        for place, (topic, payload) in enumerate(streams)
        if topic == "servo.raw" and tick in BlockDecoder().decode(payload).records["tick"]
    )
    source.played = [("flight", first), *streams[from_there:]]
    record(source, RecordingParams(tmp_path / "run.h5", 1.0), lambda: False, clock=clock)
    with open_recording(tmp_path / "run.h5") as recording:
        assert recording.column("checkpoint", "tick").tolist() == [tick]
        assert [segment.tick for segment in recording.segments()] == [tick]


def test_lost_slots_are_counted_over_all_lives() -> None:
    class Stand:
        def column(self, group: str, name: str) -> np.ndarray:
            assert (group, name) == ("servo", "lost_slots")
            # recorded from 2 on; another life, first seen at 3
            return np.array([2, 2, 5, 5, 3, 4], "<u4")

    assert pack._lost_slots(Stand()) == 7  # type: ignore[arg-type]


def test_operator_ends_it_in_order(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    # type: tuple[VirtualClock, list[Progress]]
    clock = VirtualClock(NS_PER_S)
    told = []
    params = RecordingParams(tmp_path / "run.h5")
    result = record(
        Source(recorded_run, clock), params, lambda: len(told) >= 3, told.append, clock, room
    )
    assert result["ended"] == "stopped"
    assert told[-1].records > 0
    assert told[-1].file_bytes > 100_000
    assert result["records"] >= told[-1].records


def test_nearly_full_disk_ends_it_in_order(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    clock = VirtualClock(NS_PER_S)
    result = record(
        Source(recorded_run, clock),
        RecordingParams(tmp_path / "a.h5"),
        lambda: False,
        clock=clock,
        free_bytes=lambda folder: recorder.RESERVE_BYTES - 1,
    )
    assert result["ended"] == "disk nearly full"
    assert result["records"] > 0


def test_live_file_stays_where_there_is_no_room_to_pack_it(
    recorded_run: RecordedFlight, tmp_path: Path
) -> None:
    clock = VirtualClock(NS_PER_S)
    part = tmp_path / "a.part.h5"
    with pytest.raises(
        HapticdError,
        match=r"packing needs up to \d+ MB, 0 MB are free; .*rec recover .*a\.part\.h5",
    ):
        record(
            Source(recorded_run, clock),
            RecordingParams(tmp_path / "a.h5"),
            lambda: False,
            clock=clock,
            free_bytes=lambda folder: 1000,
        )
    assert [path.name for path in tmp_path.iterdir()] == ["a.part.h5"]
    size = part.stat().st_size
    with pytest.raises(HapticdError, match="packing needs"):
        pack.pack(part, tmp_path / "a.h5", free_bytes=lambda folder: size - 1)
    assert pack.pack(part, tmp_path / "a.h5", free_bytes=lambda folder: size)["records"] > 0
    assert not part.exists()


def test_daemon_of_other_fields_is_refused(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    clock = VirtualClock(NS_PER_S)
    source = Source(recorded_run, clock)
    other = np.dtype([("tick", "<i8"), ("time_ns", "<i8")])
    for place, (topic, payload) in enumerate(source.played):
        if topic == "servo.raw":
            content = msgpack.unpackb(payload, strict_map_key=False)
            few = {"descr": other.descr, "d": bytes(content["n"] * other.itemsize)}
            source.played[place] = (topic, msgpack.packb(content | few))
    with pytest.raises(HapticdError, match=r"servo\.raw: the daemon's records have other fields"):
        record(source, RecordingParams(tmp_path / "a.h5"), lambda: False, clock=clock)


def test_silent_daemon_is_told(tmp_path: Path) -> None:
    with RecordedFlight() as flight:
        clock = VirtualClock(NS_PER_S)
        with pytest.raises(DaemonDown, match="published nothing"):
            record(
                Source(flight, clock),
                RecordingParams(tmp_path / "a.h5"),
                lambda: False,
                clock=clock,
                free_bytes=room,
            )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "existing", "reason"),
    [
        ("a.h5", "a.h5", "a.h5 exists; choose another name"),
        ("a.h5", "a.part.h5", "rec recover .*a.part.h5` first"),
        ("a.mat", "", "a recording is called NAME.h5"),
        ("no/a.h5", "", "no such folder"),
    ],
)
def test_what_is_in_the_way_is_refused(
    name: str, existing: str, reason: str, tmp_path: Path
) -> None:
    if existing:
        (tmp_path / existing).touch()
    with pytest.raises(ConfigError, match=reason):
        recorder.check_free(RecordingParams(tmp_path / name))


def test_gap_is_stored_and_said(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    ticks = [
        place for place, (topic, _) in enumerate(recorded_run.messages) if topic == "servo.raw"
    ]
    clock = VirtualClock(NS_PER_S)
    source = Source(recorded_run, clock)
    lost = msgpack.unpackb(source.played.pop(ticks[40])[1])["n"]
    result = record(
        source, RecordingParams(tmp_path / "gap.h5"), lambda: False, clock=clock, free_bytes=room
    )
    assert result["missing"]["servo"] == lost
    with open_recording(tmp_path / "gap.h5") as recording:
        (row,) = recording.column("gap", "row")[
            recording.column("gap", "stream") == b"servo"
        ].tolist()
        tick = recording.column("servo", "tick")
        assert tick[row] - tick[row - 1] - 1 == lost
        first, second = recording.stretches()
        assert (first[1], second[0]) == (row, row)


def test_write_error_ends_it_with_the_remedy(
    recorded_run: RecordedFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(self: Writer) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "write", write)
    with pytest.raises(
        HapticdError,
        match=(
            r"No space left on device; the data flushed before are safe: .*rec recover"
            r" .*run\.part\.h5"
        ),
    ):
        recorded_into(tmp_path / "run.h5", recorded_run)


def published(flight: RecordedFlight) -> int:
    """How many ticks are in the messages of `flight`."""
    blocks = [payload for topic, payload in flight.messages if topic == "servo.raw"]
    return sum(msgpack.unpackb(payload)["n"] for payload in blocks)


def test_stalled_disk_delays_and_loses_nothing(
    recorded_run: RecordedFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = VirtualClock(NS_PER_S)
    write = Writer.write

    def slow(self: Writer) -> None:
        clock.time_ns += 3 * NS_PER_S
        write(self)

    monkeypatch.setattr(Writer, "write", slow)
    result = record(
        Source(recorded_run, clock),
        RecordingParams(tmp_path / "slow.h5"),
        lambda: False,
        clock=clock,
        free_bytes=room,
    )
    assert result["missing"]["servo"] == 0
    assert result["records"] == published(recorded_run)


def test_disk_that_refuses_to_be_synchronised_loses_nothing(
    recorded_run: RecordedFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def refuse(descriptor: int) -> None:
        asked.append(descriptor)
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", refuse)
    assert recorded_into(tmp_path / "run.h5", recorded_run)["records"] == published(recorded_run)
    assert asked
