"""A connected board: its link, session, buffers and pin events, for one exchange per tick.

Exchange (`Device`). `receive` returns the newest IN frame and its arrival:

    0       the next frame, on time
    k > 0   the first frame after k lost samples
    -k      no frame for the k-th tick in a row; the old one is returned
    SEED    the filters must start at this frame

The board's latch time decides, not the sequence number. After a host pause the waiting sample is
one period old and belongs to its own time, and the gap appears in the next one.

A stale frame (a duplicate, or one left behind by a time-out) is skipped, and so is an old one, at
most MOST_READS per tick. The pipeline is one frame deep, so the frame of this tick answers the last
OUT. A frame that echoes an earlier OUT has waited in a queue, and a newer one follows; it has
already arrived, so reading it takes no time. If it has not (that OUT was lost too), the read was in
vain. It is then not repeated for some ticks, and after that it is: otherwise a link that fell
behind during a disturbance would stay behind. A tick with only old frames has no sample. A packet
of zero length, which a USB stack may append to a full one, is not a frame. It is counted, and the
next frame is read in the same tick. No buffer holds `codec.BACKWARD` ticks: if a clock is still
behind after that many, the board has restarted, and the frame seeds.

Each frame contains the OUT whose torque is in effect, and for how long. `send` stores the board
time of the sample behind each OUT, by the low byte of its sequence number. Every frame therefore
gives the delay from a sample to its force, on the board's clock alone; it is negative while
unknown. A frame of another life (the board's firmware restarted) seeds too: no state of the former
life applies.

Almost every frame is the next one, intact. `receive` and `send` handle that case inline and leave
every other to the codec: `in_parser` examines any other frame as a whole. LinkLost is for the loop;
smaller failures are counted and handled here. One task must call it, and buffers must not be
replaced.

Events at the board's pins (`PinEvents`). An event is a sync pulse or a code of a stimulus computer,
an EEG amplifier or an eye tracker. Every frame contains one: its number, its code, and its age at
the latch. The board repeats each in two frames, so a lost frame loses no event. An event counts
once, when its number first appears. A step of more than 1 gives the number of lost events; the
number has 8 bits, so a loss of 256 events is not detected. The event in the first frame of a life
of the board happened before it and is not recorded. A board that returns in the same life continues
its numbers.

The time is that of the change, by the board's clock, like `board_us` of the sample: the two need no
clock of the host. An age at the end of its 16 bits gives no time.
"""

from array import array
from binascii import crc_hqx
from collections.abc import Callable, Sequence
from math import ceil, floor

from hapticd.core.errors import LinkStalled, LinkTimeout
from hapticd.core.units import US_PER_S
from hapticd.usb import codec, frames
from hapticd.usb.codec import (
    BOARD_TIME_BITS,
    HEAD_AXIS,
    HEAD_BOARD_TIME,
    HEAD_CRC,
    HEAD_ECHO,
    HEAD_EVENT_AGE,
    HEAD_EVENT_CODE,
    HEAD_EVENT_SEQ,
    HEAD_LIFE,
    HEAD_PROBE_COUNT,
    HEAD_SEQ,
    HEAD_TORQUE_AGE,
    HEAD_TORQUE_SEQ,
    U16_HIGHEST,
    Link,
)
from hapticd.usb.frames import Capability, HelloFrame, Request

__all__ = ["NO_CODE", "NO_HEAD", "NO_TIME_US", "SEED", "Device", "Head"]

# --- events at the board's pins -------------------------------------------------------------------

NUMBERS = 256
NO_CODE = -1
NO_TIME_US = -1
LOST_MASK = 0xFFFFFFFF  # a count of the record
NO_EVENT = (NO_TIME_US, NO_CODE)


