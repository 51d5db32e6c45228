"""Looking for a board that is not there, or there and not ready: with growing pauses, never in
vain for good, and saying what for.

A board that was just plugged in may be there before udev has granted its rights, may be slow to
answer its first request, or may still be in its boot loader, which stalls that request or says
hello with another hash and then leaves the bus to come back as itself. All of these pass; so does
the program that has claimed it, some day. Each look that fails gives its reason; a reason is told
when it is another one than before, and "" when the board answers.

A hash that stays wrong does not pass: somebody has to flash or install something. `MISMATCH_NS`
is how long a start waits for another answer; a servo that runs already goes on looking.

A reason must not change with every look (a count, a time), since each new one is reported.
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
    """Looks for the board of `device`; `tell(reason)` is called when the reason changes."""

    def __init__(self, device: Device, tell: Tell) -> None:
        self._device = device
        self._tell = tell
        self.reason = ""  # why the last look failed
        self.retry_ns = 0  # no look before that
        self._attempt = 0
        self._mismatch_ns: int | None = None  # since when nothing but a wrong hash was met

    def begin(self, now_ns: int) -> None:
        """The board was lost just now: the first look is a short pause away."""
        self._attempt = 0
        self._mismatch_ns = None
        self.retry_ns = now_ns + int(backoff_s(0) * NS_PER_S)

    def look(self, now_ns: int) -> HelloFrame | None:
        """The hello of the board, open and greeted; None: not now, or not ready."""
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
        """ProtocolMismatch when the board has said nothing but a wrong hash for too long."""
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
