"""The USB link over the true usb.core and the simulated board: every way in which it can fail,
and how it comes back.
"""

import sys
import types
from array import array

import pytest
import usb.backend.libusb1
from support.boards import ENABLE, LATCH_NS, TICK_NS, board_params, out_packet

from hapticd.core.errors import (
    ConfigError,
    LinkAccess,
    LinkLost,
    LinkStalled,
    LinkTimeout,
    MissingLibrary,
)
from hapticd.core.params import UsbParams
from hapticd.core.units import VirtualClock
from hapticd.model.params import InjectionParams
from hapticd.sim.backend import SimulatedBackend
from hapticd.sim.board import BoardModel
from hapticd.sim.bus import usb_error
from hapticd.sim.injection import with_injections
from hapticd.usb import codec
from hapticd.usb.codec import backoff_s
from hapticd.usb.frames import Request, StatusBit
from hapticd.usb.link import FAILURES, UsbLink, link_error, system_backend


class Backend(SimulatedBackend):
    """Counts what the link must not do, and fails where a test says so."""

    configured = 0
    refuse = None  # name of a method and the exception it raises

    def set_configuration(self, handle, value):
        self.configured += 1
        super().set_configuration(handle, value)

    def get_interface_descriptor(self, device, index, alternate, configuration):
        found = super().get_interface_descriptor(device, index, alternate, configuration)
        found.bInterfaceClass = self.interface_class
        return found

    interface_class = 0xFF

    def get_configuration(self, handle):
        self._may("configuration")
        return super().get_configuration(handle)

    def _may(self, name):
        if self.refuse is not None and self.refuse[0] == name:
            raise self.refuse[1]

    def enumerate_devices(self):
        self._may("enumerate")
        return super().enumerate_devices()

    def clear_halt(self, handle, endpoint):
        self._may("clear_halt")
        super().clear_halt(handle, endpoint)

    def is_kernel_driver_active(self, handle, interface):
        self._may("kernel_driver")
        return super().is_kernel_driver_active(handle, interface)

    def ctrl_transfer(self, handle, *setup):
        self._may("control")
        return super().ctrl_transfer(handle, *setup)

    def release_interface(self, handle, interface):
        self._may("release")
        super().release_interface(handle, interface)

    def bulk_read(self, *arguments):
        self._may("read")
        return super().bulk_read(*arguments)

    intr_read = bulk_read

    def transfers(self, *endpoints):
        flight = super().transfers(*endpoints)
        done = flight.in_done

        def in_done(*arguments):
            self._may("read")
            return done(*arguments)

        flight.in_done = in_done
        return flight


class Bench:
    """A board with its injections, a clock, and a link that is open unless asked otherwise."""

    in_flight = False  # set by the fixture below

    def __init__(self, *injections, transfer="bulk", opened=True, **usb):
        params = board_params(injections=injections)
        self.clock, self.board = VirtualClock(), BoardModel(params)
        self.backend = Backend(with_injections(self.board, params), self.clock, transfer)
        params = UsbParams(**{"in_flight": self.in_flight, **usb})
        self.link = UsbLink(params, self.backend)
        self.buffer = array("B", bytes(64))
        self.tick = 0
        if opened:
            self.link.open()

    def write(self):
        self.link.write(array("B", bytes(out_packet(self.tick & 0xFFFF, flags=ENABLE))))
        self.tick += 1

    def pair(self):
        self.write()
        count = self.link.read(self.buffer)
        self.clock.sleep_until_ns(self.tick * TICK_NS)
        return codec.decode_in(memoryview(self.buffer)[:count])


@pytest.fixture(params=[False, True], ids=["in_turn", "in_flight"], autouse=True)
def path(request, monkeypatch):
    """Every case over both ways of transfers."""
    monkeypatch.setattr(Bench, "in_flight", request.param)


@pytest.fixture
def bench(path):
    return Bench()


