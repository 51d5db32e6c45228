"""Recordings: every value arrives, gaps are said, killed and crowded recorders lose little,
other programs open the files.
"""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import msgpack
import numpy as np
import pytest
import scipy.io
from models import board_params
from programs import program
from recorded import RecordedFlight, Source, room

from hapticd.assembly import replay
from hapticd.clock import VirtualClock
from hapticd.errors import ConfigError, DaemonDown, HapticdError
from hapticd.mailbox.layout import Command, Value
from hapticd.params import InjectionParams
from hapticd.recording import live, pack, provenance, recorder
from hapticd.recording.file import open_recording
from hapticd.recording.live import GROUPS, Writer, as_channel, channels, columns, event_row, udunits
from hapticd.recording.recorder import RecordingParams, record
from hapticd.recording.replay import replay_recording
from hapticd.units import NS_PER_S

DEADLINE_S = 60


@pytest.fixture(scope="module")
def flown() -> RecordedFlight:
    """Three seconds with a live damping toggle and one lost frame; the stack is gone, the
    messages are there.
    """
    with RecordedFlight(
        board=board_params(injections=(InjectionParams("drop_in", tick=1500, count=2),))
    ) as flight:
        flight.move()
        flight.fly(1000)
        flight.stack.do(Command.DAMPING, {Value.ADDED_DAMPING: 1.74, Value.ADDED_DAMPING_ON: 1.0})
        flight.fly(1000)
        flight.stack.do(Command.STOP)
        flight.fly(1000)
        flight.recorded = flight.records  # type: ignore[attr-defined]
    return flight


def recorded_into(
    file: Path, flight: RecordedFlight, seconds: float | None = None, **more: Any
) -> dict[str, Any]:
    """A recording of everything that was published; it ends by silence unless `seconds` are
    enough.
    """
    clock = VirtualClock(NS_PER_S)
    return record(
        Source(flight, clock),
        RecordingParams(file, seconds, "a note"),
        lambda: False,
        clock=clock,
        free_bytes=room,
        **more,
    )


@pytest.fixture(scope="module")
def file(flown: RecordedFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.h5"
    result = recorded_into(path, flown)
    assert result["ended"] == "daemon ended"
    return path


# --- what is in it --------------------------------------------------------------------------------


def test_every_value_of_every_tick_is_there(file: Path, flown: RecordedFlight) -> None:
    with open_recording(file) as recording:
        records = recording.records(0, recording.rows["servo"])
    assert records.tobytes() == flown.recorded[: len(records)].tobytes()  # type: ignore[attr-defined]
    assert len(records) > 2900


def test_probe_is_there_in_counts_and_in_si(file: Path, flown: RecordedFlight) -> None:
    with h5py.File(file) as content:
        probe = content["probe"]
        assert len(probe["index"]) > 11_000
        assert np.all(np.diff(probe["index"][:]) >= 1)
        scale = flown.params.device.probe_torque
        assert np.allclose(probe["torque_n"][:], probe["torque"][:] * scale.per_count)
        assert probe["torque_n"].attrs["units"] == "N"


def test_probe_samples_of_lost_frames_are_a_gap(file: Path) -> None:
    with open_recording(file) as recording:
        index = recording.column("probe", "index")
        assert recording.missing == {"servo": 0, "probe": int(np.sum(np.diff(index) - 1))}
        assert recording.missing["probe"] > 0


def test_plain_numbers_and_fixed_text_only(file: Path) -> None:
    kinds = set()
    with h5py.File(file) as content:
        content.visititems(
            lambda name, item: kinds.add(item.dtype.str) if isinstance(item, h5py.Dataset) else None
        )
        assert all(item.ndim <= 2 for group in content.values() for item in group.values())
    assert {kind for kind in kinds if kind[1] not in "ifuS"} == set()


def test_finished_file_is_compressed_and_old_enough_for_everyone(file: Path) -> None:
    with h5py.File(file) as content:
        dataset = content["servo/force_n"]
        assert (dataset.compression, dataset.shuffle, dataset.fletcher32) == ("gzip", True, True)
        assert dataset.chunks == (len(dataset),)
        assert (
            content.libver == ("earliest", "v108")
            or content.id.get_access_plist().get_libver_bounds()[0] == h5py.h5f.LIBVER_EARLIEST
        )


def test_units_are_those_of_udunits(file: Path) -> None:
    with h5py.File(file) as content:
        units = {
            name: content["servo"][name].attrs["units"]
            for name in ("position_m", "velocity_m_per_s", "damping_ns_per_m", "tick")
        }
    assert units == {
        "position_m": "m",
        "velocity_m_per_s": "m s-1",
        "damping_ns_per_m": "N s m-1",
        "tick": "",
    }


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("acceleration_m_per_s2", "m s-2"),
        ("stiffness_n_per_m", "N m-1"),
        ("energy_force_j", "J"),
        ("wake_ns", "ns"),
        ("winding_c", "degC"),
    ],
)
def test_unit_of_a_channel(name: str, unit: str) -> None:
    assert udunits(name) == unit


