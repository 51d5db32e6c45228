"""Who may talk to the page: browsers of this computer that have it from here.

The server listens at 127.0.0.1 alone, but a browser takes any web page's word to it. Two headers,
which no script can forge, tell such a page: `Host`, the name under which the browser looked for us
(one that is not this computer's was pointed here by somebody's name server), and `Origin`, whose
page asks. Every request needs a host of HOSTS; an origin has to be that host, and what opens the
socket has to have one. The port is left open, so that a tunnel by ssh may end at another one.

No header tells whose program asks: 127.0.0.1 has no owner, and every account of the computer may
connect to it. The kernel knows (/proc/net/tcp, and tcp6 of a program that writes the address as
::ffff:127.0.0.1), and answers are for the account that the console runs as, who called it by sudo,
and root. Its tables are read by a thread, for they may be long. STOP is taken from anyone
(`Console` has it at STOP_PATH).

MOST_VISITS are attended to at once, whoever asks; STOP does not count among them, which is why it
is not uvicorn's own limit. Connections on which nobody asks are bounded by the process's
descriptors alone (SECURITY.md).

HOSTS must not contain a host name of the outside, and no reply may have CORS headers.
"""

import asyncio
import os
import pwd
import socket as sockets
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from sys import byteorder

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
STOP_PATH = "/stop"
CONNECTIONS = Path("/proc/net/tcp")
CONNECTIONS_6 = Path("/proc/net/tcp6")
IPV4_MAPPED = "0000000000000000FFFF0000"  # before an IPv4 address in tcp6
MOST_VISITS = 64  # requests and sockets that are attended to at once
ESTABLISHED = "01"  # of its states
NO_INODE = "0"
POLICY = "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


def objection(headers: Headers, socket: bool) -> str:
    """Why this request is not answered; empty if it is."""
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
    """The account (uid) whose program opened the connection from `client` to `server`, by the lines
    of /proc/net/tcp and tcp6; None if it is not among them, or is closed: then 0 stands there,
    which is not root but nobody.
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
    """An IPv4 address as /proc/net/tcp has it: the four bytes as a number of this machine."""
    host, port = address
    number = int.from_bytes(sockets.inet_aton(host), byteorder)
    return f"{number:08X}:{port:04X}"


def accounts() -> frozenset[int]:
    """Whom the page is for."""
    return frozenset({0, os.getuid(), int(os.environ.get("SUDO_UID", os.getuid()))})


def stranger(scope: Scope, ours: frozenset[int]) -> str:
    """Why the account behind this request is not answered; empty if it is, or cannot be known."""
    client = scope.get("client")
    server = scope.get("server")
    if client is None or server is None:
        return ""
    try:
        lines = CONNECTIONS.read_text().splitlines()
    except OSError:
        return ""  # a machine that does not tell
    with suppress(OSError):  # a machine without IPv6
        lines += CONNECTIONS_6.read_text().splitlines()
    if owner_of(tuple(client), tuple(server), lines) in ours:
        return ""
    name = pwd.getpwuid(os.getuid()).pw_name
    return f"this page is {name}'s: open it as {name}, or run `hapticd console` of your own"


class Visitors:
    """ASGI middleware that turns others away with 403, and forbids pages to load anything that is
    not ours.
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