# --- finding and opening --------------------------------------------------------------------------
@pytest.mark.parametrize("transfer", ["bulk", "interrupt"])
def test_endpoints_come_from_the_descriptors(transfer):
    bench = Bench(transfer=transfer)
    assert [bench.pair().echo for _ in range(3)] == [0, 1, 2]


class WithoutContext:
    """A pyusb device that has another name for its private context."""

    def __init__(self, device):
        self.device = device

    def __getattr__(self, name):
        if name == "_ctx":
            raise AttributeError(name)
        return getattr(self.device, name)


@pytest.fixture
def without_context(monkeypatch):
    """Such a pyusb; only its own functions know the context."""
    find = usb.core.find

    def found(**asked):
        return map(WithoutContext, find(**asked))

    monkeypatch.setattr(usb.core, "find", found)
    for name in ("claim_interface", "dispose_resources"):
        own = getattr(usb.util, name)

        def inside(device, *more, own=own):
            return own(device.device, *more)

        monkeypatch.setattr(usb.util, name, inside)


@pytest.mark.parametrize("path", [False], indirect=True, ids=["in_turn"])
@pytest.mark.parametrize("transfer", ["bulk", "interrupt"])
def test_pyusb_without_its_private_context_transfers_by_its_own_calls(without_context, transfer):
    bench = Bench(InjectionParams("drop_in", tick=2), transfer=transfer, timeout_ms=2)
    assert [bench.pair().echo for _ in range(2)] == [0, 1]
    with pytest.raises(LinkTimeout):
        bench.pair()


def test_configured_board_is_not_configured_again(bench):
    bench.pair()
    assert bench.backend.configured == 0


def test_unconfigured_board_is_configured_once():
    bench = Bench(opened=False)
    bench.backend.device.configuration = 0
    bench.link.open()
    bench.pair()
    assert bench.backend.configured == 1


def test_hello_is_read_through_the_link(bench):
    hello = codec.decode_hello(bench.link.request(Request.HELLO, 80))
    assert hello.serial == "SIM0001"


def test_clear_fault_is_sent_through_the_link(bench):
    bench.board.trip(int(StatusBit.ENCODER_FAULT))
    bench.board.heal(int(StatusBit.ENCODER_FAULT))
    assert bench.pair().status & StatusBit.ENCODER_FAULT
    assert bench.link.request(Request.CLEAR_FAULT) == b""
    assert not bench.pair().status & StatusBit.ENCODER_FAULT


def test_serial_number_selects_the_board():
    assert Bench(serial="SIM0001").pair().echo == 0
    with pytest.raises(
        LinkLost,
        match=r"no board 1209:0001 with serial SIM0002 at the bus; plug it in, or correct \[usb\]",
    ):
        Bench(serial="SIM0002")


def test_other_product_is_not_ours():
    with pytest.raises(LinkLost, match=r"no board 1209:0002 at the bus"):
        Bench(product_id=2)


@pytest.mark.parametrize("descriptor", [b"", b"\x04\x03\x00\xd8"])
def test_foreign_device_without_a_serial_is_passed_over(descriptor):
    bench = Bench(opened=False, serial="SIM0001")
    bench.board._replies[0x80, 6, 0x0303] = descriptor
    with pytest.raises(LinkLost, match="no board 1209:0001 with serial SIM0001"):
        bench.link.open()


def test_device_without_vendor_interface_is_refused():
    bench = Bench(opened=False)
    bench.backend.interface_class = 0x03
    with pytest.raises(
        LinkLost, match=r"no vendor interface with a bulk or interrupt OUT and IN endpoint"
    ):
        bench.link.open()
    assert bench.backend.device.owner is None


def test_opening_twice_is_opening_anew(bench):
    bench.pair()
    bench.link.open()
    assert bench.pair().echo == 1


def test_board_of_another_program_is_left_alone(bench):
    rival = UsbLink(UsbParams(), bench.backend)
    with pytest.raises(
        LinkAccess,
        match=r"cannot open the board: Resource busy \(errno 16\); another program has claimed",
    ):
        rival.open()
    assert bench.pair().echo == 0
    bench.link.close()
    rival.open()