def test_provenance_is_complete(file: Path) -> None:
    with open_recording(file) as recording:
        found = recording.attributes
    assert found["schema"] == "hapticd-recording/1"
    assert (found["simulated"], found["notice"][:9]) == (1, "SIMULATED")
    assert (found["note"], found["device_serial"], found["rate_hz"]) == (
        "a note",
        "SIM0001",
        1000.0,
    )
    assert json.loads(found["realtime"]) == {"fifo": "granted"}
    assert json.loads(found["configuration"])["device"]["serial"] == "SIM0001"
    assert set(json.loads(found["calibration"])) >= {"position", "force", "damping"}
    assert len(found["device_hash"]) == 64
    assert found["winding_c"] == 25.0
    assert found["kernel"].startswith("Linux ")
    assert found["utc_ns"] - found["mono_ns"] > 0
    assert set(json.loads(found["libraries"])) == {"numpy", "h5py", "pyzmq", "msgpack"}
    assert {
        "uuid",
        "started_utc",
        "hapticd_version",
        "hapticd_commit",
        "server_version",
        "python",
        "cpu",
        "config_hash",
    } <= set(found)


def test_events_are_in_fixed_columns(file: Path) -> None:
    with open_recording(file) as recording:
        kinds = recording.column("event", "kind")
        faults = recording.column("event", "fault")
        text = recording.column("event", "text")
    assert b"state" in kinds
    assert b"stop" in faults
    assert any(b"before=enabled, state=stopped" in one for one in text)


def test_event_text_is_cut_to_its_column() -> None:
    row = event_row({"timestamp": 1.0, "kind": "warning", "text": "x" * 500})
    assert (len(row["text"]), row["tick"], row["fault"]) == (128, -1, "")


def test_recording_is_replayed_bit_by_bit(file: Path) -> None:
    with open_recording(file) as recording:
        same = replay_recording(recording)
        other = replay_recording(recording, {Value.DAMPING: 5.0})
    assert same.to_json()["bit_exact"] is True
    assert len(same.segments) == 1
    assert len(same.replayed) > 2500
    plain = other.to_json()
    assert plain["bit_exact"] is False
    assert plain["force_rms_n"]["flown"] > plain["force_rms_n"]["recorded"]
    assert other.time_s[0] == 0.0


def test_short_recording_has_nothing_to_replay(flown: RecordedFlight, tmp_path: Path) -> None:
    recorded_into(tmp_path / "short.h5", flown, seconds=0.1)
    with (
        open_recording(tmp_path / "short.h5") as recording,
        pytest.raises(ConfigError, match="holds no checkpoint"),
    ):
        replay_recording(recording)


# --- when it ends, and what it tells --------------------------------------------------------------


def test_seconds_are_recorded_time(flown: RecordedFlight, tmp_path: Path) -> None:
    result = recorded_into(tmp_path / "one.h5", flown, seconds=1.0)
    assert (result["ended"], result["records"]) == ("complete", 1000)
    assert result["seconds"] == pytest.approx(0.999)
    assert not (tmp_path / "one.part.h5").exists()


