"""Which part of a late tick took so long, from its record and those around it.

A tick is late when it ends after the next deadline. The loop times its parts anyway. What a part
takes beyond its usual time, the median of the last ticks on time, is its share of the lateness. The
part with the greatest share is the cause:

    deadline | wake | read     | step | write    | publish | end      next deadline
               WAKE   transfer   STEP   transfer   PUBLISH

In flight (`link.flight`) `write` hands both transfers to the kernel and waits for neither, so its
share is SUBMISSION. `read` waits for an IN that is late, and the board's clock tells why. The board
latches a sample a fixed time after it got the OUT before. So the time from that OUT (by the host's
clock) to the sample (by the board's) is constant but for the offset of the clocks, which the ticks
before have as well:

    BUS          that time is longer, because the OUT came late to the board; or the OUT before was
                 still under way a period later; or the IN never came
    COMPLETION   that time is as usual: the sample was ready, and the IN ended late

A slow bus holds up OUT and IN, so it is BUS from a quarter of the lateness on the way out. An IN
alone that is slow on the wire counts as COMPLETION: only the kernel could tell the two apart. A
late tick sends its OUT late, so the next ones may wait for their IN: they have its cause.

One after the other, libusb's call hides its parts. A late `write` is COMPLETION if the sample after
it shows its OUT in time at the board. Every other one, and a late `read`, is TRANSFER.

The cause goes into the record of the next tick, after its OUT is sent, for a tick may be late in
what it does after its own record. A tick after one on time pays for one test of an integer.

What would break it: a board that latches by a clock of its own, records that are not in the ring.
"""

import struct
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from hapticd.link.device import SEED, Device
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Flag, LateCause
from hapticd.units import NS_PER_US

LOOKED_AT = 10  # records: the late tick, the one after it, and those before
HELD_UP = 4  # from one such part of its lateness, on the way to the board, a read is late by BUS
LONGEST_NS = (1 << 31) - 1  # that the record can hold
READ, WRITE = (layout.STAGES.index(name) for name in ("read", "write"))
OWN = {  # the other stages
    layout.STAGES.index("wake"): LateCause.WAKE,
    layout.STAGES.index("step"): LateCause.STEP,
    layout.STAGES.index("publish"): LateCause.PUBLISH,
}


class Ticked(NamedTuple):
    """What a record says of the times of its tick."""

    woken_ns: int
    board_us: int  # of its sample
    flags: int
    status: int
    arrival: int
    wake_ns: int
    read_ns: int
    step_ns: int
    write_ns: int
    published_ns: int  # `publish` of the tick before
    lost_slots: int
    late_cause: int  # of the tick before


class Way(NamedTuple):
    """How frames go, and went since the late tick."""

    in_flight: bool
    behind: bool  # an IN came after its tick and was read past


def cause_of(ticks: Sequence[Ticked], period_ns: int, way: Way) -> int:
    """Why the last but one of `ticks` was late (LateCause); at least two, one after the other.

    Any numbers will do: others may have written over the ring.
    """
    *before, parts = (_parts(*pair) for pair in pairwise(ticks))
    on_time = [row for row in before if sum(row) <= period_ns]
    usual = [_median(column) for column in zip(*on_time, strict=True)] or [0] * len(parts)
    shares = [part - normal for part, normal in zip(parts, usual, strict=True)]
    worst = shares.index(max(shares))
    if worst == READ:
        return _late_read(ticks, shares[READ], way)
    if worst == WRITE:
        return _late_write(ticks, shares[WRITE], way)
    return OWN[worst]


def _late_read(ticks: Sequence[Ticked], share_ns: int, way: Way) -> int:
    *before, late, _ = ticks
    held_up_ns = _held_up_ns(ticks[:-1])
    if before and before[-1].flags & Flag.WRITE_FAILED:
        return before[-1].late_cause or LateCause.BUS
    if held_up_ns is not None and HELD_UP * held_up_ns >= share_ns:
        return LateCause.BUS
    if late.late_cause:
        return late.late_cause
    if late.arrival < 0 and not way.behind:
        return LateCause.BUS
    return LateCause.COMPLETION if way.in_flight else LateCause.TRANSFER


def _late_write(ticks: Sequence[Ticked], share_ns: int, way: Way) -> LateCause:
    if way.in_flight:
        return LateCause.SUBMISSION
    held_up_ns = _held_up_ns(ticks)
    in_time = held_up_ns is not None and HELD_UP * held_up_ns < share_ns
    return LateCause.COMPLETION if in_time else LateCause.TRANSFER


def _held_up_ns(ticks: Sequence[Ticked]) -> int | None:
    """How much longer than usual the last but one OUT took to the board; None: not known."""
    *usual, newest = (_latched_ns(*pair) for pair in pairwise(ticks)) if ticks[1:] else (None,)
    known = [one for one in usual if one is not None]
    return newest - _median(known) if known and newest is not None else None


def _parts(tick: Ticked, after: Ticked) -> tuple[int, ...]:
    """How long each of layout.STAGES took."""
    return tick.wake_ns, tick.read_ns, tick.step_ns, tick.write_ns, after.published_ns


def _latched_ns(tick: Ticked, after: Ticked) -> int | None:
    """From the OUT of `tick` to the sample after it, but for the offset of the clocks."""
    if not 0 <= after.arrival < SEED:
        return None
    return after.board_us * NS_PER_US - (tick.woken_ns + tick.read_ns + tick.step_ns)


def _median(values: Sequence[int]) -> int:
    return sorted(values)[len(values) // 2]


def _fields() -> struct.Struct:
    """Of a record what `Ticked` has, the rest skipped."""
    runs = (("time_ns", "qq"), ("flags", "IIi"), ("wake_ns", "5iII"))
    text, end = "<", 0
    for name, codes in runs:
        begin = layout.offset_of(name)
        text += f"{begin - end}x{codes}"
        end = begin + struct.calcsize(f"<{codes}")
    return struct.Struct(text)


_TICKED = _fields()
_NOTED = struct.Struct("<Ii")
_NOTE_OFFSET = layout.offset_of("late_cause")


class LateTicks:
    """The causes of late ticks over `device`, in the ring of their records."""

    def __init__(self, ring: memoryview, period_ns: int, device: Device) -> None:
        self._ring = ring
        self._period_ns = period_ns
        self._device = device
        self._behind = 0
        # of the last tick: kept here while the loop stands still, since an object of more than 30
        # attributes is slow to read in CPython 3.11
        self.publish_ns = 0
        self.late_ns = 0  # from its next deadline to its end; 0: it was on time

    def begin(self) -> None:
        """The tick that has just ended is late."""
        self._behind = self._device.counts["behind"]

    def blame(self, tick: int, late_ns: int) -> None:
        """Write into the record of `tick`, which is not published yet, why the tick before it
        was late, and by how much.
        """
        ring = self._ring
        first = max(0, tick + 1 - LOOKED_AT)
        seen = [
            Ticked._make(_TICKED.unpack_from(ring, _place(one))) for one in range(first, tick + 1)
        ]
        behind = self._device.counts["behind"] > self._behind
        cause = cause_of(seen, self._period_ns, Way(self._device.link.in_flight, behind))
        _NOTED.pack_into(ring, _place(tick) + _NOTE_OFFSET, cause, min(late_ns, LONGEST_NS))


def _place(tick: int) -> int:
    return layout.TELEMETRY_OFFSET + tick % layout.RING_RECORDS * layout.RECORD.size