@pytest.mark.parametrize("serial", [None, "SIM0001"])
def test_missing_rights_name_the_udev_rule(serial):
    bench = Bench(opened=False, serial=serial)
    bench.backend.access_denied = True
    with pytest.raises(
        LinkAccess,
        match=r"Access denied \(insufficient permissions\) \(errno 13\); as root run `hapticd inst",
    ):
        bench.link.open()


def test_bound_kernel_driver_is_detached():
    bench = Bench(opened=False)
    bench.backend.kernel_driver = True
    bench.link.open()
    assert bench.backend.kernel_driver is False


@pytest.mark.parametrize("number", [38, 2])  # not supported on this platform; none bound after all
def test_platform_without_kernel_drivers_opens(number):
    bench = Bench(opened=False)
    bench.backend.refuse = "kernel_driver", usb_error(number)
    bench.link.open()
    assert bench.pair().echo == 0


@pytest.mark.parametrize("where", ["kernel_driver", "enumerate", "configuration"])
def test_failure_while_opening_is_lost(where):
    bench = Bench(opened=False)
    bench.backend.refuse = where, usb_error(5)
    with pytest.raises(LinkLost, match=r"Input/Output Error \(errno 5\)"):
        bench.link.open()
    assert bench.backend.configured == 0
    assert bench.backend.device.owner is None


def test_endless_time_out_is_refused():
    with pytest.raises(ConfigError, match=r"usb timeout_ms 0 ms: 1 ms is the shortest"):
        UsbLink(UsbParams(timeout_ms=0), object())


# --- closing --------------------------------------------------------------------------------------
def test_closed_link_says_so(bench):
    bench.link.close()
    bench.link.close()
    for call in (
        bench.write,
        lambda: bench.link.read(bench.buffer),
        lambda: bench.link.request(Request.HELLO, 80),
    ):
        with pytest.raises(LinkLost, match="the link is not open; open it first"):
            call()
    assert bench.backend.device.owner is None


@pytest.mark.parametrize("error", [usb_error(19), usb_error(38)])
def test_close_never_raises(bench, error):
    bench.pair()
    bench.backend.refuse = "release", error
    bench.link.close()


# --- faults of the cable --------------------------------------------------------------------------
def test_missing_in_is_a_time_out():
    bench = Bench(InjectionParams("drop_in", tick=1), timeout_ms=2)
    bench.pair()
    start_ns = bench.clock.now_ns()
    with pytest.raises(
        LinkTimeout,
        match=r"cannot read endpoint 0x81: Operation timed out \(errno 110\); the tick goes on",
    ):
        bench.pair()
    assert bench.clock.now_ns() == start_ns + 2_000_000
    assert bench.pair().echo == 2


def test_missing_out_is_a_time_out_of_the_in():
    bench = Bench(InjectionParams("drop_out", tick=1))
    bench.pair()
    with pytest.raises(LinkTimeout, match="errno 110"):
        bench.pair()
    assert bench.pair().status & StatusBit.SEQ_GAP


def test_late_in_is_waited_for_within_the_time_out():
    bench = Bench(InjectionParams("late", tick=0, value=0.001), timeout_ms=2)
    assert bench.pair().board_time_us == 1875
    assert bench.clock.now_ns() == LATCH_NS + 1_000_000


def test_delayed_in_comes_in_a_later_tick():
    bench = Bench(InjectionParams("delay_in", tick=1, value=0.003), timeout_ms=1)
    bench.pair()
    with pytest.raises(LinkTimeout, match="errno 110"):
        bench.pair()
    bench.clock.time_ns += 2_000_000
    assert bench.pair().echo == 1  # stale: sequence numbers tell
    assert bench.pair().echo == 2  # one behind, until someone reads once more
    bench.link.read(bench.buffer)
    assert codec.decode_in(bench.buffer).echo == 3


