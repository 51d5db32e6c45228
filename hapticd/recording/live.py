"""From messages of the daemon to rows of the live file: columns that grow by blocks, single writer,
multiple readers (SWMR).

A stream of records becomes one column a field, in units as UDUNITS writes them. `Writer.take` gets
payloads and `Writer.write` is called ten times a second; there is no socket and no clock here.
Written plainly, fifty columns would take more processor time than a recorder may have, so
- HDF5's low-level calls are used, with number types and selections made once (a fifth of the time);
- a column that stands still is not written: it stays shorter than the others until it moves or the
  file is closed.
How many rows count is written last, in /flushed/rows, after everything else was handed over: rows
beyond do not count, and a column that ends before repeats its last value. A write that fails leaves
the library with data that it cannot put anywhere; then nothing more is written, and the file stays
as it was at the last flush, for `hapticd rec recover`.

What would break it: a flush of /flushed/rows before the columns, a dataset or an attribute made
after SWMR began, a second writer.
"""

import fcntl
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.core.errors import HapticdError
from hapticd.core.units import NS_PER_S, unit_of
from hapticd.mailbox.client_side import Noted
from hapticd.mailbox.layout import COMMAND_VALUES, VALUE_LIMITS, Command, Value
from hapticd.protocol.telemetry import PROBE_DESCR as PROBE
from hapticd.protocol.telemetry import TICK_DESCR as TICKS

Columns = dict[str, NDArray[Any]]
LEFT_OUT = "tail"  # repeats the tick, for readers of the ring
_SIGNED = {"<u8": "<i8"}  # MATLAB computes poorly with 64-bit unsigned integers
CHUNK_ROWS = {"servo": 1024, "probe": 4096, "checkpoint_text": 4096}  # a chunk is written whole
FEW_ROWS = 64  # in a chunk of all others
FLUSHED = "flushed"  # the group of the one dataset ROWS: rows that count, of every other group
ROWS = "rows"
SUFFIX = ".part.h5"
TOPICS = ("servo.raw", "probe", "event", "flight")
STREAMS = {"servo.raw": "servo", "probe": "probe"}  # topic: group
TEXT_BYTES = 128  # of an event
LONGEST_TEXT = 60_000  # bytes of an attribute; 65,535 is what HDF5 puts into a header


class Channel(NamedTuple):
    """One dataset."""

    name: str
    kind: str  # numpy's number type
    width: int  # bytes per row; 0: one number per row
    unit: str  # as UDUNITS writes it


def channels(descr: Sequence[Sequence[Any]]) -> list[Channel]:
    """The channels of records with numpy `descr`."""
    found = []
    for name, kind, *shape in (field for field in descr if field[0] != LEFT_OUT):
        if shape:
            found += [Channel(part, kind, 0, udunits(part)) for part in _parts(name, shape[0][0])]
        elif kind.startswith("V"):
            found.append(Channel(name, "u1", int(kind[1:]), ""))
        else:
            found.append(Channel(name, _SIGNED.get(kind, kind), 0, udunits(name)))
    return found


def columns(records: NDArray[np.void]) -> Columns:
    """The columns of a block of records, in the order of `channels`: views, of the bytes that
    the channels' types mean.
    """
    found: Columns = {}
    for name in (name for name in records.dtype.names or () if name != LEFT_OUT):
        column = records[name]
        if column.ndim == 2:
            found |= {
                part: column[:, place] for place, part in enumerate(_parts(name, column.shape[1]))
            }
        else:
            found[name] = column
    return found


def as_channel(channel: Channel, values: NDArray[Any]) -> NDArray[Any]:
    """`values` of a column as numbers of its channel: (n,), bytes (n, width)."""
    row = (channel.width,) if channel.width else ()
    return np.frombuffer(values.tobytes(), channel.kind).reshape(-1, *row)


def _parts(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}_{place}" for place in range(count))


def udunits(name: str) -> str:
    """Unit of a field as UDUNITS writes it: N s/m -> N s m-1."""
    over, _, under = unit_of(name).partition("/")
    powers = [
        f"{base}-{power or 1}" for base, _, power in (part.partition("^") for part in under.split())
    ]
    return " ".join([over, *powers]).strip()


def of_fixed_length(value: Any) -> Any:
    """`value` of an attribute, text as UTF-8 of a fixed length: what may have any length lies in a
    heap without a checksum, and HDF5 reads a damaged heap for ever, or dies of it. Only text that
    is too long for a header stays as it is.
    """
    data = value.encode() if isinstance(value, str) else b""
    if not isinstance(value, str) or len(data) > LONGEST_TEXT:
        return value
    return np.array(data, f"S{max(1, len(data))}")


