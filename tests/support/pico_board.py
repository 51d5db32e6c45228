"""The emulated board in place of the simulated one: the methods of `sim.board.BoardModel` that a
host's end of the wire can have. Tests of the reference firmware on the PC can then run on the
image.

Packets are transactions of the emulated bus. The chip processes an OUT of time t about 50 us later,
and likewise a read at t. No event is due in between if a host acts every 250 us and frames are
latched halfway.
"""

import errno
import struct
import weakref
from collections.abc import Callable
from math import ceil

from hapticd.core.units import NS_PER_MS, NS_PER_US
from hapticd.model.params import BoardParams
from hapticd.sim.board import ADVANCE_MAX_NS
from hapticd.usb import codec
from hapticd.usb.frames import CRC, PACKET_BYTES, OutFrame, StatusBit
from support.pico_chip import Verb
from support.pico_firmware import Change, Defines, image, start_chip
from support.pico_plant import INSTRUCTION_NS, Rig

OUT, IN = 0x01, 0x81
SET_CONFIGURATION = bytes((0, 9, 1, 0, 0, 0, 0, 0))
INTERVAL_NS = 250 * NS_PER_US
OBEYED_NS = 60 * NS_PER_US  # after its time the torque of an OUT acts
HANDLED_NS = 75 * NS_PER_US  # after its time an OUT has been worked on
READ_NS = 90 * NS_PER_US  # delay after its time until the chip is read
TAKEN_NS = 100 * NS_PER_US  # for an IN transaction, behind a SOF too
PHASE_US = 875
WORK_NS = 8 * NS_PER_US  # from the end of an OUT to the clock's reading
INTO_INTERVAL_NS = 17 * NS_PER_US  # where an OUT begins, so that it is worked on after the interval
SETTLE_NS = 5 * NS_PER_MS
# the firmware of a board that reports SIMULATED, as tests expect
SIMULATED: Change = (
    "port.c",
    "HAPTICD_CAPABILITY_SAMPLE_PHASE)",
    "HAPTICD_CAPABILITY_SAMPLE_PHASE | HAPTICD_CAPABILITY_SIMULATED)",
)


STATUS = struct.Struct("<H")
STATUS_AT = 6  # of an IN frame


def told_nothing_of_pairs(packet: bytes) -> bytes:
    """Return an IN frame without PROBE_OVERFLOW: the chip drops pairs before the host connects."""
    body = bytearray(packet[: -CRC.size])
    (status,) = STATUS.unpack_from(body, STATUS_AT)
    STATUS.pack_into(body, STATUS_AT, status & ~StatusBit.PROBE_OVERFLOW)
    return bytes(body) + CRC.pack(codec.crc16(bytes(body)))


def defines_of(params: BoardParams) -> Defines:
    """The macros of config.h by which the firmware is the board of `params`."""
    return (
        ("FORCE_LIMIT_N", f"{params.force_limit_n!r}f"),
        ("WATCHDOG_MS", str(round(params.watchdog_ms))),
    )


