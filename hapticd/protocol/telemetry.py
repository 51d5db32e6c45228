"""Telemetry: turn the ring of tick records into the messages of each topic.

Topics. A telemetry message always has two frames, [topic, payload], and every payload is one
msgpack value: a map or an array of maps. ZeroMQ matches subscriptions by prefix. The first frame
must be the plain name of the topic, because PlotJuggler subscribes to the text that its user types.
To keep `servo.raw` from subscribers of `servo`, a subscription to the name of a topic selects that
topic only. Another prefix (`""`, `s`, `servo.`) selects all topics that start with it.
The relay (`gateway.relay`) uses libzmq, where `servo` includes `servo.raw` while another client has
subscribed to that. hapticd's client therefore compares the first frame with the topic; generic
decoders skip a map of a few numbers and one binary.

Blocks. The ring is read in blocks: every record once, in order, or counted as lost. `seq` is the
number of a record in the ring of one servo life (0 is the first recorded tick). Consecutive blocks
satisfy seq + n = next seq; missing records were lost, in the ring or in transit.

Two forms of tick records. `servo` is for viewers: an array of maps of plain numbers, one per tick,
each with its own `timestamp`; non-finite numbers are omitted. `servo.raw` is for acquisition: one
map with a header and, in `d`, the records byte by byte as written by the servo. numpy.frombuffer(d,
numpy.dtype(descr)) is lossless and copies nothing.

Probe. The 4 kHz stream is extracted from the IN frames in the tick records. A frame contains 0..5
(torque, velocity) pairs and the board's index of the first one, 32 bits that wrap. This module
unwraps the index, drops duplicates, counts missing intervals, and gives each pair the host time of
its tick. Values stay counts; the header contains the scales of this device. When the board
restarts, its index restarts too: that is a new `run`, not a gap.
"""

import math
import struct
from typing import Any, NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.core.arrays import Records
from hapticd.core.params import DeviceParams
from hapticd.core.units import NS_PER_MS, NS_PER_S, PROBE_RATE_HZ
from hapticd.mailbox.layout import LAYOUT_HASH, RECORD, RING_RECORDS, TELEMETRY, Flag
from hapticd.protocol.ledger import NAMES as LEDGER
from hapticd.protocol.view import ServoView, as_records, last_torn
from hapticd.usb import frames
from hapticd.usb.codec import PROBE_INDEX_BITS, unwrap

__all__ = [
    "NAMES",
    "PROBE_DTYPE",
    "TICK_DESCR",
    "TOPICS",
    "Feed",
    "Origin",
    "ProbeDecoder",
    "RingBlock",
    "Subscriptions",
]


class Topic(NamedTuple):
    """One row: content, rate, and the ticks per sample of a topic."""

    name: str
    content: str
    rate: str
    decimation: int  # servo ticks per sample; 0: not tied to ticks


TOPICS: tuple[Topic, ...] = (
    Topic(
        "servo",
        "array of maps of numbers, `timestamp` in Unix seconds, `seq` +1 per tick",
        "`batch` ticks a message, fewer at a change of state, fault or reported damping",
        1,
    ),
    Topic(
        "servo.raw",
        "map: header and `d`, little-endian records of dtype `descr`, lossless",
        "`batch` ticks or more, or fewer at such a change",
        1,
    ),
    Topic(
        "probe",
        "map: header and `d`, 4 kHz torque and velocity in counts, index and host time",
        "as `servo.raw`",
        1,
    ),
    Topic(
        "state",
        "map: state, fault, revision, parameters, counters",
        "on change, at 1 Hz, on subscription",
        0,
    ),
    Topic(
        "event",
        "map with `kind`: state, answer, guard, lease, proxy, gap, mark, servo_up, servo_down,"
        " flight, controlled, warning",
        "when it happens",
        0,
    ),
    Topic(
        "guard",
        "map: policy, verdict with margin and allowed ranges, both without and with damping",
        "twice a second",
        0,
    ),
    Topic(
        "flight",
        "map: requests that the servo obeyed, checkpoints of its state; for replaying records",
        "when there are",
        0,
    ),
)
NAMES = frozenset(topic.name for topic in TOPICS)


def wanted_by(prefix: bytes) -> frozenset[str]:
    """Return the topics that a subscription to `prefix` selects."""
    # a subscriber may send any bytes; a name that is not ASCII is not a topic
    text = prefix.decode("ascii", errors="replace")
    return (
        frozenset({text})
        if text in NAMES
        else frozenset(name for name in NAMES if name.startswith(text))
    )


class Subscriptions:
    """The subscriptions of one subscriber: at most one for each prefix of a topic's name."""

    def __init__(self) -> None:
        self._prefixes: set[bytes] = set()
        self.wanted: frozenset[str] = frozenset()

    def take(self, message: bytes) -> frozenset[str]:
        """Note one message of the subscriber; return the newly selected topics.

        Prefixes of no topic are not kept.
        """
        kind = message[:1]
        prefix = message[1:]
        topics = wanted_by(prefix)
        if not topics or kind not in (b"\0", b"\1"):
            return frozenset()
        (self._prefixes.add if kind == b"\1" else self._prefixes.discard)(prefix)
        self.wanted = frozenset().union(*map(wanted_by, self._prefixes))
        return topics if kind == b"\1" else frozenset()


