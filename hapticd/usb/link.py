"""The USB link: the one product file that uses pyusb; a simulated board is a backend of it.

The board is found by vendor, product and serial number; the endpoints, bulk or interrupt, are those
of the vendor interface. A board that has a configuration keeps it: setting it again would reset its
toggles and its firmware. Both buffers are array('B'), which pyusb passes on without a copy. Every
time-out is finite, because a blocked read cannot be cancelled.

Every failure of pyusb becomes a LinkError by the table FAILURES. Its numbers are those that pyusb
reports on Linux. 5 (the bus failed) often precedes the hub's report of an unplug, so it is treated
as 19 (no such device). 2 belongs to a device that the kernel has de-authorised. libusb's "not
supported" has no number and counts as lost. A halted endpoint is cleared once; if its next transfer
stalls again the board counts as lost. After LinkLost the caller closes, waits `backoff_s(attempt)`
and opens again: for a moment after an unplug the dead board is still listed, and its opening fails
with LinkLost too.

Each search for the board has its own libusb context. A context lists the devices that were present
when it was created. Later it learns of others from udev's messages alone, which reach no container
without udevd and no network namespace (PrivateNetwork=).

Threads must not share a device. A time-out is not a clock, because libusb fires late. A device must
not outlive its context by more than one search.
"""

import errno
from array import array
from collections.abc import Callable, Mapping
from typing import Any

import usb.core
import usb.util

from hapticd.core.errors import (
    ConfigError,
    LinkAccess,
    LinkError,
    LinkLost,
    LinkStalled,
    LinkTimeout,
)
from hapticd.core.params import UsbParams
from hapticd.usb.codec import ENGLISH_US, VENDOR_CLASS, VENDOR_IN, VENDOR_OUT, Link
from hapticd.usb.flight import End, InFlight, OutFailed, Transfers, UsbfsTransfers
from hapticd.usb.frames import Request

__all__ = ["UsbLink"]


_AGAIN = "it is opened again when it comes back; check plug, cable and hub"
_RIGHTS = (
    "as root run `hapticd install-system --root /` and follow its output, join group hapticd"
    " (`usermod --append --groups hapticd NAME`, then log in again), plug the board in again"
)
_PUT_ASIDE = (
    "the kernel lists the board but no program can open it: it was de-authorized, by USBGuard or by"
    " hand; allow it there, or write 1 into its `authorized` in /sys/bus/usb/devices"
)
_OWNER = "another program has claimed the board: stop it and try again"

# meaning and remedy of an errno
FAILURES: dict[int | None, tuple[type[LinkError], str]] = {
    errno.ETIMEDOUT: (LinkTimeout, "the tick goes on without the frame"),
    errno.EPIPE: (LinkStalled, "the halt is cleared once"),
    errno.EOVERFLOW: (
        LinkStalled,
        "more than a packet came; the halt is cleared once, check the board's firmware",
    ),
    errno.EIO: (LinkLost, _AGAIN),
    errno.ENODEV: (LinkLost, _AGAIN),
    errno.ENOENT: (LinkAccess, _PUT_ASIDE),
    errno.EACCES: (LinkAccess, _RIGHTS),
    errno.EBUSY: (LinkAccess, _OWNER),
}
OTHERWISE = (LinkLost, _AGAIN)
NO_OTHERS: Mapping[int, str] = {}
Transfer = Callable[[int, "array[int]", int], int]  # endpoint, buffer, time-out [ms] -> bytes


# of requests to endpoint 0, which halts for one transfer only
REQUEST_REMEDIES = {
    errno.ETIMEDOUT: "the board is slow to answer, or hangs; it is asked again",
    errno.EPIPE: "the board does not know the request: is it in its boot loader, or another board?",
}


def link_error(action: str, error: Exception, remedies: Mapping[int, str] = NO_OTHERS) -> LinkError:
    """Return the LinkError for `error`, which pyusb raised while trying to `action`.

    `remedies` by errno replace those of FAILURES. Raise it from `error`.
    """
    number = getattr(error, "errno", None)
    kind, remedy = FAILURES.get(number, OTHERWISE)
    remedy = remedies.get(number or 0, remedy)
    return kind(
        f"cannot {action}: {getattr(error, 'strerror', None) or error} (errno {number}); {remedy}"
    )


CONTROL_TIMEOUT_MS = 100  # three bus transactions, never within a tick
FRAME_TRANSFERS = (usb.util.ENDPOINT_TYPE_BULK, usb.util.ENDPOINT_TYPE_INTR)
DEVICE_ERRORS = (usb.core.USBError, NotImplementedError)  # the latter: libusb's "not supported"


