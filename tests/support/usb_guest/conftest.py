"""One board for all cases, plugged in for each; its faults end with the case."""

import os
from collections.abc import Iterator
from dataclasses import replace

import pytest
from machine import Board, have_udev

from hapticd.core.params import UsbParams
from hapticd.usb.device import Device
from hapticd.usb.link import UsbLink

# far longer than may be configured, for the machine of the tests is shared
OURS = UsbParams(serial="SIM0001", timeout_ms=2000)


@pytest.fixture(scope="session")
def udev() -> None:
    """udevd with the shipped rule, unless this run is one without."""
    have_udev("NO_UDEV" not in os.environ)


@pytest.fixture(scope="session")
def any_board() -> Iterator[Board]:
    board = Board()
    yield board
    board.end()


@pytest.fixture
def board(udev: None, any_board: Board) -> Iterator[Board]:
    """Plugged in."""
    any_board.plug()
    yield any_board
    any_board("heal")
    any_board.unplug()


@pytest.fixture(params=[False, True], ids=["in_turn", "in_flight"])
def in_flight(request: pytest.FixtureRequest) -> bool:
    """Which way transfers go."""
    return bool(request.param)


@pytest.fixture
def link(board: Board, in_flight: bool) -> Iterator[UsbLink]:
    """Open."""
    link = UsbLink(replace(OURS, in_flight=in_flight))
    link.open()
    yield link
    link.close()


@pytest.fixture
def device(board: Board, in_flight: bool) -> Iterator[Device]:
    """Connected."""
    device = Device(UsbLink(replace(OURS, in_flight=in_flight)), 1000.0)
    device.connect()
    yield device
    device.close()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write one line for each case and each measurement, in the format that test_usb_stack.py
    reads.
    """
    for outcome in ("passed", "failed", "error", "skipped"):
        for report in terminalreporter.getreports(outcome):
            name = report.nodeid.rpartition("::")[2]
            terminalreporter.write_line(f"GUEST-CASE {outcome} {name}")
            for kind, text in report.user_properties:
                if report.when == "call":
                    terminalreporter.write_line(f"GUEST-TOLD {kind}: {text}")
