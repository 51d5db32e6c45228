"""What happened, one map per event: kept for `status`, and queued for the topic `event`.

kinds: `state` (from, to, fault with cause, action and remedy, actor), `answer` (what became of a scheduled change), `gap`
(ticks that were overwritten before they were read), `servo_up`, `servo_down`, `flight` (path, reason), `warning`.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

from hapticd.units import NS_PER_S

KEPT, QUEUED = 32, 256


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
