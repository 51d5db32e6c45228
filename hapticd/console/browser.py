"""One open page: its queue of outgoing messages, its commands, and its access control.

Queue (`Outbox`, `Browser`). Three kinds of messages wait, and are sent in this order. Replies and
events go first; they are few, and only a browser that reads nothing loses the oldest of WORDS. Of
state messages only the newest of each kind waits. Telemetry frames wait in a queue of FRAMES
places, which drops the oldest.

Bytes passed to the operating system can no longer be dropped, and its buffers hold many seconds of
telemetry. So at most WINDOW unacknowledged frames are in transit. After a pause, a slow or stalled
browser receives at most that many old frames and then the newest.

Messages must not each have their own kind: the queue would then be unbounded.

Commands (`Asker`). Each browser has a separate client and thread for them. The client binds leases
to the browser: they end with its socket. A page may send the commands of ALLOWED. `stop` is not
among them: it has a path of its own that waits for nothing (`server`). A reply is that of the
daemon, with the receipt, or the refusal, in the wording of the command line.

Requests that were sent before a stop and still wait are dropped: a `reset` and `enable` pressed
just before STOP must not follow it. Requests of a closed page are dropped as well: its connection
ends at once, and the gateway discards them.

The `close` of a client must not wait for its last answer.

Access (`objection`, `Visitors`). Only browsers of this computer that loaded the page from here have
access. The server listens only on 127.0.0.1, but any web page can make a browser send requests to
it. Two headers, which no script can forge, reveal such a page. `Host` is the name used by the
browser; a foreign name was resolved to this computer by a foreign name server. `Origin` is the page
that sends. Every request needs a host of HOSTS. An origin has to be that host, and a request for
the socket has to have one. The port is not checked, so that an ssh tunnel may end at another one.

No header identifies the sending program: 127.0.0.1 has no owner, and every account of the computer
may connect to it. The kernel has this information (/proc/net/tcp, and tcp6 for a program that
writes the address as ::ffff:127.0.0.1). Answers are for the account that runs the console, the
account that called it by sudo, and root. A thread reads the kernel's tables, for they may be long.
STOP is accepted from any account (`Console` has it at STOP_PATH).

MOST_VISITS are served at once, for all accounts; STOP does not count among them, which is why it is
not uvicorn's own limit. Idle connections are bounded only by the process's descriptors
(SECURITY.md).

HOSTS must not contain a host name of the outside, and no reply may have CORS headers.
"""

import asyncio
import json
import os
import pwd
import socket as sockets
import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from sys import byteorder
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from hapticd.client.client import Client
from hapticd.client.formatting import (
    guard_line,
    margin_words,
    objection_lines,
    receipt_text,
    refusal_lines,
)
from hapticd.client.telemetry import receipt_of
from hapticd.core.errors import CommandError, HapticdError
from hapticd.model.excitation import Stream, band_noise, generator
from hapticd.model.scene import Excitation
from hapticd.protocol.answers import GuardStatus, GuardVerdict, answer_of

# --- commands -------------------------------------------------------------------------------------
EXCITE = "excite"  # own command: noise as in a trial, repeated until stopped
CHANGES = frozenset(("set", "damping", "enable", "disable", "reset", "zero", "home", EXCITE))
ALLOWED = CHANGES | {"hello", "get", "guard", "lease", "status", "dump"}
NOISE_SAMPLES = 1 << 14  # 4 s
MOST_OPEN = 8  # requests of one browser without an answer
Reply = Callable[[str], None]  # takes the text for the browser; called in the asker's thread


