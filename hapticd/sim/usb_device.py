"""The simulated board as seen by a real host controller: its descriptors and its transfers.

Descriptors (`device_descriptor`). They describe a full-speed device with one configuration, one
vendor interface, one OUT and one IN endpoint of one packet. For pyusb these are objects with the
fields of the USB 2.0 specification (chapter 9.6). On a bus they are bytes, which `_packed` makes
from the same objects. IndexError beyond the only one of a kind: pyusb's iteration relies on it.
Limitations: a second interface, or endpoints of several packets.

Transfers (`UsbDevice`). They end with data, end with an error, or stay pending. The pyusb backend
replaces libusb. Here the host's own USB stack is above, so this is one layer deeper: the standard
requests of endpoint 0 (USB 2.0, chapter 9.4), halts, and packets. Board and faults are the same:
`Port` is a BoardModel or an Injector around it, and its errors become those of a controller. EIO is
a broken transaction (EPROTO). A packet longer than the endpoint's is babble (EOVERFLOW). A hanging
firmware is an endpoint that answers NAK: the transfer waits until the host cancels it. Limitations:
a read of more than one packet, which the first packet ends here.
"""

import errno
import struct
from types import SimpleNamespace
from typing import Literal, NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.core.units import NS_PER_S
from hapticd.model.params import BoardParams
from hapticd.sim.board import GET_DESCRIPTOR, MANUFACTURER, PRODUCT, SERIAL, STRING
from hapticd.sim.injection import Port, TransferFault
from hapticd.usb.codec import VENDOR_CLASS, VENDOR_OUT
from hapticd.usb.frames import PACKET_BYTES, USB_PRODUCT_ID, USB_VENDOR_ID

__all__ = ["UsbDevice", "check_traits"]

# --- descriptors ----------------------------------------------------------------------------------

Transfer = Literal["bulk", "interrupt"]

OUT_ADDRESS = 0x01
IN_ADDRESS = 0x81
FULL_SPEED = 2
# bmAttributes, bInterval
_ATTRIBUTES: dict[Transfer, tuple[int, int]] = {"bulk": (2, 0), "interrupt": (3, 1)}


def device_descriptor(address: int) -> SimpleNamespace:
    """Return the 18 standard fields, and the position of the device on the bus."""
    return SimpleNamespace(
        bLength=18,
        bDescriptorType=1,
        bcdUSB=0x0200,
        bDeviceClass=VENDOR_CLASS,
        bDeviceSubClass=0,
        bDeviceProtocol=0,
        bMaxPacketSize0=64,
        idVendor=USB_VENDOR_ID,
        idProduct=USB_PRODUCT_ID,
        bcdDevice=0x0100,
        iManufacturer=MANUFACTURER,
        iProduct=PRODUCT,
        iSerialNumber=SERIAL,
        bNumConfigurations=1,
        address=address,
        bus=1,
        port_number=1,
        port_numbers=(1,),
        speed=FULL_SPEED,
    )


def configuration_descriptor(index: int) -> SimpleNamespace:
    """Return the configuration descriptor; IndexError beyond the only one."""
    _only("configuration", index)
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=2,
        wTotalLength=32,
        bNumInterfaces=1,
        bConfigurationValue=1,
        iConfiguration=0,
        bmAttributes=0x80,
        bMaxPower=250,
        extra_descriptors=[],
    )


def interface_descriptor(index: int, alternate: int) -> SimpleNamespace:
    """Return the interface descriptor; IndexError beyond the only one."""
    _only("interface", index)
    _only("alternate setting", alternate)
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=4,
        bInterfaceNumber=0,
        bAlternateSetting=0,
        bNumEndpoints=2,
        bInterfaceClass=VENDOR_CLASS,
        bInterfaceSubClass=0,
        bInterfaceProtocol=0,
        iInterface=0,
        extra_descriptors=[],
    )


def endpoint_descriptor(index: int, transfer: Transfer) -> SimpleNamespace:
    """Return the endpoint descriptor: OUT is 0, IN is 1; IndexError beyond them."""
    if index > 1:
        raise IndexError(f"Invalid endpoint index {index}")
    attributes, interval = _ATTRIBUTES[transfer]
    return SimpleNamespace(
        bLength=7,
        bDescriptorType=5,
        bEndpointAddress=(OUT_ADDRESS, IN_ADDRESS)[index],
        bmAttributes=attributes,
        wMaxPacketSize=PACKET_BYTES,
        bInterval=interval,
        bRefresh=0,
        bSynchAddress=0,
        extra_descriptors=[],
    )


DEVICE_LAYOUT = struct.Struct("<2BH4B3H4B")
CONFIGURATION_LAYOUT = struct.Struct("<2BH5B")
INTERFACE_LAYOUT = struct.Struct("<9B")
ENDPOINT_LAYOUT = struct.Struct("<4BHB")


def device_bytes() -> bytes:
    """Return the device descriptor as read from endpoint 0."""
    return _packed(DEVICE_LAYOUT, device_descriptor(0))


def configuration_bytes(transfer: Transfer) -> bytes:
    """Return the configuration with its interface and endpoints, as read from endpoint 0."""
    endpoints = [_packed(ENDPOINT_LAYOUT, endpoint_descriptor(i, transfer)) for i in range(2)]
    interface = _packed(INTERFACE_LAYOUT, interface_descriptor(0, 0))
    head = _packed(CONFIGURATION_LAYOUT, configuration_descriptor(0))
    return b"".join((head, interface, *endpoints))


def _packed(layout: struct.Struct, descriptor: SimpleNamespace) -> bytes:
    """Pack the standard fields, which come first and in the order of the bus."""
    fields = list(vars(descriptor).values())
    count = len(layout.unpack(bytes(layout.size)))
    return layout.pack(*fields[:count])


def _only(what: str, index: int) -> None:
    if index > 0:
        raise IndexError(f"Invalid {what} index {index}")


# --- transfers ------------------------------------------------------------------------------------

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
            DEVICE: device_bytes(),
            CONFIGURATION: configuration_bytes(transfer),
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
