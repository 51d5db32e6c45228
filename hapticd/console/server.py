"""The web server of the operators' page, and recording from the page.

Server (`serve`). Its paths:

    GET  /       the page; it shows that the board is SIMULATED without any script
    GET  /static its files; nothing is loaded from elsewhere
    POST /stop   STOP: the path of `hapticd stop`, in its own threads. It waits for no socket, no
                 command and no telemetry, and presses the stop word, so that it needs no gateway
    WS   /live   telemetry to the browser; commands and acknowledgements from it. Its `stop` takes
                 the path of /stop, ahead of all earlier requests

One asyncio loop serves all browsers. A thread follows telemetry (`watch`), another one sends each
browser's commands (`browser`). Messages for a slow browser wait (`browser`). If a browser leaves at
any moment, or sends a message that this page never sends, its connection ends, and nothing is
printed. The web server would log some cases with a traceback: text that is not UTF-8, bytes before
its own answer.

A file in the daemon's folder contains the address of the page (`mailbox.daemons` reads it). That of
a killed console remains, so that the next one of this daemon listens on the same port and open
pages find it again. A folder that this user may not write (the service's) gets none.

The loop must wait only in `await`, and listen on no address of the network. The web server must log
as LOGGER, and name the protocol of a failed connection.

Recording (`Recorder`). `hapticd record` runs as a separate process, one at a time. It is that verb,
so the file is the same. If the page or the console dies, the recorder ends in order: it receives
SIGTERM when the console dies, which finishes the file. Files go to the folder in which the console
was started; no text from a page becomes part of a path.

`--parent` makes the kernel send SIGTERM when this process dies in any way. A long-lived thread must
start it, for the kernel watches that thread.
"""

import asyncio
import json
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext, suppress
from datetime import datetime
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from hapticd.client import fast_stop
from hapticd.client.formatting import board_words
from hapticd.console.browser import STOP_PATH, Asker, Browser, Visitors
from hapticd.console.plane import Planes
from hapticd.console.watch import Probing, Watch
from hapticd.core.errors import ConfigError, HapticdError, MailboxError
from hapticd.mailbox.daemons import (
    ACTOR_STOP_WORD,
    read_json,
    read_report,
    require_trusted,
    servo_lives,
    untrusted_daemon_folder,
)
from hapticd.mailbox.files import CONSOLE, write_whole

__all__ = ["serve"]

# --- recording ------------------------------------------------------------------------------------
LONGEST_NOTE = 500
LIVE = ".part.h5"  # suffix of a recording in progress
FILE_LOOK_S = 0.05  # until the file exists


class Recorder:
    """The recorder of instance `instance`; passes its state as text to `publish`."""

    def __init__(self, instance: str, folder: Path, publish: Callable[[str], None]) -> None:
        self._instance = instance
        self._folder = folder
        self._publish = publish
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    async def start(self, note: str) -> str:
        """Start with the operator's note; return the reason against it, or an empty text."""
        if self._process is not None:
            return "a recording is under way already: stop it first"
        file = self._folder / f"{datetime.now():%Y%m%d-%H%M%S}-{self._instance}.h5"
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "hapticd", "record", str(file), "--json"),
            *("--instance", self._instance, "--parent", str(os.getpid())),
            f"--note={note[:LONGEST_NOTE]}",
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            process_group=0,
        )
        self._task = asyncio.create_task(self._await_end(self._process, file))
        part = file.with_suffix(LIVE)
        while self._process is not None and not part.exists():
            await asyncio.sleep(FILE_LOOK_S)
        if self._process is not None:
            self._tell({"recording": True, "file": str(file), "note": note})
        return ""

    def stop(self) -> str:
        """Stop the recording; its file is announced when it is packed. Return the reason against
        it, or an empty text.
        """
        if self._process is None:
            return "no recording is running"
        self._process.send_signal(signal.SIGINT)
        return ""

    async def close(self) -> None:
        """Finish the current recording."""
        if self._process is not None and self._task is not None:
            self._process.send_signal(signal.SIGINT)
            await self._task

    async def _await_end(self, process: asyncio.subprocess.Process, file: Path) -> None:
        out, err = await process.communicate()
        self._process = None
        self._tell({"recording": False, "file": str(file), "text": _ending(out, err)})

    def _tell(self, content: dict[str, Any]) -> None:
        self._publish(json.dumps({"kind": "recorder", "told": content}))


def _ending(out: bytes, err: bytes) -> str:
    """Return the final output of `hapticd record --json` in one line."""
    try:
        found = json.loads(out.decode().splitlines()[-1])
    except (ValueError, IndexError):
        return f"not recorded: {err.decode(errors='replace').strip()[-300:]}"
    if not found.get("ok"):
        return f"not recorded: {found['error']['message']}"
    missing = found["missing"]["servo"]
    return f"{found['file']}: {found['seconds']:.1f} s, {found['records']} ticks, {missing} missing"


