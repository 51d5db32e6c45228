"""Damaged recordings: bounded time, one clear error, and the source stays as it is."""

import random
import shutil
from contextlib import nullcontext, suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.attacks.documents import crashed_recording, damaged_bytes, pack_damaged
from support.recorded import RecordedFlight

from hapticd.core.errors import ConfigError, HapticdError
from hapticd.recording import pack
from hapticd.recording.file import open_recording
from hapticd.recording.provenance import SCHEMA
from hapticd.recording.superblock import CHECKED, SUPERBLOCK, lookup3, tended

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def crashed(recorded_run: RecordedFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A live file as a killed recorder leaves it."""
    return crashed_recording(recorded_run, tmp_path_factory.mktemp("crashed"))


def damaged(crashed: Path, folder: Path, old: bytes, new: bytes) -> Path:
    data = crashed.read_bytes()
    place = data.rfind(old)
    assert place > 0
    path = folder / "damaged.part.h5"
    path.write_bytes(data[:place] + new + data[place + len(old) :])
    return path


def test_crashed_file_is_read_as_it_was_flushed(
    crashed: Path, recorded_run: RecordedFlight
) -> None:
    flown = recorded_run.recorded  # type: ignore[attr-defined]
    with open_recording(crashed) as recording:
        rows = recording.rows["servo"]
        assert len(flown) - 20 <= rows <= len(flown)  # a batch is published as a whole
        assert np.array_equal(recording.column("servo", "force_n"), flown["force_n"][:rows])
        assert recording.attributes["schema"] == SCHEMA


@pytest.mark.parametrize("rows", [10**12, 10_000, -1, -(2**62)])
def test_rows_that_no_column_has_are_damage(crashed: Path, tmp_path: Path, rows: int) -> None:
    """It would be packed for an hour: a column that ends early repeats its last value."""
    with open_recording(crashed) as recording:
        there = recording.rows["servo"], recording.rows["probe"]
    before, after = (np.array(count, "<i8").tobytes() for count in (there, (rows, there[1])))
    path = damaged(crashed, tmp_path, before, after)
    with pytest.raises(ConfigError, match=f"{rows} rows of servo are said to be there, {there[0]}"):
        pack.pack(path, tmp_path / "out.h5")
    assert [one.name for one in tmp_path.iterdir()] == ["damaged.part.h5"]


def test_damage_behind_a_dead_writer_is_an_error_at_once(crashed: Path, tmp_path: Path) -> None:
    """HDF5 waits for a living writer to mend a checksum, twice as long each time, 100 times."""
    path = damaged(crashed, tmp_path, b"OHDR", b"OHDs")
    with pytest.raises(HapticdError, match="or damaged"):
        pack.pack(path, tmp_path / "out.h5")


def test_text_in_a_live_file_is_where_checksums_are(crashed: Path, tmp_path: Path) -> None:
    """HDF5 reads a damaged heap of texts for ever; so there is none."""
    assert b"GCOL" not in crashed.read_bytes()
    with open_recording(crashed) as recording:
        path = tmp_path / "closed.part.h5"
    shutil.copy(crashed.with_name("written.part.h5"), path)
    with h5py.File(path) as content:
        assert content.attrs["schema"] == SCHEMA.encode()
        assert content["servo/force_n"].attrs["units"] == b"N"
    assert recording.attributes["simulated"] == 1


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


def test_bytes_at_random_are_packed_or_refused(crashed: Path, tmp_path: Path) -> None:
    source = crashed.read_bytes()
    for seed in range(30):
        pack_damaged(tmp_path, damaged_bytes(source, random.Random(seed)))


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


def test_checksum_is_that_of_its_author() -> None:
    """Bob Jenkins, lookup3.c, driver5: with initial value 0."""
    assert lookup3(b"Four score and seven years ago") == 0x17770551


def test_superblock_loses_the_mark_of_its_writer_alone(crashed: Path) -> None:
    start = crashed.read_bytes()[: SUPERBLOCK.size]
    marked = SUPERBLOCK.unpack(start)
    assert lookup3(start[:CHECKED]) == marked[-1]  # what HDF5 wrote
    clean = SUPERBLOCK.unpack(tended(start, 12_345))
    assert (marked[4], clean[4]) == (5, 0)
    assert clean[7] == 12_345
    assert clean[:4] + clean[5:7] + clean[8:9] == marked[:4] + marked[5:7] + marked[8:9]
    broken = bytes([*start[:20], start[20] ^ 1, *start[21:]])
    assert tended(broken, 12_345) == broken  # damage is not made good
