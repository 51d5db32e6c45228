"""The operators' page without a browser: what waits for one, who may talk to it, what is sent, and
the one file that is not ours.
"""

import asyncio
import gc
import hashlib
import json
import os
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq
from starlette.datastructures import Headers

from hapticd.client import CommandError
from hapticd.client.blocks import Block, BlockDecoder
from hapticd.client.client import Client
from hapticd.console import browser as asker
from hapticd.console import browser as visitors
from hapticd.console import server
from hapticd.console.browser import FRAMES, WINDOW, WORDS, Asker, Outbox, objection
from hapticd.console.watch import estimate, frame
from hapticd.core.errors import ConfigError
from hapticd.mailbox.daemons import console_place
from hapticd.mailbox.files import COMMAND_SOCKET, CONSOLE
from hapticd.mailbox.layout import TELEMETRY, Flag, State

STATIC = Path(server.__file__).with_name("static")


# --- what waits for a browser ---------------------------------------------------------------------


def test_slow_browser_gets_the_newest_frames() -> None:
    outbox = Outbox()
    for number in range(FRAMES + 7):
        outbox.put("frame", b"%d" % number)
    assert outbox.pop() == b"7"


def test_no_more_than_a_window_is_under_way_without_acknowledgement() -> None:
    outbox = Outbox()
    sent = 0
    for _ in range(10 * WINDOW):
        outbox.put("frame", b"x")
        sent += outbox.pop() is not None
    assert sent == WINDOW
    outbox.acknowledge(5)
    assert [outbox.pop() for _ in range(6)] == [b"x"] * 5 + [None]


def test_replies_pass_frames_and_are_not_held_back_by_a_full_window() -> None:
    outbox = Outbox()
    for _ in range(2 * WINDOW):
        outbox.put("frame", b"x")
        outbox.pop()
    outbox.put("frame", b"x")
    outbox.put("reply", "first")
    outbox.put("state", "old")
    outbox.put("state", "new")
    outbox.put("reply", "second")
    assert [outbox.pop() for _ in range(4)] == ["first", "second", "new", None]


def test_a_browser_that_reads_nothing_is_no_heap() -> None:
    outbox = Outbox()
    for number in range(10 * WORDS):
        outbox.put("reply", str(number))
    assert outbox.pop() == str(9 * WORDS)


# --- who may talk to it ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("host", "origin", "is_socket", "allowed"),
    [
        ("127.0.0.1:9873", None, False, True),  # typed, or a script
        ("127.0.0.1:9873", "http://127.0.0.1:9873", True, True),
        ("localhost:8080", "http://localhost:8080", True, True),  # a tunnel
        ("127.0.0.1:9873", None, True, False),
        ("127.0.0.1:9873", "http://evil.example", True, False),
        ("127.0.0.1:9873", "http://evil.example", False, False),
        ("127.0.0.1:9873", "http://127.0.0.1:9999", True, False),  # another page of this computer
        ("127.0.0.1:9873", "https://127.0.0.1:9873", True, False),
        ("127.0.0.1:9873", "null", False, False),
        ("evil.example:9873", "http://evil.example:9873", True, False),  # DNS rebinding
        ("evil.example", None, False, False),
        ("127.0.0.1.evil.example:9873", None, False, False),
        ("", None, False, False),
    ],
)
def test_only_pages_of_this_computer_are_answered(
    host: str, origin: str | None, is_socket: bool, allowed: bool
) -> None:
    headers = {"host": host} | ({} if origin is None else {"origin": origin})
    assert (objection(Headers(headers), is_socket) == "") is allowed


def exchange(scope: dict[str, Any]) -> list[dict[str, Any]]:
    """What the application sends to one request without a body."""
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    base = {"query_string": b"", "root_path": "", "http_version": "1.1", "scheme": "http"}
    asyncio.run(server.Console("nobody").app()({**base, **scope}, receive, send))  # type: ignore[arg-type]
    return sent


def headers(**given: str) -> list[tuple[bytes, bytes]]:
    return [(name.encode(), value.encode()) for name, value in given.items()]


