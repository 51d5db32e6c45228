"""A bus whose transfers take time, on virtual and on a wall clock."""

import errno
from array import array

import pytest
import usb.core
from support.boards import ENABLE, LATCH_NS, TICK_NS, board_params, out_packet

from hapticd.core.units import VirtualClock
from hapticd.model.params import InjectionParams
from hapticd.sim.backend import DistantBackend, SimulatedBackend, make_backend
from hapticd.usb import codec

OUT = 0x01
IN = 0x81
OUT_NS = 300_000
IN_NS = 500_000
START_NS = 5_000_000_000


class Bus:
    """A board at the far end, and what a host sees of it."""

    def __init__(self, **traits):
        self.clock = VirtualClock(START_NS)
        self.backend = make_backend(board_params(**traits), self.clock)
        self.device = usb.core.find(backend=self.backend, idVendor=0x1209, idProduct=0x0001)
        self.buffer = array("B", bytes(64))

    def write(self, seq):
        self.device.write(OUT, array("B", bytes(out_packet(seq, flags=ENABLE))), 10)
        return self.clock.now_ns()

    def read(self):
        self.device.read(IN, self.buffer, 10)
        return self.clock.now_ns()


@pytest.fixture
def far():
    bus = Bus(out_transport_us=OUT_NS / 1000, in_transport_us=IN_NS / 1000)
    bus.device.get_active_configuration()
    return bus


def test_no_transport_is_the_plain_backend():
    assert type(Bus().backend) is SimulatedBackend
    assert type(Bus(in_transport_us=1.0).backend) is DistantBackend


def test_write_takes_its_transport_and_the_board_latches_after_it(far):
    sent_ns = far.write(0)
    assert sent_ns == START_NS + OUT_NS
    assert far.read() == sent_ns + LATCH_NS + IN_NS
    assert codec.decode_in(far.buffer).board_time_us == LATCH_NS // 1000


def test_read_of_a_waiting_frame_takes_its_transport_alone(far):
    far.write(0)
    far.clock.time_ns += TICK_NS
    now_ns = far.clock.now_ns()
    assert far.read() == now_ns + IN_NS


def test_control_transfer_takes_both_ways(far):
    far.device.ctrl_transfer(0xC0, 1, 0, 0, 80)
    assert far.clock.now_ns() == START_NS + OUT_NS + IN_NS


def test_interrupt_transfers_take_the_same_time():
    assert DistantBackend.intr_write is DistantBackend.bulk_write
    assert DistantBackend.intr_read is DistantBackend.bulk_read


def test_hung_board_keeps_a_write_waiting_until_its_time_is_over():
    bus = Bus(injections=(InjectionParams("hang", tick=1, value=0.05),))
    bus.write(0)
    now_ns = bus.clock.now_ns()
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        bus.write(1)
    assert caught.value.errno == errno.ETIMEDOUT
    assert bus.clock.now_ns() == now_ns + 10_000_000