@pytest.mark.parametrize(
    ("kind", "action", "endpoint"), [("stall_in", "read", "0x81"), ("stall_out", "write", "0x01")]
)
def test_stall_is_cleared_once(kind, action, endpoint):
    bench = Bench(InjectionParams(kind, tick=1))
    bench.pair()
    pattern = (
        rf"cannot {action} endpoint {endpoint}: Pipe error \(errno 32\); the halt is cleared once"
    )
    with pytest.raises(LinkStalled, match=pattern):
        bench.pair()
    assert not bench.backend.device.halted
    assert bench.pair().echo == bench.tick - 1


@pytest.mark.parametrize("kind", ["stall_in", "stall_out", "babble"])
def test_second_stall_in_a_row_is_lost(kind):
    bench = Bench(InjectionParams(kind, tick=1, count=2))
    bench.pair()
    with pytest.raises(LinkStalled):
        bench.pair()
    with pytest.raises(
        LinkLost, match=r"it stalled again after that: unplug the board and plug it in"
    ):
        bench.pair()


@pytest.mark.parametrize("kind", ["stall_in", "stall_out"])
def test_stalls_apart_are_cleared_each(kind):
    bench = Bench(InjectionParams(kind, tick=1), InjectionParams(kind, tick=3))
    for stalled in (False, True, False, True, False):
        if stalled:
            with pytest.raises(LinkStalled):
                bench.pair()
        else:
            bench.pair()


def test_babble_is_an_overflow():
    bench = Bench(InjectionParams("babble", tick=0))
    with pytest.raises(
        LinkStalled,
        match=r"cannot read endpoint 0x81: Overflow \(errno 75\); more than a packet came",
    ):
        bench.pair()
    assert bench.pair().echo == 1


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (usb_error(5), r"Input/Output Error \(errno 5\)"),
        (usb_error(38), r"not supported .* \(errno None\)"),
    ],
)
def test_halt_that_cannot_be_cleared_is_lost(error, words):
    bench = Bench(InjectionParams("stall_in", tick=0))
    bench.backend.refuse = "clear_halt", error
    with pytest.raises(LinkLost, match=rf"cannot clear the halt of endpoint 0x81: .*{words}"):
        bench.pair()


def test_disturbed_bus_is_lost_as_an_unplug_is():
    bench = Bench(InjectionParams("io_error", tick=1))
    bench.pair()
    with pytest.raises(
        LinkLost,
        match=r"cannot write endpoint 0x01: Input/Output Error \(errno 5\); it is opened again",
    ):
        bench.pair()


@pytest.mark.parametrize("number", [12, 4, 22])
def test_any_other_error_is_lost(bench, number):
    bench.backend.refuse = "read", usb_error(number)
    with pytest.raises(
        LinkLost, match=rf"cannot read endpoint 0x81: .* \(errno {number}\); it is opened again"
    ):
        bench.pair()


def test_not_supported_is_lost(bench):
    bench.backend.refuse = "read", usb_error(38)
    with pytest.raises(
        LinkLost, match=r"Operation not supported or unimplemented on this platform \(errno None\)"
    ):
        bench.pair()


@pytest.mark.parametrize(
    ("number", "kind"), [(32, LinkStalled), (110, LinkTimeout), (19, LinkLost), (38, LinkLost)]
)
def test_failed_request_names_the_request(bench, number, kind):
    bench.backend.refuse = "control", usb_error(number)
    with pytest.raises(kind, match="cannot request HELLO: "):
        bench.link.request(Request.HELLO, 80)


def test_damaged_frames_reach_the_codec():
    bench = Bench(InjectionParams("short_in", tick=0, value=40))
    bench.write()
    assert bench.link.read(bench.buffer) == 40


# --- unplugged and back ---------------------------------------------------------------------------
def test_unplug_is_lost_at_both_ends(bench):
    bench.pair()
    bench.backend.unplug()
    with pytest.raises(
        LinkLost, match=r"cannot write endpoint 0x01: No such device .* \(errno 19\)"
    ):
        bench.write()
    with pytest.raises(
        LinkLost, match=r"cannot read endpoint 0x81: No such device .* \(errno 19\)"
    ):
        bench.link.read(bench.buffer)
    bench.link.close()


