"""One open page: its queue of outgoing messages, and its requests.

Three kinds of messages wait, and are sent in this order. Replies and events go first; they are few,
and only a browser that reads nothing loses the oldest of WORDS. Of state messages only the newest
of each kind waits. Telemetry frames wait in a queue of FRAMES places, which drops the oldest.

Bytes passed to the operating system can no longer be dropped, and its buffers hold many seconds of
telemetry. So at most WINDOW unacknowledged frames are in transit. After a pause, a slow or stalled
browser receives at most that many old frames and then the newest.

Messages must not each have their own kind: the queue would then be unbounded.
"""

import asyncio
import json
from collections import deque
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from hapticd.console.asker import Asker

WORDS = 256  # replies and events
FRAMES = 25  # half a second at 50 frames/s
WINDOW = 25  # unacknowledged frames in transit
UNSUPPORTED = 1003  # the code of a close: data of an unsupported kind


class Outbox:
    """Messages for one browser, text or binary; `pop` returns the next one to send."""

    def __init__(self) -> None:
        self._words: deque[str] = deque(maxlen=WORDS)
        self._latest: dict[str, str] = {}
        self._frames: deque[bytes] = deque(maxlen=FRAMES)
        self._under_way = 0
        self._news = asyncio.Event()

    def put(self, kind: str, message: bytes | str) -> None:
        """Queue `message`: bytes are a frame, a text is a reply, an event or a state."""
        if isinstance(message, bytes):
            self._frames.append(message)
        elif kind in ("reply", "event"):
            self._words.append(message)
        else:
            self._latest[kind] = message
        self._news.set()

    def acknowledge(self, count: int) -> None:
        """Note that the browser has received `count` more frames."""
        self._under_way = max(0, self._under_way - count)
        self._news.set()

    def pop(self) -> str | bytes | None:
        """Return the next message, or None while nothing may be sent."""
        if self._words:
            return self._words.popleft()
        if self._latest:
            return self._latest.pop(next(iter(self._latest)))
        if self._frames and self._under_way < WINDOW:
            self._under_way += 1
            return self._frames.popleft()
        return None

    async def send_to(self, socket: WebSocket) -> None:
        """Send waiting messages endlessly. WebSocketDisconnect if the browser has left."""
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
        """Return the next message. WebSocketDisconnect if the browser has left, or sent a message
        that this page never sends.

        Not `receive_text`, which fails in another way after a failed send.
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
