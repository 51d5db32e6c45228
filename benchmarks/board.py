"""The simulated board with the calibrated device: its share of a tick, and the whole stack in
lock-step.

`board_tick_ratio` is a write and read pair of the USB link with weir2008 (7 states, 16 sub-steps a
tick) behind it. Its yardstick is the same pair with an empty board, and the plant's straight-line
step alone, called as often and for as many sub-steps.
"""

import time
from array import array
from collections.abc import Iterator
from dataclasses import replace

from benchmarks import targets
from benchmarks.bare import empty_link
from benchmarks.blocks import quantile
from benchmarks.figures import Figure, compared
from benchmarks.lockstep import lockstep_figure
from hapticd.core.units import NS_PER_MS, NS_PER_US, VirtualClock
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, make_plant
from hapticd.run.lockstep import scene_params
from hapticd.run.servo_main import simulated_backend
from hapticd.usb import codec, frames
from hapticd.usb.frames import OutFlag
from hapticd.usb.link import UsbLink

SCENE = "fig4"
TARGETS = targets.of("board")
PAIRS = 1000
BLOCKS = 15
PIECES = 5  # of the plant in a tick: four ends of 250 us, and the latch between two of them


def measure() -> Iterator[Figure]:
    """Measure blocks in turns and take their minimum; then the lock-step runs."""
    servo, board = scene_params(SCENE)
    clocks = VirtualClock(NS_PER_MS), VirtualClock(NS_PER_MS)
    link = UsbLink(replace(servo.usb, in_flight=False), simulated_backend(board, clocks[0]))
    link.open()
    pairs = Pairs(link, clocks[0])
    empty = Pairs(empty_link(servo.usb, board, clocks[1]), clocks[1])
    plant = PlantAlone(board)
    rounds = [(pairs.us(PAIRS), empty.us(PAIRS) + plant.us(PAIRS)) for _ in range(BLOCKS)]
    ours_us, alone_us = (min(times) for times in zip(*rounds, strict=True))
    yield compared(
        "board_tick_ratio",
        TARGETS["board_tick_ratio"],
        ours_us,
        "us",
        alone_us,
        f"scene {SCENE}, moving",
    )
    yield lockstep_figure("lockstep_weir_ratio", TARGETS["lockstep_weir_ratio"], servo, board)


class Pairs:
    """Writes and reads of `link`; a changing force keeps the device moving."""

    def __init__(self, link: UsbLink, clock: VirtualClock) -> None:
        self._link = link
        self._clock = clock
        self._number = 0

    def us(self, pairs: int) -> float:
        """Return the microseconds of one pair, the median of a block."""
        out = array("B", bytes(frames.OUT_BYTES))
        reply = array("B", bytes(frames.PACKET_BYTES))
        pack = codec.out_packer(out)
        write = self._link.write
        read = self._link.read
        taken = []
        for number in range(self._number, self._number + pairs):
            pack(number & 0xFFFF, int(OutFlag.ENABLE) if number else 0, force_count(number), 0, 0)
            begin = time.perf_counter_ns()
            write(out)
            read(reply)
            taken.append(time.perf_counter_ns() - begin)
            self._clock.sleep_until_ns(
                (number + 2) * NS_PER_MS
            )  # the read has moved it to the latch
        self._number += pairs
        return quantile(taken, 0.5) / NS_PER_US


class PlantAlone:
    """The plant of `board` without a board."""

    def __init__(self, board: BoardParams) -> None:
        plant = make_plant(board)
        self._step, self._state, self._n_per_count, self._number = (
            plant.step,
            plant.rest(0.0),
            board.force_n_per_count,
            0,
        )

    def us(self, ticks: int) -> float:
        """Return the microseconds of the sub-steps of one tick, in as many pieces as on the board,
        the median of a block.
        """
        step = self._step
        state = self._state
        piece, rest = divmod(SUBSTEPS_PER_TICK, PIECES - 1)
        assert not rest
        taken = []
        for number in range(self._number, self._number + ticks):
            force_n = force_count(number) * self._n_per_count
            begin = time.perf_counter_ns()
            for count in (piece, piece, piece, piece // 2, piece - piece // 2):
                state = step(state, force_n, 0.0, 0.0, count)
            taken.append(time.perf_counter_ns() - begin)
        self._state = state
        self._number = self._number + ticks
        return quantile(taken, 0.5) / NS_PER_US


def force_count(number: int) -> int:
    """Return a square wave of 10 Hz."""
    return 2000 * (-1) ** (number // 50)
