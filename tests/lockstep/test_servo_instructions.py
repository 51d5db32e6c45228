"""What a tick executes between its wake and its OUT, in instructions of CPython: a cost that no
load of the machine changes.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from types import FrameType
from typing import Any

import pytest
from support.boards import board_params
from support.models import servo_params

import hapticd
from hapticd.core.params import UsbParams
from hapticd.mailbox.layout import Command, Value
from hapticd.run.lockstep import LockStep

OURS = str(Path(hapticd.__file__).parent)
BOARD = str(Path(OURS) / "sim")
MOST = {"bulk_write": 950, "submit_out": 1000}  # in CPython 3.11: 821 and 894
TICKS = 20


class Counter:
    """Counts the instructions of hapticd and pyusb, but for the board, from each wake of `stack` to
    the call of `sends` at its backend.
    """

    def __init__(self, stack: LockStep, sends: str) -> None:
        self.counts: list[int] = []
        self._sends = sends
        self._count = 0
        self._counting = False
        self._wait = stack.loop.wait
        stack.loop.wait = self._woken

    def _woken(self, *given: Any) -> int:
        start_ns = self._wait(*given)
        self._count, self._counting = 0, True
        return start_ns

    def call(self, frame: FrameType, _event: str, _given: Any) -> Any:
        """The global trace function."""
        code = frame.f_code
        if code.co_filename.startswith(BOARD):
            if code.co_name == self._sends and self._counting:
                self.counts.append(self._count)
                self._counting = False
            return None
        if not code.co_filename.startswith(OURS) and "/usb/" not in code.co_filename:
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return self._instruction

    def _instruction(self, _frame: FrameType, event: str, _given: Any) -> Any:
        self._count += event == "opcode"
        return self._instruction


@contextmanager
def traced(function: Any) -> Iterator[None]:
    before = sys.gettrace()
    sys.settrace(function)
    try:
        yield
    finally:
        sys.settrace(before)


@pytest.mark.parametrize("sends", MOST)
def test_tick_executes_little_before_its_out(sends: str) -> None:
    servo = servo_params(usb=UsbParams(in_flight=sends == "submit_out"))
    with LockStep(servo, board_params()) as stack:
        stack.run(5)
        stack.do(Command.ENABLE)
        stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 0.0})
        stack.run(700)
        counter = Counter(stack, sends)
        with traced(counter.call):
            stack.loop.run(TICKS)
    assert len(counter.counts) == TICKS
    assert median(counter.counts) <= MOST[sends]