# --- the server -----------------------------------------------------------------------------------
ADDRESS = "127.0.0.1"
DEFAULT_PORT = 9873  # next to telemetry's; an ephemeral one if taken
STATIC = Path(__file__).with_name("static")
BOARDS = {True: "SIMULATED", False: "REAL BOARD", None: "NO BOARD YET"}
NO_SERVO = "no servo runs; start it with `hapticd run`"
LOOK_S = 0.5  # between checks for the board
MOST_BYTES = 1 << 16  # of a message from a browser
MOST_DIGITS = 10  # of an actor
LOGGER = "uvicorn.error"
BY_THE_OTHER_END = (UnicodeDecodeError, OSError, WebSocketDisconnect)


class Console:
    """The page of daemon `instance`: its routes, and its open browsers."""

    def __init__(self, instance: str) -> None:
        self.instance = instance
        self._browsers: set[Browser] = set()
        self._latest: dict[str, str] = {}  # newest state and guard, for a new page
        self._stopping = ThreadPoolExecutor(4, thread_name_prefix="stop")
        self._under_way: set[asyncio.Task[None]] = set()  # answers to pages
        self._pages = 0
        self.recorder = Recorder(instance, Path.cwd(), lambda text: self.publish("recorder", text))
        self.stops = 0  # stops of this page
        self.missing: str | None = None  # why there is no board; None: not checked yet

    def app(self) -> Starlette:
        """Return the application for the web server."""
        routes = [
            Route("/", self.page),
            Route(STOP_PATH, self.stop, methods=["POST"]),
            WebSocketRoute("/live", self.live),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
        return Starlette(routes=routes, middleware=[Middleware(Visitors)])

    def folder(self) -> Path:
        """Return the runtime folder of the daemon."""
        return untrusted_daemon_folder(self.instance)

    def publish(self, kind: str, message: bytes | str) -> None:
        """Send `message` to all browsers; called in the loop."""
        if isinstance(message, str) and kind != "event":
            self._latest[kind] = message
        for browser in self._browsers:
            browser.outbox.put(kind, message)

    async def page(self, request: Request) -> Response:
        """Return the page, with the known facts of the board in its text."""
        report = read_report(self.folder())
        words = {
            "@BOARD@": BOARDS[report.get("simulated")],
            "@DEVICE@": str(report.get("device", "")),
            "@INSTANCE@": self.instance,
        }
        text = (STATIC / "index.html").read_text()
        for place, word in words.items():
            text = text.replace(place, escape(word))
        return HTMLResponse(text)

    async def stop(self, request: Request) -> Response:
        """Handle the stop request of a page."""
        outcome = await self._press(request.query_params.get("actor", ""))
        return JSONResponse(outcome, 200 if outcome["ok"] else 503)

    async def _press(self, actor: str) -> dict[str, Any]:
        """Press the stop word, as `hapticd stop` does, on behalf of the page: only its presser may
        reset a stop.
        """
        self.stops += 1
        loop = asyncio.get_running_loop()
        press = partial(fast_stop.stop, self.instance, _number(actor))
        try:
            found = await loop.run_in_executor(self._stopping, press)
        except HapticdError as error:
            return {"ok": False, "states": [], "text": str(error)}
        states = [one.state for one in found.daemons]
        return {"ok": not found.failed, "states": states, "text": "; ".join(found.failed)}

    async def live(self, socket: WebSocket) -> None:
        """Serve one browser from connection to disconnection."""
        await socket.accept()
        self._pages += 1
        browser = Browser(socket, Asker(self.instance, f"page {self._pages}", lambda: self.stops))
        for kind, message in self._latest.items():
            browser.outbox.put(kind, message)
        self._browsers.add(browser)
        sending = asyncio.create_task(browser.outbox.send_to(socket))
        try:
            await self._obey(browser)
        except WebSocketDisconnect:
            pass
        finally:
            self._browsers.discard(browser)
            sending.cancel()
            browser.asker.close()

    async def _obey(self, browser: Browser) -> None:
        loop = asyncio.get_running_loop()
        own = {"record": self._record, "stop": self._stop_by_socket}

        def reply(text: str) -> None:
            loop.call_soon_threadsafe(browser.outbox.put, "reply", text)

        while True:
            request = await browser.request()
            if "ack" in request:
                browser.outbox.acknowledge(int(request["ack"]))
            elif answer := own.get(str(request.get("cmd"))):
                task = asyncio.create_task(answer(browser, request))
                self._under_way.add(task)
                task.add_done_callback(self._under_way.discard)
            else:
                browser.asker.ask(request, reply)

    async def _stop_by_socket(self, browser: Browser, request: dict[str, Any]) -> None:
        """Stop over the page's connection."""
        browser.answer(request, **await self._press(str(request.get("actor", ""))))

    async def _record(self, browser: Browser, request: dict[str, Any]) -> None:
        """Start or stop the recorder of this page."""
        note = str(request.get("note", ""))
        start = bool(request.get("start"))
        trouble = await self.recorder.start(note) if start else self.recorder.stop()
        text = trouble or ("recording begins" if start else "recording ends, and is packed")
        browser.answer(request, ok=not trouble, text=text)


def _number(text: str) -> int:
    """Return the actor in the request of a page; the stop word's if the page has none."""
    return int(text) if text.isdecimal() and len(text) <= MOST_DIGITS else ACTOR_STOP_WORD


def port_before(place: Path) -> int | None:
    """Return the port of the previous console, from the file `place`; None if there was none."""
    port = read_json(place).get("port")
    return port if isinstance(port, int) and 0 < port < 1 << 16 else None


def note(place: Path, url: str, port: int) -> None:
    """Write the address of this process to the file `place`."""
    content = json.dumps({"url": url, "port": port, "pid": os.getpid()})
    with suppress(MailboxError):
        write_whole(place, content)


class _Server(uvicorn.Server):
    def capture_signals(self) -> AbstractContextManager[None]:  # type: ignore[override]
        return nullcontext()  # its own handlers end it (core.process.on_stop)


def bound(port: int | None, before: int | None) -> socket.socket:
    """Return a socket that listens on `port`; if that is None, on `before`, DEFAULT_PORT or any
    port. ConfigError if `port` is taken, or not permitted for this user.
    """
    reason = ""
    wishes = [port] if port is not None else [before or DEFAULT_PORT, DEFAULT_PORT, 0]
    for wish in wishes:
        # explicit TCP; otherwise asyncio leaves Nagle's algorithm on, which delays answers by 40 ms
        line = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            line.bind((ADDRESS, wish))
            return line
        except OSError as error:
            reason = str(error.strerror)
            line.close()
    raise ConfigError(f"port {port} of {ADDRESS}: {reason}; name another, or none for any free one")


def serve(
    instance: str,
    port: int | None,
    on_stop: Callable[[Callable[[], None]], None],
    tell: Callable[[str], None],
) -> None:
    """Serve the page of `instance` until the handler passed to `on_stop` is called; `tell` receives
    its URL. ConfigError if the port is taken.
    """
    folder = untrusted_daemon_folder(instance)
    require_trusted(folder)
    place = folder / CONSOLE
    line = bound(port, port_before(place))
    url = f"http://{ADDRESS}:{line.getsockname()[1]}/"
    console = Console(instance)
    config = uvicorn.Config(
        console.app(),
        log_config=None,
        access_log=False,
        lifespan="off",
        proxy_headers=False,  # the kernel identifies the owner of a connection, not a header
        ws_max_size=MOST_BYTES,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )
    server = _Server(config)
    on_stop(lambda: setattr(server, "should_exit", True))

    def ready() -> None:
        note(place, url, line.getsockname()[1])
        tell(url)

    try:
        asyncio.run(_serve(server, console, line, ready))
    finally:
        with suppress(OSError):
            place.unlink()


async def _tell_board(console: Console) -> None:
    """Publish why there is no board, or no servo, as `hapticd status` does; endlessly."""
    while True:
        try:
            folder = console.folder()
            missing = board_words(read_report(folder)) if servo_lives(folder) else NO_SERVO
        except (HapticdError, OSError) as error:
            missing = f"cannot look whether a servo runs: {error}"
        if missing != console.missing:
            console.missing = missing
            console.publish("board", json.dumps({"kind": "board", "told": {"text": missing}}))
        await asyncio.sleep(LOOK_S)


def _be_quiet(loop: asyncio.AbstractEventLoop) -> None:
    """Print nothing about connections broken by the other end."""
    loop.set_exception_handler(_unless_of_a_connection)
    logging.getLogger(LOGGER).addFilter(_worth_printing)


def _unless_of_a_connection(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Ignore a failed protocol: the loop ends its connection by itself."""
    if "protocol" not in context:
        loop.default_exception_handler(context)


def _worth_printing(record: logging.LogRecord) -> bool:
    failed = record.exc_info[1] if record.exc_info else None
    return not isinstance(failed, BY_THE_OTHER_END)


async def _serve(
    server: uvicorn.Server, console: Console, line: socket.socket, ready: Callable[[], None]
) -> None:
    loop = asyncio.get_running_loop()
    _be_quiet(loop)

    def publish(kind: str, message: bytes | str) -> None:
        loop.call_soon_threadsafe(console.publish, kind, message)

    line.listen()
    planes = Planes(console.folder, lambda text: publish("plane", text))
    probing = Probing(console.instance, lambda text: publish("impedance", text))
    watch = Watch(console.instance, publish, probing, planes)
    board = asyncio.create_task(_tell_board(console))
    ready()
    try:
        await server.serve(sockets=[line])
    finally:
        board.cancel()
        watch.close()
        probing.close()
        planes.close()
        await console.recorder.close()
