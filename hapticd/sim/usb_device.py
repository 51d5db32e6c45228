"""The simulated board as seen by a real host controller: transfers end with data, end with an
error, or stay pending.

The pyusb backend replaces libusb. Here the host's own USB stack is above, so this is one layer
deeper: the standard requests of endpoint 0 (USB 2.0, chapter 9.4), halts, and packets. Board and
faults are the same: `Port` is a BoardModel or an Injector around it, and its errors become those of
a controller. EIO is a broken transaction (EPROTO), a packet longer than the endpoint's is babble
(EOVERFLOW), a hanging firmware is an endpoint that answers NAK: the transfer waits until the host
cancels it.

Limitations: a read of more than one packet, which the first packet ends here.
"""

import errno
import struct
from typing import NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.core.params import BoardParams
from hapticd.core.units import NS_PER_S
from hapticd.sim import descriptors
from hapticd.sim.board import GET_DESCRIPTOR, STRING
from hapticd.sim.descriptors import Transfer
from hapticd.sim.injection import Port, TransferFault
from hapticd.usb.codec import VENDOR_OUT
from hapticd.usb.frames import PACKET_BYTES

__all__ = ["UsbDevice", "check_traits"]

DEVICE = 0x01  # types of descriptors
CONFIGURATION = 0x02
IN_BIT = 0x80  # of an endpoint's address
TYPE_AND_RECIPIENT = 0x7F  # of bmRequestType
TO_ENDPOINT = 0x02
CLEAR_FEATURE = 0x01
SET_CONFIGURATION = 0x09
SET_INTERFACE = 0x0B
GET_STATUS = 0x00
GET_CONFIGURATION = 0x08
GET_INTERFACE = 0x0A
# properties of one machine's bus, not of the board: a real bus has its own
BUS_TRAITS = ("out_transport_us", "in_transport_us", "bus", "rights_s", "boot_loader_s")


class Setup(NamedTuple):
    """The eight bytes that begin a control transfer."""

    request_type: int
    request: int
    value: int
    place: int  # wIndex: an endpoint, an interface or a language
    length: int

    @classmethod
    def of(cls, data: bytes) -> "Setup":
        return cls(*struct.unpack("<BBHHH", data))


class UsbDevice:
    """The board behind `port` on a real bus. It answers vendor requests from `hello_s` after a
    plug.
    """

    def __init__(self, port: Port, transfer: Transfer = "bulk", hello_s: float = 0.0) -> None:
        self._port = port
        self._hello_ns = round(hello_s * NS_PER_S)
        self._plugged_ns = 0
        self._halted: set[int] = set()
        self.configuration = 0
        self._descriptors = {
            DEVICE: descriptors.device_bytes(),
            CONFIGURATION: descriptors.configuration_bytes(transfer),
        }

    def plug(self, t_ns: int) -> None:
        """Connect supply and bus: power up, not configured."""
        self._port.power_up()
        self._plugged_ns = t_ns
        self._halted.clear()
        self.configuration = 0

    def advance(self, t_ns: int) -> None:
        """Play the board up to `t_ns` without a transfer."""
        self._port.advance(t_ns)

    def next_in_ns(self) -> int | None:
        """Return when a waiting read may have its packet; None: not before the next write."""
        return self._port.next_in_ns()

    def control(self, setup: Setup, t_ns: int) -> bytes | None:
        """Return the reply, b"" after an OUT; None: not yet. TransferFault EPIPE: refused."""
        if setup.request_type & VENDOR_OUT and t_ns - self._plugged_ns < self._hello_ns:
            return None
        reply = self._standard(setup)
        if reply is None:
            request_type, request, value, _place, length = setup
            reply = self._port.control(request_type, request, value, length)
        if reply is None:
            raise TransferFault(errno.EPIPE)
        return reply[: setup.length]

    def _standard(self, setup: Setup) -> bytes | None:
        """Return the reply to a standard request; None for a request of the board itself."""
        kind = setup.request_type & TYPE_AND_RECIPIENT
        if kind > TO_ENDPOINT:
            return None
        if setup.request_type & IN_BIT:
            return self._told(kind, setup)
        if setup.request == CLEAR_FEATURE and kind == TO_ENDPOINT:
            self._halted.discard(setup.place & 0xFF)
        elif setup.request in (SET_CONFIGURATION, SET_INTERFACE):
            self._halted.clear()
            if setup.request == SET_CONFIGURATION:
                self.configuration = setup.value
        else:
            return None
        return b""

    def _told(self, kind: int, setup: Setup) -> bytes | None:
        if setup.request == GET_DESCRIPTOR and setup.value >> 8 != STRING:
            return self._descriptors.get(setup.value >> 8)
        halted = kind == TO_ENDPOINT and setup.place & 0xFF in self._halted
        return {
            GET_STATUS: bytes((halted, 0)),
            GET_CONFIGURATION: bytes((self.configuration,)),
            GET_INTERFACE: b"\0",
        }.get(setup.request)

    def write(self, endpoint: int, data: memoryview, t_ns: int) -> bool:
        """Receive an OUT transfer of any length; False: not accepted (NAK). TransferFault."""
        self._check(endpoint)
        try:
            for start in range(0, len(data) or 1, PACKET_BYTES):
                self._port.on_out(data[start : start + PACKET_BYTES], t_ns)
        except TransferFault as fault:
            self._fail(fault, endpoint)
            return False
        return True

    def read(self, endpoint: int, room: int, t_ns: int) -> bytes | None:
        """Return the IN packet for a waiting host; None: none yet (NAK). TransferFault."""
        self._check(endpoint)
        try:
            packet = self._port.poll_in(t_ns)
        except TransferFault as fault:
            self._fail(fault, endpoint)
            return None
        if packet is not None and len(packet) > min(room, PACKET_BYTES):
            raise TransferFault(errno.EOVERFLOW)
        return packet

    def _check(self, endpoint: int) -> None:
        if endpoint in self._halted:
            raise TransferFault(errno.EPIPE)

    def _fail(self, fault: TransferFault, endpoint: int) -> None:
        """Return if the endpoint only answers NAK."""
        if fault.number == errno.ETIMEDOUT:
            return
        if fault.number == errno.EPIPE:
            self._halted.add(endpoint)
        number = errno.EPROTO if fault.number == errno.EIO else fault.number
        raise TransferFault(number, fault.away_s) from fault


def check_traits(params: BoardParams) -> None:
    """Raise ConfigError if `params` contain properties that a real bus has itself."""
    for name in BUS_TRAITS:
        if getattr(params, name):
            raise ConfigError(
                f"simulation.{name} applies to the bus within one process; a real bus has its own"
                " properties: remove it"
            )
