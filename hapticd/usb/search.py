"""Search for a board that is absent or not ready, with growing pauses, without end, and with a
reason.

A board that was just plugged in may appear before udev has granted access, or be slow to answer its
first request. It may also still run its boot loader, which stalls that request or sends a hello
with another hash. The board then leaves the bus and returns. All of these conditions pass, and so
does a claim by another program. Each failed attempt has a reason; a reason is reported when it
differs from the last one, and "" when the board answers.

A persistent wrong hash does not pass: the user must flash or install something. A start waits
`MISMATCH_NS` for another answer; a running servo continues to search.

A reason must not change with every attempt (a count, a time), because each new one is reported.
"""

from collections.abc import Callable

from hapticd.core.errors import LinkError, ProtocolMismatch, WireError
from hapticd.core.units import NS_PER_S
from hapticd.usb.base import backoff_s
from hapticd.usb.device import Device
from hapticd.usb.frames import HelloFrame

__all__ = ["BoardSearch", "Tell"]

MISMATCH_NS = 30 * NS_PER_S  # boot loaders wait for seconds, and flashing takes half a minute
Tell = Callable[[str], None]


class BoardSearch:
    """Searches for the board of `device`; `tell(reason)` is called when the reason changes."""

    def __init__(self, device: Device, tell: Tell) -> None:
        self._device = device
        self._tell = tell
        self.reason = ""  # why the last attempt failed
        self.retry_ns = 0  # time of the next attempt
        self._attempt = 0
        self._mismatch_ns: int | None = None  # time from which only a wrong hash was received

    def begin(self, now_ns: int) -> None:
        """Start the search for a board that was just lost: the first attempt follows after a short
        pause.
        """
        self._attempt = 0
        self._mismatch_ns = None
        self.retry_ns = now_ns + int(backoff_s(0) * NS_PER_S)

    def look(self, now_ns: int) -> HelloFrame | None:
        """Return the hello of the board, open and greeted; None: not due, or not ready."""
        if now_ns < self.retry_ns:
            return None
        try:
            hello = self._device.connect()
        except (LinkError, WireError) as error:
            self._device.close()
            self._note(str(error), isinstance(error, ProtocolMismatch), now_ns)
            return None
        self._say("")
        return hello

    def check_patience(self, now_ns: int) -> None:
        """Raise ProtocolMismatch if the board has sent only a wrong hash for too long."""
        if self._mismatch_ns is not None and now_ns - self._mismatch_ns >= MISMATCH_NS:
            raise ProtocolMismatch(self.reason)

    def _note(self, reason: str, mismatch: bool, now_ns: int) -> None:
        self._attempt += 1
        self.retry_ns = now_ns + int(backoff_s(self._attempt) * NS_PER_S)
        if not mismatch:
            self._mismatch_ns = None
        elif self._mismatch_ns is None:
            self._mismatch_ns = now_ns
        self._say(reason)

    def _say(self, reason: str) -> None:
        if reason != self.reason:
            self.reason = reason
            self._tell(reason)
