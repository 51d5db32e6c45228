"""The line to the guard's worker: its framing, and a worker that dies, hangs or lies."""

import selectors
import socket
import struct
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest

from hapticd.core.units import NS_PER_S
from hapticd.guard.worker import RESTART_NS, Worker
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

HASH = "c" * 64
HELLO = {"hello": {"model": True, "model_hash": "m", "config_hash": HASH, "pid": 7}}


def framed(message: Any) -> bytes:
    data = msgpack.packb(message)
    return struct.pack("<I", len(data)) + data


class FakeProcess:
    """A process that only knows whether it was killed."""

    pid = 7

    def __init__(self) -> None:
        self.killed = False

    def poll(self) -> int | None:
        return -9 if self.killed else None

    def kill(self) -> None:
        self.killed = True


class Line:
    """A worker line whose other end is played by the test."""

    def __init__(self) -> None:
        self.selector = selectors.DefaultSelector()
        self.processes: list[FakeProcess] = []
        self.ends: list[socket.socket] = []
        self.worker = Worker(self._start, self.selector, HASH)
        self.worker.tend(0)

    def _start(self, theirs: socket.socket) -> FakeProcess:
        self.ends.append(theirs.dup())
        self.processes.append(FakeProcess())
        return self.processes[-1]

    def says(self, data: bytes) -> None:
        """The worker writes `data`, and the gateway looks."""
        self.ends[-1].sendall(data)
        self.look()

    def look(self) -> None:
        for key, mask in self.selector.select(0):
            key.data(mask)

    def close(self) -> None:
        self.worker.close()
        for end in self.ends:
            end.close()
        self.selector.close()


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    yield line
    line.close()


def test_it_is_up_once_it_has_said_hello(line: Line) -> None:
    assert line.worker.state == "starting"
    line.says(framed(HELLO))
    assert (line.worker.state, line.worker.hello["pid"]) == ("up", 7)


def test_question_and_answer_go_through_in_any_pieces(line: Line) -> None:
    line.says(framed(HELLO))
    line.worker.ask({"ask": "look", "n": 3})
    assert line.ends[-1].recv(1000) == framed({"ask": "look", "n": 3})
    answers = framed({"n": 3}) + framed({"n": 4})
    for place in range(len(answers)):
        line.says(answers[place : place + 1])
    assert line.worker.answers() == [{"n": 3}, {"n": 4}]
    assert line.worker.answers() == []


@pytest.mark.parametrize(
    "data",
    [
        framed([1, 2]),
        framed({"n": 1}),
        struct.pack("<I", MAX_MESSAGE_BYTES + 1),
        struct.pack("<I", 3) + b"\xc1\xc1\xc1",
        framed({"hello": {"config_hash": "d" * 64}}),
        framed({"hello": {"config_hash": HASH, "model": b"bytes"}}),
    ],
    ids=["no map", "no hello", "too long", "no msgpack", "another configuration", "bytes"],
)
def test_worker_that_sends_garbage_is_ended(line: Line, data: bytes) -> None:
    line.says(data)
    assert line.worker.state == "down"
    assert line.processes[0].killed
    assert line.worker.trouble


def test_worker_that_ends_is_started_again_at_most_every_two_seconds(line: Line) -> None:
    line.says(framed(HELLO))
    line.ends[-1].close()
    line.look()
    assert line.worker.state == "down"
    line.worker.tend(RESTART_NS - 1)
    assert len(line.processes) == 1
    line.worker.tend(RESTART_NS)
    assert (len(line.processes), line.worker.state) == (2, "starting")


def test_what_an_ended_worker_said_is_forgotten(line: Line) -> None:
    line.says(framed(HELLO) + framed({"n": 1}) + framed({"n": 2})[:3])
    line.worker.give_up("no verdict")
    line.worker.tend(10 * NS_PER_S)
    assert line.worker.answers() == []
    line.says(framed(HELLO) + framed({"n": 5}))
    assert line.worker.answers() == [{"n": 5}]


def test_worker_that_takes_nothing_is_ended_and_nobody_waits(line: Line) -> None:
    line.says(framed(HELLO))
    for number in range(2000):
        line.worker.ask({"n": number, "padding": "x" * 1000})
        if line.worker.state == "down":
            break
    assert line.processes[0].killed


def test_worker_that_cannot_be_started_is_tried_again(line: Line) -> None:
    def fails(theirs: socket.socket) -> FakeProcess:
        raise OSError("no such file")

    worker = Worker(fails, line.selector, HASH)
    worker.tend(0)
    assert (worker.state, worker.trouble) == ("down", "it could not be started: no such file")


def test_worker_ends_with_the_gateway(line: Line) -> None:
    line.says(framed(HELLO))
    line.worker.close()
    assert line.processes[0].killed
    assert line.ends[-1].recv(10) == b""
