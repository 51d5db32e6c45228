"""The minimal path of a tick: pyusb on the simulated bus, an empty board, the simple tick, the
wire's CRCs.

Left out are the product's own parts: the board's firmware and plant, the sequence, the commands,
the safety table, the mailbox.
"""

import time
from array import array
from dataclasses import replace

from benchmarks.tick_reference import ReferenceTick
from hapticd.core.params import UsbParams
from hapticd.core.units import Clock, VirtualClock
from hapticd.model.params import BoardParams
from hapticd.sim.backend import SimulatedBackend
from hapticd.sim.board import control_replies
from hapticd.usb import codec, frames
from hapticd.usb.frames import InFrame
from hapticd.usb.link import UsbLink

QUIET = InFrame(0, 1, 0, int(frames.StatusBit.SIMULATED), 0, 0, 0, 0, 0, 2200, 0, 1, 0, 0)


class EmptyBoard:
    """A port that answers every OUT with the same IN at once."""

    def __init__(self, params: BoardParams) -> None:
        self._replies, self._frame = control_replies(params), codec.encode_in(QUIET)

    def power_up(self) -> None:
        """Do nothing."""

    def on_out(self, data: memoryview, t_ns: int) -> None:
        """Ignore the packet."""

    def poll_in(self, t_ns: int) -> bytes | None:
        """Return the same frame."""
        return self._frame

    def next_in_ns(self) -> int | None:
        """Return None: there is no wait."""
        return None

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        """Answer as the simulated board."""
        reply = self._replies.get((request_type, request, value))
        return None if reply is None else reply[:length]


class PyusbLink(UsbLink):
    """Frames by pyusb's own `read` and `write`."""

    def open(self) -> None:
        super().open()
        self._read, self._write = self._device.read, self._device.write


def empty_link(usb: UsbParams, board: BoardParams, clock: Clock) -> UsbLink:
    """Return an open link to an empty board, with pyusb's own transfers: the yardstick."""
    usb = replace(usb, in_flight=False)
    link = PyusbLink(usb, SimulatedBackend(EmptyBoard(board), clock))
    link.open()
    return link


class BareLoop:
    """Wire, pyusb, empty board and minimal tick, repeatedly."""

    def __init__(self, usb: UsbParams, board: BoardParams, tick: ReferenceTick) -> None:
        self._link = empty_link(usb, board, VirtualClock())
        self._tick = tick

    def cpu_s(self, ticks: int) -> float:
        """Return the CPU time of `ticks` ticks."""
        inward = array("B", bytes(frames.PACKET_BYTES))
        outward = array("B", bytes(frames.OUT_BYTES))
        read = self._link.read
        write = self._link.write
        tick = self._tick
        parse = codec.in_parser(inward)
        seal = frames.CRC.pack_into
        offset = frames.OUT_BYTES - frames.CRC.size
        body = memoryview(outward)[:offset]
        begin = time.process_time()
        for number in range(ticks):
            read(inward)
            assert parse() is not None
            outward[:] = array("B", tick(inward.tobytes(), number))
            seal(outward, offset, codec.crc16(body))
            write(outward)
        return time.process_time() - begin