class Asker:
    """Sends requests to the daemon `instance` for one browser; `stops` counts the stops of this
    page.
    """

    def __init__(self, instance: str, name: str, stops: Callable[[], int]) -> None:
        self._client = Client(instance, name=name)
        self._stops = stops
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._places = threading.Semaphore(MOST_OPEN)

    def close(self) -> None:
        """Send no more requests, and end the connection at once: waiting requests are dropped."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        threading.Thread(target=self._client.close).start()

    def ask(self, request: dict[str, Any], reply: Reply) -> None:
        """Send `request` ({cmd, ask, ..}, `ask` is repeated) and pass the answer as JSON to
        `reply`.
        """
        number = request.pop("ask", None)
        cmd = str(request.pop("cmd", ""))
        if cmd not in ALLOWED:
            reply(_refused(number, "invalid", f"{cmd[:32]!r} cannot be requested from a page"))
        elif not self._places.acquire(blocking=False):
            reply(_refused(number, "busy", f"{MOST_OPEN} requests have no answer yet"))
        else:
            self._thread.submit(self._answer, number, cmd, request, self._stops(), reply)

    def _answer(
        self, number: Any, cmd: str, fields: dict[str, Any], stops: int, reply: Reply
    ) -> None:
        try:
            reply(self._answered(number, cmd, fields, stops))
        finally:
            self._places.release()

    def _answered(self, number: Any, cmd: str, fields: dict[str, Any], stops: int) -> str:
        if cmd in CHANGES and stops != self._stops():
            return _refused(number, "stopped", f"{cmd}: not done, for STOP was pressed after it")
        try:
            if cmd == EXCITE:
                if strange := fields.keys() - {"on"}:
                    text = f"{EXCITE}: {min(strange)!r} is not a field of it; there is 'on'"
                    return _refused(number, "invalid", text)
                return self._excited(number, bool(fields.get("on")))
            return _accepted(number, cmd, self._client.call(cmd, **fields))
        except CommandError as error:
            outcome = error.guard.outcome if error.guard else ""
            return _refused(number, error.code, "\n".join(refusal_lines(error)), outcome)
        except (HapticdError, TypeError) as error:
            return _refused(number, type(error).__name__, str(error))

    def _excited(self, number: Any, on: bool) -> str:
        if not on:
            return _accepted(number, EXCITE, self._client.call("perturb", action="stop"))
        paper = Excitation("noise")
        random = generator(paper.seed, Stream.SHARED)
        noise = band_noise(NOISE_SAMPLES, paper.psd_n2_per_hz, paper.band_hz, random)
        self._client.perturb_load(noise)
        return _accepted(number, EXCITE, self._client.call("perturb", action="start", loop=True))


def _accepted(number: Any, cmd: str, found: dict[str, Any]) -> str:
    content = {"kind": "reply", "ask": number, "ok": True, "result": found.get("result")}
    if cmd == "guard":
        guard = answer_of(GuardStatus, content["result"])
        content["text"] = f"guard: {guard_line(guard)}\n{margin_words(guard)}"
    if "receipt" in found:
        receipt = receipt_of(found)
        content["text"] = receipt_text(receipt)
        content["warning"] = _warning(receipt.guard)
    return json.dumps(content)


def _warning(verdict: GuardVerdict | None) -> str:
    """Return the guard's objection to a change that acts nevertheless; empty without one."""
    if not verdict or verdict.policy == "off" or verdict.safe:
        return ""
    return "\n".join(objection_lines(verdict))


def _refused(number: Any, code: str, text: str, outcome: str = "") -> str:
    content = {"kind": "reply", "ask": number, "ok": False, "code": code, "text": text}
    return json.dumps(content | {"outcome": outcome})  # of the guard


# --- the queue ------------------------------------------------------------------------------------
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


# --- access ---------------------------------------------------------------------------------------
HOSTS = ("127.0.0.1", "localhost")
STOP_PATH = "/stop"
CONNECTIONS = Path("/proc/net/tcp")
CONNECTIONS_6 = Path("/proc/net/tcp6")
IPV4_MAPPED = "0000000000000000FFFF0000"  # before an IPv4 address in tcp6
MOST_VISITS = 64  # requests and sockets that are served at once
ESTABLISHED = "01"  # of its states
NO_INODE = "0"
POLICY = "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


