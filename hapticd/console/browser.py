"""One open page: what waits for it, and what it sends.

Three kinds of messages wait, and are sent in this order. Replies and events go first; they are few,
and only a browser that reads nothing at all loses the oldest of WORDS. Of what describes a state
only the newest of each kind waits. Telemetry frames wait in a queue of FRAMES places from which
the oldest falls.

Bytes that were handed to the operating system can no longer be dropped, and its buffers hold many
seconds of telemetry. So at most WINDOW frames are on their way that the browser has not
acknowledged: one that is slow, or stands still, finds after its pause at most that many old frames
and then the newest.

Messages must not each have a kind of their own: nothing would then be bounded.
"""

import asyncio
import json
from collections import deque
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from hapticd.console.asker import Asker

WORDS = 256  # replies and events
FRAMES = 25  # half a second at 50 frames/s
WINDOW = 25  # frames on their way that were not acknowledged
UNSUPPORTED = 1003  # the code of a close: data of a kind that is not taken


class Outbox:
    """Messages for one browser, text or binary; `pop` gives what is to be sent next."""

    def __init__(self) -> None:
        self._words: deque[str] = deque(maxlen=WORDS)
        self._latest: dict[str, str] = {}
        self._frames: deque[bytes] = deque(maxlen=FRAMES)
        self._under_way = 0
        self._news = asyncio.Event()

    def put(self, kind: str, message: bytes | str) -> None:
        """Have `message` sent: bytes are a frame, a text is a reply, an event or a state."""
        if isinstance(message, bytes):
            self._frames.append(message)
        elif kind in ("reply", "event"):
            self._words.append(message)
        else:
            self._latest[kind] = message
        self._news.set()

    def acknowledge(self, count: int) -> None:
        """The browser has taken `count` more frames."""
        self._under_way = max(0, self._under_way - count)
        self._news.set()

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

    async def send_to(self, socket: WebSocket) -> None:
        """Send what waits, for ever. WebSocketDisconnect: the browser has left."""
        while True:
            message = self.pop()
            if message is None:
                self._news.clear()
                await self._news.wait()
            elif isinstance(message, str):
                await socket.send_text(message)
            else:
                await socket.send_bytes(message)


class Browser:
    """One open page."""

    def __init__(self, socket: WebSocket, asker: Asker) -> None:
        self.socket = socket
        self.asker = asker
        self.outbox = Outbox()

    def answer(self, request: dict[str, Any], **content: Any) -> None:
        """Reply to `request`."""
        reply = {"kind": "reply", "ask": request.get("ask"), **content}
        self.outbox.put("reply", json.dumps(reply))

    async def request(self) -> dict[str, Any]:
        """The next message. WebSocketDisconnect: the browser has left, or sent what no page of
        ours does.

        Not `receive_text`, which fails otherwise where a send has failed before.
        """
        message = await self.socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message["code"])
        try:
            request = json.loads(message.get("text") or "")
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict) or not isinstance(request.get("ack", 0), int):
            raise WebSocketDisconnect(UNSUPPORTED, "not a message of this page")
        return request