@pytest.mark.parametrize("serial", [None, "SIM0001"])
def test_board_is_opened_again_after_a_re_plug(serial):
    bench = Bench(InjectionParams("unplug", tick=2, value=0.3), serial=serial)
    bench.pair()
    bench.pair()
    with pytest.raises(LinkLost, match="errno 5"):
        bench.pair()
    with pytest.raises(LinkLost, match="errno 19"):
        bench.pair()
    failures = []
    for attempt in range(10):
        try:
            bench.link.open()
            break
        except LinkLost as error:
            failures.append(str(error))
            bench.clock.time_ns += round(backoff_s(attempt) * 1e9)
    assert "errno 19" in failures[0]  # the dead board is listed once more
    assert all("no board 1209:0001" in words for words in failures[1:])
    assert len(failures) == 3  # 0.05 + 0.1 + 0.2 s
    assert bench.backend.device.address == 2
    bench.tick = 0
    assert bench.pair().board_time_us == 875


def test_live_board_is_found_behind_a_stale_one():
    bench = Bench(serial="SIM0001")
    bench.backend.unplug()
    bench.backend.plug()
    bench.link.open()
    assert bench.pair().echo == 0


# --- tables ---------------------------------------------------------------------------------------
def test_backoff_doubles_to_a_second():
    assert [backoff_s(attempt) for attempt in (0, 1, 2, 3, 4, 5, 1000)] == [
        0.05,
        0.1,
        0.2,
        0.4,
        0.8,
        1.0,
        1.0,
    ]


def test_every_known_errno_has_its_class():
    kinds = {
        110: LinkTimeout,
        32: LinkStalled,
        75: LinkStalled,
        5: LinkLost,
        19: LinkLost,
        2: LinkAccess,
        13: LinkAccess,
        16: LinkAccess,
    }
    assert {number: kind for number, (kind, _) in FAILURES.items()} == kinds
    for number, kind in kinds.items():
        assert type(link_error("try", usb_error(number))) is kind


# --- libusb of the system -------------------------------------------------------------------------
def test_system_libusb_comes_first(monkeypatch):
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: "system")
    assert system_backend() == "system"


def test_packaged_libusb_comes_second(monkeypatch):
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: None)
    package = types.SimpleNamespace(get_libusb1_backend=lambda: "packaged")
    monkeypatch.setitem(sys.modules, "libusb_package", package)
    assert system_backend() == "packaged"
    package.get_libusb1_backend = lambda: None
    with pytest.raises(ConfigError, match=r"libusb 1\.0 is there but cannot be loaded"):
        system_backend()


def test_missing_libusb_names_what_to_install(monkeypatch):
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: None)
    monkeypatch.setitem(sys.modules, "libusb_package", None)
    with pytest.raises(MissingLibrary) as missing:
        UsbLink(UsbParams())
    assert missing.value.requirement.startswith("libusb-package>=")


class EventFed:
    """Lists what was at the bus when it was made, as Debian's libusb does where udev's messages
    do not come; `lib` is the bus.
    """

    def __init__(self, lib):
        self.lib = lib
        self.listed = list(lib.enumerate_devices())

    def enumerate_devices(self):
        return iter(self.listed)

    def __getattr__(self, name):
        return getattr(self.lib, name)


def test_board_that_is_plugged_in_late_and_again_is_found_without_messages_of_udev(monkeypatch):
    bus = Bench(opened=False).backend
    bus.unplug()
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: EventFed(bus))
    link = UsbLink(UsbParams(serial="SIM0001", in_flight=False))  # its device node is none
    for _ in range(2):
        list(bus.enumerate_devices())  # a dead device is listed once more
        with pytest.raises(LinkLost, match="no board"):
            link.open()
        bus.plug()
        link.open()
        link.write(array("B", bytes(out_packet(0))))
        bus.unplug()
