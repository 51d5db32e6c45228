"""The guard's worker: a child process that judges, and the gateway's connection to it.

Connection (`Worker`). One child process, one socket pair, numbered answers. The worker has the
model and computes; the gateway does not wait. Each message is a msgpack map preceded by its length
(u32, little-endian), at most 64 kB. The first message of the worker is its hello. No call blocks: a
message fits the socket buffer, or the worker has hung, and input is read when the selector reports
it. A worker that ends, sends an invalid message or does not read is killed and restarted, at most
every 2 s. The worker ends with the gateway. Its hello contains the hash of its configuration, so a
worker with another configuration is not used.

Process (`main`): `python -m hapticd.guard.worker FOLDER --fd N [--parent PID]`. It judges
environments on the model in FOLDER/guard.json (`guard.judge.Judge`) for the gateway, which keeps
the other end of the socket N. It first sends a hello with its configuration; then every request
gets one answer. An error in a request is answered with {"n": .., "error": text}, and the worker
continues. While idle, it prepares the levels of damping for later requests.

Exit code 0: the gateway has ended or has asked the worker to end; 78: guard.json is wrong, and a
restart would not help.

The process must not import numba, zmq or pydantic (a test checks), the gateway no `judge`.
"""

import argparse
import os
import select
import selectors
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack

from hapticd.core.errors import HapticdError
from hapticd.core.params import read_params
from hapticd.core.process import die_with_parent, on_stop
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.files import GUARD_JSON
from hapticd.model.params import GuardSetup
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

if TYPE_CHECKING:
    import subprocess

    from hapticd.guard.judge import Judge

__all__ = ["LENGTH", "Start", "Worker"]

RESTART_NS = 2 * NS_PER_S
READ_BYTES = 4 * MAX_MESSAGE_BYTES  # in one pass
LENGTH = struct.Struct("<I")  # before each message, in bytes


Start = Callable[[socket.socket], "subprocess.Popen[bytes]"]  # the worker, with its end of the line


class BadMessage(ValueError):
    """The worker sent an invalid or unexpected message."""


class Worker:
    """The worker process and its successors. `state` is up, starting or down."""

    def __init__(self, start: Start, selector: selectors.BaseSelector, config_hash: str) -> None:
        self._start = start
        self._selector = selector
        self._config_hash = config_hash
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: list[subprocess.Popen[bytes]] = []  # killed, not yet reaped
        self._socket: socket.socket | None = None
        self._buffer = b""
        self._answers: list[dict[str, Any]] = []
        self._started_ns: int | None = None
        self.life = 0  # number of the worker: a new one has none of the earlier questions
        self.hello: dict[str, Any] = {}
        self.trouble = "it has not been started"

    @property
    def state(self) -> str:
        """Up once the hello has arrived."""
        if self._socket is None:
            return "down"
        return "up" if self.hello else "starting"

    def tend(self, now_ns: int) -> None:
        """Start the worker if due."""
        self._ended = [one for one in self._ended if one.poll() is None]
        due = self._started_ns is None or now_ns - self._started_ns >= RESTART_NS
        if self._socket is None and due:
            self._started_ns = now_ns
            self._begin()

    def _begin(self) -> None:
        ours, theirs = socket.socketpair()
        try:
            self._process = self._start(theirs)
        except OSError as error:
            self.trouble = f"it could not be started: {error}"
            ours.close()
            return
        finally:
            theirs.close()
        ours.setblocking(False)
        self.life += 1
        self._socket = ours
        self._selector.register(ours, selectors.EVENT_READ, self._read)

    def ask(self, request: dict[str, Any]) -> None:
        """Send `request`; end a worker that does not read it."""
        if self._socket is None:
            return
        data = bytes(msgpack.packb(request))
        try:
            sent = self._socket.send(LENGTH.pack(len(data)) + data)
        except OSError:
            sent = 0
        if sent != LENGTH.size + len(data):
            self.give_up("it does not read requests")

    def answers(self) -> list[dict[str, Any]]:
        """Return the answers since the last call."""
        found = self._answers
        self._answers = []
        return found

    def give_up(self, trouble: str) -> None:
        """End the worker, because of `trouble`; `tend` starts the next one when due."""
        self.trouble = trouble
        self.hello = {}
        self._buffer = b""
        self._answers = []
        if self._socket is not None:
            self._selector.unregister(self._socket)
            self._socket.close()
        self._socket = None
        if self._process is not None:
            self._process.kill()
            self._ended.append(self._process)
        self._process = None

    def _read(self, _events: int) -> None:
        try:
            came = self._socket.recv(READ_BYTES) if self._socket else b""
        except BlockingIOError:
            return
        except OSError:
            came = b""
        if not came:
            self.give_up("it has ended")
            return
        self._buffer += came
        try:
            self._take_messages()
        except (ValueError, msgpack.UnpackException) as error:
            self.give_up(f"it sent an invalid message: {error}")

    def _take_messages(self) -> None:
        while len(self._buffer) >= LENGTH.size:
            (length,) = LENGTH.unpack_from(self._buffer)
            if length > MAX_MESSAGE_BYTES:
                raise BadMessage(f"{length} bytes, at most {MAX_MESSAGE_BYTES}")
            end = LENGTH.size + length
            if len(self._buffer) < end:
                return
            # no bytes and no extensions: JSON clients receive its content
            message = msgpack.unpackb(self._buffer[LENGTH.size : end], max_bin_len=0, max_ext_len=0)
            self._buffer = self._buffer[end:]
            if not isinstance(message, dict):
                raise BadMessage(f"{type(message).__name__} instead of a map")
            self._take(message)

    def _take(self, message: dict[str, Any]) -> None:
        if self.hello:
            self._answers.append(message)
            return
        hello = message.get("hello")
        if not isinstance(hello, dict):
            raise BadMessage("no hello before its first answer")
        theirs = str(hello.get("config_hash", ""))
        if theirs != self._config_hash:
            raise BadMessage(
                f"it judges configuration {theirs[:12]}, the gateway {self._config_hash[:12]}"
            )
        self.hello = hello

    def close(self) -> None:
        """End the worker permanently."""
        self.give_up("the gateway ends")


