"""A board without time: the next IN frame is ready and OUT frames are dropped. The rest of a tick
is the servo's own.

`prepare` makes frames in advance, valid in number, echo, board time and CRC, with a moving encoder.
The cost of the link itself is subtracted from the tick: `read_ns` is the body of each read,
`calls_ns` the rest of a read and the whole of a write. The latter is measured once without a pause,
so it subtracts too little rather than too much.
"""

import time
from array import array
from math import pi, sin
from statistics import median

from hapticd.core.units import US_PER_S
from hapticd.model.params import BoardParams
from hapticd.sim.board import hello
from hapticd.usb import codec, frames
from hapticd.usb.codec import Link
from hapticd.usb.frames import InFrame, Request

AMPLITUDE_COUNTS = 2000
WAVE_HZ = 3.0
AMBIENT_COUNT = 2200
AGE_US = 875  # age of the torque, as reported by a board at 1 kHz
TRIALS = 1000


class NullLink(Link):
    """The board of `params` at its rate, at no cost."""

    def __init__(self, params: BoardParams) -> None:
        self._params = params
        self._made = 0
        self._next = 0
        self.frames: list[array[int]] = []
        self.read_ns = array("q")
        self.calls_ns = self._calibrate()

    def prepare(self, ticks: int) -> None:
        """Replace the prepared frames by the next `ticks` IN frames, beginning after the last one
        read.
        """
        self._made = self._made + self._next
        self._next = 0
        self.frames = [array("B", self._frame(self._made + index)) for index in range(ticks)]
        self.read_ns = array("q", bytes(8 * ticks))

    def _frame(self, number: int) -> bytes:
        time_us = round((number + 1) * US_PER_S / self._params.rate_hz)
        encoder = round(AMPLITUDE_COUNTS * sin(2.0 * pi * WAVE_HZ * number / self._params.rate_hz))
        bits = frames.StatusBit
        status = int(bits.ENABLED | bits.AMPLIFIER_READY | bits.SIMULATED)
        return codec.encode_in(
            InFrame(
                seq=number & 0xFFFF,
                echo=number + 1 & 0xFFFF,
                axis=0,
                status=status,
                board_time_us=time_us & 0xFFFFFFFF,
                encoder=encoder,
                current=5,
                voltage=6,
                emf_velocity=7,
                temperature=AMBIENT_COUNT,
                fifo_level=0,
                life=1,
                index_offset=0,
                probe_index=0,
                torque_age_us=AGE_US,
                torque_seq=number + 1 & 0xFF,
            )
        )

    def _calibrate(self) -> float:
        """Return the time [ns] of a read and a write at the caller, without the clock reading and
        `read_ns`.
        """
        clock = time.monotonic_ns
        read = self.read
        write = self.write
        buffer = array("B", bytes(frames.PACKET_BYTES))
        self.frames, self.read_ns = [buffer] * TRIALS, array("q", bytes(8 * TRIALS))
        stamps = []
        for _ in range(TRIALS):
            start = clock()
            begin = clock()
            read(buffer)
            middle = clock()
            write(buffer)
            stamps.append((begin - start, middle - begin, clock() - middle))
        tick, reading, writing = (median(times) for times in zip(*stamps, strict=True))
        self._next = 0
        return float(reading - tick - median(self.read_ns) + writing - tick)

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def read(self, buffer: "array[int]") -> int:
        begin_ns = time.monotonic_ns()
        index = self._next
        buffer[:] = self.frames[index]
        self._next = index + 1
        self.read_ns[index] = time.monotonic_ns() - begin_ns
        return frames.IN_BYTES

    def write(self, buffer: "array[int]") -> None:
        """Drop the frame."""

    def request(self, request: Request, length: int = 0) -> bytes:
        return codec.encode_hello(hello(self._params))
