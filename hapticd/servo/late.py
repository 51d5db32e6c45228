"""The time of a tick: wait for its deadline, rehearsal before it, and the cause of a late one.

Wait (`spinning_wait`, `virtual_wait`). Live: sleep to `spin` before the deadline, then spin on the
clock. The kernel wakes a sleeper 10-60 us late. The spin makes the tick start within 0.1 us for
10 % of a core at 1 kHz and warms the caches. Deadlines lie half a period off the millisecond, away
from the scheduler's own tick. In virtual time: move the clock.

Rehearsal (`rehearsal`). In a millisecond of sleep the caches go cold, and a tick costs twice as
much as a hot one. A tick on dummy data at the start of the spin warms them. It must have no effect.
The loop must have no closure (a variable that it shares with one costs a tick more than a local).

Cause (`cause_of`). It comes from the record of a tick and those around it. A tick is late when it
ends after the next deadline. The loop times its parts anyway. The share of a part is its time
beyond the usual, which is the median of three ticks on time at a tally. The part with the largest
share is the cause:

    deadline | wake | read     | step | write    | publish | end      next deadline
               WAKE   transfer   STEP   transfer   PUBLISH

In flight (`usb.flight`) `write` hands both transfers to the kernel and waits for neither, so its
share is SUBMISSION. `read` waits for a late IN, and the board's clock shows the reason. The board
latches a sample a fixed time after it got the previous OUT. So the time from that OUT (by the
host's clock) to the sample (by the board's) is constant, up to the offset of the clocks. The two
ticks before have the same offset:

    BUS          that time is longer, because the OUT reached the board late; or the previous OUT
                 was still in transit a period later; or no IN arrived within the time-out
    COMPLETION   that time is as usual: the sample was ready, and the IN ended late

A slow bus delays OUT and IN, so the cause is BUS from a quarter of the lateness on the way out. An
IN alone that is slow on the wire counts as COMPLETION: only the kernel could tell the two apart. A
late tick sends its OUT late, so the next ones may wait for their IN: they have its cause. One after
the other, libusb's call hides its parts, and everything but BUS is TRANSFER. The sample of the next
tick shows when the OUT of the late tick reached the board, but does not separate submission from
bus. No sample shows when an IN was fetched.

The cause is computed after the end of the tick and before its lost slots are counted. The next tick
is therefore not delayed: cold code takes tens of times longer. The cause goes into the record of
the next tick, because the tick's own record is already published. A tick on time only writes two
integers of its record.

Limitations: a board that latches by its own clock, records that are not in the ring.
"""

import os
import struct
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US
from hapticd.mailbox import layout
from hapticd.mailbox.daemons import READ_BYTES
from hapticd.mailbox.layout import Flag, LateCause
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.servo.plan import SETTLED, ServoState
from hapticd.servo.step import Step
from hapticd.usb.codec import HEAD_ENCODER, HEAD_STATUS, HEAD_TEMPERATURE
from hapticd.usb.device import SEED, Device

__all__ = ["Wait", "first_deadline", "spinning_wait"]

# --- wait -----------------------------------------------------------------------------------------

Wait = Callable[[int, Callable[[], object]], int]
REHEARSAL_NS = 30_000  # room that a rehearsal needs before the deadline


def spinning_wait(spin_ns: int, period_ns: int) -> Wait:
    """Return `wait(deadline_ns, rehearse)` -> monotonic ns at or after the deadline. The spin takes
    at most 0.4 periods: the core needs idle time.
    """
    margin_ns = min(spin_ns, int(0.4 * period_ns))
    clock = time.monotonic_ns
    sleep = time.sleep
    per_ns = 1.0 / NS_PER_S

    def wait(deadline_ns: int, rehearse: Callable[[], object]) -> int:
        ahead = deadline_ns - margin_ns - clock()
        if ahead > 0:
            sleep(ahead * per_ns)
        if deadline_ns - clock() > REHEARSAL_NS:
            rehearse()
        now = clock()
        while now < deadline_ns:
            now = clock()
        return now

    return wait