class PinEvents:
    """The events of one board. `seen` is the number of the newest one, `lost` the number of missed
    ones; a board that is not `able` has none.
    """

    __slots__ = ("able", "lost", "seen")

    def __init__(self) -> None:
        self.able = False
        self.seen = 0
        self.lost = 0

    def take(self, head: tuple[int, ...], board_us: int) -> tuple[int, int]:
        """Return time [us] and code of the event of `head`, latched at `board_us`, with a number
        other than `seen`.
        """
        number = head[HEAD_EVENT_SEQ]
        missed = (number - self.seen - 1) % NUMBERS
        self.seen = number
        if not self.able:
            return NO_EVENT
        self.lost = self.lost + missed & LOST_MASK
        age_us = head[HEAD_EVENT_AGE]
        time_us = board_us - age_us if age_us < U16_HIGHEST else NO_TIME_US
        return time_us, head[HEAD_EVENT_CODE]


# --- exchange -------------------------------------------------------------------------------------

# far above any number of lost samples: the link is given up long before
SEED = 1 << 20
# each is a separate transfer within the tick; the deepest known queue holds four frames
MOST_READS = 4
# a search for a newer frame in vain took its time-out; it is not repeated for this long
REST_TICKS = 4
Head = tuple[int, ...]  # fields of frames.IN_SEALED; places: codec.HEAD_SEQ and the others
# arrival, unwrapped board time [us], delay of the force in effect [us] or -1, head
Received = tuple[int, int, int, Head]
# board time of a missing sample: the delay becomes negative
NO_SAMPLE_US = 1 << 62
AGE_HIGHEST_US = codec.U16_HIGHEST  # of a torque; it also represents longer ages
MOST_LAG = codec.SEQ_MASK // 2  # a larger lag means an OUT ahead of this one
NO_HEAD: Head = (0,) * codec.HEAD_FIELDS


class Device:
    """The board as the servo sees it.

    `counts` are frames: missing, bad, empty (packets of zero length), stale, behind (they answer an
    OUT before the last one), gap (IN lost), unseen (OUT the board missed); and lives of the board
    after the first.
    """

    def __init__(self, link: Link, rate_hz: float) -> None:
        self.link = link
        self.period_us = US_PER_S / rate_hz
        # pyusb passes an array('B') to libusb without a copy
        self.in_buffer = array("B", bytes(frames.PACKET_BYTES))
        self.out_buffer = array("B", bytes(frames.OUT_BYTES))
        kinds = (
            "missing",
            "bad",
            "empty",
            "stale",
            "behind",
            "gap",
            "unseen",
            "write_errors",
            "lives",
        )
        self.counts = dict.fromkeys(kinds, 0)
        self.hello: HelloFrame | None = None
        self.events = PinEvents()
        self._phase_us: int | None = None  # as requested; None: the board's default
        self._phase_life = 0  # life of the board at the request
        self._begin, self.receive, self.send, self.rehearse = _exchange(self)

    def connect(self) -> HelloFrame:
        """Open, greet, check the protocol, and send one frame without torque.

        LinkError or ProtocolMismatch.
        """
        self.link.open()
        hello = self.greet()
        self._phase_us = None
        self.begin()
        return hello

    def greet(self) -> HelloFrame:
        """Request the hello of an open board again. LinkError, ProtocolMismatch or FrameError."""
        self.hello = codec.greet(self.link.request(Request.HELLO, frames.HELLO_BYTES))
        self.events.able = bool(self.hello.capabilities & Capability.EVENT)
        return self.hello

    def begin(self) -> None:
        """Send a frame without torque, and restart all counting from it."""
        self.link.drain()
        # samples of an earlier session may wait in the board; a frame without ENABLE also
        # ends a tripped watchdog
        self.send(frames.OutFlag.FIFO_CLEAR, 0, 0, 0)
        # a lost board may count from 0 again, and no sample was behind that frame
        self._begin()

    def set_phase(self, phase_us: float) -> None:
        """Request that the board latches each IN `phase_us` after its OUT; it must have the
        capability.
        """
        self.link.request(Request.SAMPLE_PHASE, value=round(phase_us))
        self._phase_us = round(phase_us)
        self._phase_life = self.counts["lives"]

    def keep_phase(self) -> None:
        """Set the phase again if the board has restarted and lost it. LinkError."""
        if self._phase_us is not None and self._phase_life != self.counts["lives"]:
            self.set_phase(self._phase_us)

    def clear_fault(self) -> None:
        """Request that the board clears latched faults whose cause is gone."""
        self.link.request(Request.CLEAR_FAULT)

    def close(self) -> None:
        """Release the board."""
        self.link.close()


