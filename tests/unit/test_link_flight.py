"""The rules of transfers in flight: one IN, one OUT, nothing waited for, nothing cancelled."""

import errno
from array import array

import pytest
import usb.core

from hapticd.usb.flight import InFlight, OutFailed

TIMEOUT_MS = 1
OUT, IN = 0x01, 0x81


class Bus:
    """Transfers that end when a test says so; `said` is what was asked of them."""

    def __init__(self):
        self.said = []
        self.out_ends = True  # or False: still on its way; an error: how it failed
        self.in_ends = True

    def submit_out(self, data):
        self.said.append("out")

    def submit_in(self):
        self.said.append("in")

    def out_done(self, wait_ns):
        self.said.append(f"out? {wait_ns}")
        return self._ended(self.out_ends)

    def in_done(self, buffer, wait_ns):
        self.said.append(f"in? {wait_ns}")
        return 64 if self._ended(self.in_ends) else -1

    def cancel(self):
        self.said.append("cancel")

    @staticmethod
    def _ended(how):
        if isinstance(how, Exception):
            raise how
        return how

    def heard(self):
        """What was asked since the last call."""
        said, self.said = self.said, []
        return said


class Bench:
    def __init__(self):
        self.bus = Bus()
        self.flight = InFlight(self.bus)
        self.buffer = array("B", bytes(64))
        self.write()
        self.read()
        self.write()
        self.bus.heard()

    def read(self):
        return self.flight.read(IN, self.buffer, TIMEOUT_MS)

    def write(self):
        self.flight.write(OUT, array("B", bytes(32)), TIMEOUT_MS)


@pytest.fixture
def bench():
    return Bench()


def failure(number):
    return usb.core.USBError("as a test says", None, number)


def test_tick_reaps_its_in_and_submits_the_next_before_its_out(bench):
    assert bench.read() == 64
    bench.write()
    assert bench.bus.heard() == ["out? 0", "in? 1000000", "in", "out"]


def test_first_out_comes_before_the_first_in():
    """Or the IN would take a frame of an earlier session."""
    bus = Bus()
    flight = InFlight(bus)
    flight.write(OUT, array("B", bytes(32)), TIMEOUT_MS)
    assert bus.heard() == ["out"]
    flight.read(IN, array("B", bytes(64)), TIMEOUT_MS)
    assert bus.heard() == ["out? 0", "in", "in? 1000000"]


def test_there_is_never_a_second_in(bench):
    """However many ticks go without a frame."""
    bench.bus.in_ends = False
    for _ in range(5):
        with pytest.raises(usb.core.USBTimeoutError):
            bench.read()
        bench.write()
    assert "in" not in bench.bus.heard()
    bench.bus.in_ends = True
    bench.read()
    bench.write()
    assert bench.bus.heard().count("in") == 1


def test_read_asks_first_where_no_in_is_under_way(bench):
    bench.read()
    bench.bus.heard()
    bench.read()
    assert bench.bus.heard() == ["in", "in? 1000000"]


def test_out_that_is_still_on_its_way_costs_its_tick_and_gets_no_second_one(bench):
    """Neither is waited for: the tick is short, and the next one tries again."""
    bench.bus.out_ends = False
    for _ in range(3):
        for act in (bench.read, bench.write):
            with pytest.raises(usb.core.USBTimeoutError):
                act()
    assert set(bench.bus.heard()) == {"out? 0"}
    bench.bus.out_ends = True
    bench.write()
    assert bench.bus.heard() == ["out? 0", "out"]


@pytest.mark.parametrize("number", [errno.EPIPE, errno.EIO, errno.ENODEV])
def test_out_that_failed_is_told_by_the_next_read_and_the_way_is_free(bench, number):
    bench.bus.out_ends = failure(number)
    with pytest.raises(OutFailed) as caught:
        bench.read()
    assert caught.value.error.errno == number
    bench.write()
    assert bench.bus.heard() == ["out? 0", "out"]


def test_in_that_failed_is_asked_for_again(bench):
    bench.bus.in_ends = failure(errno.EPIPE)
    with pytest.raises(usb.core.USBError):
        bench.read()
    bench.bus.in_ends = True
    bench.read()
    assert bench.bus.heard() == ["out? 0", "in? 1000000", "in", "in? 1000000"]


def test_drain_waits_for_the_out_and_keeps_how_it_failed(bench):
    bench.bus.out_ends = failure(errno.EPIPE)
    bench.flight.drain(TIMEOUT_MS)
    assert bench.bus.heard() == ["out? 1000000"]
    with pytest.raises(OutFailed):
        bench.read()
    bench.write()
    assert bench.bus.heard() == ["out"]


def test_last_out_has_the_time_out_to_arrive_before_anything_is_cancelled(bench):
    bench.flight.close(TIMEOUT_MS, (usb.core.USBError,))
    assert bench.bus.heard() == ["out? 1000000", "cancel"]


def test_nothing_is_cancelled_in_a_tick(bench):
    for bench.bus.out_ends in (True, False, failure(errno.EIO)):
        for bench.bus.in_ends in (True, False, failure(errno.EIO)):
            for act in (bench.read, bench.write):
                try:
                    act()
                except (OutFailed, usb.core.USBError):
                    pass
    assert "cancel" not in bench.bus.heard()


@pytest.mark.parametrize("error", [failure(errno.ENODEV), failure(errno.EIO)])
def test_close_never_raises(bench, error):
    def gone():
        raise error

    bench.bus.out_ends = error
    bench.bus.cancel = gone
    bench.flight.close(TIMEOUT_MS, (usb.core.USBError,))
