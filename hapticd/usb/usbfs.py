"""Transfers in flight through Linux's own usbfs: submitted, and reaped when they are done.

libusb and pyusb find the board, read its descriptors and carry its control requests. Its frames use
a separate descriptor on the same device node, which claims the interface. usbfs keeps claims and
transfers by descriptor, so libusb never reaps a transfer that it has not submitted.

    SUBMITURB        starts one transfer; the bytes of an OUT are copied
    REAPURBNDELAY    returns a completed transfer, in the order of completion; the bytes of an IN
                     are copied then
    select           sleeps until one is complete (then the node is writable), where a tick must
                     wait for a late IN
    DISCARDURB       cancels one; only `cancel` uses it

Structures and buffers are created once, so no call of a tick allocates anything that lasts.
`fcntl.ioctl` would copy them and lose their addresses, which the kernel keeps. Errors are raised as
by pyusb (`usb.core.USBError` with libusb's errno): a transaction that failed on the wire is EIO.

Python must not move or free a structure during its transfer (they live as long as this object, and
`cancel` closes the descriptor first). One thread must use it.
"""

import ctypes
import errno
import os
import time
from array import array
from collections.abc import Callable
from select import select

import usb.core

from hapticd.core.units import NS_PER_S
from hapticd.usb.flight import End
from hapticd.usb.frames import PACKET_BYTES

PENDING = -1
BULK = 3  # USBDEVFS_URB_TYPE_*
INTERRUPT = 1
# errors of a completed transfer; every other one is a transaction that failed on the wire
KEPT = frozenset((errno.EPIPE, errno.EOVERFLOW, errno.ENODEV))
GONE = frozenset((errno.ESHUTDOWN, errno.ENODEV))


class _Urb(ctypes.Structure):
    """struct usbdevfs_urb of <linux/usbdevice_fs.h>."""

    _fields_ = (
        ("type", ctypes.c_ubyte),
        ("endpoint", ctypes.c_ubyte),
        ("status", ctypes.c_int),
        ("flags", ctypes.c_uint),
        ("buffer", ctypes.c_void_p),
        ("buffer_length", ctypes.c_int),
        ("actual_length", ctypes.c_int),
        ("start_frame", ctypes.c_int),
        ("number_of_packets", ctypes.c_int),
        ("error_count", ctypes.c_int),
        ("signr", ctypes.c_uint),
        ("usercontext", ctypes.c_void_p),
    )


def _request(direction: int, number: int, size: int) -> int:
    """Return _IOC of <asm-generic/ioctl.h>, for usbfs."""
    return direction << 30 | size << 16 | ord("U") << 8 | number


_POINTER = ctypes.sizeof(ctypes.c_void_p)
_UINT = ctypes.sizeof(ctypes.c_uint)
SUBMIT = _request(2, 10, ctypes.sizeof(_Urb))
DISCARD = _request(0, 11, 0)
REAP = _request(1, 13, _POINTER)
CLAIM = _request(2, 15, _UINT)
CLEAR_HALT = _request(2, 21, _UINT)

_ioctl: Callable[..., int] = ctypes.CDLL(None, use_errno=True).ioctl
_ioctl.argtypes = (ctypes.c_int, ctypes.c_ulong, ctypes.c_void_p)  # type: ignore[attr-defined]


class _Transfer:
    """One transfer, which is submitted repeatedly."""

    def __init__(self, end: End) -> None:
        self.bytes = (ctypes.c_ubyte * PACKET_BYTES)()
        self.view = memoryview(self.bytes).cast("B")
        self.urb = _Urb(
            type=INTERRUPT if end.interrupt else BULK,
            endpoint=end.address,
            buffer=ctypes.addressof(self.bytes),
            buffer_length=PACKET_BYTES,
        )
        self.address = ctypes.addressof(self.urb)
        self.done = True


class UsbfsTransfers:
    """One OUT and one IN of the device at `path`, whose `interface` it claims. USBError."""

    def __init__(self, path: str, interface: int, out: End, into: End) -> None:
        self._out = _Transfer(out)
        self._in = _Transfer(into)
        self._slot = ctypes.c_void_p()
        self._slot_address = ctypes.addressof(self._slot)
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise _error(error.errno or errno.EIO) from error
        try:
            self._ask(CLAIM, interface)
        except usb.core.USBError:
            os.close(self._fd)
            raise

    def submit_out(self, data: "array[int]") -> None:
        """Send `data`."""
        out = self._out
        out.view[: len(data)] = memoryview(data)
        out.urb.buffer_length = len(data)
        self._submit(out)

    def submit_in(self) -> None:
        """Submit the IN for one packet."""
        self._submit(self._in)

    def out_done(self, wait_ns: int) -> bool:
        """Return whether the OUT has arrived, after waiting for at most `wait_ns`."""
        if not self._ended(self._out, wait_ns):
            return False
        _check(self._out.urb.status)
        return True

    def in_done(self, buffer: "array[int]", wait_ns: int) -> int:
        """Return the bytes of the IN, copied to `buffer`, or PENDING after `wait_ns`."""
        into = self._in
        if not self._ended(into, wait_ns):
            return PENDING
        _check(into.urb.status)
        size: int = into.urb.actual_length
        memoryview(buffer)[:size] = into.view[:size]
        return size

    def clear_halt(self, endpoint: int) -> None:
        """Clear the halt of an endpoint, which requires the claim."""
        self._ask(CLEAR_HALT, endpoint)

    def cancel(self) -> None:
        """Cancel both and release the board."""
        for transfer in (self._out, self._in):
            if not transfer.done:
                _ioctl(self._fd, DISCARD, transfer.address)
        os.close(self._fd)  # the kernel waits for transfers in progress

    def _submit(self, transfer: _Transfer) -> None:
        if _ioctl(self._fd, SUBMIT, transfer.address) < 0:
            raise _error(ctypes.get_errno())
        transfer.done = False

    def _ended(self, transfer: _Transfer, wait_ns: int) -> bool:
        deadline_ns = 0
        while not transfer.done:
            if _ioctl(self._fd, REAP, self._slot_address) >= 0:
                ended = self._out if self._slot.value == self._out.address else self._in
                ended.done = True
                continue
            number = ctypes.get_errno()
            if number != errno.EAGAIN:
                raise _error(number)
            now_ns = time.monotonic_ns()
            deadline_ns = deadline_ns or now_ns + wait_ns
            if now_ns >= deadline_ns:
                return False
            select((), (self._fd,), (), (deadline_ns - now_ns) / NS_PER_S)
        return True

    def _ask(self, request: int, number: int) -> None:
        held = ctypes.c_uint(number)
        if _ioctl(self._fd, request, ctypes.addressof(held)) < 0:
            raise _error(ctypes.get_errno())


def _check(status: int) -> None:
    if status:
        number = errno.ENODEV if -status in GONE else -status
        raise _error(number if number in KEPT else errno.EIO)


def _error(number: int) -> Exception:
    known = errno.ENODEV if number in GONE else number
    error: Exception = usb.core.USBError(os.strerror(known), None, known)
    return error
