"""A hostile bench for two boards: it applies the same actions to both and compares all their
observable outputs.

The actions are read from bytes of any source (a seed, hypothesis). A byte of 0 is a valid frame of
a host. Others are frames that are damaged, cut, forged with a valid CRC, out of order, early, in
bursts, repeated or unread. There is silence up to the end of the released damping. The emergency
stop, board faults, codes at the event pins, requests of endpoint 0 and restarts of the firmware
come at any instant.

All actions are at whole microseconds: on every sub-step of T/16 at 250, 1250, 2500 and 12500 Hz (5
us), on every second one at 1 kHz.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK
from hapticd.sim.board import BoardModel, compensates
from hapticd.usb import codec, frames
from hapticd.usb.frames import OutFlag, OutFrame, Request, StatusBit
from support.boards import board_params

VENDOR_IN = 0xC0
VENDOR_OUT = 0x40
RATES_HZ = (1000.0, 250.0, 1250.0, 2500.0, 12500.0)
WATCHDOGS_MS = (20.0, 1.0, 5.0, 250.0)
LACKS: tuple[tuple[str, ...], ...] = (
    (),
    ("probe",),
    ("temperature",),
    ("sample_phase",),
    ("event",),
)
LONGEST_NS = 20 * NS_PER_MS  # that a simulated board plays at once
FAULTS = (
    StatusBit.AMPLIFIER_FAULT,
    StatusBit.ENCODER_FAULT,
    StatusBit.OVER_TEMPERATURE,
    StatusBit.AMPLIFIER_FAULT | StatusBit.OVER_TEMPERATURE,
)
GOOD_FLAGS = int(OutFlag.ENABLE | OutFlag.PERTURB)
# damage to a sealed frame: place and value of a byte that is changed before the CRC is computed
FORGED = ((2, 1), (3, 0x08), (3, 0x80), (10, 7), (10, 255), (11, 1), (24, 1), (29, 128))


class Bytes:
    """Numbers from bytes; 0 once they are used up."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def __bool__(self) -> bool:
        return self._at < len(self._data)

    def take(self, count: int = 1) -> int:
        """The next `count` bytes as one number."""
        piece = self._data[self._at : self._at + count]
        self._at += count
        return int.from_bytes(piece, "little")

    def signed(self) -> int:
        """A number of 16 bits; one in four at an end of its range."""
        value = self.take(2)
        ends = (-32768, 32767, 0, value - 32768)
        return ends[value >> 2 & 3] if not value & 3 else value - 32768 if value else 0


class Seen(NamedTuple):
    """The outputs of a board after a step."""

    packet: bytes | None
    next_in_ns: int | None
    force_n: float
    torque_n: float
    damping_n: float
    resistance: int
    refused: int
    slip_ns: int  # effect of a pause on the simulation
    replies: tuple[bytes | None, ...]


class Tally:
    """Counts of events."""

    def __init__(self) -> None:
        self.frames = 0
        self.refused = 0
        self.statuses = 0  # union of the status bits of all IN frames
        self.packets = 0


def bench_params(data: Bytes) -> BoardParams:
    """Return a board with some properties read from the bytes."""
    return board_params(
        rate_hz=RATES_HZ[data.take() % len(RATES_HZ)],
        watchdog_ms=WATCHDOGS_MS[data.take() % len(WATCHDOGS_MS)],
        lacks=LACKS[data.take() % len(LACKS)],
        force_limit_n=8.0 if data.take() % 2 == 0 else 1.7,
        board_time_us=0 if data.take() % 2 == 0 else 2**32 - 5000,
    )


