"""The USB link over the true usb.core and the simulated board: every way in which it can fail,
and how it comes back.
"""

import gc
import sys
from array import array

import pytest
from support.boards import ENABLE, TICK_NS
from test_link_usb import Bench

from hapticd.core.errors import (
    LinkAccess,
    LinkLost,
)
from hapticd.usb import codec


@pytest.fixture(params=[False, True], ids=["in_turn", "in_flight"], autouse=True)
def path(request, monkeypatch):
    """Every case over both ways of transfers."""
    monkeypatch.setattr(Bench, "in_flight", request.param)


@pytest.fixture
def bench(path):
    return Bench()


def test_ten_thousand_pairs_leave_nothing_behind(bench):
    out = array("B", bytes(32))
    pack = codec.out_packer(out)

    def ticks(first, last):
        for tick in range(first, last):
            pack(tick & 0xFFFF, ENABLE, tick % 500, tick % 700, 0)
            bench.link.write(out)
            bench.link.read(bench.buffer)
            bench.clock.sleep_until_ns((tick + 1) * TICK_NS)

    ticks(0, 500)
    gc.collect()
    gc.disable()
    try:
        before = sys.getallocatedblocks()
        ticks(500, 10_500)
        after = sys.getallocatedblocks()
        unreachable = gc.collect()
    finally:
        gc.enable()
    assert after - before < 50
    assert unreachable == 0


@pytest.mark.parametrize("hinder", ["access_denied", "unplugged"])
def test_board_that_cannot_be_opened_leaves_nothing_behind(hinder):
    bench = Bench(opened=False, serial="SIM0001")
    bench.backend.access_denied = hinder == "access_denied"
    if hinder == "unplugged":
        bench.backend.unplug()
    gc.collect()
    gc.disable()
    try:
        for _ in range(20):
            with pytest.raises((LinkAccess, LinkLost)):
                bench.link.open()
        unreachable = gc.collect()
    finally:
        gc.enable()
    assert unreachable == 0
