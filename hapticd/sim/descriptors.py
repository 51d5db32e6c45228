"""USB descriptors of the simulated board: a full-speed device with one configuration, one vendor
interface, one OUT and one IN endpoint of one packet.

For pyusb these are objects with the fields of the USB 2.0 specification (chapter 9.6). On a bus
they are bytes, which `_packed` makes from the same objects. IndexError beyond the only one of a
kind: pyusb's iteration relies on it.

Limitations: a second interface, or endpoints of several packets.
"""

import struct
from types import SimpleNamespace
from typing import Literal

from hapticd.sim.board import MANUFACTURER, PRODUCT, SERIAL
from hapticd.usb.codec import VENDOR_CLASS
from hapticd.usb.frames import PACKET_BYTES, USB_PRODUCT_ID, USB_VENDOR_ID

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