class PicoBoard:
    """The board of `params`, run by the image in the emulator."""

    patience_ns = TAKEN_NS
    read_ns = READ_NS

    def __init__(self, params: BoardParams, _on_slip: Callable[[int], None] | None = None) -> None:
        self.params = params
        self.sim_slip_ns = 0
        self.late_ns = 0.0  # by which the last OUT came late, since a transfer took longer
        self.chip = start_chip(image(defines_of(params), (SIMULATED,)))
        weakref.finalize(self, self.chip.close)
        self.rig = Rig(self.chip, params)
        self._enumerate()
        self._calibrate()
        self.power_up()

    @property
    def _axis(self) -> "PicoBoard":
        """Where tests read `force_n` and `damping_n` of a BoardModel."""
        return self

    def _enumerate(self) -> None:
        assert self.rig.plug(), self.chip.complaints()
        assert self.rig.control(SET_CONFIGURATION).status == 0
        self.rig.advance(self.rig.now_ns + SETTLE_NS)

    def _calibrate(self) -> None:
        """When, after its supply came, the board's clock begins: its intervals begin then too."""
        self.rig.wait(self.chip.submit(OUT, 0, bytes(codec.encode_out(OutFrame(0)))), NS_PER_MS)
        acknowledged_ns = self.rig.now_ns
        packet = self.rig.wait(self.chip.submit(IN, PACKET_BYTES), 2 * NS_PER_MS).data
        out_us = codec.decode_in(packet).board_time_us - PHASE_US
        self._boot_ns = acknowledged_ns + WORK_NS - out_us * NS_PER_US

    def power_up(self) -> None:
        self.rig.power_cycle()
        begun_ns = self.rig.now_ns
        self._enumerate()
        intervals = (self.rig.now_ns - begun_ns - self._boot_ns) // INTERVAL_NS + 2
        self._base_ns = begun_ns + self._boot_ns + intervals * INTERVAL_NS + INTO_INTERVAL_NS
        self._origin_ns: int | None = None
        self._due_ns: list[int] = []  # latch times of the requested frames

    def _begin(self, t_ns: int) -> None:
        """The first OUT; a host that has read before it comes some intervals later."""
        behind_ns = max(0.0, self.rig.now_ns - self._base_ns)
        self._base_ns += ceil(behind_ns / INTERVAL_NS) * INTERVAL_NS
        self._origin_ns = t_ns

    # --- the methods of BoardModel ----------------------------------------------------------------
    def _chip_ns(self, t_ns: int) -> float:
        return self._base_ns + t_ns - (self._origin_ns or 0)

    def _advance(self, t_ns: int) -> None:
        if self._origin_ns is None:
            return
        now_ns = self.rig.now_ns
        self.rig.advance(min(self._chip_ns(t_ns), now_ns + ADVANCE_MAX_NS))

    def advance(self, t_ns: int) -> None:
        self._advance(t_ns)

    def on_out(self, data: memoryview, t_ns: int) -> None:
        if self._origin_ns is None:
            self._begin(t_ns)
        self._advance(t_ns)
        late_ns = self.rig.now_ns - self._chip_ns(t_ns)
        # an instruction that was begun before its time ends after it
        self.late_ns = late_ns if late_ns > INSTRUCTION_NS else 0.0
        self._base_ns += self.late_ns  # delay all later times by this
        result = self.rig.wait(self.chip.submit(OUT, 0, bytes(data)), NS_PER_MS)
        assert result.status == 0
        self._due_ns.append(t_ns + PHASE_US * NS_PER_US)
        self.rig.advance(self._chip_ns(t_ns) + HANDLED_NS)

    def poll_in(self, t_ns: int) -> bytes | None:
        self._due_ns = [due_ns for due_ns in self._due_ns if due_ns > t_ns]
        self._advance(t_ns + self.read_ns)
        result = self.rig.wait(self.chip.submit(IN, PACKET_BYTES), self.patience_ns)
        return None if result.status == -errno.ETIMEDOUT else result.data

    def next_in_ns(self) -> int | None:
        """Return when the next frame is latched, unless its OUT was refused."""
        return self._due_ns[0] if self._due_ns else None

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        setup = struct.pack("<BBHHH", request_type, request, value, 0, length)
        result = self.rig.control(setup, length)
        return None if result.status else result.data

    def press_stop(self, t_ns: int, pressed: bool) -> None:
        self._advance(t_ns + OBEYED_NS)
        for pin in ("stop", "ready"):  # its contact cuts the amplifier as well
            self.chip.drive(pin, 0 if pressed else 1)
        self.rig.advance(self.rig.now_ns + WORK_NS)

    def hang(self) -> None:
        """The processor stops for ever."""
        self.chip.tell(Verb.HANG)

    @property
    def force_n(self) -> float:
        """The present command to the motor."""
        state = self.chip.state
        return state.torque * self.params.force_n_per_count if state.amplifier else 0.0

    @property
    def damping_n(self) -> float:
        """The active damping at this moment, N s/m."""
        return self.chip.state.damping * self.params.active_damping_ns_per_m_per_count

    @property
    def state(self) -> tuple[float, ...]:
        """Of the plant."""
        return self.rig.state