@pytest.mark.parametrize("path", ["/", "/stop", "/static/page.js"])
@pytest.mark.usefixtures("runtime")
def test_a_foreign_page_is_turned_away_everywhere(path: str) -> None:
    method = "POST" if path == "/stop" else "GET"
    asked = headers(host="127.0.0.1:9873", origin="http://evil.example")
    sent = exchange({"type": "http", "method": method, "path": path, "headers": asked})
    assert sent[0]["status"] == 403


@pytest.mark.usefixtures("runtime")
def test_a_foreign_socket_is_never_accepted() -> None:
    asked = headers(host="127.0.0.1:9873", origin="http://evil.example")
    sent = exchange({"type": "websocket", "path": "/live", "headers": asked, "subprotocols": []})
    assert [one["type"] for one in sent] == ["websocket.close"]


class Leaver:
    """A browser over ASGI: sends `messages`, then leaves; takes nothing if `gone`."""

    def __init__(self, *messages: dict[str, Any], gone: bool = False) -> None:
        self._messages = [{"type": "websocket.connect"}, *messages]
        self._gone = gone
        self.unhandled: list[dict[str, Any]] = []  # that the loop would print

    async def receive(self) -> dict[str, Any]:
        for _ in range(5):
            await asyncio.sleep(0)  # what waits for it is sent meanwhile
        last = {"type": "websocket.disconnect", "code": 1006}
        return self._messages.pop(0) if self._messages else last

    async def send(self, message: dict[str, Any]) -> None:
        if self._gone and message["type"] == "websocket.send":
            raise BrokenPipeError

    async def visit(self) -> None:
        """Come and go; raises what the application raises."""
        handler = asyncio.get_running_loop().set_exception_handler
        handler(lambda _loop, context: self.unhandled.append(context))
        console = server.Console("nobody")
        console.publish("board", "{}")
        asked = headers(host="localhost:1", origin="http://localhost:1")
        scope = {"type": "websocket", "path": "/live", "headers": asked, "subprotocols": []}
        base = {"query_string": b"", "root_path": "", "http_version": "1.1", "scheme": "ws"}
        await console.app()({**base, **scope}, self.receive, self.send)  # type: ignore[arg-type]
        gc.collect()
        await asyncio.sleep(0)


def text_of_page(text: str) -> dict[str, Any]:
    return {"type": "websocket.receive", "text": text}


@pytest.mark.parametrize(
    "messages",
    [
        [text_of_page('{"ack": 1}')],
        [{"type": "websocket.receive", "bytes": b"{}"}],
        [text_of_page("[" * 60_000)],
        [text_of_page("{")],
        [],
    ],
    ids=["message", "bytes", "deep", "half", "silent"],
)
@pytest.mark.parametrize("gone", [False, True], ids=["takes", "gone"])
@pytest.mark.usefixtures("runtime")
def test_a_browser_that_leaves_in_the_middle_of_a_message_is_no_error(
    messages: list[dict[str, Any]], gone: bool
) -> None:
    browser = Leaver(*messages, gone=gone)
    asyncio.run(browser.visit())
    assert browser.unhandled == []


