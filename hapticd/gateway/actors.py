"""Who does what: a small number per client, which travels in every tick record, and the name it gave itself.

ZeroMQ does not tell when a client leaves, so the table keeps the most recent ones; numbers are never used twice.
"""

from collections import OrderedDict

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
