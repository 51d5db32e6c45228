"""What happened, and who did it.

Events are maps, one per event: kept for `status`, and queued for the topic `event`. Their kinds:
`state` (from, to, fault with cause, action and remedy, actor), `answer` (what became of a scheduled
change), `gap` (ticks that were overwritten before they were read), `servo_up`, `servo_down`,
`flight` (path, reason), `warning`.

An actor is a small number per client, which travels in every tick record, and the name that the
client gave itself. ZeroMQ does not report when a client leaves, so the table keeps the most recent
ones; numbers are never used twice.
"""

from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any

from hapticd.units import NS_PER_S

KEPT = 32
QUEUED = 256


class Journal:
    """The last events and those not yet published; both bounded."""

    def __init__(self, unix_ns: Callable[[], int]) -> None:
        self._unix_ns = unix_ns
        self.recent: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._queue: deque[dict[str, Any]] = deque(maxlen=QUEUED)

    def note(self, kind: str, unix_ns: int | None = None, **fields: Any) -> None:
        """Note an event of `kind`; it happened now unless `unix_ns` says when."""
        event = {"timestamp": (unix_ns or self._unix_ns()) / NS_PER_S, "kind": kind, **fields}
        self.recent.append(event)
        self._queue.append(event)

    def drain(self) -> list[dict[str, Any]]:
        """Events since the last call."""
        events = list(self._queue)
        self._queue.clear()
        return events


MOST = 64
RESERVED = {1: "gateway", 2: "stop page"}  # 0 is the servo itself
FIRST = 16


class Actors:
    """Numbers from FIRST on by client identity."""

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, tuple[int, str]] = OrderedDict()
        self._last = FIRST - 1

    def number(self, identity: bytes) -> int:
        """The number of the client; a new one for a client not seen among the last ones."""
        if identity not in self._known:
            self._last += 1
            self._known[identity] = (self._last, "client")
            if len(self._known) > MOST:
                self._known.popitem(last=False)
        self._known.move_to_end(identity)
        return self._known[identity][0]

    def call(self, identity: bytes, name: str) -> None:
        """The client's name from now on."""
        self._known[identity] = (self.number(identity), name)

    def names(self) -> dict[str, str]:
        """Name by number (as text, for JSON)."""
        return {str(number): name for number, name in self._known.values()}

    def name(self, number: int) -> str:
        """Name of actor `number`; empty for the servo itself and for one long gone."""
        return RESERVED.get(number) or self.names().get(str(number), "")