MOST_RECORDS = 512  # in one block
MOST_BLOCKS = 2  # at once: after a standstill the rest follows in the next passes
LINGER_NS = 100 * NS_PER_MS  # maximum wait of an incomplete batch for its last ticks


class RingBlock(NamedTuple):
    """Consecutive records of one servo life; `lost` records are missing just before.

    `records` shares the memory of `data`.
    """

    life: int
    seq: int
    lost: int
    data: bytes
    records: Records

    def batches(self, energies: NDArray[np.float64], origin: "Origin", batch: int) -> list[bytes]:
        """Return payloads of topic `servo`, with at most `batch` ticks each. `energies` are the
        ledger's sums (n, causes) of the self.
        """
        records = self.records
        columns: list[Any] = [
            ((records["time_ns"] + origin.unix_offset_ns) / NS_PER_S).tolist(),
            range(self.seq, self.seq + len(records)),
            *(records[name].tolist() for name in COLUMNS),
            *energies.T.tolist(),
        ]
        names = ("timestamp", "seq", *COLUMNS, *ENERGIES)
        maps = [
            _finite(dict(zip(names, values, strict=True))) for values in zip(*columns, strict=True)
        ]
        return [
            bytes(msgpack.packb(maps[start : start + batch]))
            for start in range(0, len(maps), batch)
        ]

    def message(self, origin: "Origin") -> bytes:
        """Return the payload of topic `servo.raw`: {.., seq, next, n, lost, descr, d}."""
        return packed_block(
            origin,
            self.seq,
            self.seq + len(self.records),
            len(self.records),
            self.lost,
            TICK_DESCR,
            self.data,
        )


class Feed:
    """Read whole batches, or the available records if no batch was completed for a while."""

    def __init__(self, view: ServoView, batch: int) -> None:
        self._view = view
        self._batch = batch
        self._life = 0
        self._tail = 0
        self._taken_ns = 0
        self.lost = 0

    def take(self, now_ns: int, early: bool = False) -> list[RingBlock]:
        """Return the due blocks: whole batches, unless the ring stood still or `early` requests the
        available records.
        """
        view = self._view
        if view.mailbox is None:
            return []
        if self._life != view.life:
            self._begin(now_ns)
        blocks: list[RingBlock] = []
        while len(blocks) < MOST_BLOCKS and (ready := self._ready(now_ns, early)):
            data, tail, lost = view.mailbox.records(self._tail, ready)
            records = as_records(data)
            # the servo may write over the oldest records while they are copied
            torn = last_torn(records)
            seq = tail - len(records) + torn
            blocks.append(
                RingBlock(self._life, seq, lost + torn, data[torn * RECORD.size :], records[torn:])
            )
            self._tail = tail
            self._taken_ns = now_ns
            self.lost += lost + torn
        return [block for block in blocks if len(block.records) or block.lost]

    def _begin(self, now_ns: int) -> None:
        """Start at the first record of a young ring, or at the newest of one that has
        run for long.
        """
        head = self._view.head
        self._life = self._view.life
        self._taken_ns = now_ns
        self._tail = 0 if head < RING_RECORDS // 2 else head

    def _ready(self, now_ns: int, early: bool) -> int:
        self._tail = min(self._tail, self._view.head)  # the head may fall back after damage
        waiting = min(self._view.head - self._tail, MOST_RECORDS)
        # a batch longer than a block never fills: it is sent incomplete after LINGER_NS
        whole = waiting - waiting % self._batch if self._batch <= MOST_RECORDS else 0
        if early or (not whole and now_ns - self._taken_ns >= LINGER_NS):
            return waiting
        return whole


BLOCK_VERSION = 1
# sent in another form (`timestamp`), or for `servo.raw` alone
_LEFT_OUT = frozenset({"time_ns", "in_frame", "out_frame", "tail"})
COLUMNS: tuple[str, ...] = tuple(str(field[0]) for field in TELEMETRY if field[0] not in _LEFT_OUT)
ENERGIES = tuple(f"energy_{name}_j" for name in LEDGER)
TICK_DESCR = [list(field) for field in TELEMETRY]


class Origin:
    """The header of every block about its origin: one per servo life."""

    def __init__(self, epoch: int, unix_offset_ns: int, simulated: bool) -> None:
        self.epoch = epoch
        self.unix_offset_ns = unix_offset_ns
        self.header: dict[str, Any] = {
            "v": BLOCK_VERSION,
            "epoch": epoch,
            "mono_unix_offset_ns": unix_offset_ns,
            "simulated": simulated,
            "layout": LAYOUT_HASH.hex(),
        }


