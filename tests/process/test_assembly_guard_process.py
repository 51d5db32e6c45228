"""The guard's worker: what it starts from, what it says, and that it outlives a bad request."""

import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
from support.assembly_guard import REQUEST
from support.tree import ROOT

from hapticd.mailbox import files
from hapticd.run import supervisor
from hapticd.settings.load import load

LENGTH = struct.Struct("<I")


@contextmanager
def worker(folder: Path) -> Iterator[tuple["subprocess.Popen[str]", socket.socket]]:
    ours, theirs = socket.socketpair()
    command = [sys.executable, "-X", "importtime", "-m", "hapticd.guard.worker"]
    process = subprocess.Popen(
        [*command, str(folder), "--fd", str(theirs.fileno())],
        pass_fds=(theirs.fileno(),),
        stderr=subprocess.PIPE,
        text=True,
    )
    theirs.close()
    ours.settimeout(60.0)
    try:
        yield process, ours
    finally:
        ours.close()
        process.kill()
        process.communicate()


def receive(line: socket.socket) -> Any:
    (size,) = LENGTH.unpack(line.recv(LENGTH.size, socket.MSG_WAITALL))
    return msgpack.unpackb(line.recv(size, socket.MSG_WAITALL))


def send(line: socket.socket, message: Any) -> None:
    content = msgpack.packb(message)
    line.sendall(LENGTH.pack(len(content)) + content)


@pytest.mark.process
def test_worker_says_hello_answers_and_ends_with_the_gateway(runtime: Path) -> None:
    folder = runtime / "hapticd" / "instance-guard"
    supervisor.write(folder, load(ROOT / "tests/support/data" / "guard_weir2008.toml"), "guard")
    setup = json.loads((folder / files.GUARD_JSON).read_text())
    with worker(folder) as (process, line):
        hello = receive(line)["hello"]
        assert hello["model"]
        assert hello["model_hash"] == setup["model_hash"] != ""
        assert hello["config_hash"] == setup["config_hash"]
        assert hello["pid"] == process.pid
        # woken by a question it takes nobody's core
        assert os.sched_getscheduler(process.pid) == os.SCHED_BATCH
        send(line, REQUEST)
        assert receive(line)["action"] == "apply"
        line.close()
        _, imported = process.communicate(timeout=60.0)
        assert process.returncode == 0
    names = {row.rsplit("|", 1)[-1].strip().partition(".")[0] for row in imported.splitlines()}
    assert "numpy" in names
    assert names & {"numba", "zmq", "pydantic", "typer", "scipy", "usb"} == set()


@pytest.mark.process
@pytest.mark.parametrize("content", ["", "{}", '{"guard": 1}'])
def test_wrong_setup_is_told_and_no_restart_would_help(runtime: Path, content: str) -> None:
    (runtime / files.GUARD_JSON).write_text(content)
    with worker(runtime) as (process, _line):
        _, told = process.communicate(timeout=60.0)
    assert process.returncode == 78
    assert "guard.json" in told.splitlines()[-1] or "hapticd guard:" in told
