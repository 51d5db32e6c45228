"""What waits for one browser. No socket, no clock.

Three kinds, taken in this order. Words, which are replies and events, go first; they are few, and
only a browser that reads nothing at all loses the oldest of WORDS. Of what describes a state
(`latest`) only the newest of each kind waits. Telemetry frames wait in a queue of FRAMES places
from which the oldest falls.

Bytes that were handed to the operating system can no longer be dropped, and its buffers hold many
seconds of telemetry. So at most WINDOW frames are on their way that the browser has not
acknowledged: one that is slow, or stands still, finds after its pause at most that many old frames
and then the newest.

What would break it: a kind of `latest` for every message, for nothing would then be bounded.
"""

from collections import deque

WORDS = 256  # replies and events
FRAMES = 25  # half a second at 50 frames/s
WINDOW = 25  # frames on their way that were not acknowledged


class Outbox:
    """Messages for one browser, text or binary; `pop` gives what is to be sent next."""

    def __init__(self) -> None:
        self._words: deque[str] = deque(maxlen=WORDS)
        self._latest: dict[str, str] = {}
        self._frames: deque[bytes] = deque(maxlen=FRAMES)
        self._under_way = 0
        self.dropped = 0  # frames that this browser did not get

    def words(self, text: str) -> None:
        """An answer to what this browser asked, or an event."""
        self._words.append(text)

    def latest(self, kind: str, text: str) -> None:
        """A state of some kind; replaces the one that still waits."""
        self._latest[kind] = text

    def frame(self, data: bytes) -> None:
        """A telemetry frame; the oldest falls when there are too many."""
        self.dropped += len(self._frames) == FRAMES
        self._frames.append(data)

    def acknowledge(self, count: int) -> None:
        """The browser has taken `count` more frames."""
        self._under_way = max(0, self._under_way - count)

    def pop(self) -> str | bytes | None:
        """The next message, or None while nothing may be sent."""
        if self._words:
            return self._words.popleft()
        if self._latest:
            return self._latest.pop(next(iter(self._latest)))
        if self._frames and self._under_way < WINDOW:
            self._under_way += 1
            return self._frames.popleft()
        return None