def system_backend() -> Any:
    """Return the libusb of the system, or the one of libusb-package.

    MissingLibrary: neither is installed. ConfigError: it cannot be loaded.
    """
    from usb.backend import libusb1  # loads ctypes and the library: not for a simulated board

    backend = libusb1.get_backend()
    if backend is None:
        from hapticd.core.extras import need  # it reads metadata: not for a simulated board

        backend = need("libusb_package", "a USB board").get_libusb1_backend()
    if backend is None:
        raise ConfigError("libusb 1.0 is there but cannot be loaded; reinstall libusb-1.0-0")
    return backend


class UsbLink(Link):
    """The board that `params` describe at the bus of `backend`; None: the system's libusb."""

    def __init__(self, params: UsbParams, backend: Any = None) -> None:
        if params.timeout_ms < 1:
            raise ConfigError(
                f"usb timeout_ms {params.timeout_ms} ms: 1 ms is the shortest, 0 would wait for"
                " ever"
            )
        self._params = params
        self._system = system_backend() if backend is None else None
        self._backend = backend
        self._timeout_ms = params.timeout_ms
        self._device: Any = None
        self._forget()

    def _forget(self) -> None:
        self._device = None
        # replaces a test in every transfer whether the link is open
        self._read = self._write = _not_open
        self._clear_halt: Callable[[int], object] = _not_open
        self._flight: InFlight | None = None
        self.in_flight = False
        self._in = self._out = 0
        self._halted: set[int] = set()  # endpoints whose last transfer stalled

    def open(self) -> None:
        # a lost board leaves a dead handle
        self.close()
        self._device = device = self._find()
        try:
            self._take(device)
        except DEVICE_ERRORS as error:
            self.close()
            raise link_error("open the board", error) from error
        except LinkError:
            self.close()
            raise

    def close(self) -> None:
        device = self._device
        flight = self._flight
        # before the device is disposed of: the link is closed even if that fails
        self._forget()
        if flight is not None:
            flight.close(self._timeout_ms, DEVICE_ERRORS)
        if device is not None:
            _dispose(device)

    def drain(self) -> None:
        if self._flight is not None:
            self._flight.drain(self._timeout_ms)

    def read(self, buffer: "array[int]") -> int:
        try:
            count = self._read(self._in, buffer, self._timeout_ms)
        except DEVICE_ERRORS as error:
            raise self._transfer_failure("read", self._in, error) from error
        except OutFailed as failed:
            raise self._transfer_failure("write", self._out, failed.error) from failed
        # only two stalls in a row mean that the board is lost
        if self._halted:
            self._halted.discard(self._in)
            if self.in_flight:  # the OUT before has arrived, otherwise the IN could not be read
                self._halted.discard(self._out)
        return count

    def write(self, buffer: "array[int]") -> None:
        try:
            self._write(self._out, buffer, self._timeout_ms)
        except DEVICE_ERRORS as error:
            raise self._transfer_failure("write", self._out, error) from error
        except OutFailed as failed:
            raise self._transfer_failure("write", self._out, failed.error) from failed
        if self._halted and not self.in_flight:
            self._halted.discard(self._out)

    def request(self, request: Request, length: int = 0, value: int = 0) -> bytes:
        if self._device is None:
            _not_open()
        try:
            if length:
                reply = self._device.ctrl_transfer(
                    VENDOR_IN, request.value, value, 0, length, CONTROL_TIMEOUT_MS
                )
                # pyusb returns an array
                return bytes(reply)
            self._device.ctrl_transfer(
                VENDOR_OUT, request.value, value, 0, None, CONTROL_TIMEOUT_MS
            )
        except DEVICE_ERRORS as error:
            raise link_error(f"request {request.name}", error, REQUEST_REMEDIES) from error
        return b""

    def _find(self) -> Any:
        params = self._params
        unreadable = None
        ids = {"idVendor": params.vendor_id, "idProduct": params.product_id}
        try:
            if self._system is not None:
                # a new context lists the devices that are present now
                self._backend = type(self._system)(self._system.lib)
            # a list, because pyusb's generator raises only during iteration
            found = list(usb.core.find(find_all=True, backend=self._backend, **ids))
        except DEVICE_ERRORS as error:
            raise link_error("look for boards", error) from error
        for device in found:
            try:
                # reading the serial number opens the device, which needs permission
                if params.serial is None or _serial(device) == params.serial:
                    return device
            except DEVICE_ERRORS as error:
                # kept for the end: another board at the bus may match
                unreadable = link_error("read the board's serial number", error)
            _dispose(device)
        serial = "" if params.serial is None else f" with serial {params.serial}"
        name = f"{params.vendor_id:04x}:{params.product_id:04x}{serial}"
        try:
            raise unreadable or LinkLost(
                f"no board {name} at the bus; plug it in, or correct [usb] and the device file's"
                " serial"
            )
        finally:
            del unreadable  # it holds this frame: a cycle, which is not collected in the servo

    def _take(self, device: Any) -> None:
        number, out, into = _frame_endpoints(_configuration(device))
        self._out, self._in = out.address, into.address
        # before the claim, which fails with EBUSY while a kernel driver holds the interface
        _detach_kernel_driver(device, number)
        transfers = self._transfers(device, number, out, into)
        if transfers is None:
            usb.util.claim_interface(device, number)
            self._read, self._write = _in_turn(device, number, out, into)
            self._clear_halt = device.clear_halt
            return
        self._flight = flight = InFlight(transfers)
        self._read, self._write = flight.read, flight.write
        self._clear_halt = transfers.clear_halt
        self.in_flight = True

    def _transfers(self, device: Any, number: int, out: End, into: End) -> Transfers | None:
        """Return transfers in flight for the interface, claimed with them; None: only one after the
        other.
        """
        if not self._params.in_flight:
            return None
        if self._system is not None:
            path = f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}"
            return UsbfsTransfers(path, number, out, into)
        make = getattr(self._backend, "transfers", None)
        if make is None:
            return None
        usb.util.claim_interface(device, number)
        transfers: Transfers = make(out.address, into.address)
        return transfers

    def _transfer_failure(self, action: str, endpoint: int, error: Exception) -> LinkError:
        failure = link_error(f"{action} endpoint 0x{endpoint:02x}", error)
        if not isinstance(failure, LinkStalled):
            return failure
        if endpoint in self._halted:
            return LinkLost(
                f"{failure}; it stalled again after that: unplug the board and plug it in"
            )
        self._halted.add(endpoint)
        try:
            # a control request to the board, which also sets both data toggles to 0
            self._clear_halt(endpoint)
        except DEVICE_ERRORS as worse:
            return LinkLost(str(link_error(f"clear the halt of endpoint 0x{endpoint:02x}", worse)))
        return failure


