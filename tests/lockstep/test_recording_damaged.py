"""Damaged recordings: bounded time, one clear error, and the source stays as it is."""

import random
import shutil
import struct
from contextlib import nullcontext, suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.attacks.documents import crashed_recording
from support.recorded import RecordedFlight

from hapticd.core.errors import ConfigError, HapticdError
from hapticd.protocol.flight import dtype_of, read_header
from hapticd.recording import pack
from hapticd.recording.file import open_recording
from hapticd.recording.live import MAGIC
from hapticd.recording.provenance import SCHEMA

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def crashed(recorded_run: RecordedFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A live file as a killed recorder leaves it."""
    return crashed_recording(recorded_run, tmp_path_factory.mktemp("crashed"))


def test_crashed_file_is_read_as_it_was_flushed(
    crashed: Path, recorded_run: RecordedFlight
) -> None:
    flown = recorded_run.recorded  # type: ignore[attr-defined]
    with open_recording(crashed) as recording:
        rows = recording.rows["servo"]
        assert len(flown) - 20 <= rows <= len(flown)  # a batch is published as a whole
        assert np.array_equal(recording.column("servo", "force_n"), flown["force_n"][:rows])
        assert recording.attributes["schema"] == SCHEMA


def frame_ends(path: Path) -> list[int]:
    """Offsets in a live file at which a frame begins or the last one ends."""
    data = path.read_bytes()
    header, place = read_header(data, MAGIC)
    row_bytes = [dtype_of(descr).itemsize for descr in header["groups"].values()]
    ends = [place]
    while place < len(data):
        counts = struct.unpack_from(f"<{len(row_bytes)}I", data, place + 4)
        body = sum(count * size for count, size in zip(counts, row_bytes, strict=True))
        place += 4 + 4 * len(row_bytes) + body
        ends.append(place)
    return ends


def test_file_cut_at_any_byte_holds_every_whole_frame(crashed: Path, tmp_path: Path) -> None:
    """As `kill -9` or a full disk cuts it, in the middle of a write."""
    data = crashed.read_bytes()
    ends = frame_ends(crashed)
    assert ends[-1] == len(data)
    chance = random.Random(1)
    cuts = [chance.randrange(ends[0], len(data)) for _ in range(40)]
    path = tmp_path / "cut.part.h5"
    rows = []
    for cut in sorted(
        [*cuts, *ends, *(end - 1 for end in ends[1:]), *(end + 1 for end in ends[:-1])]
    ):
        path.write_bytes(data[:cut])
        with open_recording(path) as recording:
            whole = max(end for end in ends if end <= cut)
            assert recording.dropped_bytes == cut - whole
            rows.append((whole, recording.rows))
    of_frames = dict(rows)
    assert all(of_frames[whole] == found for whole, found in rows)
    counts = [of_frames[end]["servo"] for end in ends]
    assert counts == sorted(counts)
    with open_recording(crashed) as recording:
        assert of_frames[ends[-1]] == recording.rows
        assert recording.dropped_bytes == 0


def test_torn_end_is_counted_and_stays_beside_the_recording(crashed: Path, tmp_path: Path) -> None:
    path = tmp_path / "torn.part.h5"
    data = crashed.read_bytes()
    last = frame_ends(crashed)[-2]
    path.write_bytes(data[: last + 1000])
    summary = pack.pack(path, tmp_path / "torn.h5")
    assert summary["dropped_bytes"] == 1000
    assert summary["records"] > 0
    assert path.read_bytes() == data[: last + 1000]


@pytest.mark.parametrize("back", [0, 2])  # frames before the last
def test_damaged_frame_ends_the_recording(crashed: Path, tmp_path: Path, back: int) -> None:
    ends = frame_ends(crashed)
    data = bytearray(crashed.read_bytes())
    data[ends[-1 - back] - 10] ^= 1
    path = tmp_path / "damaged.part.h5"
    path.write_bytes(data)
    with open_recording(path) as recording, open_recording(crashed) as whole:
        assert recording.dropped_bytes == len(data) - ends[-2 - back]
        rows = recording.rows["servo"]
        assert 0 < rows < whole.rows["servo"]
        kept = recording.column("servo", "force_n")
        assert np.array_equal(kept, whole.column("servo", "force_n")[:rows])


def test_damaged_header_vouches_for_no_rows(crashed: Path, tmp_path: Path) -> None:
    """Its description of the rows says what they mean."""
    data = crashed.read_bytes()
    path = tmp_path / "damaged.part.h5"
    path.write_bytes(data.replace(b'"force_n", "<f8"', b'"force_n", "<i8"', 1))
    assert path.read_bytes() != data
    with open_recording(path) as recording:
        assert recording.rows["servo"] == 0
        assert recording.dropped_bytes == len(data) - frame_ends(crashed)[0]


@pytest.mark.parametrize("size", [0, 20, 1000])
def test_file_without_a_whole_header_is_damage(crashed: Path, tmp_path: Path, size: int) -> None:
    path = tmp_path / "begun.part.h5"
    path.write_bytes(crashed.read_bytes()[:size])
    with pytest.raises(HapticdError, match="or damaged"):
        pack.pack(path, tmp_path / "out.h5")
    assert [one.name for one in tmp_path.iterdir()] == ["begun.part.h5"]


def test_text_in_a_finished_file_is_in_no_heap(crashed: Path, tmp_path: Path) -> None:
    path = tmp_path / "finished.h5"
    pack.pack(Path(shutil.copy(crashed, tmp_path)), path)
    assert b"GCOL" not in path.read_bytes()
    with h5py.File(path) as content:
        assert content.attrs["schema"] == SCHEMA.encode()


def test_note_that_is_longer_than_a_header_is_kept_all_the_same(
    crashed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    note = "ü" * 50_000
    with open_recording(crashed) as recording:
        monkeypatch.setitem(recording.attributes, "note", note)
        monkeypatch.setattr(pack, "open_recording", lambda _: nullcontext(recording))
        pack.pack(Path(shutil.copy(crashed, tmp_path)), tmp_path / "finished.h5")
    with open_recording(tmp_path / "finished.h5") as finished:
        assert finished.attributes["note"] == note


@pytest.mark.parametrize("place", [24, 40, 48])  # base, end, driver block, in a superblock of 0
def test_address_beyond_what_a_file_may_have_is_damage(
    recording_file: Path, tmp_path: Path, place: int
) -> None:
    data = bytearray(recording_file.read_bytes())
    assert data[8] == 0
    data[place : place + 8] = (2**64 - 2**49).to_bytes(8, "little")
    path = tmp_path / "damaged.h5"
    path.write_bytes(data)
    with pytest.raises(ConfigError, match="or damaged"):
        open_recording(path)


def test_flight_recording_with_any_header_is_read_or_refused(runtime: Path, tmp_path: Path) -> None:
    with RecordedFlight() as flown:
        flown.fly(200)
        told = flown.publisher.flight.dump("asked")
        flown.publisher.flight.close()
    source = Path(told["path"]).read_bytes()
    path = tmp_path / "any.flight"
    length = int.from_bytes(source[17:25], "little")
    for seed in range(150):
        chance = random.Random(seed)
        data = bytearray(source)
        for _ in range(chance.choice((1, 1, 2, 5))):
            place = chance.randrange(25 + length)
            data[place : place + 1] = chance.choice((b"9", b"x", b"null", b"[]", b"1e999", b"-"))
        path.write_bytes(data)
        with suppress(ConfigError), open_recording(path) as recording:
            recording.segments()