def _exchange(
    device: Device,
) -> tuple[Callable[[], None], Callable[[], Received], Callable[..., bool], Callable[[], Head]]:
    """Return closures over the device's buffers. The state of the exchange is in their cells, which
    are as fast as locals.
    """
    link = device.link
    read = link.read
    write = link.write
    in_buffer = device.in_buffer
    out_buffer = device.out_buffer
    counts = device.counts
    period_us = device.period_us
    parse = codec.in_parser(in_buffer)
    pack = codec.out_packer(out_buffer)
    unpack = frames.IN_SEALED.unpack_from
    fill = frames.OUT_BARE.pack_into
    check = crc_hqx
    initial = frames.CRC_INITIAL
    in_body, out_body = (memoryview(one)[: -frames.CRC.size] for one in (in_buffer, out_buffer))
    # this host is little-endian
    out_seal = memoryview(out_buffer).cast("H")
    seal_place = len(out_body) // frames.CRC.size
    whole = frames.IN_BYTES
    most = frames.PAIR_MAX
    # whole, as board time is
    shortest = ceil(0.5 * period_us)
    longest = floor(1.5 * period_us)
    head = NO_HEAD
    board_us = 0
    # by the low byte of the sequence number of an OUT: board time of the sample behind it
    sampled = [NO_SAMPLE_US] * codec.TORQUE_SEQUENCES
    life = -1
    expected = -1
    sent = 0
    missing = 0
    seeding = True
    resting = 0  # ticks until an old frame causes another read
    scratch = bytearray(frames.OUT_BYTES)
    left = 0  # samples of the OUT frame before

    def begin() -> None:
        nonlocal expected, missing, seeding
        # not a sequence number: the first frame takes the slow path, through `odd`
        expected = -1
        missing = 0
        seeding = True
        sampled[:] = [NO_SAMPLE_US] * codec.TORQUE_SEQUENCES

    def absent(kind: str) -> Received:
        nonlocal missing
        missing += 1
        counts[kind] += 1
        return -missing, board_us, NO_TIME_US, head

    def fetch() -> Head | str:
        """Return one frame, or how it failed; packets of zero length are skipped."""
        try:
            for _ in range(MOST_READS):
                if size := read(in_buffer):
                    break
                counts["empty"] += 1
        except (LinkTimeout, LinkStalled):
            return "missing"
        return (parse() if size == whole else None) or "bad"

    def newest(found: Head) -> Head | str:
        """Return `found`, or the first frame after it that is neither stale nor old, or how that
        failed.
        """
        nonlocal resting
        for _ in range(MOST_READS):
            lag = sent - found[HEAD_ECHO] & codec.SEQ_MASK
            if seeding or found[HEAD_LIFE] != life:
                kind = ""
            elif codec.unwrap(board_us, found[HEAD_BOARD_TIME], BOARD_TIME_BITS) <= board_us:
                kind = "stale"
            else:
                kind = "behind" if 0 < lag <= MOST_LAG else ""
            if not kind:
                resting = 0
                return found
            counts[kind] += 1
            if kind == "behind" and resting:
                resting -= 1
                return "missing"
            again = fetch()
            if isinstance(again, str):
                resting = REST_TICKS
                return again
            found = again
        return "missing"

    def odd(found: Head) -> Received:
        """Handle a frame that is not simply the next one: stale, old, after a gap, or the first."""
        nonlocal head, board_us, expected, missing, seeding, life
        if missing > codec.BACKWARD and found[HEAD_LIFE] == life:
            latched = codec.unwrap(board_us, found[HEAD_BOARD_TIME], BOARD_TIME_BITS)
            if not seeding and latched < board_us:
                begin()
        taken = newest(found)
        if isinstance(taken, str):
            return absent(taken)
        found = taken
        latched = found[HEAD_BOARD_TIME]
        if found[HEAD_LIFE] != life:
            counts["lives"] += life >= 0
            life = found[HEAD_LIFE]
            device.events.seen = found[HEAD_EVENT_SEQ]
            begin()
        if not seeding:
            latched = codec.unwrap(board_us, latched, BOARD_TIME_BITS)
            counts["gap"] += codec.lost_between(head[HEAD_SEQ], found[HEAD_SEQ])
            counts["unseen"] += codec.lost_between(head[HEAD_ECHO], found[HEAD_ECHO])
        lost = SEED if seeding else max(0, round((latched - board_us) / period_us) - 1)
        head = found
        board_us = latched
        expected = (found[HEAD_SEQ] + 1) & codec.SEQ_MASK
        missing = 0
        seeding = False
        return lost, board_us, delay_us(found), head

    def delay_us(found: Head) -> int:
        """Return the delay from a sample to the force in effect when `found` was
        latched, just now.
        """
        age_us = found[HEAD_TORQUE_AGE]
        if age_us == AGE_HIGHEST_US:
            return NO_TIME_US
        return max(NO_TIME_US, board_us - age_us - sampled[found[HEAD_TORQUE_SEQ]])

    def receive() -> Received:
        nonlocal head, board_us, expected, missing
        try:
            size = read(in_buffer)
        except (LinkTimeout, LinkStalled):
            return absent("missing")
        # before the size is checked: the buffer always has 64 bytes
        found = unpack(in_buffer)
        # negative where 32 bits of microseconds wrap, every 71 minutes: `odd` unwraps them
        passed = found[HEAD_BOARD_TIME] - head[HEAD_BOARD_TIME]
        if (
            found[HEAD_SEQ] != expected
            or found[HEAD_ECHO] != sent
            or found[HEAD_LIFE] != life
            or found[HEAD_CRC] != check(in_body, initial)
            or found[HEAD_AXIS]
            or found[HEAD_PROBE_COUNT] > most
            or passed < shortest
            or passed > longest
            or size != whole
        ):
            if not size:
                counts["empty"] += 1
                behind_it = fetch()
                return absent(behind_it) if isinstance(behind_it, str) else odd(behind_it)
            intact = parse() if size == whole else None
            return absent("bad") if intact is None else odd(intact)
        head = found
        missing = 0
        expected = (expected + 1) & 0xFFFF
        board_us = board_us + passed
        # `delay_us` inline; for the loop every negative number means unknown
        delay = board_us - found[HEAD_TORQUE_AGE] - sampled[found[HEAD_TORQUE_SEQ]]
        return 0, board_us, delay, found

    def send(
        flags: int,
        torque: int,
        damping: int,
        resistance: int,
        count: int = 0,
        samples: Sequence[int] = codec.NO_SAMPLES,
    ) -> bool:
        nonlocal sent, left
        sent = (sent + 1) & 0xFFFF
        sampled[sent & 0xFF] = board_us
        # also for the frame after the last samples: it replaces them by zeros
        if count or left:
            pack(sent, flags, torque, damping, resistance, count, samples)
            left = count
        else:
            fill(out_buffer, 0, sent, flags, torque, damping, resistance)
            out_seal[seal_place] = check(out_body, initial)
        try:
            write(out_buffer)
        except (LinkTimeout, LinkStalled):
            counts["write_errors"] += 1
            # not submitted: the newest frame answers the OUT before
            if link.in_flight:
                sent = (sent - 1) & 0xFFFF
            return False
        return True

    def rehearse() -> Head:
        """Do the work of `receive` and `send` between their transfers, without effect, to warm the
        caches. Return the head in the buffer.
        """
        check(in_body, initial)
        fill(scratch, 0, sent, 0, 0, 0, 0)
        check(out_body, initial)
        return unpack(in_buffer)

    return begin, receive, send, rehearse
