"""The twin below the true usb.core: what pyusb sees must be what libusb on Linux shows it."""

import errno
from array import array

import pytest
import usb.core
import usb.util
from support.boards import ENABLE, LATCH_NS, TICK_NS, board_params, out_packet

from hapticd.core.units import MonotonicClock, VirtualClock
from hapticd.sim.backend import ENDLESS_MS, SPIN_NS, SimulatedBackend
from hapticd.sim.board import BoardModel
from hapticd.sim.bus import LIBUSB_ERRORS, usb_error
from hapticd.usb import codec

OUT = 0x01
IN = 0x81


class Bench:
    """A plugged board and a clock."""

    def __init__(self, transfer="bulk", clock=None):
        self.clock = clock or VirtualClock(5_000_000_000)
        self.board = BoardModel(board_params())
        self.backend = SimulatedBackend(self.board, self.clock, transfer)
        self.buffer = array("B", bytes(64))

    def find(self):
        return usb.core.find(backend=self.backend, idVendor=0x1209, idProduct=0x0001)

    def out(self, seq=0, **fields):
        return array("B", bytes(out_packet(seq, **fields)))


@pytest.fixture
def bench():
    return Bench()


def fails(number, call, *arguments):
    code, text = LIBUSB_ERRORS[number]
    with pytest.raises(usb.core.USBError) as caught:
        call(*arguments)
    assert (caught.value.errno, caught.value.backend_error_code, caught.value.strerror) == (
        number,
        code,
        text,
    )
    return caught.value


def test_errors_are_worded_as_libusb_does():
    assert (
        str(usb_error(errno.ENODEV)) == "[Errno 19] No such device (it may have been disconnected)"
    )
    assert isinstance(usb_error(errno.ETIMEDOUT), usb.core.USBTimeoutError)
    assert not isinstance(usb_error(errno.EIO), usb.core.USBTimeoutError)
    assert isinstance(usb_error(errno.ENOSYS), NotImplementedError)


def test_descriptors_describe_one_vendor_interface(bench):
    device = bench.find()
    assert (device.bus, device.address, device.speed, device.parent) == (1, 1, 2, None)
    assert (device.manufacturer, device.product, device.serial_number) == (
        "hapticd",
        "analog board (simulated)",
        "SIM0001",
    )
    (configuration,) = device
    (interface,) = configuration
    assert interface.bInterfaceClass == 0xFF
    assert [(e.bEndpointAddress, e.wMaxPacketSize) for e in interface] == [(OUT, 64), (IN, 64)]
    assert "Bulk OUT" in str(configuration)


def test_enumeration_ends_with_index_errors(bench):
    plugged = bench.backend.device
    for call in (
        lambda: bench.backend.get_configuration_descriptor(plugged, 1),
        lambda: bench.backend.get_interface_descriptor(plugged, 1, 0, 0),
        lambda: bench.backend.get_interface_descriptor(plugged, 0, 1, 0),
        lambda: bench.backend.get_endpoint_descriptor(plugged, 2, 0, 0, 0),
    ):
        with pytest.raises(IndexError, match="Invalid"):
            call()


@pytest.mark.parametrize("transfer", ["bulk", "interrupt"])
def test_pair_carries_one_frame_each_way(transfer):
    bench = Bench(transfer)
    device = bench.find()
    assert device.write(OUT, bench.out(3, flags=ENABLE), 10) == 32
    assert device.read(IN, bench.buffer, 10) == 64
    assert codec.decode_in(bench.buffer).echo == 3


def test_read_waits_for_the_latch_and_no_longer(bench):
    device = bench.find()
    start_ns = bench.clock.now_ns()
    device.write(OUT, bench.out(), 10)
    device.read(IN, bench.buffer, 10)
    assert bench.clock.now_ns() == start_ns + LATCH_NS


def test_latched_frame_is_read_without_waiting(bench):
    device = bench.find()
    device.write(OUT, bench.out(), 10)
    bench.clock.time_ns += TICK_NS
    now_ns = bench.clock.now_ns()
    device.read(IN, bench.buffer, 10)
    assert bench.clock.now_ns() == now_ns


@pytest.mark.parametrize(("timeout_ms", "waited_ms"), [(2, 2), (7, 7), (0, ENDLESS_MS)])
def test_read_times_out_exactly_and_always(bench, timeout_ms, waited_ms):
    device = bench.find()
    start_ns = bench.clock.now_ns()
    error = fails(errno.ETIMEDOUT, device.read, IN, bench.buffer, timeout_ms)
    assert isinstance(error, usb.core.USBTimeoutError)
    assert bench.clock.now_ns() == start_ns + waited_ms * 1_000_000


