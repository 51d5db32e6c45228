"""The journal: events, and the actors behind them.

Events are maps, kept for `status` and queued for the topic `event`. Their kinds: `state` (from, to,
fault with cause, action and remedy, actor), `answer` (the outcome of a scheduled or staged change),
`guard` (the hand that destabilises a request), `gap` (ticks that were overwritten before they were
read), `servo_up`, `servo_down`, `flight` (path, reason), `lease` (what, change, actor, name, by),
`controlled` (tick, excess_j, text: the energy controller acted), `warning`.

An actor is a small number for each client, which every tick record contains, and the name that the
client has chosen. Both exist as long as the connection, and are remembered for the clients that
left last. Numbers are never reused in a servo life, even by another gateway.
"""

from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any

from hapticd.core.units import NS_PER_S
from hapticd.mailbox.stop_word import ACTOR_STOP_WORD

__all__ = ["GATEWAY_ACTOR", "Actors", "Journal"]

KEPT = 32
QUEUED = 256


class Journal:
    """The last events, and those not yet published; both bounded."""

    def __init__(self, unix_ns: Callable[[], int]) -> None:
        self._unix_ns = unix_ns
        self.recent: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._queue: deque[dict[str, Any]] = deque(maxlen=QUEUED)

    def note(self, kind: str, unix_ns: int | None = None, **fields: Any) -> None:
        """Note an event of `kind`, at `unix_ns` or now."""
        event = {"timestamp": (unix_ns or self._unix_ns()) / NS_PER_S, "kind": kind, **fields}
        self.recent.append(event)
        self._queue.append(event)

    def drain(self) -> list[dict[str, Any]]:
        """Return the events since the last call."""
        events = list(self._queue)
        self._queue.clear()
        return events


MOST = 64  # clients that have left
GATEWAY_ACTOR = 1
RESERVED = {GATEWAY_ACTOR: "gateway", ACTOR_STOP_WORD: "stop word"}  # 0 is the servo itself


class Actors:
    """Client numbers, from `next_number`, by identity; a client that left is forgotten after MOST
    others.
    """

    def __init__(self, next_number: Callable[[], int]) -> None:
        self._next_number = next_number
        self._present: dict[bytes, tuple[int, str]] = {}
        self._left: OrderedDict[bytes, tuple[int, str]] = OrderedDict()

    def number(self, identity: bytes) -> int:
        """Return the number of the client; a new one for an unknown client."""
        known = self._present.get(identity) or self._left.get(identity)
        if known is None:
            known = self._present[identity] = self._next_number(), "client"
        return known[0]

    def call(self, identity: bytes, name: str) -> None:
        """Set the client's name."""
        self._present[identity] = self.number(identity), name

    def leave(self, identity: bytes) -> int:
        """Note the end of the client's connection; return its number, 0 if it never sent a request.

        Its waiting requests keep the number.
        """
        # a client that left may have returned with the same identity
        known = self._present.pop(identity, None) or self._left.get(identity)
        if known is None:
            return 0
        self._left[identity] = known
        if len(self._left) > MOST:
            self._left.popitem(last=False)
        return known[0]

    def names(self) -> dict[str, str]:
        """Return the names by number (as text, for JSON)."""
        known = (*self._left.values(), *self._present.values())
        return {str(number): name for number, name in known}

    def name(self, number: int) -> str:
        """Return the name of actor `number`; empty for the servo itself and for
        forgotten clients.
        """
        return RESERVED.get(number) or self.names().get(str(number), "")
