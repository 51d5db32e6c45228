"""A pyusb backend over the emulated board, on any clock. pyusb reads the descriptors that the chip
itself sends.

Before each transfer the chip runs up to the clock's time; after the transfer the clock advances to
the chip's time. A transfer takes its time on the emulated bus, and time-outs are counted in that
time. With a VirtualClock host and chip are in lock-step, independently of the load of the machine.
It also supports transfers in flight (`hapticd.usb.flight`).
"""

import errno
import struct
from array import array
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import usb.backend

from hapticd.core.units import NS_PER_MS, Clock
from hapticd.sim.bus import usb_error
from support.pico_plant import ADDRESS, Rig

DEVICE, CONFIGURATION, INTERFACE, ENDPOINT = 1, 2, 4, 5
STANDARD_IN, GET_DESCRIPTOR, SET_CONFIGURATION = 0x80, 6, 9
CLEAR_FEATURE, TO_ENDPOINT = 1, 2
FULL_SPEED = 2
LAYOUTS = {
    DEVICE: struct.Struct("<2BH4B3H4B"),
    CONFIGURATION: struct.Struct("<2BH5B"),
    INTERFACE: struct.Struct("<9B"),
    ENDPOINT: struct.Struct("<4BHB"),
}
FIELDS = {
    DEVICE: "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol"
    " bMaxPacketSize0 idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber"
    " bNumConfigurations",
    CONFIGURATION: "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue"
    " iConfiguration bmAttributes bMaxPower",
    INTERFACE: "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints"
    " bInterfaceClass bInterfaceSubClass bInterfaceProtocol iInterface",
    ENDPOINT: "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval",
}
ENDLESS_MS = 10_000
REQUEST_MS = 1000
# errno of the controller: its value in libusb
AS_LIBUSB = {errno.EPROTO: errno.EIO, errno.ESHUTDOWN: errno.ENODEV}
PENDING = -1
PACKET = 64


def failure(status: int) -> Exception:
    """Return the exception of pyusb for a transfer that ended with `status`, a negative errno."""
    return usb_error(AS_LIBUSB.get(-status, -status))


