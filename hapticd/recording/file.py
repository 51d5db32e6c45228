"""Opening what was recorded: finished files, live or crashed ones, flight recordings.

All become a `Recording`: columns read on demand, records as the servo wrote them, and the segments
that can be replayed. A finished file is read as it is. Of a live or crashed one only as many rows
count as /flushed/rows says; a column that ends before that repeats its last value (see `live`). A
flight recording is turned into the same columns in memory.

A segment is a stretch of consecutive ticks of one servo life, from its first checkpoint up to the
next gap, or to a tick whose requests were lost (`break`).

What would break it: reading /flushed/rows after the columns that it counts, for a file that grows
meanwhile; or a field that changed its meaning under the same name.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.params import ScaleParams, ServoParams, from_plain
from hapticd.core.units import NS_PER_S, PROBE_RATE_HZ
from hapticd.mailbox.client_side import Noted
from hapticd.protocol import flight
from hapticd.protocol.view import RECORD_DTYPE, Records
from hapticd.recording.live import (
    FLUSHED,
    GROUPS,
    LEFT_OUT,
    REQUEST,
    ROWS,
    STREAMS,
    Columns,
    as_channel,
    as_text,
    columns,
    is_written,
    replay_rows,
    table,
    texts,
    udunits,
)
from hapticd.recording.provenance import SCHEMA
from hapticd.recording.superblock import Unattended
from hapticd.run.replay import Segment
from hapticd.settings.inputs import SAMPLES_BYTES, regular

__all__ = ["is_recording", "open_recording"]

TEXT = "checkpoint_text"
STANDING = 4096  # rows that a small group may have beyond its longest column
# what h5py and numpy say where a file is damaged
_UNREADABLE = (
    *(OSError, RuntimeError, LookupError, ValueError, TypeError, MemoryError),
    OverflowError,  # an address beyond what a file has, where `Unattended` seeks it
)
# the column that counts time, and its counts per second
CLOCKS = {"servo": ("time_ns", NS_PER_S), "probe": ("index", PROBE_RATE_HZ)}
# computed from recorded channels; a finished file has them as datasets, too
COMPUTED = {"servo": ("t_s",), "probe": ("torque_n", "velocity_m_per_s", "t_s")}


class Recording:
    """An opened recording: `attributes` say where it comes from, `column(group, name)` reads one
    channel, `rows` counts the rows of each group. Use it as a context manager.
    """

    def __init__(
        self,
        path: Path,
        attributes: Mapping[str, Any],
        groups: Mapping[str, Mapping[str, Any]],
    ) -> None:
        self.path = path
        self.attributes = attributes
        self.opened = ExitStack()  # what its end closes
        self._groups = {name: group for name, group in groups.items() if name != FLUSHED}
        self.rows = {
            name: min(map(len, group.values()), default=0) for name, group in self._groups.items()
        }
        if FLUSHED in groups:  # a live file: see `live`
            with _damage(path):
                self.rows = self._flushed(groups[FLUSHED][ROWS])

    def _flushed(self, counts: Any) -> dict[str, int]:
        """Rows by group as a live file says. ValueError: a group cannot have as many."""
        newest = counts[-1].tolist() if len(counts) else [0] * counts.shape[1]
        names = map(as_text, counts.attrs["groups"].tolist())
        rows = dict(zip(names, newest, strict=True))
        for name, count in rows.items():
            longest = max(map(len, self._groups[name].values()), default=0)
            # in a stream one column always moves, in the others all may stand still for a while
            most = longest if name in STREAMS.values() else longest + STANDING
            if not 0 <= count <= most:
                raise ValueError(f"{count} rows of {name} are said to be there, {longest} are")
        return rows

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.opened.close()

    def names(self, group: str) -> list[str]:
        """The channels of `group`, in the order of the records, then those that are computed
        from them (`COMPUTED`).
        """
        there = self._groups.get(group, {})
        known = [channel.name for channel in GROUPS.get(group, []) if channel.name in there]
        return list(
            dict.fromkeys(
                [*known, *there, *(COMPUTED.get(group, ()) if self.rows.get(group) else ())]
            )
        )

    def column(self, group: str, name: str, begin: int = 0, end: int | None = None) -> NDArray[Any]:
        """Rows begin..end of a channel: (n,), raw frames (n, bytes)."""
        if name not in self._groups[group] and name in COMPUTED.get(group, ()):
            return self._computed(group, name, begin, end)
        after = self.rows[group] if end is None else min(end, self.rows[group])
        stored = self._groups[group][name]
        with _damage(self.path):
            found = np.asarray(stored[begin:after])
            standing = max(0, after - max(begin, len(stored)))
            if not standing:
                return found
            return np.concatenate([found, np.repeat(np.asarray(stored[-1:]), standing, axis=0)])

    def _computed(self, group: str, name: str, begin: int, end: int | None) -> NDArray[Any]:
        """Seconds from the first record, or a signal of the probe in N or m/s."""
        if name == "t_s":
            count, rate_hz = CLOCKS[group]
            return np.asarray(
                (self.column(group, count, begin, end) - self.column(group, count, 0, 1)) / rate_hz
            )
        counts = name.partition("_")[0]
        scale: ScaleParams = getattr(self.params.device, f"probe_{counts}")
        return np.asarray(
            scale.sign
            * (self.column(group, counts, begin, end) - scale.offset_count)
            * scale.per_count
        )

    def unit(self, group: str, name: str) -> str:
        """Unit of a channel; empty when it has none."""
        return next(
            (channel.unit for channel in GROUPS.get(group, []) if channel.name == name),
            udunits(name),
        )

    @property
    def params(self) -> ServoParams:
        """The servo's parameters."""
        with _damage(self.path, "recording"):
            plain = json.loads(self.attributes["configuration"])
        try:
            return from_plain(ServoParams, plain, "configuration")
        except ConfigError as error:
            text = f"{self.path}: {error}; the recording is of another version, or damaged"
            raise ConfigError(text) from error

    @property
    def missing(self) -> dict[str, int]:
        """Records that are missing, by stream."""
        streams = self.column("gap", "stream")
        counts = self.column("gap", "missing")
        return {name: int(counts[streams == name.encode()].sum()) for name in ("servo", "probe")}

    def records(self, begin: int, end: int) -> Records:
        """Rows as the records they were. ConfigError: another version recorded them and a field is
        missing.
        """
        found = np.empty(end - begin, RECORD_DTYPE)
        self._check_fields(RECORD_DTYPE.names or ())
        for name in RECORD_DTYPE.names or ():
            if RECORD_DTYPE[name].kind == "V":
                found[name] = (
                    np.ascontiguousarray(self.column("servo", name, begin, end))
                    .view(RECORD_DTYPE[name])
                    .ravel()
                )
            else:
                found[name] = self.column("servo", "tick" if name == LEFT_OUT else name, begin, end)
        return found

    def _check_fields(self, names: Sequence[str]) -> None:
        there = {*self._groups["servo"], LEFT_OUT}
        for name in names:
            if name not in there:
                version = self.attributes.get("server_version", "another version")
                raise ConfigError(
                    f"{self.path} was recorded by hapticd {version} and lacks {name!r}; replay it"
                    " with that one"
                )

    def segments(self) -> list[Segment]:
        """What can be replayed: of each stretch without a gap, from its first checkpoint on."""
        found = (self._segment(*stretch) for stretch in self.stretches())
        return [segment for segment in found if segment is not None]

    def stretches(self) -> list[tuple[int, int, int]]:
        """(first row, row after the last, epoch) of consecutive ticks of one servo life."""
        tick = self.column("servo", "tick")
        lives = self.column("life", "row")
        cuts = {0, len(tick), *lives.tolist(), *(np.flatnonzero(np.diff(tick) != 1) + 1).tolist()}
        edges = sorted(cuts)
        epochs = self.column("life", "epoch")[np.searchsorted(lives, edges[:-1], side="right") - 1]
        return [
            (first, after, int(epoch))
            for first, after, epoch in zip(edges[:-1], edges[1:], epochs, strict=True)
        ]

    def _segment(self, first: int, after: int, epoch: int) -> Segment | None:
        begin_tick = int(self.column("servo", "tick", first, first + 1)[0])
        end_tick = begin_tick + after - first
        breaks = [lost for life, lost in self._epoch_and_tick("break") if life == epoch]
        # a crashed file may hold fewer whole states than checkpoints: not strict
        checkpoints = zip(self._epoch_and_tick("checkpoint"), self._states(), strict=False)
        for (life, tick), state in checkpoints:
            end = min([end_tick, *(lost for lost in breaks if lost >= tick)])
            if life == epoch and begin_tick <= tick < end:
                row = first + tick - begin_tick
                records = self.records(row, row + end - tick)
                return Segment(tick, state, records, self._requests(epoch, tick, end))
        return None

    def _epoch_and_tick(self, group: str) -> list[list[int]]:
        columns = [self.column(group, name) for name in ("epoch", "tick")]
        return list(np.stack(columns, axis=1).tolist())

    def _states(self) -> list[Any]:
        text = self.column(TEXT, "bytes").tobytes()
        ends = np.cumsum([0, *self.column("checkpoint", "length").tolist()]).tolist()
        return [
            msgpack.unpackb(text[begin:end], strict_map_key=False)
            for begin, end in pairwise(ends)
            if end <= len(text)  # in a crashed file the last may be cut off
        ]

    def _requests(self, epoch: int, begin: int, end: int) -> list[Noted]:
        numbers = np.stack(
            [self.column("request", name) for name in ("epoch", *REQUEST)], axis=1
        ).tolist()
        values = np.stack(
            [self.column("request", name) for name in self.names("request") if "value_" in name],
            axis=1,
        ).tolist()
        found = (
            Noted(**dict(zip(REQUEST, row, strict=True)), values=tuple(given))
            for (one, *row), given in zip(numbers, values, strict=True)
            if one == epoch
        )
        return [noted for noted in found if begin <= noted.tick < end]


