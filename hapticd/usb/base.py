"""The interface of every link to a board.

Real and simulated boards are twins below it: nobody above asks which.
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

    `in_flight`: `write` returns before its frame has arrived, and a frame may be under way while
    no call is (`usb.flight`).
    """

    in_flight = False

    @abstractmethod
    def open(self) -> None:
        """Find and claim the board. LinkLost: not there; LinkAccess: not allowed or taken."""

    @abstractmethod
    def close(self) -> None:
        """Release everything; never raises, may be called twice."""

    @abstractmethod
    def read(self, buffer: "array[int]") -> int:
        """Fill `buffer` (array('B'), one packet) with the next IN frame; number of bytes.

        LinkTimeout, LinkStalled, LinkLost.
        """

    @abstractmethod
    def write(self, buffer: "array[int]") -> None:
        """Send `buffer` (array('B')) as one OUT frame. LinkTimeout, LinkStalled, LinkLost."""

    def drain(self) -> None:  # noqa: B027  # nothing to do where `write` waits
        """Give the OUT frame that is on its way the time-out to arrive; never raises.

        Between ticks only: the next `write` does not find the bus taken.
        """

    @abstractmethod
    def request(self, request: Request, length: int = 0, value: int = 0) -> bytes:
        """Vendor control request with wValue `value`: its reply of at most `length` bytes.

        With `length` 0 it is an OUT request without data.
        """


def backoff_s(attempt: int) -> float:
    """Pause before looking for a lost board again: 50 ms, doubled each time, at most 1 s."""
    return min(1.0, 0.05 * 2.0 ** min(attempt, 10))