def as_text(value: Any) -> Any:
    """`value` of an attribute as it was before `of_fixed_length`."""
    return value.decode(errors="replace") if isinstance(value, bytes) else value


class Column:
    """One dataset that grows."""

    def __init__(self, group: Any, channel: Channel, chunk_rows: int) -> None:
        self._row = (channel.width,) if channel.width else ()
        self._dtype = np.dtype(channel.kind)
        self._bytes = self._dtype.itemsize * max(1, channel.width)
        self.dataset = group.create_dataset(
            channel.name,
            (0, *self._row),
            self._dtype,
            maxshape=(None, *self._row),
            chunks=(chunk_rows, *self._row),
        )
        self.dataset.attrs["units"] = of_fixed_length(channel.unit)
        self._identifier = self.dataset.id
        self._kind = self.dataset.id.get_type()
        self._last = b""
        self._standing = 0
        self._rows = 0

    def append(self, values: NDArray[Any]) -> None:
        """Add `values`, whose bytes are those of the dataset's number type; nothing is written
        while all of them equal the last one.
        """
        data = values.tobytes()
        if data == self._last * len(values):
            self._standing += len(values)
        else:
            self._write(self._last * self._standing + data)

    def catch_up(self) -> None:
        """Write the rows that stood still."""
        if self._standing:
            self._write(self._last * self._standing)

    def _write(self, data: bytes) -> None:
        values = np.frombuffer(data, self._dtype).reshape(-1, *self._row)
        begin = self._rows
        self._rows += len(values)
        self._identifier.set_extent((self._rows, *self._row))
        self._identifier.write(*_selections(begin, values.shape), values, self._kind)
        self._last = data[-self._bytes :]
        self._standing = 0


@lru_cache(maxsize=4)
def _selections(begin: int, shape: tuple[int, ...]) -> tuple[Any, Any]:
    """Where a block of `shape` lies in memory, and where it goes in its dataset, which was just
    extended to hold it, from row `begin` on; the same for most columns of a group.
    """
    from h5py import h5s as spaces

    there = spaces.create_simple((begin + shape[0], *shape[1:]), (spaces.UNLIMITED, *shape[1:]))
    there.select_hyperslab((begin, *(0,) * (len(shape) - 1)), shape)
    return spaces.create_simple(shape), there