def first_deadline(now_ns: int, period_ns: int) -> int:
    """Return a deadline a few periods ahead, half a period off the millisecond."""
    return (now_ns // NS_PER_MS + 3) * NS_PER_MS + period_ns // 2


# --- rehearsal ------------------------------------------------------------------------------------

_BLANK = [one.unpack(bytes(one.size)) for one in (layout.STEPPED, layout.MEASURED)]


def rehearsal(
    device: Device,
    step: Step,
    mailbox: ServoMailbox,
    now: Callable[[], tuple[ServoState, int, int]],
) -> Callable[[], None]:
    """Return the function that the loop calls while it waits. `now` returns state, tick and slot of
    the next tick.
    """
    words = mailbox.words
    stop_word = mailbox.stop_word.descriptor
    pack_stepped = layout.STEPPED.pack_into
    pack_measured = layout.MEASURED.pack_into
    behind = layout.STEPPED.size
    stepped, measured = _BLANK
    ring = mailbox.ring
    in_bytes = device.in_buffer.tobytes
    size = layout.RECORD.size
    places = layout.RING_RECORDS

    def rehearse() -> None:
        head = device.rehearse()
        sample = (head[HEAD_ENCODER], head[HEAD_STATUS], head[HEAD_TEMPERATURE])
        state, tick, slot = now()
        settled = state[SETTLED]
        # not the slow path: with cold caches it takes longer than the spin
        if slot < settled.wake_tick:
            step(state, (), (*sample, 0, settled.host, 0, 0.0, 0, 0), slot)
        _ = (
            os.pread(stop_word, READ_BYTES, 0),
            words[layout.COMMAND_HEAD_WORD],
            words[layout.GATEWAY_BEAT_WORD],
            in_bytes(),
        )
        # the oldest record, which the tick replaces anyway
        place = layout.TELEMETRY_OFFSET + tick % places * size
        pack_stepped(ring, place, *stepped)
        pack_measured(ring, place + behind, *measured)

    return rehearse


# --- cause of a late tick -------------------------------------------------------------------------

SAMPLES = 3  # of ticks on time
EARLIER = 3  # ticks before the late one, which show the usual time on the way to the board
HELD_UP = 4  # a read is late by BUS from 1/HELD_UP of its lateness on the way to the board
READ, WRITE = (layout.STAGES.index(name) for name in ("read", "write"))
OWN = {  # the other stages
    layout.STAGES.index("wake"): LateCause.WAKE,
    layout.STAGES.index("step"): LateCause.STEP,
    layout.STAGES.index("publish"): LateCause.PUBLISH,
}


class Ticked(NamedTuple):
    """The times of a tick in its record."""

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


# for the next record: LateCause, and how long after its next deadline the tick ended [ns]
LateTick = tuple[int, int]
ON_TIME: LateTick = (LateCause.NONE, 0)


def cause_of(
    parts: Sequence[int], usual: Sequence[int], in_flight: bool, ticks: Callable[[], list[Ticked]]
) -> int:
    """Return why a tick was late (LateCause) that took `parts`, compared with `usual`
    (layout.STAGES).

    `ticks()` returns at most EARLIER ticks before it, and the tick itself. Any numbers are valid:
    the ring may have been overwritten.
    """
    shares = [part - normal for part, normal in zip(parts, usual, strict=True)]
    worst = shares.index(max(shares))
    if worst == READ:
        return _late_read(ticks(), shares[READ], in_flight)
    if worst == WRITE:
        return LateCause.SUBMISSION if in_flight else LateCause.TRANSFER
    return OWN[worst]


def _late_read(ticks: Sequence[Ticked], share_ns: int, in_flight: bool) -> int:
    *before, late = ticks
    if before and before[-1].flags & Flag.WRITE_FAILED:
        return before[-1].late_cause or LateCause.BUS
    held_up_ns = _held_up_ns(ticks)
    if held_up_ns is not None and HELD_UP * held_up_ns >= share_ns:
        return LateCause.BUS
    if late.late_cause:
        return late.late_cause
    if late.arrival < 0:
        return LateCause.BUS
    return LateCause.COMPLETION if in_flight else LateCause.TRANSFER


def _held_up_ns(ticks: Sequence[Ticked]) -> int | None:
    """Return the additional delay of the last but one OUT on its way to the board; None:
    not known.
    """
    *usual, newest = (_latched_ns(*pair) for pair in pairwise(ticks)) if ticks[1:] else (None,)
    known = [one for one in usual if one is not None]
    return newest - min(known) if known and newest is not None else None


def _parts(tick: Ticked, publish_ns: int) -> tuple[int, ...]:
    return tick.wake_ns, tick.read_ns, tick.step_ns, tick.write_ns, publish_ns


def _latched_ns(tick: Ticked, after: Ticked) -> int | None:
    """Return the time from the OUT of `tick` to the sample after it, up to the offset of the
    clocks.
    """
    if not 0 <= after.arrival < SEED:
        return None
    return after.board_us * NS_PER_US - (tick.woken_ns + tick.read_ns + tick.step_ns)


def _fields() -> struct.Struct:
    """Return the layout of the fields in `Ticked`, with the rest of a record skipped."""
    runs = (("time_ns", "qq"), ("flags", "IIi"), ("wake_ns", "5iII"))
    text, end = "<", 0
    for name, codes in runs:
        begin = layout.offset_of(name)
        text += f"{begin - end}x{codes}"
        end = begin + struct.calcsize(f"<{codes}")
    return struct.Struct(text)


_TICKED = _fields()


class LateTicks:
    """Find the causes of late ticks over `device`, in the ring of their records."""

    def __init__(self, ring: memoryview, period_ns: int, device: Device) -> None:
        self._ring = ring
        self._period_ns = period_ns
        self._device = device
        self._samples = [(0,) * len(layout.STAGES)] * SAMPLES
        self._usual = self._samples[0]
        # of the last tick, kept here between runs of the loop: an object with more than 30
        # attributes is slow to read in CPython 3.11
        self.publish_ns = 0
        self.told = ON_TIME

    def learn(self, tick: int) -> None:
        """Take the tick before `tick`, whose record is the newest, as a sample of usual
        durations.
        """
        parts = _parts(self._seen(tick - 1), self._seen(tick).published_ns)
        if tick and sum(parts) <= self._period_ns:
            self._samples = [*self._samples[1:], parts]
            self._usual = tuple(
                sorted(column)[SAMPLES // 2] for column in zip(*self._samples, strict=True)
            )

    def cause(self, tick: int, publish_ns: int) -> int:
        """Return why `tick`, whose record is the newest, was late."""
        return cause_of(
            _parts(self._seen(tick), publish_ns),
            self._usual,
            self._device.link.in_flight,
            lambda: [self._seen(one) for one in range(max(0, tick - EARLIER), tick + 1)],
        )

    def _seen(self, tick: int) -> Ticked:
        return Ticked._make(_TICKED.unpack_from(self._ring, _place(tick)))


def _place(tick: int) -> int:
    return layout.TELEMETRY_OFFSET + tick % layout.RING_RECORDS * layout.RECORD.size