def open_recording(path: Path) -> Recording:
    """The recording in `path`, of whatever kind. ConfigError: it is none, or cannot be read."""
    return _flight(path) if path.suffix == flight.SUFFIX else _hdf5(path)


def is_recording(path: Path) -> bool:
    """Whether a file is an HDF5 recording of this package, finished or not."""
    try:
        with _hdf5(path):
            return True
    except (OSError, HapticdError):
        return False


def _hdf5(path: Path) -> Recording:
    import h5py

    regular(path)
    with ExitStack() as opened, _damage(path):
        file = _opened(h5py, path, opened)
        attributes = {name: as_text(value) for name, value in file.attrs.items()}
        # of a file that grows meanwhile the count is read before what it counts
        names = sorted(file, key=lambda name: name != FLUSHED)
        groups = {name: dict(file[name]) for name in names}
        if attributes.get("schema") != SCHEMA:
            found = attributes.get("schema", "without a schema")
            raise ConfigError(
                f"{path} is no hapticd recording ({found}); its schema must be {SCHEMA}"
            )
        recording = Recording(path, attributes, groups)
        recording.opened = opened.pop_all()
    return recording


def _opened(h5py: Any, path: Path, opened: ExitStack) -> Any:
    try:
        return opened.enter_context(h5py.File(path, "r"))
    except OSError:
        if is_written(path):  # only a reader who knows that opens it
            return opened.enter_context(h5py.File(path, "r", swmr=True))
    left = opened.enter_context(Unattended(path))
    return opened.enter_context(h5py.File(left, "r"))