class LiveFile:
    """The file at `path`, with one group per entry of `groups`; no dataset or attribute can be
    added later, for SWMR forbids it. HapticdError: it exists.
    """

    def __init__(
        self, path: Path, attributes: Mapping[str, Any], groups: Mapping[str, Iterable[Channel]]
    ) -> None:
        import h5py

        try:
            self._file = h5py.File(path, "x", libver=("v110", "v110"))
        except OSError as error:
            raise HapticdError(
                f"{path}: {error}; choose another name, or `hapticd rec recover` it first"
            ) from error
        for name, value in attributes.items():
            self._file.attrs[name] = of_fixed_length(value)
        counts = [Channel(ROWS, "<i8", len(groups), "")]
        self._groups = {
            name: self._columns(name, channels)
            for name, channels in {**groups, FLUSHED: counts}.items()
        }
        self._groups[FLUSHED][ROWS].dataset.attrs["groups"] = np.array([*groups], "S")
        self._rows = dict.fromkeys(groups, 0)
        self._file.swmr_mode = True
        self.descriptor: int = self._file.id.get_vfd_handle()
        # so that readers know of a living writer (`is_written`); HDF5 has locks of another kind
        with suppress(OSError):
            fcntl.lockf(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _columns(self, name: str, channels: Iterable[Channel]) -> dict[str, Column]:
        group = self._file.create_group(name)
        chunk_rows = CHUNK_ROWS.get(name, FEW_ROWS)
        return {channel.name: Column(group, channel, chunk_rows) for channel in channels}

    def append(self, group: str, columns: Mapping[str, NDArray[Any]]) -> None:
        """Add rows to all columns of `group`."""
        for name, values in columns.items():
            self._groups[group][name].append(values)
        self._rows[group] += len(values)

    def flush(self) -> None:
        """Hand everything to the operating system: from here on it survives the end of this
        process.
        """
        self._file.flush()
        counts = self._groups[FLUSHED][ROWS]
        counts.append(np.array([list(self._rows.values())], "<i8"))
        counts.dataset.id.flush()

    def close(self) -> None:
        """Bring all columns to the same length and close an intact file."""
        for name in self._rows:
            for column in self._groups[name].values():
                column.catch_up()
        self._file.flush()
        self._file.close()


def is_written(path: Path) -> bool:
    """Whether another process writes the live file at `path`. OSError: it cannot be read."""
    with path.open("rb") as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _integers(*names: str) -> list[Channel]:
    return [Channel(name, "<i8", 0, "") for name in names]


REQUEST = ("tick", "seq", "kind", "actor", "apply_tick")
# by place and name, so that they sort by place: value_02_stiffness
VALUES = tuple(f"value_{int(place):02}_{place.name.lower()}" for place in Value)
assert len(VALUES) == COMMAND_VALUES
# requests that are rows of `event` too: of the others the change of state is one
CHANGES = frozenset(
    (Command.SET, Command.DAMPING, Command.ZERO, Command.PERTURB_START, Command.PERTURB_STOP)
)
GROUPS: dict[str, list[Channel]] = {
    "servo": channels(TICKS),
    "probe": channels(PROBE),
    "event": [
        Channel("timestamp", "<f8", 0, "s"),
        Channel("tick", "<i8", 0, ""),
        Channel("kind", "S16", 0, ""),
        Channel("fault", "S32", 0, ""),
        Channel("text", f"S{TEXT_BYTES}", 0, ""),
    ],
    "gap": [Channel("stream", "S16", 0, ""), *_integers("row", "missing")],
    "life": _integers("row", "epoch", "mono_unix_offset_ns"),
    "checkpoint": _integers("epoch", "tick", "length"),
    "checkpoint_text": [Channel("bytes", "u1", 0, "")],
    "request": [
        *_integers("epoch", *REQUEST),
        *(Channel(name, "<f8", 0, "") for name in VALUES),
    ],
    "break": _integers("epoch", "tick"),
}


class Newest(NamedTuple):
    """The newest record of a block."""

    tick: int
    unix_ns: int
    period_ns: float  # from tick to tick, the mean of the block

    def unix_s(self, tick: int) -> float:
        """The time of another tick, counted from this one."""
        return (self.unix_ns + (tick - self.tick) * self.period_ns) / NS_PER_S


class Writer:
    """Collects messages and writes them in blocks; records `seconds` after the first one, or later,
    are left out.
    """

    def __init__(
        self, path: Path, attributes: dict[str, Any], seconds: float | None = None
    ) -> None:
        self._seconds = seconds
        self.file = LiveFile(path, attributes, GROUPS)
        self._decoders = {topic: BlockDecoder() for topic in STREAMS}
        self._blocks: dict[str, list[Block]] = {topic: [] for topic in STREAMS}
        self._rows = dict.fromkeys(STREAMS, 0)
        self._small: dict[str, list[dict[str, Any]]] = {
            name: [] for name in GROUPS if name not in STREAMS.values()
        }
        self._epoch: int | None = None
        self._newest = Newest(0, 0, 0.0)
        self.missing = dict.fromkeys(STREAMS, 0)
        self.first_ns = 0  # time of the first record that was taken
        self.last_ns = 0  # and of the newest
        self.beyond = False  # a record came that lies after the end

    @property
    def records(self) -> int:
        """Ticks taken so far."""
        return self._rows["servo.raw"]

    @property
    def seconds(self) -> float:
        """Recorded time."""
        return (self.last_ns - self.first_ns) / NS_PER_S

    def take(self, topic: str, payload: bytes) -> None:
        """Take one message."""
        if topic in STREAMS:
            self._stream(topic, self._decoders[topic].decode(payload))
            return
        content = msgpack.unpackb(payload, use_list=False)
        if topic == "event":
            found = {"event": [event_row(content)]}
        else:
            lost, checkpoint = (
                [] if content[one] is None else [content[one]] for one in ("break", "checkpoint")
            )
            requests = [Noted(*one) for one in content["requests"]]
            found = replay_rows(content["epoch"], requests, lost, checkpoint)
            found["event"] = self._changes(requests)
        for name, rows in found.items():
            self._small[name] += rows

    def _changes(self, requests: Iterable[Noted]) -> list[dict[str, Any]]:
        """Rows of `event` for the requests that changed what is rendered, damped or played; their
        time is that of their tick, counted from the newest record.
        """
        return [
            {
                "timestamp": self._newest.unix_s(noted.tick),
                "tick": noted.tick,
                "kind": Command(noted.kind).name.lower(),
                "fault": "",
                "text": change_words(noted.values).encode()[:TEXT_BYTES],
            }
            for noted in requests
            if noted.kind in CHANGES
        ]

    def _stream(self, topic: str, block: Block) -> None:
        if self._seconds is not None and self.first_ns:
            inside = block.records["time_ns"] < self.first_ns + round(self._seconds * NS_PER_S)
            self.beyond |= topic == "servo.raw" and not inside.all()
            block = Block(block.records[inside], block.gap, block.restarted, block.header)
        if not len(block.records):
            return
        row = self._rows[topic]
        name = STREAMS[topic]
        if block.gap:
            self.missing[topic] += block.gap
            self._small["gap"].append({"stream": name, "row": row, "missing": block.gap})
        if topic == "servo.raw" and block.header["epoch"] != self._epoch:
            self._epoch = block.header["epoch"]
            offset_ns = block.header["mono_unix_offset_ns"]
            self._small["life"].append(
                {"row": row, "epoch": self._epoch, "mono_unix_offset_ns": offset_ns}
            )
        if topic == "servo.raw":
            self.first_ns = self.first_ns or int(block.records["time_ns"][0])
            self.last_ns = int(block.records["time_ns"][-1])
            self._newest = _newest(block)
        self._rows[topic] += len(block.records)
        self._blocks[topic].append(block)

    def write(self) -> None:
        """Put everything taken into the file and flush it. OSError or RuntimeError: it cannot
        be written (any more).
        """
        for topic, name in STREAMS.items():
            if blocks := self._blocks[topic]:
                self._blocks[topic] = []
                data = b"".join(block.records.tobytes() for block in blocks)
                self.file.append(name, columns(np.frombuffer(data, blocks[0].records.dtype)))
        for name, rows in self._small.items():
            if rows:
                self._small[name] = []
                self.file.append(name, table(name, rows))
                if name == "checkpoint":
                    self.file.append("checkpoint_text", {"bytes": texts(rows)})
        self.file.flush()


def _newest(block: Block) -> Newest:
    first_tick, last_tick = block.records["tick"][[0, -1]].tolist()
    first_ns, last_ns = block.records["time_ns"][[0, -1]].tolist()
    period_ns = (last_ns - first_ns) / max(1, last_tick - first_tick)
    return Newest(last_tick, last_ns + block.header["mono_unix_offset_ns"], period_ns)


def table(group: str, rows: list[dict[str, Any]]) -> Columns:
    """The columns of a small group from its rows."""
    return {
        channel.name: np.array([row[channel.name] for row in rows], channel.kind)
        for channel in GROUPS[group]
    }


def texts(checkpoints: list[dict[str, Any]]) -> NDArray[np.uint8]:
    """The bytes of `checkpoint_text` of rows of `checkpoint`."""
    return np.frombuffer(b"".join(row["text"] for row in checkpoints), "u1")


def replay_rows(
    epoch: int,
    requests: Iterable[Any],
    breaks: Iterable[int],
    checkpoints: Iterable[tuple[int, Any]],
) -> dict[str, list[dict[str, Any]]]:
    """Rows of `request`, `break` and `checkpoint` (with its `text`): the requests that the servo
    obeyed in one life, the ticks at which some were lost, and its states (tick, state).
    """
    packed = [(tick, msgpack.packb(state)) for tick, state in checkpoints]
    return {
        "request": [
            {
                "epoch": epoch,
                **dict(zip(REQUEST, numbers, strict=True)),
                **dict(zip(VALUES, values, strict=True)),
            }
            for *numbers, values in requests
        ],
        "break": [{"epoch": epoch, "tick": tick} for tick in breaks],
        "checkpoint": [
            {"epoch": epoch, "tick": tick, "text": text, "length": len(text)}
            for tick, text in packed
        ],
    }


def change_words(values: Sequence[float]) -> str:
    """What a command with these values asks for: `stiffness=100 N/m, ramp_s=0.05 s`."""
    mask = int(values[Value.MASK])
    asked = [place for place in Value if place != Value.MASK and mask >> place & 1]
    limits = {place: VALUE_LIMITS.get(place) for place in asked}
    units = {place: f" {limit.unit}" if limit else "" for place, limit in limits.items()}
    return ", ".join(f"{place.name.lower()}={values[place]:.6g}{units[place]}" for place in asked)


def event_row(event: dict[str, Any]) -> dict[str, Any]:
    """An event of the daemon in fixed columns; fields without a column go into its text."""
    columns_of_its_own = {"timestamp", "tick", "kind", "fault", "cause", "action", "remedy"}
    words = [f"{name}={value}" for name, value in event.items() if name not in columns_of_its_own]
    return {
        "timestamp": event["timestamp"],
        "tick": event.get("tick", -1),
        "kind": event["kind"],
        "fault": event.get("fault", ""),
        "text": ", ".join(words).encode()[:TEXT_BYTES],
    }
