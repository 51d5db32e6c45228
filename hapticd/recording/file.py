"""Recordings as files: opening them, their energy ledger, and their replay.

Opening (`open_recording`). Finished files, live or crashed ones, and flight recordings all become a
`Recording`: columns read on demand, records as the servo wrote them, and the segments that can be
replayed. A finished file is read directly. For a live or crashed one (see `live`) all complete
frames count, and for a flight recording all records; both have the columns of a finished file. A
field must keep its meaning under its name.

A segment is a stretch of consecutive ticks of one servo life, from its first checkpoint on. It
lasts to the next gap, or to a tick whose requests were lost (`break`).

Energy ledger (`energies`, `total_j`). It has for every tick the sums by cause since its first
record. A finished file contains them in its group `energy`. For any other file they are computed
here, from the records, with the gateway's own ledger. Across a gap, and from one servo life to the
next, no motion is booked. Recordings of boards that did not report the force in effect are booked
with the delay assumed at the time. Nothing in them is unexplained. Limitations: records without a
field that the ledger reads (`Recording.records` raises the error).

Replay (`replay_recording`). It covers a whole recording, one segment after the other. In each,
`recording.replay` runs the servo's own step on the recorded samples. The motion remains the
recorded one. With other settings a replay shows the commands of the tick law, not the motion of the
display. The result of a tick must depend on the checkpoint, the samples and the requests in the
file alone. Otherwise `first_difference` names that tick.
"""

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.core.arrays import Records
from hapticd.core.errors import ConfigError
from hapticd.core.params import ScaleParams, ServoParams, from_plain
from hapticd.core.units import NS_PER_S, PROBE_RATE_HZ, unit_of
from hapticd.mailbox.client_side import Noted
from hapticd.mailbox.layout import Value
from hapticd.protocol import flight
from hapticd.protocol.ledger import NAMES, Ledger
from hapticd.protocol.view import RECORD_DTYPE
from hapticd.recording import live
from hapticd.recording.live import GROUPS, LEFT_OUT, REQUEST, STREAMS, TEXT
from hapticd.recording.provenance import SCHEMA
from hapticd.recording.replay import Difference, Segment, difference, replay
from hapticd.settings.toml import SAMPLES_BYTES, regular

__all__ = ["ReplayResult", "open_recording", "replay_recording", "total_j"]

# --- opening --------------------------------------------------------------------------------------

# errors of h5py, numpy and struct for a damaged file
_UNREADABLE = (
    *(OSError, RuntimeError, LookupError, ValueError, TypeError, MemoryError, OverflowError),
    struct.error,
)
CHANNELS = {name: live.channels(rows) for name, rows in GROUPS.items()}
UNITS = {"timestamp": "s"}  # of groups other than streams, whose names contain no unit
# the column that counts time, and its counts per second
CLOCKS = {"servo": ("time_ns", NS_PER_S), "probe": ("index", PROBE_RATE_HZ)}
# computed from recorded channels; a finished file has them as datasets, too
COMPUTED = {"servo": ("t_s",), "probe": ("torque_n", "velocity_m_per_s", "t_s")}


def udunits(name: str) -> str:
    """Return the unit of a field in UDUNITS notation: N s/m -> N s m-1."""
    over, _, under = unit_of(name).partition("/")
    powers = [
        f"{base}-{power or 1}" for base, _, power in (part.partition("^") for part in under.split())
    ]
    return " ".join([over, *powers]).strip()