@contextmanager
def _damage(path: Path, kind: str = "HDF5 file") -> Iterator[None]:
    """Turn whatever is said of a file that cannot be read into a ConfigError that names it."""
    try:
        yield
    except _UNREADABLE as error:
        raise ConfigError(f"{path}: {error}; it is no {kind}, or damaged") from error


def _flight(path: Path) -> Recording:
    header, records = flight.read_flight(regular(path, SAMPLES_BYTES))
    with _damage(path, "flight recording"):
        return _of_flight(path, header, records)


def _of_flight(path: Path, header: dict[str, Any], records: Records) -> Recording:
    attributes = {
        "schema": SCHEMA,
        "started_utc": header["written_utc"],
        "simulated": int(header["simulated"]),
        "rate_hz": header["rate_hz"],
        "note": f"flight recording: {header['reason']}",
        "leases": json.dumps(header.get("leases", {})),
        "layout": header["layout"],
        "configuration": json.dumps(header["servo"]),
        "server_version": header["version"],
        "realtime": json.dumps(header["report"].get("realtime", {})),
    }
    rows: dict[str, list[dict[str, Any]]] = {
        "gap": [{"stream": "servo", "row": row, "missing": lost} for row, lost in header["gaps"]],
        "life": [
            {
                "row": 0,
                "epoch": header["epoch"],
                "mono_unix_offset_ns": header["mono_unix_offset_ns"],
            }
        ],
        "event": [],
        **replay_rows(header["epoch"], header["requests"], header["breaks"], header["checkpoints"]),
    }
    ticks = columns(records)
    groups: dict[str, Columns] = {
        "servo": {
            channel.name: as_channel(channel, ticks[channel.name])
            for channel in GROUPS["servo"]
            if channel.name in ticks
        },
        "probe": {},
        TEXT: {"bytes": texts(rows["checkpoint"])},
    }
    return Recording(
        path, attributes, groups | {name: table(name, found) for name, found in rows.items()}
    )