def test_operator_ends_it_in_order(flown: RecordedFlight, tmp_path: Path) -> None:
    # type: tuple[VirtualClock, list[Progress]]
    clock = VirtualClock(NS_PER_S)
    told = []
    params = RecordingParams(tmp_path / "run.h5")
    result = record(Source(flown, clock), params, lambda: len(told) >= 3, told.append, clock, room)
    assert result["ended"] == "stopped"
    assert told[-1].records > 0
    assert told[-1].file_bytes > 100_000
    assert result["records"] >= told[-1].records


def test_nearly_full_disk_ends_it_in_order(flown: RecordedFlight, tmp_path: Path) -> None:
    clock = VirtualClock(NS_PER_S)
    result = record(
        Source(flown, clock),
        RecordingParams(tmp_path / "a.h5"),
        lambda: False,
        clock=clock,
        free_bytes=lambda folder: 1000,
    )
    assert result["ended"] == "disk nearly full"
    assert result["records"] > 0


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


def test_gap_is_stored_and_said(flown: RecordedFlight, tmp_path: Path) -> None:
    ticks = [place for place, (topic, _) in enumerate(flown.messages) if topic == "servo.raw"]
    clock = VirtualClock(NS_PER_S)
    source = Source(flown, clock)
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
        first, second = recording._stretches()
        assert (first[1], second[0]) == (row, row)


def test_another_servo_life_is_no_gap(flown: RecordedFlight, tmp_path: Path) -> None:
    clock = VirtualClock(NS_PER_S)
    source = Source(flown, clock)
    for topic, payload in flown.messages[:200]:
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


# --- what a recorder survives ---------------------------------------------------------------------

HALF_WAY = """
import pickle, sys, time
from pathlib import Path
from hapticd.recording.live import Writer
messages = pickle.load(open(sys.argv[1], "rb"))
names = ("schema", "simulated", "configuration", "layout")
writer = Writer(Path(sys.argv[2]), dict(zip(names, ("hapticd-recording/1", 1, *sys.argv[3:]))))
for place, (topic, payload) in enumerate(messages):
    writer.take(topic, payload)
    if place % 20 == 19:
        writer.write()
        print(writer.records, flush=True)
print("all", flush=True)
time.sleep(600)
"""