class PicoBackend(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """The board of `rig` at the bus of a host with the time of `clock`."""

    def __init__(self, rig: Rig, clock: Clock) -> None:
        self.rig = rig
        self.clock = clock
        self.flight: PicoFlight | None = None
        self.plug()

    def plug(self) -> None:
        """Enumerate the board as Linux does. AssertionError if it does not answer."""
        self._unplugs = self.rig.chip.state.unplugs
        assert self.rig.plug(), f"no board: {self.rig.chip.complaints()}"
        self.offset_ns = self.rig.now_ns - self.clock.now_ns()
        self.device = object()
        self._raw = {DEVICE: self._get(DEVICE, LAYOUTS[DEVICE].size)}
        head = self._get(CONFIGURATION, LAYOUTS[CONFIGURATION].size)
        (size,) = struct.unpack_from("<H", head, 2)
        self._raw[CONFIGURATION] = self._get(CONFIGURATION, size)
        self.set_configuration(None, self._raw[CONFIGURATION][5])

    def _get(self, kind: int, size: int) -> bytes:
        return self._request(STANDARD_IN, GET_DESCRIPTOR, kind << 8, 0, size)

    # --- time -------------------------------------------------------------------------------------
    def follow(self) -> None:
        """The chip lives up to the clock's now."""
        self.rig.advance(self.clock.now_ns() + self.offset_ns)

    def lead(self) -> None:
        """The host waits until the chip's now."""
        self.clock.sleep_until_ns(round(self.rig.now_ns - self.offset_ns))

    def check(self) -> None:
        """USBError ENODEV if the board has left the bus."""
        if self.rig.chip.state.unplugs != self._unplugs:
            raise usb_error(errno.ENODEV)

    def _end(self, number: int, timeout_ms: int) -> bytes:
        result = self.rig.wait(number, (timeout_ms or ENDLESS_MS) * NS_PER_MS)
        self.lead()
        if result.status:
            raise failure(result.status)
        return result.data

    def _request(self, *setup: int, timeout_ms: int = REQUEST_MS) -> bytes:
        self.follow()
        self.check()
        raw = struct.pack("<BBHHH", *setup)
        return self._end(self.rig.chip.submit(0, setup[-1], b"", raw), timeout_ms)

    # --- interface of pyusb -----------------------------------------------------------------------
    def enumerate_devices(self) -> Iterator[object]:
        if self.rig.chip.state.unplugs != self._unplugs:  # it has left and returned
            self.follow()
            self.plug()
        return iter([self.device])

    def get_parent(self, _device: object) -> None:
        return None

    def _described(self, kind: int, index: int, **more: Any) -> SimpleNamespace:
        """IndexError past the last of a kind."""
        raw = self._raw.get(kind) or self._within(kind)[index]
        values = LAYOUTS[kind].unpack_from(raw)
        return SimpleNamespace(**dict(zip(FIELDS[kind].split(), values, strict=True)), **more)

    def _within(self, kind: int) -> list[bytes]:
        raw = self._raw[CONFIGURATION]
        found = []
        while raw:
            if raw[1] == kind:
                found.append(raw[: raw[0]])
            raw = raw[raw[0] :]
        return found

    def get_device_descriptor(self, _device: object) -> SimpleNamespace:
        place = {"address": ADDRESS, "bus": 1, "port_number": 1, "port_numbers": (1,)}
        return self._described(DEVICE, 0, **place, speed=FULL_SPEED)

    def get_configuration_descriptor(self, _device: object, index: int) -> SimpleNamespace:
        if index:
            raise IndexError(index)
        return self._described(CONFIGURATION, 0, extra_descriptors=[])

    def get_interface_descriptor(
        self, _device: object, index: int, alternate: int, _configuration: int
    ) -> SimpleNamespace:
        if alternate:
            raise IndexError(alternate)
        return self._described(INTERFACE, index, extra_descriptors=[])

    def get_endpoint_descriptor(
        self, _device: object, index: int, _i: int, _a: int, _c: int
    ) -> SimpleNamespace:
        return self._described(ENDPOINT, index, bRefresh=0, bSynchAddress=0, extra_descriptors=[])

    def open_device(self, device: object) -> object:
        if device is not self.device:
            raise usb_error(errno.ENODEV)
        self.check()
        return device

    def close_device(self, _handle: object) -> None:
        return None

    def get_configuration(self, _handle: object) -> int:
        return self.configuration

    def set_configuration(self, _handle: object, value: int) -> None:
        self._request(0, SET_CONFIGURATION, value, 0, 0)
        self.configuration = value

    def claim_interface(self, _handle: object, _interface: int) -> None:
        return None

    def release_interface(self, _handle: object, _interface: int) -> None:
        return None

    def is_kernel_driver_active(self, _handle: object, _interface: int) -> bool:
        return False

    def clear_halt(self, _handle: object, endpoint: int) -> None:
        self._request(TO_ENDPOINT, CLEAR_FEATURE, 0, endpoint, 0)

    # --- transfers --------------------------------------------------------------------------------
    def ctrl_transfer(
        self,
        _handle: object,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: "array[int]",
        timeout_ms: int,
    ) -> int:
        setup = (request_type, request, value, index, len(data))
        reply = self._request(*setup, timeout_ms=timeout_ms)
        memoryview(data)[: len(reply)] = reply
        return len(reply) if request_type & STANDARD_IN else len(data)

    def bulk_write(
        self, _handle: object, endpoint: int, _interface: int, data: "array[int]", timeout_ms: int
    ) -> int:
        self.follow()
        self.check()
        self._end(self.rig.chip.submit(endpoint, 0, bytes(data)), timeout_ms)
        return len(data)

    def bulk_read(
        self, _handle: object, endpoint: int, _interface: int, buffer: "array[int]", timeout_ms: int
    ) -> int:
        self.follow()
        self.check()
        reply = self._end(self.rig.chip.submit(endpoint, len(buffer)), timeout_ms)
        memoryview(buffer)[: len(reply)] = reply
        return len(reply)

    def transfers(self, out_endpoint: int, in_endpoint: int) -> "PicoFlight":
        """One OUT and one IN, submitted and reaped (`link.flight`)."""
        self.flight = PicoFlight(self, out_endpoint, in_endpoint)
        return self.flight


class PicoFlight:
    """At most one OUT and one IN in flight while the host continues."""

    def __init__(self, backend: PicoBackend, out_endpoint: int, in_endpoint: int) -> None:
        self._backend = backend
        self._chip = backend.rig.chip
        self._ends = (out_endpoint, in_endpoint)
        self._out: int | None = None
        self._in: int | None = None

    def submit_out(self, data: "array[int]") -> None:
        self._begin()
        self._out = self._chip.submit(self._ends[0], 0, bytes(data))

    def submit_in(self) -> None:
        self._begin()
        self._in = self._chip.submit(self._ends[1], PACKET)

    def _begin(self) -> None:
        self._backend.follow()
        self._backend.check()

    def out_done(self, wait_ns: int) -> bool:
        assert self._out is not None
        if not self._ended(self._out, wait_ns):
            return False
        number, self._out = self._out, None
        status = self._chip.results.pop(number).status
        if status:
            raise failure(status)
        return True

    def in_done(self, buffer: "array[int]", wait_ns: int) -> int:
        assert self._in is not None
        if not self._ended(self._in, wait_ns):
            return PENDING
        number, self._in = self._in, None
        result = self._chip.results.pop(number)
        if result.status:
            raise failure(result.status)
        memoryview(buffer)[: len(result.data)] = result.data
        return len(result.data)

    def _ended(self, number: int, wait_ns: int) -> bool:
        """Whether a transfer has ended, after waiting for `wait_ns` at most."""
        backend = self._backend
        results = self._chip.results
        backend.follow()
        if number not in results and wait_ns:
            rig = backend.rig
            rig.advance(rig.now_ns + wait_ns, lambda: number in results)
            backend.lead()
        return number in results

    def clear_halt(self, endpoint: int) -> None:
        self._backend.clear_halt(None, endpoint)

    def cancel(self) -> None:
        for number in (self._out, self._in):
            if number is not None:
                self._chip.cancel(number)
        self._out = self._in = None
