"""The line to the guard's worker: one child process, one pair of sockets, answers by number.

The worker knows the model and computes; the gateway asks and goes on. Each message is a map in
msgpack behind its length (u32, little-endian), at most 64 kB. The first one from the worker is its
hello. Nothing here waits: what is sent fits the socket or the worker hangs, what came is read when
the selector says so. A worker that ends, sends what is no message, or does not take what is sent is
killed, and started anew, at most every 2 s.

The worker ends with the gateway. Its hello names the hash, so a worker of another configuration is
not used.
"""

import selectors
import socket
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgpack

from hapticd.core.units import NS_PER_S
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

if TYPE_CHECKING:
    import subprocess

__all__ = ["LENGTH", "Start", "Worker"]

RESTART_NS = 2 * NS_PER_S
READ_BYTES = 4 * MAX_MESSAGE_BYTES  # in one pass
LENGTH = struct.Struct("<I")  # before each message, in bytes


Start = Callable[[socket.socket], "subprocess.Popen[bytes]"]  # the worker, with its end of the line


class BadMessage(ValueError):
    """What the worker sent is no message, or not one that was expected."""


class Worker:
    """The worker, as long as it lives, and the next one. `state` is up, starting or down."""

    def __init__(self, start: Start, selector: selectors.BaseSelector, config_hash: str) -> None:
        self._start = start
        self._selector = selector
        self._config_hash = config_hash
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: list[subprocess.Popen[bytes]] = []  # killed, to be waited for
        self._socket: socket.socket | None = None
        self._buffer = b""
        self._answers: list[dict[str, Any]] = []
        self._started_ns: int | None = None
        self.life = 0  # number of the worker: the next one knows nothing of what was asked
        self.hello: dict[str, Any] = {}
        self.trouble = "it has not been started"

    @property
    def state(self) -> str:
        """Up once it has said hello."""
        if self._socket is None:
            return "down"
        return "up" if self.hello else "starting"

    def tend(self, now_ns: int) -> None:
        """Start it if it is due."""
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
        """Send `request`; a worker that does not take it is given up."""
        if self._socket is None:
            return
        data = bytes(msgpack.packb(request))
        try:
            sent = self._socket.send(LENGTH.pack(len(data)) + data)
        except OSError:
            sent = 0
        if sent != LENGTH.size + len(data):
            self.give_up("it takes no requests")

    def answers(self) -> list[dict[str, Any]]:
        """What it has said since the last call."""
        found = self._answers
        self._answers = []
        return found

    def give_up(self, trouble: str) -> None:
        """End it, because of `trouble`; the next one is started when it is time."""
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
            # no bytes and no extensions: JSON clients get what it says
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
        """End it for good."""
        self.give_up("the gateway ends")