def _finite(numbers: dict[str, Any]) -> dict[str, Any]:
    # a sum is finite unless one of its terms is not, or it overflows; the slow path then finds
    # none
    if math.isfinite(sum(numbers.values())):
        return numbers
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


def packed_block(
    origin: Origin,
    seq: int,
    after: int,
    count: int,
    lost: int,
    descr: list[Any],
    data: bytes,
    **more: Any,
) -> bytes:
    """Return header and records as one msgpack map.

    `seq` is the number of the first record, `next` that after the last; `lost` are missing since
    the last block.
    """
    place = {"seq": seq, "next": after, "n": count, "lost": lost, "descr": descr}
    return bytes(msgpack.packb(origin.header | place | more | {"d": data}))


PROBE_DTYPE = np.dtype(
    [("index", "<u8"), ("time_ns", "<i8"), ("torque", "<i2"), ("velocity", "<i2")]
)
# if an index falls back further, the board has restarted; the frame is not just late
RESTART = PROBE_RATE_HZ // 10

_COUNT_PLACE = frames.IN_OFFSETS["probe_count"]
_INDEX = struct.Struct("<I")
_INDEX_PLACE = frames.IN_OFFSETS["probe_index"]
_PAIRS_PLACE = frames.IN_OFFSETS["pair"]
_PAIR_BYTES = frames.IN_PAIRS.size // frames.PAIR_MAX
_STALE = Flag.MISSING_IN | Flag.BAD_IN  # the record repeats an older frame


def scales(device: DeviceParams) -> dict[str, dict[str, Any]]:
    """Return the scales of the two signals, in `unit`.

    value = sign * (count - offset_count) * per_count
    """
    signals = (("torque", device.probe_torque, "N"), ("velocity", device.probe_velocity, "m/s"))
    return {
        name: {
            "per_count": scale.per_count,
            "sign": scale.sign,
            "offset_count": scale.offset_count,
            "unit": unit,
        }
        for name, scale, unit in signals
    }


class ProbeDecoder:
    """Decode the probe from one stream of blocks.

    Call `forget` after a time without subscribers, so that the pause is not a gap.
    """

    def __init__(self, device: DeviceParams) -> None:
        self._more = {"rate_hz": PROBE_RATE_HZ, "scale": scales(device)}
        self.run = 0
        self.forget()

    def forget(self) -> None:
        """Start the stream at the next frame."""
        self._next: int | None = None
        self._clear()

    def _clear(self) -> None:
        self._lost = 0
        self._stretches: list[tuple[int, int, int]] = []  # first index, pairs, host time
        self._pairs: list[bytes] = []

    def messages(self, block: RingBlock, origin: Origin) -> list[bytes]:
        """Return payloads of topic `probe` for the pairs in `block`: one for each run of
        the board.
        """
        found = []
        records = block.records
        for flags, time_ns, frame in zip(
            *(records[name].tolist() for name in ("flags", "time_ns", "in_frame")), strict=True
        ):
            count = min(frame[_COUNT_PLACE], frames.PAIR_MAX)
            if flags & _STALE or not count:
                continue
            if self._next is not None and self._first(frame) < self._next - RESTART:
                found += self._flush(origin)
                self._next = None
                self.run = self.run + 1
            self._gather(frame, count, time_ns)
        return found + self._flush(origin)

    def _first(self, frame: bytes) -> int:
        (wrapped,) = _INDEX.unpack_from(frame, _INDEX_PLACE)
        return int(wrapped) if self._next is None else unwrap(self._next, wrapped, PROBE_INDEX_BITS)

    def _gather(self, frame: bytes, count: int, time_ns: int) -> None:
        first = self._first(frame)
        expected = first if self._next is None else self._next
        # pairs already received in an earlier frame
        known = max(0, expected - first)
        if known < count:
            self._lost += max(0, first - expected)
            self._stretches.append((first + known, count - known, time_ns))
            self._pairs.append(
                frame[_PAIRS_PLACE + known * _PAIR_BYTES : _PAIRS_PLACE + count * _PAIR_BYTES]
            )
            self._next = first + count

    def _flush(self, origin: Origin) -> list[bytes]:
        if not self._stretches:
            return []
        first, count, time_ns = np.array(self._stretches, np.int64).T
        samples = np.empty(int(count.sum()), PROBE_DTYPE)
        # within a stretch, indices rise by 1 from the first
        samples["index"] = (
            np.repeat(first, count)
            + np.arange(len(samples))
            - np.repeat(np.cumsum(count) - count, count)
        )
        samples["time_ns"] = np.repeat(time_ns, count)
        samples["torque"], samples["velocity"] = (
            np.frombuffer(b"".join(self._pairs), "<i2").reshape(-1, 2).T
        )
        seq = int(first[0])
        after = int(first[-1] + count[-1])
        lost = self._lost
        self._clear()
        return [
            packed_block(
                origin,
                seq,
                after,
                len(samples),
                lost,
                PROBE_DTYPE.descr,
                samples.tobytes(),
                run=self.run,
                **self._more,
            )
        ]
