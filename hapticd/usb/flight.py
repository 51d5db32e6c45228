"""Transfers in flight: IN and OUT are in progress while the servo computes and sleeps.

The IN is that of the next sample, the OUT that of this tick. With transfers one after the other, a
tick waits for its IN, computes, and waits for its OUT. Each wait includes a submission, the bus, an
interrupt and a wake-up. In flight, only the path of the force remains:

    board latches -> IN on the wire -> kernel has it | deadline: law | submission, OUT on the wire

Rules (`InFlight`). They bound the effect of a transfer on a tick:

    one IN      submitted just before the OUT that triggers its sample, reaped when due. Never a
                second one: a spare would take a frame that a newer one should replace.
    one OUT     not waited for. If it is still in progress at the next deadline, that tick is lost
                (no sample, WRITE_FAILED in its record) and no other OUT is submitted behind it.
                STOP therefore goes into the next OUT, a period later unless the bus is stuck, and
                then the board's watchdog ends the force.
    no cancel   in a tick: a cancelled OUT may have been delivered, a cancelled IN acknowledged.
                Only the close of a link cancels, after the last OUT has had the time-out.

Both buffers may be reused at once: the backend (`Transfers`) copies an OUT when it is submitted and
an IN when it is reaped. It must not fill the buffer of an IN before that. The failure of an OUT is
known in the next tick, which has no sample anyway. Limitations: a caller that leaves an IN unread
for ticks (it is then one frame behind, which `usb.device` skips).

Linux's own usbfs (`UsbfsTransfers`). libusb and pyusb find the board, read its descriptors and
carry its control requests. Its frames use a separate descriptor on the same device node, which
claims the interface. Claims and transfers belong to a descriptor, so libusb never reaps a transfer
that it has not submitted.

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
from typing import NamedTuple, Protocol

import usb.core

from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.usb.frames import PACKET_BYTES

# --- rules ----------------------------------------------------------------------------------------


class Transfers(Protocol):
    """One OUT and one IN of a board. Errors are those of pyusb (`usb.core.USBError`)."""

    def submit_out(self, data: "array[int]") -> None:
        """Submit the OUT with `data`."""

    def submit_in(self) -> None:
        """Submit the IN."""

    def out_done(self, wait_ns: int) -> bool:
        """Return whether the OUT has arrived, after waiting for at most `wait_ns`."""

    def in_done(self, buffer: "array[int]", wait_ns: int) -> int:
        """Return the bytes of the IN, copied to `buffer`; -1: none after waiting for at most
        `wait_ns`.
        """

    def clear_halt(self, endpoint: int) -> None:
        """Clear the halt of `endpoint`."""

    def cancel(self) -> None:
        """Cancel what is pending."""


class End(NamedTuple):
    """An endpoint of the board."""

    address: int
    interrupt: bool


class OutFailed(Exception):
    """The OUT in progress has failed with `error`."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error))
        self.error = error


class InFlight:
    """`read` and `write` as in pyusb's device, over transfers in flight."""

    def __init__(self, transfers: Transfers) -> None:
        self._transfers = transfers
        self._out_pending = False
        self._in_pending = False
        self._begun = False  # an OUT has been sent
        self._failed: OutFailed | None = None  # found outside a tick

    def read(self, _endpoint: int, buffer: "array[int]", timeout_ms: int) -> int:
        """Reap the IN, or submit one first; return its bytes. OutFailed, USBError."""
        if self._out_pending and not self._landed(0):
            raise _pending()
        transfers = self._transfers
        if not self._in_pending:
            transfers.submit_in()
        # any end clears it, including an error
        self._in_pending = False
        count = transfers.in_done(buffer, timeout_ms * NS_PER_MS)
        if count < 0:
            self._in_pending = True
            raise _pending()
        return count

    def write(self, _endpoint: int, buffer: "array[int]", _timeout_ms: int) -> int:
        """Submit the next IN and send `buffer`; return its bytes. OutFailed, USBError."""
        if self._out_pending and not self._landed(0):
            raise _pending()
        transfers = self._transfers
        # before the first OUT it would take a frame of an earlier session from the board
        if self._begun and not self._in_pending:
            transfers.submit_in()
            self._in_pending = True
        transfers.submit_out(buffer)
        self._out_pending = self._begun = True
        return len(buffer)

    def drain(self, timeout_ms: int) -> None:
        """Wait for the OUT in progress, up to the time-out; never raises. The next `read` or
        `write` reports its failure.
        """
        if self._out_pending:
            try:
                self._landed(timeout_ms * NS_PER_MS)
            except OutFailed as failed:
                self._out_pending = True
                self._failed = failed

    def close(self, timeout_ms: int, errors: tuple[type[Exception], ...]) -> None:
        """Drain, and cancel the rest; `errors` are suppressed."""
        self.drain(timeout_ms)
        try:
            self._transfers.cancel()
        except errors:
            pass  # the device is gone, and its transfers with it

    def _landed(self, wait_ns: int) -> bool:
        failed, self._failed = self._failed, None
        if failed is not None:
            self._out_pending = False
            raise failed
        try:
            landed = self._transfers.out_done(wait_ns)
        except Exception as error:
            self._out_pending = False
            raise OutFailed(error) from error
        self._out_pending = not landed
        return landed


def _pending() -> Exception:
    """Return a time-out as libusb reports it; the transfer continues."""
    error: Exception = usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
    return error


# --- usbfs ----------------------------------------------------------------------------------------

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