def _not_open(*_: Any) -> int:
    raise LinkLost("the link is not open; open it first")


def _in_turn(device: Any, number: int, out: End, into: End) -> tuple[Transfer, Transfer]:
    """Return `read` and `write` of the claimed interface, one transfer after the other. pyusb looks
    up interface, endpoint and handle under a lock in every transfer, a third of the instructions
    before the OUT. A pyusb without this private name keeps its slower path.
    """
    backend = device.backend
    handle = getattr(getattr(device, "_ctx", None), "handle", None)
    if handle is None:
        return device.read, device.write
    reading = backend.intr_read if into.interrupt else backend.bulk_read
    writing = backend.intr_write if out.interrupt else backend.bulk_write

    def read(endpoint: int, buffer: "array[int]", timeout_ms: int) -> int:
        count: int = reading(handle, endpoint, number, buffer, timeout_ms)
        return count

    def write(endpoint: int, buffer: "array[int]", timeout_ms: int) -> int:
        count: int = writing(handle, endpoint, number, buffer, timeout_ms)
        return count

    return read, write


def _serial(device: Any) -> str | None:
    try:
        text: str | None = usb.util.get_string(device, device.iSerialNumber, ENGLISH_US)
    except ValueError:  # not UTF-16
        return None
    except usb.core.USBError as error:
        if error.errno is not None:
            raise
        return None  # pyusb's own "Invalid descriptor": a foreign device with the same ids
    return text


def _configuration(device: Any) -> Any:
    try:
        return device.get_active_configuration()
    except usb.core.USBError as error:
        if error.errno is not None:  # pyusb's own "Configuration not set" has none
            raise
    device.set_configuration()
    return device.get_active_configuration()


def _frame_endpoints(configuration: Any) -> tuple[int, End, End]:
    """Return the number of the vendor interface, and its OUT and IN endpoint."""
    for interface in configuration:
        # alternate setting 0 is the default
        if interface.bInterfaceClass == VENDOR_CLASS and interface.bAlternateSetting == 0:
            outs, ins = (
                _ends(interface, usb.util.ENDPOINT_OUT),
                _ends(interface, usb.util.ENDPOINT_IN),
            )
            if outs and ins:
                return interface.bInterfaceNumber, outs[0], ins[0]
    raise LinkLost(
        "the device has no vendor interface with a bulk or interrupt OUT and IN endpoint; is it a"
        " hapticd board?"
    )


def _ends(interface: Any, direction: int) -> list[End]:
    found = []
    for endpoint in interface:
        kind = usb.util.endpoint_type(endpoint.bmAttributes)
        address = endpoint.bEndpointAddress
        if kind in FRAME_TRANSFERS and usb.util.endpoint_direction(address) == direction:
            found.append(End(address, kind == usb.util.ENDPOINT_TYPE_INTR))
    return found


def _detach_kernel_driver(device: Any, number: int) -> None:
    try:
        if device.is_kernel_driver_active(number):
            device.detach_kernel_driver(number)
    except NotImplementedError:
        return  # not supported on this platform
    except usb.core.USBError as error:
        # ENOENT: the driver released it between the query and the request
        if error.errno != errno.ENOENT:
            raise


def _dispose(device: Any) -> None:
    try:
        usb.util.dispose_resources(device)
    except DEVICE_ERRORS:
        return  # the device is gone, with all its resources
