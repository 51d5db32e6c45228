"""Minimal yardsticks of the operators' page: for page_cpu a ZeroMQ-to-websocket forwarder and a
reader of websockets, for page_seen a page whose switch is answered by a websocket echo.

python -m benchmarks.page_worker forward ENDPOINT            prints {url} once it serves; forwards
                                                             messages of ENDPOINT to each client of
                                                             the url, until terminated
python -m benchmarks.page_worker read URL SECONDS [ENDPOINT] reads frames for SECONDS, acknowledges
                                                             them like a page, publishes all
                                                             messages at ENDPOINT; then prints
                                                             {frames}
python -m benchmarks.page_worker serve                       prints {url} once it serves: a page
                                                             with a minimal switch, and at `same`
                                                             one with the bytes of the page as text
"""

import asyncio
import json
import re
import sys
import time
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path

import zmq
import zmq.asyncio
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.client import connect
from websockets.typing import Origin

from hapticd import console

ACK_EVERY = 5  # like the page's
TEXT = b"text"
BINARY = b"binary"
HOST = "127.0.0.1"
STATIC = Path(console.__file__).with_name("static")
SWITCH = """<!doctype html><title>bare</title>
<button id="damping-switch" role="switch" aria-checked="mixed">switch</button>
<div id="damping-board"></div>
<script>
    const button = document.querySelector("button");
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.onopen = () => { button.ariaChecked = "false"; };
    const report = document.querySelector("div");
    socket.onmessage = (message) => {
        button.ariaChecked = message.data;
        report.textContent = message.data;
    };
    button.onclick = () => socket.send(String(button.ariaChecked !== "true"));
</script>"""


async def forward(endpoint: str) -> None:
    """Serve until terminated."""
    context = zmq.asyncio.Context()

    async def live(browser: ServerConnection) -> None:
        socket = context.socket(zmq.SUB)
        socket.subscribe(b"")
        socket.connect(endpoint)
        with suppress(ConnectionClosed):
            while True:
                kind, data = await socket.recv_multipart()
                await browser.send(data if kind == BINARY else data.decode())

    async with serve(live, HOST, 0, compression=None) as server:
        host, port = server.sockets[0].getsockname()
        print(json.dumps({"url": f"ws://{host}:{port}/"}), flush=True)
        await server.serve_forever()


async def serve_pages() -> None:
    """Serve until terminated: the minimal switch, its echo, and the page as text."""
    pages = {"/": SWITCH, "/same": as_text(STATIC)}

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        if request.path not in pages:
            return None  # the socket
        response = connection.respond(HTTPStatus.OK, pages[request.path])
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        return response

    async def echo(browser: ServerConnection) -> None:
        async for message in browser:
            await browser.send(message)

    async with serve(echo, HOST, 0, process_request=answer, compression=None) as server:
        host, port = server.sockets[0].getsockname()
        print(json.dumps({"url": f"http://{host}:{port}/"}), flush=True)
        await server.serve_forever()


def as_text(folder: Path) -> str:
    """Return the page of `folder` with all its files: its style as style, its scripts as text."""
    page = (folder / "index.html").read_text()
    style = (folder / "console.css").read_text()
    scripts = "".join(one.read_text() for one in sorted(folder.rglob("*.js")))
    bare = re.sub(r"<(link|script)[^>]*>(</script>)?", "", page)
    bare = bare.replace("</head>", f"<style>{style}</style></head>")
    return bare.replace("</body>", f"<script type='text/plain'>{scripts}</script></body>")


def read(url: str, seconds: str, endpoint: str = "") -> None:
    """Count binary messages."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    told = context.socket(zmq.PUB)
    if endpoint:
        told.bind(endpoint)
    origin = url.replace("ws:", "http:").removesuffix("/live")
    end = time.monotonic() + float(seconds)
    frames = 0
    with (
        connect(url, origin=Origin(origin), compression=None) as page,
        suppress(TimeoutError),
    ):
        while (left_s := end - time.monotonic()) > 0:
            message = page.recv(left_s)
            is_frame = isinstance(message, bytes)
            frames += is_frame
            if endpoint:
                told.send_multipart(_published(message))
                if is_frame and frames % ACK_EVERY == 0:
                    page.send(json.dumps({"ack": ACK_EVERY}))
    print(json.dumps({"frames": frames}), flush=True)


def _published(message: str | bytes) -> list[bytes]:
    return [BINARY, message] if isinstance(message, bytes) else [TEXT, message.encode()]


if __name__ == "__main__":
    if sys.argv[1] == "read":
        read(*sys.argv[2:])
    else:
        asyncio.run({"forward": forward, "serve": serve_pages}[sys.argv[1]](*sys.argv[2:]))
