"""Ticks without USB, timed: the servo's own, the Python yardstick's and the C yardstick's; and USB
pairs alone.
"""

import sys
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from benchmarks.bare import empty_link
from benchmarks.bench_servo import BenchServo, read_parameters
from benchmarks.null_link import NullLink
from benchmarks.records import place
from benchmarks.tick_c import CReference, check_same_work
from benchmarks.tick_reference import yardstick
from benchmarks.worker import serve
from hapticd.core.params import ServoParams
from hapticd.core.units import MonotonicClock
from hapticd.mailbox import layout
from hapticd.model.params import BoardParams
from hapticd.run.servo_main import simulated_backend
from hapticd.servo.late import first_deadline
from hapticd.usb import codec, frames
from hapticd.usb.frames import OutFrame
from hapticd.usb.link import UsbLink

STAGES = slice(
    place("read_ns"), place("publish_ns") + 1
)  # read, step, write, and publish of the tick before


def own_ns(block: bytes, read_ns: Sequence[int], calls_ns: float = 0.0) -> list[float]:
    """Return the time from wake to end of each tick in `block` but the last, less that
    of the link.
    """
    stages = [record[STAGES] for record in layout.RECORD.iter_unpack(block)]
    return [
        sum(now[:3]) + after[3] - read - calls_ns
        for now, after, read in zip(stages, stages[1:], read_ns, strict=False)
    ]


def no_wait(_deadline_ns: int, _rehearse: Callable[[], object]) -> int:
    """Return at once: the wait of a loop without pauses."""
    return time.monotonic_ns()


def _nothing() -> None:
    """Do nothing: the yardstick has no rehearsal."""


class TickBench:
    """One servo on a null link, its yardsticks, and USB links to the simulated board and to an
    empty one.
    """

    def __init__(self, params: ServoParams, board: BoardParams, library: str) -> None:
        self.link = NullLink(board)
        self.servo = BenchServo(params, self.link, self.link.prepare)
        self.wait = self.servo.loop.wait
        self.period_ns = self.servo.loop.period_ns
        self.reference = yardstick(params.environment, params.realtime.rate_hz)
        self.in_c = CReference(library, params) if library else None
        in_turn = replace(params.usb, in_flight=False)
        self.usb = UsbLink(in_turn, simulated_backend(board, MonotonicClock()))
        self.usb.open()
        self.empty = empty_link(params.usb, board, MonotonicClock())

    def paced(self, ticks: int) -> dict[str, list[float]]:
        """Time the servo's tick and the Python yardstick's, a block of each at their pace."""
        self.servo.loop.wait = self.wait
        ours = own_ns(self.servo.run(ticks), self.link.read_ns, self.link.calls_ns)
        return {"servo": ours, "reference": self._every_period(self.link.frames, self.reference)}

    def hot(self, ticks: int) -> dict[str, list[float]]:
        """Time the servo's tick without a pause, and the C yardstick's from the same state over the
        same frames.
        """
        self.servo.loop.wait = no_wait
        state = self.servo.loop.state
        tick = self.servo.loop.tick
        ours = self.servo.run(ticks)
        taken = {"servo": own_ns(ours, self.link.read_ns, self.link.calls_ns)}
        if self.in_c is not None:
            theirs = self.in_c.run(state, tick, self.link.frames)
            check_same_work(ours, theirs)
            taken["c"] = own_ns(theirs, [0] * ticks)
        return taken

    def pairs(self, ticks: int) -> dict[str, list[float]]:
        """Time a read and a write through pyusb at the servo's pace: the simulated board's, and an
        empty board's.
        """
        return {"pair": self._pairs(self.usb, ticks), "empty": self._pairs(self.empty, ticks)}

    def _pairs(self, link: UsbLink, ticks: int) -> list[float]:
        inward = array("B", bytes(frames.PACKET_BYTES))
        read = link.read
        write = link.write

        def pair(outward: "array[int]", _: int) -> None:
            read(inward)
            write(outward)

        first, *outward = [array("B", codec.encode_out(OutFrame(seq))) for seq in range(ticks + 1)]
        write(first)
        return self._every_period(outward, pair)

    def _every_period(
        self, arguments: Sequence[Any], action: Callable[[Any, int], Any]
    ) -> list[float]:
        """Return the times of `action(argument, start)`, one argument each period; past periods are
        dropped.
        """
        wait = self.wait
        clock = time.monotonic_ns
        period_ns = self.period_ns
        taken = [0.0] * len(arguments)
        deadline_ns = first_deadline(clock(), period_ns)
        for index, argument in enumerate(arguments):
            start_ns = wait(deadline_ns, _nothing)
            action(argument, start_ns)
            end_ns = clock()
            taken[index] = end_ns - start_ns
            deadline_ns += ((end_ns - deadline_ns) // period_ns + 1) * period_ns
        return taken


def main() -> None:
    """Run with the arguments: parameter file, path of the compiled C yardstick or an empty text."""
    params, board = read_parameters(sys.argv[1])
    bench = TickBench(params, board, sys.argv[2] if len(sys.argv) > 2 else "")
    actions = {"paced": bench.paced, "hot": bench.hot, "pairs": bench.pairs}
    serve(
        lambda request: actions[request["what"]](request["ticks"]),
        params.realtime,
        bench.servo.enable,
    )


if __name__ == "__main__":
    main()
