"""Browsers that leave in the middle of a message, and connections that send no messages of a page.

What ends one connection is no news for who runs the console. The web server logs some of it with a
traceback: text that is not UTF-8, bytes before its own answer. `be_quiet` takes those records out
by the kind of their exception; all others are printed as before.

What would break it: a server that logs under another name than LOGGER, or that names no protocol
where it failed.
"""

import asyncio
import logging
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

LOGGER = "uvicorn.error"
BY_THE_OTHER_END = (UnicodeDecodeError, OSError, WebSocketDisconnect)
UNSUPPORTED = 1003  # the code of a close: data of a kind that is not taken


async def text_from(socket: WebSocket) -> str:
    """The next text. WebSocketDisconnect: the browser has left, or sent bytes.

    Not `receive_text`, which fails otherwise where a send has failed before.
    """
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message["code"])
    text = message.get("text")
    if text is None:
        raise WebSocketDisconnect(UNSUPPORTED, "bytes are not taken")
    return str(text)


def be_quiet(loop: asyncio.AbstractEventLoop) -> None:
    """Print nothing of connections that the other end has broken."""
    loop.set_exception_handler(_unless_of_a_connection)
    logging.getLogger(LOGGER).addFilter(_worth_printing)


def _unless_of_a_connection(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """The loop ends a connection by itself whose protocol has failed."""
    if "protocol" not in context:
        loop.default_exception_handler(context)


def _worth_printing(record: logging.LogRecord) -> bool:
    failed = record.exc_info[1] if record.exc_info else None
    return not isinstance(failed, BY_THE_OTHER_END)
