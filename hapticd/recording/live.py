"""The live file, and the conversion of the daemon's messages to its rows.

A recorder only appends, so written data survive any end of the recorder:

    hapticd-live/1 LF | bytes of header, u64 little-endian | header, JSON | frame | frame | ...

The header contains `attributes`, and in `groups` numpy's description of the rows of each. A frame
is the data of 100 ms: its CRC-32, seeded with that of everything before the first frame; the number
of rows of each group, u32 little-endian; then the rows. The rows of all groups are therefore
written together or not at all. The last frame is incomplete if the recorder was killed or the disk
was full. It is ignored, and so is everything after a damaged frame; the ignored bytes are counted.
The rows stay in the mapped file until their columns are read.

`Writer.take` receives payloads and `Writer.write` is called ten times a second; this module has no
socket and no clock. A stream of records becomes one column per field, with units in UDUNITS
notation.

No write may follow a failed one, and a file must have one writer.
"""

import struct
from collections.abc import Iterable, Mapping, Sequence
from fcntl import LOCK_EX, LOCK_NB, LOCK_SH, flock
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.core.arrays import Records
from hapticd.core.errors import HapticdError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.client_side import Noted
from hapticd.mailbox.layout import COMMAND_VALUES, VALUE_LIMITS, Command, Value
from hapticd.protocol.flight import dtype_of, read_header, with_header
from hapticd.protocol.telemetry import PROBE_DTYPE
from hapticd.protocol.view import RECORD_DTYPE

MAGIC = b"hapticd-live/1\n"
LEFT_OUT = "tail"  # repeats the tick, for readers of the ring
_SIGNED = {"<u8": "<i8"}  # MATLAB computes poorly with 64-bit unsigned integers
SUFFIX = ".part.h5"
TOPICS = ("servo.raw", "probe", "event", "flight")
STREAMS = {"servo.raw": "servo", "probe": "probe"}  # topic: group
TEXT = "checkpoint_text"  # group of the bytes of all checkpoints
TEXT_BYTES = 128  # of an event


class Channel(NamedTuple):
    """One column."""

    name: str
    kind: str  # numpy's number type
    width: int  # bytes per row; 0: one number per row
    field: str  # of the rows
    place: int | None = None  # in that field, if it holds several numbers

    def of(self, rows: Records) -> NDArray[Any]:
        """Return its values in `rows`: (n,), bytes (n, width)."""
        values = rows[self.field] if self.place is None else rows[self.field][:, self.place]
        shape = (-1, self.width) if self.width else (-1,)
        return np.frombuffer(values.tobytes(), self.kind).reshape(shape)


def channels(rows: np.dtype[Any]) -> list[Channel]:
    """Return the channels of rows of a type."""
    found = []
    for name in (name for name in rows.names or () if name != LEFT_OUT):
        kind = rows[name].base.str
        if rows[name].shape:
            places = range(rows[name].shape[0])
            found += [Channel(f"{name}_{place}", kind, 0, name, place) for place in places]
        elif rows[name].kind == "V":
            found.append(Channel(name, "u1", rows[name].itemsize, name))
        else:
            found.append(Channel(name, _SIGNED.get(kind, kind), 0, name))
    return found


class Column:
    """A channel of rows in blocks, joined when read: len(), and [begin:end]."""

    def __init__(
        self, channel: Channel, blocks: Sequence[Records], edges: NDArray[np.int64]
    ) -> None:
        self._channel = channel
        self._blocks = blocks
        self._edges = edges  # rows before each block, and all rows

    def __len__(self) -> int:
        return int(self._edges[-1])

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        begin, end, _ = rows.indices(len(self))
        first = int(np.searchsorted(self._edges, begin, side="right")) - 1
        after = int(np.searchsorted(self._edges, end, side="left"))
        none = self._channel.of(self._blocks[0][:0])
        found = np.concatenate([none, *map(self._channel.of, self._blocks[first:after])])
        start = begin - int(self._edges[first])
        return found[start : start + max(0, end - begin)]


def require_finished(path: Path) -> None:
    """Raise HapticdError while the live file at `path` is being written."""
    with path.open("rb") as file:
        try:
            flock(file, LOCK_SH | LOCK_NB)
        except BlockingIOError as error:
            raise HapticdError(
                f"{path} is being recorded; end that recording first, with Ctrl-C"
            ) from error


def columns(blocks: Sequence[Records]) -> dict[str, Column]:
    """Return the columns of rows in `blocks`, of one type; none without a block."""
    if not blocks:
        return {}
    edges = np.cumsum([0, *map(len, blocks)])
    return {one.name: Column(one, blocks, edges) for one in channels(blocks[0].dtype)}