class SteppingClock(MonotonicClock):
    """A wall clock whose every reading is a microsecond later and whose sleep is 40 us late."""

    def __init__(self):
        self.time_ns = 10**9
        self.sleeps_ns = []

    def now_ns(self):
        self.time_ns += 1000
        return self.time_ns

    def sleep_until_ns(self, deadline_ns):
        self.sleeps_ns.append(deadline_ns)
        self.time_ns = max(self.time_ns, deadline_ns + 40_000)


def test_wall_clock_is_slept_then_spun_to_the_latch():
    clock = SteppingClock()
    bench = Bench(clock=clock)
    device = bench.find()
    device.write(OUT, bench.out(), 10)
    due_ns = bench.board.next_in_ns()
    device.read(IN, bench.buffer, 10)
    assert clock.sleeps_ns == [due_ns - SPIN_NS]
    assert due_ns <= clock.time_ns <= due_ns + 3000


def test_second_owner_is_refused(bench):
    first = bench.find()
    second = bench.find()
    usb.util.claim_interface(first, 0)
    fails(errno.EBUSY, usb.util.claim_interface, second, 0)
    fails(errno.EBUSY, second.write, OUT, bench.out(), 10)
    usb.util.dispose_resources(first)
    usb.util.claim_interface(second, 0)


def test_configuration_is_refused_while_claimed(bench):
    device = bench.find()
    assert device.get_active_configuration().bConfigurationValue == 1
    usb.util.claim_interface(device, 0)
    fails(errno.EBUSY, device.set_configuration)


def test_foreign_rights_and_drivers(bench):
    device = bench.find()
    bench.backend.access_denied = True
    fails(errno.EACCES, device.get_active_configuration)
    bench.backend.access_denied = False
    assert device.is_kernel_driver_active(0) is False
    fails(errno.ENOENT, device.detach_kernel_driver, 0)
    fails(errno.ENOENT, device.attach_kernel_driver, 0)
    bench.backend.kernel_driver = True
    fails(errno.EBUSY, usb.util.claim_interface, device, 0)
    device.detach_kernel_driver(0)
    usb.util.claim_interface(device, 0)


def test_unplugged_device_is_dead_for_every_call(bench):
    device = bench.find()
    usb.util.claim_interface(device, 0)
    bench.backend.unplug()
    fails(errno.ENODEV, device.write, OUT, bench.out(), 10)
    fails(errno.ENODEV, device.read, IN, bench.buffer, 10)
    fails(errno.ENODEV, device.ctrl_transfer, 0xC0, 1, 0, 0, 80)
    fails(errno.ENODEV, device.clear_halt, IN)
    fails(errno.ENODEV, device.set_configuration)
    fails(errno.ENODEV, device.set_interface_altsetting, 0, 0)
    fails(errno.ENODEV, device.is_kernel_driver_active, 0)
    usb.util.dispose_resources(device)
    fails(errno.ENODEV, device.reset)


def test_dead_device_is_listed_once_more(bench):
    bench.backend.unplug()
    stale = bench.find()
    assert stale.address == 1
    fails(errno.ENODEV, stale.get_active_configuration)
    assert bench.find() is None
    bench.backend.plug()
    assert bench.find().address == 2


def test_plug_powers_the_board_up(bench):
    device = bench.find()
    device.write(OUT, bench.out(9), 10)
    bench.backend.plug()  # it is plugged in: nothing happens
    assert bench.board.next_in_ns() is not None
    bench.backend.unplug()
    bench.backend.unplug()
    bench.backend.plug()
    assert bench.board.next_in_ns() is None


def test_board_comes_back_when_it_is_time(bench):
    bench.backend.unplug(away_s=0.5)
    assert bench.find().address == 1  # stale
    assert bench.find() is None
    bench.clock.time_ns += 499_999_999
    assert bench.find() is None
    bench.clock.time_ns += 1
    assert bench.find().address == 2


def test_small_buffer_overflows(bench):
    device = bench.find()
    device.write(OUT, bench.out(), 10)
    fails(errno.EOVERFLOW, device.read, IN, array("B", bytes(8)), 10)


def test_halt_stays_until_it_is_cleared(bench):
    device = bench.find()
    device.write(OUT, bench.out(), 10)
    bench.backend.device.halted.add(IN)
    for _ in range(2):
        fails(errno.EPIPE, device.read, IN, bench.buffer, 10)
    device.write(OUT, bench.out(1), 10)  # the other endpoint works
    device.clear_halt(IN)
    assert device.read(IN, bench.buffer, 10) == 64


def test_reset_and_configuration_clear_halts(bench):
    for cure in (lambda device: device.reset(), lambda device: device.set_configuration()):
        device = bench.find()
        bench.backend.device.halted.add(IN)
        cure(device)
        assert not bench.backend.device.halted


def test_unknown_control_request_stalls(bench):
    fails(errno.EPIPE, bench.find().ctrl_transfer, 0xC0, 0x55, 0, 0, 8)
