"""Access control of the page: only browsers of this computer that loaded it from here.

The server listens only on 127.0.0.1, but any web page can make a browser send requests to it. Two
headers, which no script can forge, reveal such a page. `Host` is the name used by the browser; a
foreign name was resolved to this computer by a foreign name server. `Origin` is the page that
sends. Every request needs a host of HOSTS. An origin has to be that host, and a request for the
socket has to have one. The port is not checked, so that an ssh tunnel may end at another one.

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