# --- process --------------------------------------------------------------------------------------


def main(arguments: list[str]) -> int:
    """Serve until the other end closes; return the exit code."""
    parser = argparse.ArgumentParser(prog="hapticd.guard.worker", allow_abbrev=False)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fd", type=int, required=True)
    parser.add_argument("--parent", type=int)
    asked = parser.parse_args(arguments)
    on_stop(_end)
    die_with_parent(asked.parent)
    _be_a_batch()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy loads; threads only wait
    from hapticd.guard.judge import Judge

    try:
        judge = Judge(read_params(GuardSetup, asked.folder / GUARD_JSON))
    except HapticdError as error:
        sys.stderr.write(f"hapticd guard: {error}\n")
        return error.exit_code
    with socket.socket(fileno=asked.fd) as line:
        serve(line, judge)
    return 0


def _be_a_batch() -> None:
    """Run under SCHED_BATCH, so that a request does not interrupt the gateway. Otherwise the worker
    would take the gateway's core for about 3 ms, in the middle of a pass.
    """
    with suppress(OSError):  # without the right to do so, changes act a little later
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _end() -> None:
    raise SystemExit(0)


def serve(line: socket.socket, judge: "Judge") -> None:
    """Answer the requests on `line` until it ends."""
    try:
        _send(line, judge.hello(os.getpid()))
        while True:
            _warm_while_idle(line, judge)
            request = _receive(line)
            if request is None:
                return
            _send(line, answered(judge, request))
    except ConnectionError:
        return


def answered(judge: "Judge", request: bytes) -> dict[str, Any]:
    """Return the answer to one message; an error is an answer too."""
    number = None
    try:
        plain = msgpack.unpackb(request)
        number = plain.get("n")
        return judge.answer(plain)
    except Exception as error:  # one request that fails must not end the guard
        return {"n": number, "error": f"{type(error).__name__}: {error}"}


def _warm_while_idle(line: socket.socket, judge: "Judge") -> None:
    try:
        while not select.select([line], [], [], 0.0)[0] and judge.warm():
            pass
    except HapticdError:
        return  # a request for a level that cannot be computed reports the error


def _receive(line: socket.socket) -> bytes | None:
    """Return the next message; None at the end, or if a message is longer than allowed."""
    head = line.recv(LENGTH.size, socket.MSG_WAITALL)
    if len(head) < LENGTH.size:
        return None
    (size,) = LENGTH.unpack(head)
    if size > MAX_MESSAGE_BYTES:
        return None
    content = line.recv(size, socket.MSG_WAITALL)
    return content if len(content) == size else None


def _send(line: socket.socket, message: dict[str, Any]) -> None:
    content = msgpack.packb(message)
    line.sendall(LENGTH.pack(len(content)) + content)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
