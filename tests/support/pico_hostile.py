"""The hostile bench of `support.hostile` for the image in the emulator, compared with the compiled
reference firmware on the PC: the same input gives the same output.

The host acts every 250 us, and frames are latched halfway. Work that takes 50 us on the chip and no
time on the PC therefore never changes an order. Times and encoder values may differ: the age of a
torque by the time from an OUT to its DAC.
"""

from hapticd.core.units import NS_PER_MS
from hapticd.sim.board import VENDOR_OUT
from hapticd.usb import codec
from hapticd.usb.frames import Request, StatusBit
from support.firmware_board import FirmwareBoard
from support.hostile import VENDOR_IN, Bench, Bytes, Tally
from support.pico_board import INTERVAL_NS, PicoBoard
from support.pico_firmware import pico_params

AGE_US = 50
SAME = ("seq", "echo", "axis", "status", "fifo_level", "damping_effect", "torque_seq")
HALVES_US = (125, 375, 625, 875)  # phases
# unread pairs are lost, on the chip since before the host connected
UNTOLD = StatusBit.PROBE_OVERFLOW
DAC_N = 8.0 / 32767  # a step
WATCHDOG_MS = 250.0
LONGEST = 40  # intervals


class PicoBench(Bench):
    """The compiled reference firmware and the image, and a host that applies `data` to both."""

    def __init__(self, data: bytes, tally: Tally) -> None:
        self.data = Bytes(data)
        # heavy, so that random torques stay within the speed of the decoder
        self.params = pico_params(watchdog_ms=WATCHDOG_MS, mass_kg=10.0)
        self.pico = PicoBoard(self.params)
        self.boards = (FirmwareBoard(self.params), self.pico)
        self.tally = tally
        self.period_ns = NS_PER_MS
        self.t_ns = 10 * NS_PER_MS
        self.seq = 0
        self.replies = ([], [])
        self._fed_ns = 0
        self.latest_age_us = 0

    def step(self, kind: int) -> None:
        if kind < 200:
            self.pass_time(kind)
            self.send(self.frame() if kind < 160 else self.damaged())
        elif kind < 215:
            self.pass_time(kind)
        elif kind < 216:
            self.fall_silent()
        elif kind < 240:
            self.pass_time(kind)
            self.each(lambda board: board.press_stop(self.t_ns, bool(kind & 1)))
        else:
            self.pass_time(kind)
            self.request(kind)

    def pass_time(self, kind: int) -> None:
        """Advance by a period in most cases, else by some intervals, never until the watchdog
        trips.
        """
        steps = 4 if kind % 8 < 6 else 1 + self.data.take(2) % LONGEST
        self.t_ns += steps * INTERVAL_NS
        if self.t_ns - self._fed_ns == WATCHDOG_MS * NS_PER_MS:
            self.t_ns += INTERVAL_NS

    def send(self, packet: bytes) -> None:
        self._fed_ns = self.t_ns
        super().send(packet)
        assert self.pico.late_ns == 0.0

    def fall_silent(self) -> None:
        """Send nothing, sometimes for up to 3 s, but read the boards."""
        length = self.data.take()
        self.t_ns += INTERVAL_NS
        self.settle()
        for _ in range(length % 8 if length & 1 else 14 + length % 136):
            self.t_ns += 20 * NS_PER_MS
            self.settle()
            self.each(lambda board: board.poll_in(self.t_ns))

    def request(self, kind: int) -> None:
        value = self.data.take(2)
        asked = (
            (VENDOR_OUT, Request.CLEAR_FAULT.value, 0, 0),
            (VENDOR_OUT, Request.CLEAR_FAULT.value, value % 2, 0),
            (VENDOR_OUT, Request.SAMPLE_PHASE.value, HALVES_US[value % 4], 0),
            (VENDOR_IN, 0x70 | value & 7, value % 3, 80),
        )[kind % 4]
        for board, replies in zip(self.boards, self.replies, strict=True):
            replies.append(board.control(*asked))
        self.t_ns += INTERVAL_NS

    def compare(self, kind: int) -> None:
        """Read both boards, unless the bytes skip this frame, and compare them."""
        where = f"step {kind} at {self.t_ns} ns"
        reference, pico = self.boards
        assert self.replies[0] == self.replies[1], where
        if self.data.take() < 230:
            self._compare_frames(where)
        forces_n = (reference.force_n, pico.force_n)
        assert abs(forces_n[0] - forces_n[1]) <= DAC_N, f"{where}: {forces_n} N"
        release = self.params.active_damping_ns_per_m_per_count * 65535 / 2000
        levels = (reference.damping_n, pico.damping_n)
        assert abs(levels[0] - levels[1]) <= release, f"{where}: {levels} N s/m"

    def _compare_frames(self, where: str) -> None:
        one, other = (board.poll_in(self.t_ns) for board in self.boards)
        assert (one is None) == (other is None), where
        if one is None or other is None:
            return
        frame, seen = codec.decode_in(one), codec.decode_in(other)
        self.tally.packets += 1
        self.tally.statuses |= seen.status
        frame, seen = (one._replace(status=one.status & ~UNTOLD) for one in (frame, seen))
        differ = [name for name in SAME if getattr(frame, name) != getattr(seen, name)]
        assert not differ, f"{where}: {differ} of {frame}, {seen}"
        assert abs(frame.torque_age_us - seen.torque_age_us) <= AGE_US, where
