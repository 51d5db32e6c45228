"""The link above real usbcore, usbfs, libusb and udev: transfers and the cable. Run by `make
test-usb` in a user-mode kernel (tests/acceptance/test_usb_stack.py).
"""

import gc
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import OURS
from machine import (
    Board,
    attach,
    configured,
    place,
    until,
)
from packets import answers, opens, read, write

from hapticd.core.errors import LinkLost, LinkStalled, LinkTimeout
from hapticd.core.units import MonotonicClock
from hapticd.usb import codec, frames
from hapticd.usb.device import Device
from hapticd.usb.frames import Request
from hapticd.usb.link import UsbLink
from hapticd.usb.search import settle_transport


# --- enumeration ----------------------------------------------------------------------------------
def test_shipped_board_is_enumerated_and_greeted(udev: None) -> None:
    command = [sys.executable, "-m", "hapticd", "sim-board", "--usbip", "3240"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "SIMULATED board SIM0001" in process.stdout.readline()
        attach("127.0.0.1:3240")
        found = until(lambda: (at := place()) and configured(at), "the board")
        read = {name: (found / name).read_text().strip() for name in ("speed", "serial", "product")}
        assert read == {
            "speed": "12",
            "serial": "SIM0001",
            "product": "analog board (simulated)",
        }
        assert not (next(found.glob("*:1.0")) / "driver").exists()
        link = UsbLink(OURS)
        link.open()
        hello = codec.decode_hello(link.request(Request.HELLO, frames.HELLO_BYTES))
        assert hello.protocol_hash == frames.PROTOCOL_HASH
        link.close()
        process.terminate()
        assert process.wait() == 0
    until(lambda: place() is None, "the board has left")


def test_every_frame_is_answered_in_order(link: UsbLink) -> None:
    for seq in range(300):
        write(link, seq)
        assert codec.decode_in(read(link)).echo == seq


def test_rate_that_the_kernel_holds(
    device: Device, record_property: Callable[[str, object], None]
) -> None:
    """Measured and reported, not asserted: this kernel is an ordinary process."""
    found = settle_transport(device, MonotonicClock())
    start = time.perf_counter()
    for _ in range(1000):
        device.send(0, 0, 0, 0)
        device.link.drain()
        device.receive()
    pairs_hz = 1000 / (time.perf_counter() - start)
    way = "in flight" if found.in_flight else "in turn"
    record_property(
        "rate",
        f"{way}, a pair of transfers takes {found.pair_us:.0f} us: {found.rate_hz:g} Hz are held,"
        f" with a latch at {found.sample_phase:g} of a period; {pairs_hz:.0f} Hz back to back,"
        f" {device.counts['missing']} of 1000 missing",
    )
    calls = sorted(paced_us(device) for _ in range(500))
    record_property("calls", f"{way}, a tick at 250 Hz spends {calls[250]:.0f} us in its transfers")


def paced_us(device: Device) -> float:
    """Return the time that a tick spends in its transfers when the IN is ready."""
    time.sleep(0.004)
    start = time.perf_counter()
    device.receive()
    device.send(0, 0, 0, 0)
    return 1e6 * (time.perf_counter() - start)


# --- transfers that fail --------------------------------------------------------------------------
def test_stall_is_cleared_once(board: Board, link: UsbLink) -> None:
    for direction in ("in", "out"):
        board(f"fault {direction} EPIPE 1")
        with pytest.raises(LinkStalled, match=r"errno 32\); the halt is cleared once"):
            answers(link)
        assert answers(link)


def test_endpoint_that_stalls_again_is_lost(board: Board, link: UsbLink) -> None:
    board("fault out EPIPE")
    with pytest.raises(LinkStalled):
        answers(link)
    with pytest.raises(LinkLost, match="it stalled again after that"):
        answers(link)


def test_more_than_a_packet_overflows_and_is_cleared(board: Board, link: UsbLink) -> None:
    board("length 65 1")
    write(link)
    with pytest.raises(LinkStalled, match="errno 75"):
        read(link)
    assert answers(link)


@pytest.mark.parametrize("length", [0, 20, 63])
def test_short_and_empty_packets_arrive_as_such(length: int, board: Board, link: UsbLink) -> None:
    board(f"length {length} 1")
    write(link)
    assert len(read(link)) == length
    assert answers(link)


# in flight a packet may be later than its tick where board and host share a core: the count would
# be a matter of time
@pytest.mark.parametrize("in_flight", [False], ids=["in_turn"])
def test_short_and_empty_packets_cost_one_sample(board: Board, device: Device) -> None:
    device.receive()
    for length, expected in ((20, {"bad": 1}), (0, {"bad": 1, "empty": 1, "missing": 1})):
        board(f"length {length} 1")
        for arrived in (False, True):
            device.send(0, 0, 0, 0)
            device.link.drain()
            assert (device.receive()[0] >= 0) == arrived
        assert {kind: device.counts[kind] for kind in expected} == expected


@pytest.mark.parametrize("direction", ["in", "out"])
def test_board_that_never_answers_costs_its_time_out_each_time(
    direction: str, in_flight: bool, board: Board
) -> None:
    link = UsbLink(replace(OURS, timeout_ms=1, in_flight=in_flight))
    link.open()
    board(f"fault {direction} ETIMEDOUT")
    for _ in range(20):
        with pytest.raises(LinkTimeout, match="errno 110"):
            answers(link)
    link.close()
    board("heal")
    link = UsbLink(OURS)
    link.open()
    assert answers(link)
    link.close()


def test_broken_transaction_is_a_lost_link(board: Board, link: UsbLink) -> None:
    board("fault out EPROTO")
    with pytest.raises(LinkLost, match="errno 5"):
        answers(link)


# --- the cable ------------------------------------------------------------------------------------
def test_plug_pulled_under_a_transfer_and_put_in_again(board: Board, link: UsbLink) -> None:
    board("fault in ETIMEDOUT")
    pulling = threading.Timer(0.05, lambda: board("pull"))
    pulling.start()
    with pytest.raises(LinkLost, match=r"errno (19|5)\)"):
        read(link)
    pulling.join()
    with pytest.raises(LinkLost):
        answers(link)
    until(lambda: place() is None, "the board has left")
    board("heal")
    board.plug()
    until(lambda: opens(link), "the link opens again")
    assert answers(link)


def test_looks_leave_nothing_behind(udev: None) -> None:
    """Each search has its own libusb context, with descriptors and a thread."""
    link = UsbLink(OURS)
    gc.disable()  # as in the servo
    try:
        assert not opens(link)
        before = held()
        for _ in range(20):
            assert not opens(link)
        assert held() == before
    finally:
        gc.enable()


def held() -> tuple[int, int]:
    """Descriptors and threads of this process."""
    return len(list(Path("/proc/self/fd").iterdir())), len(list(Path("/proc/self/task").iterdir()))