class Bench:
    """Two boards of the same parameters, and a host that applies `data` to both."""

    def __init__(
        self,
        data: bytes,
        other: Callable[[BoardParams], Any],
        tally: Tally,
        params: BoardParams | None = None,
    ) -> None:
        self.data = Bytes(data)
        self.params = params or bench_params(self.data)
        self.boards = (BoardModel(self.params), other(self.params))
        self.tally = tally
        substeps = 2 if self.params.rate_hz == 1000.0 else 1
        self.grid_ns = round(substeps * NS_PER_S / (SUBSTEPS_PER_TICK * self.params.rate_hz))
        self.period_ns = round(NS_PER_S / self.params.rate_hz)
        self.t_ns = 10 * NS_PER_MS
        self.seq = 0
        self.replies: tuple[list[bytes | None], list[bytes | None]] = ([], [])

    def run(self) -> None:
        """Do everything; AssertionError where the boards differ."""
        while self.data:
            kind = self.data.take()
            self.step(kind)
            self.compare(kind)

    def step(self, kind: int) -> None:
        """Do one action of the table below."""
        if kind < 160:
            self.pass_time(kind)
            self.send(self.frame())
        elif kind < 200:
            self.pass_time(kind)
            self.send(self.damaged())
        elif kind < 210:
            self.pass_time(kind)
        elif kind < 215:
            code = self.data.take() % 4
            self.each(lambda board: board.set_event_code(self.t_ns, code))
        elif kind < 217:
            self.fall_silent()
        elif kind < 228:
            self.each(lambda board: board.press_stop(self.t_ns, bool(kind & 1)))
        elif kind < 236:
            fault = FAULTS[kind % len(FAULTS)].value
            self.settle()
            self.each(lambda board: board.trip(fault))
        elif kind < 244:
            fault = FAULTS[kind % len(FAULTS)].value
            self.each(lambda board: board.heal(fault))
        elif kind < 254:
            self.request(kind)
        else:
            time_us = self.data.take(4)
            self.each(lambda board: board.restart(self.t_ns, time_us))

    def each(self, act: Callable[[Any], Any]) -> None:
        for board in self.boards:
            act(board)

    def settle(self) -> None:
        """Both boards are at this very instant: a fault strikes where its board is."""
        self.each(lambda board: board._advance(self.t_ns))

    def pass_time(self, kind: int) -> None:
        """Advance by a period in most cases, else by zero or any time up to the longest."""
        choice = kind % 8
        steps = self.data.take(2) if choice >= 6 else 0
        wait_ns = self.period_ns if choice < 6 else steps % 64 * self.grid_ns
        if choice == 7 and steps & 1:
            wait_ns = steps * self.grid_ns
        self.t_ns += min(wait_ns, LONGEST_NS // self.grid_ns * self.grid_ns)

    def fall_silent(self) -> None:
        """Send nothing for up to 3 s, but read the board."""
        for _ in range(self.data.take() % 150):
            self.t_ns += LONGEST_NS // self.grid_ns * self.grid_ns
            self.settle()
            self.each(lambda board: board.poll_in(self.t_ns))

    def frame(self) -> bytes:
        """A frame of the protocol; its sequence jumps now and then."""
        data = self.data
        flags = data.take()
        flags = GOOD_FLAGS if flags < 200 else flags & 7
        step = data.take()
        self.seq = self.seq + (1 if step < 240 else step) & 0xFFFF
        samples = tuple(data.signed() for _ in range(data.take() % 7))
        return codec.encode_out(
            OutFrame(self.seq, 0, flags, data.signed(), data.take(2), data.signed(), samples)
        )

    def damaged(self) -> bytes:
        """A frame that is cut, longer, flipped in a bit, or wrong under a CRC that fits."""
        frame = bytearray(self.frame())
        way = self.data.take()
        detail = self.data.take()
        if way < 64:
            return bytes(frame[: detail % len(frame)])
        if way < 96:
            return bytes(frame) + bytes(1 + detail % 33)
        if way < 176:
            frame[detail % len(frame)] ^= 1 << way % 8
            return bytes(frame)
        at, value = FORGED[detail % len(FORGED)]
        frame[at] = value
        body = bytes(frame[: -frames.CRC.size])
        return body + frames.CRC.pack(codec.crc16(body))

    def send(self, packet: bytes) -> None:
        self.tally.frames += 1
        self.each(lambda board: board.on_out(memoryview(packet), self.t_ns))

    def request(self, kind: int) -> None:
        """Send a request of endpoint 0: clear, hello, phase, or an unknown one."""
        value = self.data.take(2)
        phase_us = value % 20 * self.grid_ns // 1000
        asked = (
            (VENDOR_OUT, Request.CLEAR_FAULT.value, 0, 0),
            (VENDOR_OUT, Request.CLEAR_FAULT.value, value % 2, 0),
            (VENDOR_IN, Request.HELLO.value, 0, value % 100),
            (VENDOR_OUT, Request.SAMPLE_PHASE.value, phase_us, 0),
            (value & 0xFF, value >> 8, value % 3, 80),
        )[kind % 5]
        for board, replies in zip(self.boards, self.replies, strict=True):
            replies.append(board.control(*asked))

    def compare(self, kind: int) -> None:
        """Read both boards, unless the bytes skip this frame, and compare them."""
        read = self.data.take() < 230
        python, firmware = (self.look(place, read) for place in range(2))
        assert python == firmware, f"step {kind} at {self.t_ns} ns, {self.params.rate_hz:g} Hz"
        if python.packet is not None:
            self.tally.packets += 1
            self.tally.statuses |= codec.decode_in(python.packet).status

    def look(self, place: int, read: bool) -> Seen:
        board = self.boards[place]
        packet = board.poll_in(self.t_ns) if read else None
        axis = board._axis
        connected = compensates(self.params)
        resistance = axis.out.resistance if place else axis.resistance_count * connected
        return Seen(
            packet,
            board.next_in_ns(),
            axis.force_n,
            axis.torque_n if place else axis.probe.torque_n,
            axis.damping_n,
            resistance,
            board.out_refused,
            board.sim_slip_ns,
            tuple(self.replies[place]),
        )


def compare_boards(
    data: bytes,
    other: Callable[[BoardParams], Any],
    tally: Tally,
    params: BoardParams | None = None,
) -> None:
    """Run a bench over `data`. AssertionError if the board of `other` differs from the simulated
    one. Without `params` the bytes select the board too.
    """
    bench = Bench(data, other, tally, params)
    bench.run()
    tally.refused += bench.boards[0].out_refused