def write_elsewhere(flown: RecordedFlight, folder: Path, **more: Any) -> "subprocess.Popen[str]":
    """A process that writes all messages into run.part.h5, saying how many records it has
    flushed.
    """
    import pickle

    from hapticd.mailbox.layout import LAYOUT_HASH
    from hapticd.params import to_plain

    (folder / "messages").write_bytes(pickle.dumps(flown.messages))
    arguments = [
        str(folder / "messages"),
        str(folder / "run.part.h5"),
        json.dumps(to_plain(flown.params)),
        LAYOUT_HASH.hex(),
    ]
    return subprocess.Popen(
        [sys.executable, "-c", HALF_WAY, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


@pytest.fixture
def writing(flown: RecordedFlight, tmp_path: Path) -> Iterator["subprocess.Popen[str]"]:
    process = write_elsewhere(flown, tmp_path)
    yield process
    process.kill()
    process.communicate(timeout=DEADLINE_S)


@pytest.mark.process
def test_killed_recorder_loses_nothing_that_was_flushed(
    writing: "subprocess.Popen[str]", flown: RecordedFlight, tmp_path: Path
) -> None:
    assert writing.stdout
    flushed = [int(writing.stdout.readline()) for _ in range(10)][-1]
    writing.send_signal(signal.SIGKILL)
    writing.wait(DEADLINE_S)
    part = tmp_path / "run.part.h5"
    final = tmp_path / "run.h5"
    with pytest.raises(OSError, match=r"."):
        h5py.File(part, "r")
    summary = pack.pack(part, final, recovered=True)
    assert summary["records"] >= flushed
    with open_recording(final) as recording:
        assert recording.attributes["recovered"] == 1
        records = recording.records(0, summary["records"])
    assert records.tobytes() == flown.recorded[: len(records)].tobytes()  # type: ignore[attr-defined]
    assert not part.exists()


@pytest.mark.process
def test_live_file_can_be_read_meanwhile(writing: "subprocess.Popen[str]", tmp_path: Path) -> None:
    assert writing.stdout
    flushed = int(writing.stdout.readline())
    with open_recording(tmp_path / "run.part.h5") as recording:
        assert recording.rows["servo"] >= flushed


@pytest.mark.process
def test_full_disk_keeps_what_was_flushed(flown: RecordedFlight, tmp_path: Path) -> None:
    limit = 1 << 20
    process = write_elsewhere(
        flown,
        tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode != 0
    assert "File too large" in err or "OSError" in err or "RuntimeError" in err
    summary = pack.pack(tmp_path / "run.part.h5", tmp_path / "run.h5", recovered=True)
    assert summary["records"] >= int(out.split()[-1]) > 500
    with open_recording(tmp_path / "run.h5") as recording:
        records = recording.records(0, summary["records"])
    assert records.tobytes() == flown.recorded[: len(records)].tobytes()  # type: ignore[attr-defined]


def test_write_error_ends_it_with_the_remedy(
    flown: RecordedFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(self: Writer) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "write", write)
    with pytest.raises(
        HapticdError,
        match=(
            r"No space left on device; what was flushed before is safe: .*rec recover"
            r" .*run\.part\.h5"
        ),
    ):
        recorded_into(tmp_path / "run.h5", flown)


def test_stalled_disk_delays_and_loses_nothing(
    flown: RecordedFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = VirtualClock(NS_PER_S)
    write = Writer.write

    def slow(self: Writer) -> None:
        clock.time_ns += 3 * NS_PER_S
        write(self)

    monkeypatch.setattr(Writer, "write", slow)
    result = record(
        Source(flown, clock),
        RecordingParams(tmp_path / "slow.h5"),
        lambda: False,
        clock=clock,
        free_bytes=room,
    )
    assert result["missing"]["servo"] == 0
    assert result["records"] == 3000


def test_disk_that_refuses_to_be_synchronised_loses_nothing(
    flown: RecordedFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def refuse(descriptor: int) -> None:
        asked.append(descriptor)
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", refuse)
    assert recorded_into(tmp_path / "run.h5", flown)["records"] == 3000
    assert asked


def test_column_that_stands_still_is_filled_and_the_unmeant_is_cut(tmp_path: Path) -> None:
    part = tmp_path / "torn.part.h5"
    with h5py.File(part, "w") as content:
        content.attrs["schema"] = "hapticd-recording/1"
        content["flushed/rows"] = [[40], [97]]
        content["flushed/rows"].attrs["groups"] = ["servo"]
        for name, rows in (("tick", 100), ("time_ns", 99), ("state", 3)):
            content[f"servo/{name}"] = np.arange(rows, dtype="<i8")
    with open_recording(part) as recording:
        assert recording.rows == {"servo": 97}
        assert recording.column("servo", "tick").tolist() == list(range(97))
        assert recording.column("servo", "state").tolist() == [0, 1, *[2] * 95]
        assert recording.column("servo", "state", 1, 5).tolist() == [1, 2, 2, 2]
        assert recording.column("servo", "state", 90, 92).tolist() == [2, 2]


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


# --- opening and packing --------------------------------------------------------------------------


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_text("not HDF5")
    with pytest.raises(ConfigError, match="it is no HDF5 file, or damaged"):
        open_recording(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w"):
        pass
    with pytest.raises(ConfigError, match="is no hapticd recording"):
        open_recording(tmp_path / "b.h5")
    with pytest.raises(ConfigError, match="no such file"):
        open_recording(tmp_path / "c.h5")


def test_records_of_another_version_are_not_replayed(file: Path, tmp_path: Path) -> None:
    other = shutil.copy(file, tmp_path / "old.h5")
    with h5py.File(other, "a") as content:
        content.attrs["layout"] = "0123456789abcdef"
    with (
        open_recording(other) as recording,
        pytest.raises(ConfigError, match=r"was recorded by hapticd 0\.1\.0 with other"),
    ):
        recording.segments()


def test_packing_never_replaces_a_file(file: Path, tmp_path: Path) -> None:
    (tmp_path / "there.h5").touch()
    with pytest.raises(HapticdError, match=r"there\.h5 exists; move it away"):
        pack.pack(file, tmp_path / "there.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["there.h5"]


def test_packing_that_fails_keeps_the_source(tmp_path: Path) -> None:
    part = tmp_path / "bad.part.h5"
    part.write_text("nothing")
    with pytest.raises(HapticdError, match="it is no HDF5 file"):
        pack.pack(part, tmp_path / "bad.h5")
    assert part.exists()


def test_live_file_is_not_opened_twice(tmp_path: Path) -> None:
    file = live.LiveFile(tmp_path / "a.part.h5", {}, {"servo": GROUPS["servo"]})
    with pytest.raises(HapticdError, match="choose another name"):
        live.LiveFile(tmp_path / "a.part.h5", {}, {})
    file.close()


def test_missing_library_names_the_extra() -> None:
    with pytest.raises(
        HapticdError, match=r"this needs no_such_library .*install hapticd\[record\]"
    ):
        provenance.needed("no_such_library.part", "record")


def test_channels_and_columns_agree(flown: RecordedFlight) -> None:
    records = flown.recorded  # type: ignore[attr-defined]
    known = channels(records.dtype.descr)
    found = columns(records)
    assert (
        list(found)
        == [channel.name for channel in known]
        == [channel.name for channel in GROUPS["servo"]]
    )
    assert "energy_stiffness_j" in found
    for channel in known:
        values = as_channel(channel, found[channel.name])
        assert values.shape == (len(records), channel.width)[: 1 + bool(channel.width)]
        assert values.tobytes() == found[channel.name].tobytes()


def test_commit_of_nowhere_is_empty(tmp_path: Path) -> None:
    assert provenance.commit(tmp_path) == ""
    assert provenance.processor()


# --- other programs -------------------------------------------------------------------------------


def test_mat_file_holds_what_the_recording_holds(file: Path, tmp_path: Path) -> None:
    with open_recording(file) as recording:
        pack.to_mat(recording, tmp_path / "run.mat")
        force = recording.column("servo", "force_n")
    content = scipy.io.loadmat(tmp_path / "run.mat", squeeze_me=True, struct_as_record=False)
    assert np.array_equal(content["servo"].force_n, force)
    assert content["servo"].added_damping_asked_ns_per_m.shape == force.shape
    assert content["info"].device_serial == "SIM0001"


def test_csv_holds_every_bit(file: Path, tmp_path: Path) -> None:
    with open_recording(file) as recording:
        main, probe = pack.to_csv(recording, tmp_path / "run.csv")
        force = recording.column("servo", "force_n")
        tick = recording.column("servo", "tick")
    read = np.genfromtxt(main, delimiter=",", names=True)
    assert np.array_equal(read["force_n"], force)
    assert np.array_equal(read["tick"], tick)
    assert probe.name == "run.probe.csv"
    with (
        open_recording(file) as recording,
        pytest.raises(HapticdError, match="choose another name"),
    ):
        pack.to_csv(recording, tmp_path / "run.csv")


@pytest.mark.process
def test_octave_opens_it(file: Path, tmp_path: Path) -> None:
    octave = program("octave-cli")
    script = f"""
        r = load('{file}');
        printf('%d %.17g ', numel(r.servo.force_n), max(abs(r.servo.position_m)));
        printf('%s %s\\n', class(r.servo.tick), class(r.event));
        printf('%d\\n', numel(r.probe.torque_n));
    """
    environment = {**os.environ, "HOME": str(tmp_path)}
    done = subprocess.run(
        [octave, "--norc", "--eval", script],
        capture_output=True,
        text=True,
        env=environment,
        timeout=DEADLINE_S,
    )
    lines = done.stdout.split()
    with open_recording(file) as recording:
        position = recording.column("servo", "position_m")
        assert lines == [
            str(len(position)),
            f"{np.abs(position).max():.17g}",
            "int64",
            "struct",
            str(recording.rows["probe"]),
        ], done.stderr