@pytest.mark.usefixtures("runtime")
def test_page_may_load_nothing_from_elsewhere_and_stand_in_no_frame() -> None:
    asked = {"type": "http", "method": "GET", "path": "/", "headers": headers(host="localhost:1")}
    policy = dict(exchange(asked)[0]["headers"])[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy


@pytest.mark.usefixtures("runtime")
def test_stop_of_nobody_is_no_success() -> None:
    asked = {"type": "http", "method": "POST", "path": "/stop"}
    start, body = exchange({**asked, "headers": headers(host="localhost:1")})
    assert start["status"] == 503
    assert "no daemon runs there" in json.loads(body["body"])["text"]


@pytest.mark.usefixtures("runtime")
def test_what_cannot_be_looked_at_is_not_said_to_be_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def denied(_folder: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(server, "servo_lives", denied)
    said = board_told(server.Console("nobody"))
    assert said == "cannot look whether a servo runs: [Errno 13] Permission denied"


@pytest.mark.usefixtures("runtime")
def test_a_page_is_told_by_a_new_console_that_the_board_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It may still show what the console before said."""
    monkeypatch.setattr(server, "servo_lives", lambda _folder: True)
    assert board_told(server.Console("nobody")) == ""


def board_told(console: server.Console) -> str:
    """What pages of `console` are told first of the board."""

    async def first() -> str:
        looking = asyncio.create_task(server._tell_board(console))
        while "board" not in console._latest:
            await asyncio.sleep(0)
        looking.cancel()
        return console._latest["board"]

    text: str = json.loads(asyncio.run(asyncio.wait_for(first(), 10)))["told"]["text"]
    return text


# --- commands -------------------------------------------------------------------------------------


class StandIn:
    """A client whose calls wait until they are let go."""

    def __init__(self, instance: str, name: str) -> None:
        self.asked: list[str] = []
        self.came = threading.Event()
        self.go = threading.Event()

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        self.asked.append(cmd)
        self.came.set()
        assert self.go.wait(30)
        if cmd == "set":
            raise CommandError("invalid", "K = 1: too stiff")
        return {"ok": True, "result": fields}

    def close(self) -> None: ...


class Conversation:
    """An asker with a stand-in for its client, and its replies."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(asker, "Client", StandIn)
        self.stops = 0
        self.replies: list[dict[str, Any]] = []
        self.asker = Asker("nobody", "page", lambda: self.stops)
        self.client: StandIn = self.asker._client  # type: ignore[assignment]

    def ask(self, **request: Any) -> None:
        self.asker.ask(request, lambda text: self.replies.append(json.loads(text)))

    def finish(self) -> list[dict[str, Any]]:
        self.client.go.set()
        self.asker._thread.shutdown(wait=True)
        self.asker.close()
        return self.replies


def test_what_waits_when_stop_is_pressed_is_not_done(monkeypatch: pytest.MonkeyPatch) -> None:
    talk = Conversation(monkeypatch)
    talk.ask(ask=1, cmd="get")
    talk.ask(ask=2, cmd="reset")
    talk.ask(ask=3, cmd="enable")
    talk.stops += 1
    talk.ask(ask=4, cmd="status")
    replies = talk.finish()
    told = [(one["ask"], one["ok"]) for one in replies]
    assert told == [(1, True), (2, False), (3, False), (4, True)]
    assert "enable" not in talk.client.asked
    assert "STOP was pressed" in replies[2]["text"]


def test_what_waits_when_a_page_leaves_is_not_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its connection ends at once, and with it what the gateway has not begun."""
    monkeypatch.setattr(
        asker, "Client", lambda _, name: Client(folder=tmp_path, name=name, timeout_s=30.0)
    )
    page = Asker("nobody", "page", lambda: 0)
    with zmq.Context() as context, context.socket(zmq.ROUTER) as gateway:
        gateway.setsockopt(zmq.RCVTIMEO, 30_000)
        left = gateway.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        gateway.bind(f"ipc://{tmp_path / COMMAND_SOCKET}")
        page.ask({"cmd": "enable"}, lambda _: None)
        while msgpack.unpackb(gateway.recv_multipart()[-1])["cmd"] != "enable":
            pass
        page.close()
        assert left.poll(10_000)
        left.close()


def test_what_waits_for_its_turn_when_a_page_leaves_is_not_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    talk = Conversation(monkeypatch)
    talk.ask(ask=1, cmd="get")
    talk.ask(ask=2, cmd="enable")
    assert talk.client.came.wait(30)
    talk.asker.close()
    talk.finish()
    assert talk.client.asked == ["get"]


def test_a_page_asks_the_gateway_for_no_stop_and_nothing_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    talk = Conversation(monkeypatch)
    talk.ask(ask=1, cmd="stop")
    talk.ask(ask=2, cmd="schema")
    assert [one["ok"] for one in talk.finish()] == [False, False]
    assert talk.client.asked == []


def test_refusals_come_back_in_the_daemons_words(monkeypatch: pytest.MonkeyPatch) -> None:
    talk = Conversation(monkeypatch)
    talk.ask(ask=1, cmd="set", K=1)
    (reply,) = talk.finish()
    assert (reply["ok"], reply["code"], reply["text"]) == (False, "invalid", "K = 1: too stiff")


def test_a_page_that_asks_without_end_is_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    talk = Conversation(monkeypatch)
    for number in range(20):
        talk.ask(ask=number, cmd="get")
    assert [one["code"] for one in talk.replies] == ["busy"] * (20 - asker.MOST_OPEN)
    talk.finish()


# --- frames ---------------------------------------------------------------------------------------


def block(**values: Any) -> Any:
    """A block of two records as the gateway sends it."""
    records = np.zeros(2, np.dtype([tuple(field) for field in TELEMETRY]))
    for name, value in values.items():
        records[name] = value
    told = {"epoch": 1, "mono_unix_offset_ns": 5_000_000_000, "simulated": True, "next": 2}
    descr = [list(field) for field in TELEMETRY]
    payload = msgpack.packb(told | {"descr": descr, "d": records.tobytes()})
    return BlockDecoder().decode(payload)


def read(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A frame as the page reads it."""
    (length,) = struct.unpack_from("<I", data)
    header = json.loads(data[4 : 4 + length])
    assert (4 + length) % 8 == 0
    rows = np.frombuffer(data, "<f8", offset=4 + length).reshape(-1, header["n"])
    return header, dict(zip(header["columns"], rows, strict=True))


def test_a_frame_carries_every_tick_and_the_newest_state() -> None:
    header, columns = read(
        frame(
            block(
                time_ns=[1_000_000_000, 1_001_000_000],
                state=[State.DISABLED, State.ENABLED],
                position_m=[0.5, 0.25],
                read_ns=[1000, 2000],
                write_ns=[500, 500],
            )
        )
    )
    assert columns["time_s"].tolist() == [6.0, 6.001]
    assert columns["position_m"].tolist() == [0.5, 0.25]
    assert columns["work_ns"].tolist() == [1500, 2500]
    assert (header["n"], header["now"]["state"], header["simulated"]) == (2, "enabled", True)


def test_damping_that_a_board_does_not_report_is_unknown_and_not_zero() -> None:
    header, _ = read(frame(block(active_damping_effect_ns_per_m=np.nan)))
    assert header["now"]["active_damping_effect_ns_per_m"] is None
    assert header["now"]["damping_count"] is None


@pytest.mark.parametrize("flags", [0, Flag.PROXY_HELD])
def test_a_frame_carries_the_proxy_and_who_holds_the_lease(flags: int) -> None:
    header, _ = read(frame(block(proxy_m=0.004, lease_control=17, flags=flags)))
    now = header["now"]
    assert (now["proxy_m"], now["proxy_held"], now["lease_control"]) == (0.004, bool(flags), 17)


def test_count_of_the_damping_is_that_of_the_boards_frame() -> None:
    raw = bytearray(64)
    struct.pack_into("<HHB", raw, 56, 123, 11403, 1)
    header, _ = read(frame(block(active_damping_effect_ns_per_m=1.74, in_frame=bytes(raw))))
    assert header["now"]["damping_count"] == 11403


# --- where it is ----------------------------------------------------------------------------------


def test_a_taken_port_is_passed_over_unless_it_was_asked_for() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        with server.bound(None, taken) as line:
            assert line.getsockname()[1] != taken
            assert line.getsockname()[0] == "127.0.0.1"
        with pytest.raises(ConfigError, match=str(taken)):
            server.bound(taken, None)


def test_no_answer_is_held_back_until_the_one_before_it_was_acknowledged() -> None:
    async def accepted() -> int:
        came: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        def look(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            line = writer.get_extra_info("socket")
            came.set_result(line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        line = server.bound(None, None)
        async with await asyncio.start_server(look, sock=line):
            _, writer = await asyncio.open_connection(*line.getsockname())
            found = await came
            writer.close()
        return found

    assert asyncio.run(accepted()) == 1


def test_the_place_is_told_while_the_page_lives_and_its_port_kept(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    place = tmp_path / CONSOLE
    assert (server.port_before(place), console_place(tmp_path)) == (None, None)
    server.note(place, "http://127.0.0.1:1234/", 1234)
    told = console_place(tmp_path)
    assert told is not None
    assert told["url"] == "http://127.0.0.1:1234/"
    assert server.port_before(place) == 1234
    place.unlink()
    assert console_place(tmp_path) is None


# --- what is not ours -----------------------------------------------------------------------------


def test_vendored_file_is_the_one_that_was_released() -> None:
    text = (STATIC / "vendor" / "uPlot.txt").read_text()
    content = (STATIC / "vendor" / "uPlot.iife.min.js").read_bytes()
    assert hashlib.sha256(content).hexdigest() in text
    assert "package uplot, version 1.6.32" in text
    assert b"(v1.6.32)" in content[:80]
    assert "The MIT License" in text


def test_nothing_else_is_vendored() -> None:
    names = {path.name for path in (STATIC / "vendor").iterdir()}
    assert names == {"uPlot.iife.min.js", "uPlot.txt"}


# --- impedance ------------------------------------------------------------------------------------


def probe_block(force_n: np.ndarray, velocity: np.ndarray, gap: int = 0) -> Block:
    """A block of the probe as the gateway sends it: counts, and what they mean."""
    dtype = [("index", "<u8"), ("time_ns", "<i8"), ("torque", "<i2"), ("velocity", "<i2")]
    records = np.zeros(len(force_n), dtype)
    records["torque"] = np.round(-force_n / 1e-4) + 7
    records["velocity"] = np.round(velocity / 1e-5)
    scale = {
        "torque": {"per_count": 1e-4, "sign": -1, "offset_count": 7.0},
        "velocity": {"per_count": 1e-5, "sign": 1, "offset_count": 0.0},
    }
    return Block(records, gap, False, {"scale": scale})


def damper(samples: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    """Force on a pure damper of 2 N s/m, and its velocity."""
    velocity = np.random.default_rng(3).normal(0.0, 0.03, samples)
    return 2.0 * velocity, velocity


def test_estimate_is_the_impedance_whatever_signs_and_offsets_the_counts_have() -> None:
    force, velocity = damper()
    found = estimate(
        [probe_block(force[:9000], velocity[:9000]), probe_block(force[9000:], velocity[9000:])]
    )
    np.testing.assert_allclose(found["real"], 2.0, atol=0.01)
    np.testing.assert_allclose(found["size"], 2.0, atol=0.01)
    assert (found["seconds"], found["lost"]) == (5.0, 0)


def test_samples_that_were_lost_are_told() -> None:
    force, velocity = damper()
    blocks = [probe_block(force, velocity, gap=50), probe_block(force, velocity, gap=12)]
    assert estimate(blocks)["lost"] == 12  # what was lost before the first is not missing


def test_what_is_not_coherent_is_not_shown() -> None:
    force, velocity = damper()
    noise = np.random.default_rng(4).normal(0.0, 1.0, len(force))
    found = estimate([probe_block(0.001 * force + noise, velocity)])
    assert found["real"] == [None] * len(found["real"])


# --- other accounts of the computer -----------------------------------------------------------


@pytest.fixture
def connection() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Both ends of a connection over the loopback: (client's, server's)."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = socket.create_connection(listener.getsockname())
        server, _ = listener.accept()
    with client, server:
        yield client, server


def asked_over(connection: tuple[socket.socket, socket.socket], **scope: Any) -> dict[str, Any]:
    client, _ = connection
    ends = {"client": client.getsockname(), "server": client.getpeername()}
    return {**ends, "headers": headers(host="127.0.0.1:9873"), **scope}


def test_kernel_tells_whose_connection_it_is(
    connection: tuple[socket.socket, socket.socket],
) -> None:
    client, _ = connection
    table = visitors.CONNECTIONS.read_text().splitlines()
    ends = (client.getsockname(), client.getpeername())
    assert visitors.owner_of(*ends, table) == os.getuid()
    assert visitors.owner_of(("127.0.0.1", 1), client.getpeername(), table) is None


@pytest.mark.parametrize(("state", "inode"), [("01", "0"), ("04", "0"), ("06", "77")])
def test_a_connection_that_is_closed_is_nobodys_and_not_roots(state: str, inode: str) -> None:
    """The kernel writes account 0 behind an end that its owner has closed."""
    ends = "0100007F:C350 0100007F:2691"
    line = f"1: {ends} {state} 00000000:00000000 00:00000000 00000000     0        0 {inode} 1"
    asked = ("127.0.0.1", 0xC350), ("127.0.0.1", 0x2691)
    assert visitors.owner_of(*asked, [line]) is None
    opened = line.replace(f" {state} ", " 01 ").replace(f" {inode} 1", " 77 1")
    assert visitors.owner_of(*asked, [opened]) == 0


@pytest.mark.parametrize(
    ("ours", "path", "status"),
    [
        (frozenset({os.getuid()}), "/", 200),
        (frozenset({os.getuid() + 1}), "/", 403),
        (frozenset({os.getuid() + 1}), "/static/page.js", 403),
        (frozenset({os.getuid() + 1}), "/stop", 405),  # by GET; it came as far as its route
    ],
)
@pytest.mark.usefixtures("runtime")
def test_another_account_of_the_computer_may_stop_and_nothing_else(
    connection: tuple[socket.socket, socket.socket],
    monkeypatch: pytest.MonkeyPatch,
    ours: frozenset[int],
    path: str,
    status: int,
) -> None:
    monkeypatch.setattr(visitors, "accounts", lambda: ours)
    sent = exchange(asked_over(connection, type="http", method="GET", path=path))
    assert sent[0]["status"] == status
    if status == 403:
        assert b"or run `hapticd console` of your own" in sent[1]["body"]


def test_program_that_writes_the_address_as_ipv6_is_known_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A socket of IPv6 that is connected to ::ffff:127.0.0.1 stands in tcp6 alone."""
    mapped = "0000000000000000FFFF00000100007F"
    zeros = "00000000:00000000 00:00000000 00000000"
    (tmp_path / "tcp6").write_text(f"7: {mapped}:C350 {mapped}:2691 01 {zeros}  1000        0 77 1")
    monkeypatch.setattr(visitors, "CONNECTIONS_6", tmp_path / "tcp6")
    scope = {"client": ("127.0.0.1", 0xC350), "server": ("127.0.0.1", 0x2691)}
    assert visitors.stranger(scope, frozenset({1000})) == ""
    assert "this page is" in visitors.stranger(scope, frozenset({1001}))


def test_crowd_of_visitors_is_turned_away_and_stop_is_not() -> None:
    """Nobody else waits for the ones that are attended to, and STOP is not counted."""
    passed: list[str] = []
    released = asyncio.Event()

    async def page(scope: Any, receive: Any, send: Any) -> None:
        passed.append(scope["path"])
        if scope["path"] == "/":
            await released.wait()

    async def crowd() -> list[Any]:
        app = visitors.Visitors(page)
        scope = {
            "type": "http",
            "method": "GET",
            "path": "/",
            "headers": headers(host="127.0.0.1:1"),
        }
        sent: list[Any] = []

        async def send(message: Any) -> None:
            sent.append(message)

        there = [asyncio.create_task(app(scope, None, send)) for _ in range(visitors.MOST_VISITS)]
        while len(passed) < visitors.MOST_VISITS:
            await asyncio.sleep(0.001)
        await app(scope, None, send)
        await app({**scope, "method": "POST", "path": "/stop"}, None, send)
        released.set()
        await asyncio.gather(*there)
        await app(scope, None, send)
        return sent

    sent = asyncio.run(crowd())
    assert [one["status"] for one in sent if "status" in one] == [503]
    assert passed == ["/"] * visitors.MOST_VISITS + ["/stop", "/"]


@pytest.mark.usefixtures("runtime")
def test_another_account_opens_no_socket(
    connection: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visitors, "accounts", lambda: frozenset({os.getuid() + 1}))
    page = headers(host="127.0.0.1:9873", origin="http://127.0.0.1:9873")
    scope = asked_over(connection, type="websocket", path="/live", subprotocols=[])
    sent = exchange(scope | {"headers": page})
    assert [one["type"] for one in sent] == ["websocket.close"]


def test_page_is_for_its_account_root_and_who_called_it_by_sudo(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 1000)
    monkeypatch.delenv("SUDO_UID", raising=False)
    assert visitors.accounts() == {0, 1000}
    monkeypatch.setenv("SUDO_UID", "1001")
    assert visitors.accounts() == {0, 1000, 1001}
