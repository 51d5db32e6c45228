"""The guard's worker: `python -m hapticd.guard.main FOLDER --fd N [--parent PID]`.

It judges environments on the model in FOLDER/guard.json (`guard.judge.Judge`) for the gateway,
which keeps the other end of the socket N. Messages in both directions are msgpack maps, each
preceded by its length (`guard.worker`). The worker first sends a hello with its configuration; then
every request gets one answer. An error in a request is answered with {"n": .., "error": text}, and
the worker continues. While idle, it prepares the levels of damping for later requests.

Exit code 0: the gateway has ended or has asked the worker to end; 78: guard.json is wrong, and a
restart would not help.

It must not import numba, zmq or pydantic (a test checks).
"""

import argparse
import os
import select
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack

from hapticd.core.errors import HapticdError
from hapticd.core.params import GuardSetup, read_params
from hapticd.core.process import die_with_parent, on_stop
from hapticd.guard.worker import LENGTH
from hapticd.mailbox.files import GUARD_JSON
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

if TYPE_CHECKING:
    from hapticd.guard.judge import Judge


def main(arguments: list[str]) -> int:
    """Serve until the other end closes; return the exit code."""
    parser = argparse.ArgumentParser(prog="hapticd.guard.main", allow_abbrev=False)
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
