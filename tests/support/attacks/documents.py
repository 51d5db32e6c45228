"""Badly edited or damaged files: configurations, devices and scenes in TOML, recordings in HDF5.
Each is accepted, or refused by one clear error, in bounded time.

A refused file stays unchanged. Of a recording and its packed copy, at least one is complete. HDF5
is a C library, which may hang or crash on a damaged file. The files therefore go to a separate
process, BATCH at a time. A process that dies, or is silent for PATIENCE_S, counts as a loss that
names its seed.
"""

import json
import multiprocessing
import re
import tempfile
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.params import to_plain
from hapticd.model.params import InjectionParams
from hapticd.recording import pack
from hapticd.recording.file import open_recording
from hapticd.recording.live import Writer
from hapticd.recording.provenance import SCHEMA
from hapticd.run.lockstep import scene_params
from hapticd.settings.build import board_params, gateway_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from support.attacks.rows import Losses, Outcome
from support.boards import board_params as board_of_models
from support.recorded import RecordedFlight, recorded_into

BATCH = 500
PATIENCE_S = 60.0
TICKS = 1000  # of the recording that is damaged
CONFIG = shipped("config")
DEVICES = sorted((CONFIG / "devices").glob("*.toml"))
SCENES = sorted((CONFIG / "scenes").glob("*.toml"))
NUMBER = re.compile(r"(?m)(?<=[=\[,] )[-+]?\d[\d_.]*(?:e[-+]?\d+)?")
TINY = ["1e-308", "5e-324", "2.3e-308", "1e-300", "1e-160", "1e-30", "-1e-308"]
HUGE = ["1e30", "1e160", "1e300", "1.7e308", "9223372036854775807", "inf", "-inf", "nan"]
VALUES = [*TINY, *HUGE, "0", "-0.0", "-1", "1", "3", "1e-3", "1e3", "true", '"x"', "[]"]
ODD = ["\x00", "\x1b", "\ufeff", "[[", "]]", '"""', "=", "\r", "é", "#"]


# --- TOML -----------------------------------------------------------------------------------------


def read_settings(path: Path) -> None:
    """Everything that starting with the file at `path` would compute from it."""
    if b"effects" in path.read_bytes() and path.name in {scene.name for scene in SCENES}:
        scene_params(path)
        return
    if path.name in {device.name for device in DEVICES}:
        text = (CONFIG / "hapticd.toml").read_text()
        config = path.with_name("hapticd.toml")
        config.write_text(re.sub(r"(?m)^device = .*$", f'device = "{path}"', text))
        path = config
    settings = load(path)
    servo_params(settings, "default")
    board_params(settings)
    gateway_params(settings)


def mutated_toml(text: str, chance: Random) -> str:
    """Return `text` with numbers replaced or lines removed."""
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        numbers = list(NUMBER.finditer(text))
        lines = text.split("\n")
        if numbers and chance.random() < 0.9:
            number = chance.choice(numbers)
            text = text[: number.start()] + chance.choice(VALUES) + text[number.end() :]
        else:
            del lines[chance.randrange(len(lines))]
            text = "\n".join(lines)
    return text


def damaged_text(text: str, chance: Random) -> bytes:
    """With characters that do not belong there, lines twice or exchanged, bytes at random."""
    lines = text.split("\n")
    way = chance.randrange(4)
    if way == 0:
        lines.insert(chance.randrange(len(lines)), chance.choice(lines))
    elif way == 1:
        chance.shuffle(lines)
    elif way == 2:
        at = chance.randrange(len(text))
        return (text[:at] + chance.choice(ODD) + text[at:]).encode()
    data = bytearray("\n".join(lines).encode())
    for _ in range(chance.choice((0, 1, 5))):
        data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data)


def one_toml(folder: Path, seed: int) -> None:
    """AssertionError, or any error but HapticdError, where the file of `seed` is a loss."""
    chance = Random(seed)
    source = chance.choice((CONFIG / "hapticd.toml", *DEVICES, *SCENES))
    text = source.read_text()
    hard = chance.random() < 0.3
    data = damaged_text(text, chance) if hard else mutated_toml(text, chance).encode()
    path = folder / source.name
    path.write_bytes(data)
    with suppress(ConfigError):
        read_settings(path)


# --- HDF5 -----------------------------------------------------------------------------------------


