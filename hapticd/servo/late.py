"""Which part of a late tick took so long, from its record and those around it.

A tick is late when it ends after the next deadline. The loop times its parts anyway. What a part
takes beyond its usual time, the median of three ticks on time at a tally, is its share of the
lateness. The part with the greatest share is the cause:

    deadline | wake | read     | step | write    | publish | end      next deadline
               WAKE   transfer   STEP   transfer   PUBLISH

In flight (`link.flight`) `write` hands both transfers to the kernel and waits for neither, so its
share is SUBMISSION. `read` waits for an IN that is late, and the board's clock tells why. The board
latches a sample a fixed time after it got the OUT before. So the time from that OUT (by the host's
clock) to the sample (by the board's) is constant but for the offset of the clocks, which the two
ticks before have as well:

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

Little may be done there: cold code takes tens of times longer, and a tick that is held up by the
search for a cause is late as well. So one or two records are read, and five for a transfer.

What would break it: a board that latches by a clock of its own, records that are not in the ring.
"""

import struct
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

from hapticd.link.device import SEED, Device
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Flag, LateCause
from hapticd.units import NS_PER_US

SAMPLES = 3  # of ticks on time
EARLIER = 3  # ticks before the late one, which show what is usual on the way to the board
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


def cause_of(
    late: Ticked,
    after: Ticked,
    usual: Sequence[int],
    way: Way,
    earlier: Callable[[], list[Ticked]],
) -> int:
    """Why the tick `late` was late (LateCause); `after` is the next one, `usual` what parts take.

    `earlier()` gives at most EARLIER ticks before it. Any numbers will do: others may have written
    over the ring.
    """
    shares = [part - normal for part, normal in zip(parts_of(late, after), usual, strict=True)]
    worst = shares.index(max(shares))
    if worst in OWN:
        return OWN[worst]
    ticks = [*earlier(), late, after]
    decide = _late_read if worst == READ else _late_write
    return decide(ticks, shares[worst], way)


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
    return newest - min(known) if known and newest is not None else None


def parts_of(tick: Ticked, after: Ticked) -> tuple[int, ...]:
    """How long each of layout.STAGES took."""
    return tick.wake_ns, tick.read_ns, tick.step_ns, tick.write_ns, after.published_ns


def _latched_ns(tick: Ticked, after: Ticked) -> int | None:
    """From the OUT of `tick` to the sample after it, but for the offset of the clocks."""
    if not 0 <= after.arrival < SEED:
        return None
    return after.board_us * NS_PER_US - (tick.woken_ns + tick.read_ns + tick.step_ns)


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
        self._samples = [(0,) * len(layout.STAGES)] * SAMPLES
        self._usual = self._samples[0]
        # of the last tick: kept here while the loop stands still, since an object of more than 30
        # attributes is slow to read in CPython 3.11
        self.publish_ns = 0
        self.late_ns = 0  # from its next deadline to its end; 0: it was on time

    def learn(self, tick: int) -> None:
        """Take the tick before `tick`, whose record is the newest, as a sample of what is usual."""
        parts = parts_of(self._seen(tick - 1), self._seen(tick))
        if tick and sum(parts) <= self._period_ns:
            self._samples = [*self._samples[1:], parts]
            self._usual = tuple(
                sorted(column)[SAMPLES // 2] for column in zip(*self._samples, strict=True)
            )

    def begin(self) -> None:
        """The tick that has just ended is late."""
        self._behind = self._device.counts["behind"]

    def blame(self, tick: int, late_ns: int) -> None:
        """Write into the record of `tick`, which is not published yet, why the tick before it
        was late, and by how much.
        """
        first = max(0, tick - 1 - EARLIER)
        behind = self._device.counts["behind"] > self._behind
        cause = cause_of(
            self._seen(tick - 1),
            self._seen(tick),
            self._usual,
            Way(self._device.link.in_flight, behind),
            lambda: [self._seen(one) for one in range(first, tick - 1)],
        )
        place = _place(tick) + _NOTE_OFFSET
        _NOTED.pack_into(self._ring, place, cause, min(late_ns, LONGEST_NS))

    def _seen(self, tick: int) -> Ticked:
        return Ticked._make(_TICKED.unpack_from(self._ring, _place(tick)))


def _place(tick: int) -> int:
    return layout.TELEMETRY_OFFSET + tick % layout.RING_RECORDS * layout.RECORD.size
