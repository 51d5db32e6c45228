"""Who may talk to the page: browsers of this computer that have it from here.

The server listens at 127.0.0.1 alone, but a browser takes any web page's word to it. Two headers,
which no script can forge, tell such a page: `Host`, the name under which the browser looked for us
(one that is not this computer's was pointed here by somebody's name server), and `Origin`, whose
page asks. Every request needs a host of HOSTS; an origin has to be that host, and what opens the
socket has to have one. The port is left open, so that a tunnel by ssh may end at another one.

What would break it: a host name of the outside in HOSTS, or a reply with CORS headers.
"""

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
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


class Visitors:
    """ASGI middleware that turns others away with 403, and forbids pages to load anything that is
    not ours.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        socket = scope["type"] == "websocket"
        reason = objection(Headers(scope=scope), socket)
        if reason and socket:
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
        elif reason:
            await PlainTextResponse(f"{reason}\n", 403)(scope, receive, send)
        else:
            await self._app(scope, receive, _with_policy(send))


def _with_policy(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            more = ((b"content-security-policy", POLICY.encode()), (b"cache-control", b"no-cache"))
            message["headers"] = [*message["headers"], *more]
        await send(message)

    return sending
