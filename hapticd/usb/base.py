"""The interface of every link to a board.

Real and simulated boards share it: no caller distinguishes them.
"""

from abc import ABC, abstractmethod
from array import array

from hapticd.usb.frames import Request

__all__ = ["ENGLISH_US", "VENDOR_CLASS", "VENDOR_IN", "VENDOR_OUT", "backoff_s"]

VENDOR_CLASS = 0xFF  # of the board's interface
VENDOR_IN = 0xC0  # bmRequestType of requests to it
VENDOR_OUT = 0x40
ENGLISH_US = 0x0409  # language of its strings


class Link(ABC):
    """One board, one owner. Every call returns within the link's time-out or raises a LinkError.

    `in_flight`: `write` returns before its frame has arrived, and a frame may be in transit between
    calls (`usb.flight`).
    """

    in_flight = False

    @abstractmethod
    def open(self) -> None:
        """Find and claim the board. LinkLost: not found; LinkAccess: not allowed or in use."""

    @abstractmethod
    def close(self) -> None:
        """Release everything; never raises, may be called twice."""

    @abstractmethod
    def read(self, buffer: "array[int]") -> int:
        """Fill `buffer` (array('B'), one packet) with the next IN frame; return the number of
        bytes.

        LinkTimeout, LinkStalled, LinkLost.
        """

    @abstractmethod
    def write(self, buffer: "array[int]") -> None:
        """Send `buffer` (array('B')) as one OUT frame. LinkTimeout, LinkStalled, LinkLost."""

    def drain(self) -> None:  # noqa: B027  # nothing to do where `write` waits
        """Wait for the OUT frame in transit, up to the time-out; never raises.

        Call it between ticks only: the next `write` then finds the bus free.
        """

    @abstractmethod
    def request(self, request: Request, length: int = 0, value: int = 0) -> bytes:
        """Send a vendor control request with wValue `value`; return its reply of at most `length`
        bytes.

        With `length` 0 it is an OUT request without data.
        """


def backoff_s(attempt: int) -> float:
    """Return the pause before the next search for a lost board: 50 ms, doubled each time, at most 1
    s.
    """
    return min(1.0, 0.05 * 2.0 ** min(attempt, 10))