def crashed_recording(flown: RecordedFlight, folder: Path) -> Path:
    """A live file as a killed recorder leaves it, after the messages of `flown`."""
    configuration = json.dumps(to_plain(flown.params))
    attributes = {"schema": SCHEMA, "simulated": 1, "configuration": configuration}
    path = folder / "crashed.part.h5"
    writer = Writer(path, attributes)
    for number, (topic, payload) in enumerate(flown.messages):
        writer.take(topic, payload)
        if number % 20 == 19:
            writer.write()
    writer.write()
    writer.file.close()
    return path


def recordings(folder: Path) -> tuple[bytes, bytes]:
    """Return a live file as its recorder left it, and a finished one."""
    board = board_of_models(injections=(InjectionParams("drop_in", tick=500, count=2),))
    with RecordedFlight(board=board) as flown:
        flown.move()
        flown.fly(TICKS)
    live = crashed_recording(flown, folder).read_bytes()
    recorded_into(folder / "whole.h5", flown)
    return live, (folder / "whole.h5").read_bytes()


def damaged_bytes(source: bytes, chance: Random) -> bytes:
    """Return `source` with flipped bits, mostly in the structure; one in five is cut."""
    data = bytearray(source)
    for _ in range(chance.choice((1, 2, 5, 20))):
        data[chance.randrange(chance.choice((40_000, len(data))))] ^= 1 << chance.randrange(8)
    if chance.random() < 0.2:
        del data[chance.randrange(len(data)) :]
    return bytes(data)


def pack_damaged(folder: Path, data: bytes) -> None:
    """Pack a live file of `data`. AssertionError if the live file is removed although a part of it
    was not packed, if it remains although all was packed, or if it has changed.
    """
    path = folder / "any.part.h5"
    path.write_bytes(data)
    whole = False
    with suppress(HapticdError):
        whole = not pack.pack(path, folder / "any.h5")["dropped_bytes"]
    assert path.exists() != whole
    assert whole or path.read_bytes() == data
    (folder / "any.h5").unlink(missing_ok=True)


def read_damaged(folder: Path, data: bytes) -> None:
    """Read a finished file of `data`, every column. AssertionError if that changes it."""
    path = folder / "any.h5"
    path.write_bytes(data)
    with suppress(HapticdError), open_recording(path) as recording:
        for table in recording.rows:
            for name in recording.names(table):
                recording.column(table, name)
    assert path.read_bytes() == data
    path.unlink()


class Hdf5:
    """The recordings that are damaged; made once for a process."""

    def __init__(self, folder: Path) -> None:
        self.live, self.whole = recordings(folder)

    def one(self, folder: Path, seed: int) -> None:
        """AssertionError, or any error but HapticdError, where the file of `seed` is a loss."""
        chance = Random(seed)
        if chance.random() < 0.5:
            pack_damaged(folder, damaged_bytes(self.live, chance))
        else:
            read_damaged(folder, damaged_bytes(self.whole, chance))


# --- a process for each batch ---------------------------------------------------------------------

Try = Callable[[Path, int], None]


def attack_toml(times: int, seed: int) -> Outcome:
    """`times` files of TOML."""
    return _attack(one_toml, times, seed)


def attack_hdf5(times: int, seed: int) -> Outcome:
    """`times` recordings."""
    with tempfile.TemporaryDirectory() as folder:
        return _attack(Hdf5(Path(folder)).one, times, seed)


def _attack(one: Try, times: int, seed: int) -> Outcome:
    losses = Losses()
    place = 0
    while place < times:
        place += _batch(one, range(seed + place, seed + min(times, place + BATCH)), losses)
    return losses.outcome(times)


def _batch(one: Try, seeds: range, losses: Losses) -> int:
    """Try the files of `seeds` in a process of their own; how many were tried before it died."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(one, seeds, theirs))
    process.start()
    theirs.close()
    done = 0
    with suppress(EOFError):
        while done < len(seeds) and ours.poll(PATIENCE_S):
            said = ours.recv()
            done += 1
            if said:
                losses.add(said)
    if done < len(seeds):
        process.kill()
        losses.add(f"seed {seeds[done]}: no answer, exit code {process.exitcode}")
        done += 1
    process.join()
    ours.close()
    return done


def _serve(one: Try, seeds: range, told: Connection) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            for left in Path(folder).iterdir():  # files of a lost batch do not count in the next
                left.unlink()
            try:
                one(Path(folder), seed)
                told.send("")
            except Exception as error:
                told.send(f"seed {seed}: {error!r:.300}")