class LiveFile:
    """A new file at `path` with the `groups` of rows, of these types. HapticdError if it exists, or
    cannot be created.
    """

    def __init__(
        self, path: Path, attributes: Mapping[str, Any], groups: Mapping[str, np.dtype[Any]]
    ) -> None:
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise HapticdError(
                f"{path}: {error}; choose another name, or `hapticd rec recover` it first"
            ) from error
        self.descriptor: int = self._file.fileno()
        flock(self.descriptor, LOCK_EX)  # until it is closed: see `require_finished`
        self._row_bytes = {name: kind.itemsize for name, kind in groups.items()}
        descriptions = {name: kind.descr for name, kind in groups.items()}
        header = with_header(MAGIC, {"attributes": attributes, "groups": descriptions})
        self._seed = crc32(header)
        self._hand_over(header)

    def append(self, rows: Mapping[str, bytes]) -> None:
        """Add rows of several groups as one frame, and pass it to the operating system: from here
        on it survives the end of this process. After an OSError nothing more may be added.
        """
        if any(rows.values()):
            data = {name: rows.get(name, b"") for name in self._row_bytes}
            counts = [len(data[name]) // size for name, size in self._row_bytes.items()]
            body = struct.pack(f"<{len(counts)}I", *counts) + b"".join(data.values())
            self._hand_over(struct.pack("<I", crc32(body, self._seed)) + body)

    def _hand_over(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def is_live(path: Path) -> bool:
    """Whether the file at `path` is a live file, or was one. OSError if it cannot be read."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def read_live(path: Path) -> tuple[dict[str, Any], dict[str, list[Records]], int]:
    """Return the content of the live file at `path`, which may grow meanwhile: its attributes, the
    blocks of each group (the first is empty), and the bytes after the last complete frame.

    OSError, LookupError, TypeError, ValueError or struct.error if its header is damaged.
    """
    with path.open("rb") as file:
        data = memoryview(mmap(file.fileno(), 0, access=ACCESS_READ))
    header, place = read_header(data, MAGIC)
    kinds = {name: dtype_of(descr) for name, descr in header["groups"].items()}
    blocks = {name: [np.empty(0, kind)] for name, kind in kinds.items()}
    head = struct.Struct(f"<{1 + len(kinds)}I")
    seed = crc32(data[:place])
    while place + head.size <= len(data):
        checksum, *counts = head.unpack_from(data, place)
        begin = place + head.size
        sizes = [count * kind.itemsize for count, kind in zip(counts, kinds.values(), strict=True)]
        after = begin + sum(sizes)
        if after > len(data) or crc32(data[place + 4 : after], seed) != checksum:
            break
        for (name, kind), count, size in zip(kinds.items(), counts, sizes, strict=True):
            if count:
                blocks[name].append(np.frombuffer(data, kind, count, begin))
            begin += size
        place = after
    return header["attributes"], blocks, len(data) - place


def _integers(*names: str) -> list[tuple[str, str]]:
    return [(name, "<i8") for name in names]


REQUEST = ("tick", "seq", "kind", "actor", "apply_tick")
# by place and name, so that they sort by place: value_02_stiffness
VALUES = tuple(f"value_{int(place):02}_{place.name.lower()}" for place in Value)
assert len(VALUES) == COMMAND_VALUES
# requests that become rows of `event`; for the others the change of state does
CHANGES = frozenset(
    (Command.SET, Command.DAMPING, Command.ZERO, Command.PERTURB_START, Command.PERTURB_STOP)
)
EVENT = [
    ("timestamp", "<f8"),
    ("tick", "<i8"),
    ("kind", "S16"),
    ("fault", "S32"),
    ("text", f"S{TEXT_BYTES}"),
]
# the type of the rows of each group
GROUPS: dict[str, np.dtype[Any]] = {
    "servo": RECORD_DTYPE,
    "probe": PROBE_DTYPE,
    "event": np.dtype(EVENT),
    "gap": np.dtype([("stream", "S16"), *_integers("row", "missing")]),
    "life": np.dtype(_integers("row", "epoch", "mono_unix_offset_ns")),
    "checkpoint": np.dtype(_integers("epoch", "tick", "length")),
    TEXT: np.dtype([("bytes", "u1")]),
    "request": np.dtype([*_integers("epoch", *REQUEST), *((name, "<f8") for name in VALUES)]),
    "break": np.dtype(_integers("epoch", "tick")),
}


class Writer:
    """Collects messages and writes them in blocks; records `seconds` after the first one, or later,
    are omitted.
    """

    def __init__(
        self, path: Path, attributes: dict[str, Any], seconds: float | None = None
    ) -> None:
        self._seconds = seconds
        self.file = LiveFile(path, attributes, GROUPS)
        self._decoders = {topic: BlockDecoder() for topic in STREAMS}
        self._new: dict[str, list[Records]] = {name: [] for name in GROUPS}  # rows to be written
        self._rows = dict.fromkeys(STREAMS, 0)
        self._epoch: int | None = None
        self._newest: Block | None = None  # of ticks
        self.missing = dict.fromkeys(STREAMS, 0)
        self.first_ns = 0  # time of the first record
        self.last_ns = 0  # time of the newest record
        self.beyond = False  # a record after the end arrived

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
            self._add("event", **event_row(content))
            return
        lost, checkpoint = (
            [] if content[one] is None else [content[one]] for one in ("break", "checkpoint")
        )
        requests = [Noted(*one) for one in content["requests"]]
        for name, rows in replay_rows(content["epoch"], requests, lost, checkpoint).items():
            self._new[name].append(rows)
        self._new["event"].append(table("event", self._changes(requests)))

    def _changes(self, requests: Iterable[Noted]) -> list[dict[str, Any]]:
        """Return rows of `event` for the requests that changed the environment, the damping or the
        perturbation; their time is that of their tick, counted from the newest record.
        """
        return [
            {
                "timestamp": unix_s(self._newest, noted.tick) if self._newest else 0.0,
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
        if block.records.dtype != GROUPS[name]:
            raise HapticdError(
                f"{topic}: the daemon's records have other fields; record with the daemon's version"
                " of hapticd"
            )
        if block.gap:
            self.missing[topic] += block.gap
            self._add("gap", stream=name, row=row, missing=block.gap)
        if topic == "servo.raw" and block.header["epoch"] != self._epoch:
            self._epoch = block.header["epoch"]
            offset_ns = block.header["mono_unix_offset_ns"]
            self._add("life", row=row, epoch=self._epoch, mono_unix_offset_ns=offset_ns)
        if topic == "servo.raw":
            self.first_ns = self.first_ns or int(block.records["time_ns"][0])
            self.last_ns = int(block.records["time_ns"][-1])
            self._newest = block
        self._rows[topic] += len(block.records)
        self._new[name].append(block.records)

    def _add(self, group: str, **row: Any) -> None:
        self._new[group].append(table(group, [row]))

    def write(self) -> None:
        """Write all pending rows to the file. OSError if it cannot be written (any more)."""
        self.file.append(
            {name: b"".join(rows.tobytes() for rows in new) for name, new in self._new.items()}
        )
        self._new = {name: [] for name in GROUPS}


def unix_s(block: Block, tick: int) -> float:
    """Return the time of a tick, extrapolated from the newest record of `block` with the block's
    mean period.
    """
    first_tick, last_tick = block.records["tick"][[0, -1]].tolist()
    first_ns, last_ns = block.records["time_ns"][[0, -1]].tolist()
    away_ns = (tick - last_tick) * (last_ns - first_ns) / max(1, last_tick - first_tick)
    return float(last_ns + block.header["mono_unix_offset_ns"] + away_ns) / NS_PER_S


def table(group: str, rows: Iterable[Mapping[str, Any]]) -> Records:
    """Return rows of a group as a structured array (n,)."""
    kind = GROUPS[group]
    return np.array([tuple(row[name] for name in kind.names or ()) for row in rows], kind)


def replay_rows(
    epoch: int,
    requests: Iterable[Any],
    breaks: Iterable[int],
    checkpoints: Iterable[tuple[int, Any]],
) -> dict[str, Records]:
    """Return rows of the groups `request`, `break`, `checkpoint` and TEXT: the requests that the
    servo obeyed in one life, the ticks at which some were lost, and its states (tick, state).
    """
    states = [(tick, msgpack.packb(state)) for tick, state in checkpoints]
    rows = {
        "request": [(epoch, *numbers, *values) for *numbers, values in requests],
        "break": [(epoch, tick) for tick in breaks],
        "checkpoint": [(epoch, tick, len(text)) for tick, text in states],
        TEXT: [(one,) for _, text in states for one in text],
    }
    return {name: np.array(found, GROUPS[name]) for name, found in rows.items()}


def change_words(values: Sequence[float]) -> str:
    """Describe a command with these values: `stiffness=100 N/m, ramp_s=0.05 s`."""
    mask = int(values[Value.MASK])
    asked = [place for place in Value if place != Value.MASK and mask >> place & 1]
    limits = {place: VALUE_LIMITS.get(place) for place in asked}
    units = {place: f" {limit.unit}" if limit else "" for place, limit in limits.items()}
    return ", ".join(f"{place.name.lower()}={values[place]:.6g}{units[place]}" for place in asked)


def event_row(event: dict[str, Any]) -> dict[str, Any]:
    """Return an event of the daemon in fixed columns; fields without a column go into its text."""
    columns_of_its_own = {"timestamp", "tick", "kind", "fault", "cause", "action", "remedy"}
    words = [f"{name}={value}" for name, value in event.items() if name not in columns_of_its_own]
    return {
        "timestamp": event["timestamp"],
        "tick": event.get("tick", -1),
        "kind": event["kind"],
        "fault": event.get("fault", ""),
        "text": ", ".join(words).encode()[:TEXT_BYTES],
    }