def objection(headers: Headers, socket: bool) -> str:
    """Return the reason why this request is not answered; empty if it is."""
    host = headers.get("host", "")
    origin = headers.get("origin")
    if host.partition(":")[0] not in HOSTS:
        return f"host {host[:64]!r} is not this computer: open http://127.0.0.1 with the port"
    if origin is None:
        return "a socket is opened by a page, and this request has no origin" if socket else ""
    if origin != f"http://{host}":
        return f"origin {origin[:64]!r} is not this page"
    return ""


Address = tuple[str, int]  # host, port


def owner_of(client: Address, server: Address, table: Iterable[str]) -> int | None:
    """Return the account (uid) that opened the connection from `client` to `server`, from the lines
    of /proc/net/tcp and tcp6. None if it is not listed, or closed: its uid 0 does not mean root
    then.
    """
    ends = [_as_the_kernel_writes(client), _as_the_kernel_writes(server)]
    mapped = [IPV4_MAPPED + end for end in ends]
    for line in table:
        # number, local, remote, state, queues, timer, retransmits, uid, timeout, inode, ...
        fields = line.split()
        if fields[1:3] in (ends, mapped):
            return int(fields[7]) if fields[3] == ESTABLISHED and fields[9] != NO_INODE else None
    return None


def _as_the_kernel_writes(address: Address) -> str:
    """Return an IPv4 address as in /proc/net/tcp: the four bytes as a number of this machine."""
    host, port = address
    number = int.from_bytes(sockets.inet_aton(host), byteorder)
    return f"{number:08X}:{port:04X}"


def accounts() -> frozenset[int]:
    """Return the accounts that may use the page."""
    return frozenset({0, os.getuid(), int(os.environ.get("SUDO_UID", os.getuid()))})


def stranger(scope: Scope, ours: frozenset[int]) -> str:
    """Return why the account of this request is not answered; empty if it is, or if it
    is unknown.
    """
    client = scope.get("client")
    server = scope.get("server")
    if client is None or server is None:
        return ""
    try:
        lines = CONNECTIONS.read_text().splitlines()
    except OSError:
        return ""  # a machine without these tables
    with suppress(OSError):  # a machine without IPv6
        lines += CONNECTIONS_6.read_text().splitlines()
    if owner_of(tuple(client), tuple(server), lines) in ours:
        return ""
    name = pwd.getpwuid(os.getuid()).pw_name
    return f"this page is {name}'s: open it as {name}, or run `hapticd console` of your own"


class Visitors:
    """ASGI middleware that rejects other visitors with 403, and forbids pages to load foreign
    content.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._accounts = accounts()
        self._visits = 0
        self._looking = ThreadPoolExecutor(1, thread_name_prefix="visitors")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["path"] == STOP_PATH:
            await self._visit(scope, receive, send)
        elif self._visits >= MOST_VISITS:
            await _turned_away(scope, receive, send, f"{MOST_VISITS} visitors are here", 503)
        else:
            self._visits += 1
            try:
                await self._visit(scope, receive, send)
            finally:
                self._visits -= 1

    async def _visit(self, scope: Scope, receive: Receive, send: Send) -> None:
        socket = scope["type"] == "websocket"
        reason = objection(Headers(scope=scope), socket)
        if not reason and scope["path"] != STOP_PATH:
            loop = asyncio.get_running_loop()
            reason = await loop.run_in_executor(self._looking, stranger, scope, self._accounts)
        if reason:
            await _turned_away(scope, receive, send, reason, 403)
        else:
            await self._app(scope, receive, send if socket else _with_policy(send))


async def _turned_away(
    scope: Scope, receive: Receive, send: Send, reason: str, status: int
) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
    else:
        await PlainTextResponse(f"{reason}\n", status)(scope, receive, send)


def _with_policy(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            more = ((b"content-security-policy", POLICY.encode()), (b"cache-control", b"no-cache"))
            message["headers"] = [*message["headers"], *more]
        await send(message)

    return sending
