"""Transfers in flight: the IN of the next sample and the OUT of this tick are in progress while the
servo computes and sleeps.

With transfers one after the other, a tick waits for its IN, computes, and waits for its OUT: each
wait includes a submission, the bus, an interrupt and a wake-up. In flight, only the path of the
force remains:

    board latches -> IN on the wire -> kernel has it | deadline: law | submission, OUT on the wire

The rules, which bound the effect of a transfer on a tick:

    one IN      submitted just before the OUT that triggers its sample, reaped when due. Never a
                second one: a spare would take a frame that a newer one should replace.
    one OUT     not waited for. If it is still in progress at the next deadline, that tick is lost
                (no sample, WRITE_FAILED in its record) and no other OUT is submitted behind it.
                STOP therefore goes into the next OUT, a period later unless the bus is stuck, and
                then the board's watchdog ends the force.
    no cancel   in a tick: a cancelled OUT may have been delivered, a cancelled IN acknowledged.
                Only the close of a link cancels, after the last OUT has had the time-out.

Both buffers may be reused at once: the kernel copies an OUT when it is submitted and an IN when it
is reaped. The failure of an OUT is known in the next tick, which has no sample anyway.

A backend must not fill the buffer of an IN before it is reaped. Limitations: a caller that leaves
an IN unread for ticks (it is then one frame behind, which `usb.device` skips).
"""

import errno
from array import array
from typing import NamedTuple, Protocol

import usb.core

from hapticd.core.units import NS_PER_MS


class Transfers(Protocol):
    """One OUT and one IN of a board. Errors are those of pyusb (`usb.core.USBError`)."""

    def submit_out(self, data: "array[int]") -> None: ...
    def submit_in(self) -> None: ...

    def out_done(self, wait_ns: int) -> bool:
        """Return whether the OUT has arrived, after waiting for at most `wait_ns`."""

    def in_done(self, buffer: "array[int]", wait_ns: int) -> int:
        """Return the bytes of the IN, copied to `buffer`; -1: none after waiting for at most
        `wait_ns`.
        """

    def clear_halt(self, endpoint: int) -> None: ...
    def cancel(self) -> None: ...


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