class Recording:
    """An open recording: `attributes` contain its origin, `column(group, name)` reads one channel,
    `rows` counts the rows of each group. `dropped_bytes` at the end of a live file are an
    incomplete frame. Use it as a context manager.
    """

    def __init__(
        self,
        path: Path,
        attributes: Mapping[str, Any],
        groups: Mapping[str, Mapping[str, Any]],
        dropped_bytes: int = 0,
    ) -> None:
        self.path = path
        self.attributes = attributes
        self.opened = ExitStack()  # closed at its end
        self.dropped_bytes = dropped_bytes
        self._groups = groups
        self.rows = {
            name: min(map(len, group.values()), default=0) for name, group in groups.items()
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.opened.close()

    def names(self, group: str) -> list[str]:
        """Return the channels of `group`, in the order of the records, then the computed ones
        (`COMPUTED`).
        """
        there = self._groups.get(group, {})
        known = [channel.name for channel in CHANNELS.get(group, ()) if channel.name in there]
        computed = COMPUTED.get(group, ()) if self.rows.get(group) else ()
        return list(dict.fromkeys([*known, *there, *computed]))

    def column(self, group: str, name: str, begin: int = 0, end: int | None = None) -> NDArray[Any]:
        """Return rows begin..end of a channel: (n,), raw frames (n, bytes)."""
        if name not in self._groups[group] and name in COMPUTED.get(group, ()):
            return self._computed(group, name, begin, end)
        after = self.rows[group] if end is None else min(end, self.rows[group])
        with _damage(self.path):
            return np.asarray(self._groups[group][name][begin:after])

    def _computed(self, group: str, name: str, begin: int, end: int | None) -> NDArray[Any]:
        """Return seconds from the first record, or a signal of the probe in N or m/s."""
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
        """Return the unit of a channel in UDUNITS notation; empty if it has none."""
        if group in GROUPS and group not in STREAMS.values():
            return UNITS.get(name, "")
        return udunits(name)

    @property
    def params(self) -> ServoParams:
        """The servo's parameters."""
        with _damage(self.path, "recording"):
            plain = json.loads(self.attributes["configuration"])
        try:
            return from_plain(ServoParams, plain, "configuration")
        except ConfigError as error:
            raise ConfigError(
                f"{self.path}: {error}; the recording is of another version, or damaged"
            ) from error

    @property
    def missing(self) -> dict[str, int]:
        """Number of missing records, by stream."""
        streams = self.column("gap", "stream")
        counts = self.column("gap", "missing")
        return {name: int(counts[streams == name.encode()].sum()) for name in ("servo", "probe")}

    def records(self, begin: int, end: int) -> Records:
        """Return rows as original records. ConfigError if another version recorded them and a field
        is missing.
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
        """Return the segments that can be replayed: of each stretch without a gap, from its first
        checkpoint on.
        """
        found = (self._segment(*stretch) for stretch in self.stretches())
        return [segment for segment in found if segment is not None]

    def stretches(self) -> list[tuple[int, int, int]]:
        """Return (first row, row after the last, epoch) of consecutive ticks of one servo life."""
        tick = self.column("servo", "tick")
        lives = self.column("life", "row")
        gaps = np.flatnonzero(np.diff(tick) != 1) + 1
        edges = np.unique(np.concatenate(([0, len(tick)], lives, gaps)))
        epochs = self.column("life", "epoch")[np.searchsorted(lives, edges[:-1], side="right") - 1]
        return list(zip(edges[:-1].tolist(), edges[1:].tolist(), epochs.tolist(), strict=True))

    def _segment(self, first: int, after: int, epoch: int) -> Segment | None:
        begin_tick = int(self.column("servo", "tick", first, first + 1)[0])
        end_tick = begin_tick + after - first
        breaks = [lost["tick"] for lost in self._table("break") if lost["epoch"] == epoch]
        for checkpoint, state in zip(self._table("checkpoint"), self._states(), strict=True):
            tick = checkpoint["tick"]
            end = min([end_tick, *(lost for lost in breaks if lost >= tick)])
            if checkpoint["epoch"] == epoch and begin_tick <= tick < end:
                row = first + tick - begin_tick
                records = self.records(row, row + end - tick)
                return Segment(tick, state, records, self._requests(epoch, tick, end))
        return None

    def _table(self, group: str) -> list[dict[str, Any]]:
        """Return the rows of a group as maps of plain values."""
        names = self.names(group)
        columns = [self.column(group, name).tolist() for name in names]
        return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]

    def _states(self) -> list[Any]:
        text = self.column(TEXT, "bytes").tobytes()
        ends = np.cumsum([0, *self.column("checkpoint", "length").tolist()]).tolist()
        return [
            msgpack.unpackb(text[begin:end], strict_map_key=False) for begin, end in pairwise(ends)
        ]

    def _requests(self, epoch: int, begin: int, end: int) -> list[Noted]:
        return [
            Noted(
                **{name: row[name] for name in REQUEST},
                values=tuple(value for name, value in row.items() if "value_" in name),
            )
            for row in self._table("request")
            if row["epoch"] == epoch and begin <= row["tick"] < end
        ]


def open_recording(path: Path) -> Recording:
    """Open the recording in `path`, of any kind. ConfigError if it is not one or unreadable."""
    if path.suffix == flight.SUFFIX:
        found = flight.read_flight(regular(path, SAMPLES_BYTES))
        with _damage(path, "flight recording"):
            return _flight(path, *found)
    with _damage(path):
        growing = live.is_live(regular(path))
    with _damage(path, "recording" if growing else "HDF5 file"):
        return _live(path) if growing else _hdf5(path)


def _live(path: Path) -> Recording:
    attributes, blocks, dropped_bytes = live.read_live(path)
    _check_schema(path, attributes)
    groups = {name: live.columns(found) for name, found in blocks.items()}
    return Recording(path, attributes, groups, dropped_bytes)


def _hdf5(path: Path) -> Recording:
    import h5py

    with ExitStack() as opened:
        file = opened.enter_context(h5py.File(path, "r"))
        attributes = {name: as_text(value) for name, value in file.attrs.items()}
        _check_schema(path, attributes)
        recording = Recording(path, attributes, {name: dict(file[name]) for name in file})
        recording.opened = opened.pop_all()
    return recording


def _check_schema(path: Path, attributes: Mapping[str, Any]) -> None:
    if attributes.get("schema") != SCHEMA:
        found = attributes.get("schema", "without a schema")
        raise ConfigError(
            f"{path} is not a hapticd recording ({found}); its schema must be {SCHEMA}"
        )


def as_text(value: Any) -> Any:
    """Return `value` of an attribute, with fixed-length text decoded."""
    return value.decode(errors="replace") if isinstance(value, bytes) else value


@contextmanager
def _damage(path: Path, kind: str = "HDF5 file") -> Iterator[None]:
    """Turn any error of a reader into a ConfigError that names the file."""
    try:
        yield
    except _UNREADABLE as error:
        raise ConfigError(f"{path}: {error}; it is not a valid {kind}, or damaged") from error


def _flight(path: Path, header: dict[str, Any], records: Records) -> Recording:
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
    gaps = [{"stream": "servo", "row": row, "missing": lost} for row, lost in header["gaps"]]
    life = {
        "row": 0,
        "epoch": header["epoch"],
        "mono_unix_offset_ns": header["mono_unix_offset_ns"],
    }
    rows = {
        "servo": records,
        "gap": live.table("gap", gaps),
        "life": live.table("life", [life]),
        "event": live.table("event", []),
        **live.replay_rows(
            header["epoch"], header["requests"], header["breaks"], header["checkpoints"]
        ),
    }
    groups = {name: live.columns([found]) for name, found in rows.items()}
    return Recording(path, attributes, {"probe": {}, **groups})


# --- energy ledger --------------------------------------------------------------------------------

GROUP = "energy"
DATASETS = tuple(f"{name}_j" for name in NAMES)
ROWS_AT_ONCE = 1 << 15


def energies(recording: Recording) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield first row, and sums [J] after each row from it on, (n, causes) in the order of
    DATASETS. ConfigError if another version recorded it, and a field is missing.
    """
    ledger = Ledger(recording.params)
    for first, after, _ in recording.stretches():
        ledger.forget()
        for begin in range(first, after, ROWS_AT_ONCE):
            yield begin, ledger.take(recording.records(begin, min(begin + ROWS_AT_ONCE, after)))


def total_j(recording: Recording) -> dict[str, float]:
    """Return the energy [J] by cause of the whole recording. ConfigError as `energies`."""
    last = np.zeros(len(NAMES))
    if rows := recording.rows.get(GROUP, 0):
        last = np.array([recording.column(GROUP, name, rows - 1, rows)[0] for name in DATASETS])
    else:
        for _, sums in energies(recording):
            last = sums[-1]
    return dict(zip(NAMES, last.tolist(), strict=True))


# --- replay ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ReplayResult:
    """A recording and its replay, row by row."""

    recorded: Records  # (n,)
    replayed: NDArray[np.void]  # (n,), the same fields
    segments: Sequence[tuple[int, int]]  # (first row, row after the last) of each
    first_difference: Difference | None  # None: bit-exact
    left_out: int = 0  # recorded ticks before a checkpoint, which cannot be replayed

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Seconds from the first replayed record (n,)."""
        time_ns = self.recorded["time_ns"]
        return np.asarray((time_ns - time_ns[0]) / NS_PER_S)

    @property
    def first_force_tick(self) -> int | None:
        """The first tick at which the force differs; None if it never does."""
        changed = np.flatnonzero(self.recorded["force_n"] != self.replayed["force_n"])
        return int(self.recorded["tick"][changed[0]]) if changed.size else None

    def to_json(self) -> dict[str, Any]:
        """Return counts, the first difference, and rms and peak of both forces [N]."""
        recorded = self.recorded["force_n"]
        replayed = self.replayed["force_n"]
        forces = {"recorded": recorded, "replayed": replayed, "difference": replayed - recorded}
        first = self.first_difference
        return {
            "ticks": len(self.replayed),
            "legs": len(self.segments),
            "left_out": self.left_out,
            "first_force_tick": self.first_force_tick,
            "bit_exact": first is None,
            "first_difference": None if first is None else first._asdict(),
            "force_rms_n": {
                name: float(np.sqrt(np.mean(np.square(force_n))))
                for name, force_n in forces.items()
            },
            "force_peak_n": {
                "recorded": float(np.abs(recorded).max()),
                "replayed": float(np.abs(replayed).max()),
            },
        }


def replay_recording(
    recording: Recording, instead: dict[Value, float] | None = None
) -> ReplayResult:
    """Replay all segments of `recording`; `instead`: settings to replace. ConfigError if it
    contains no segment.
    """
    segments = recording.segments()
    if not segments:
        raise ConfigError(
            f"{recording.path} holds no checkpoint of the servo, from which a replay begins; record"
            " a second or longer"
        )
    recorded = np.concatenate([segment.records for segment in segments])
    params = recording.params
    replayed = np.concatenate([replay(params, segment, instead) for segment in segments])
    edges = np.cumsum([0, *(len(segment.records) for segment in segments)]).tolist()
    left_out = recording.rows["servo"] - len(recorded)
    first = difference(recorded, replayed)
    return ReplayResult(recorded, replayed, list(pairwise(edges)), first, left_out)
