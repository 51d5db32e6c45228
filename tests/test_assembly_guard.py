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
from support.guard_device import (
    change,
    over_compensated,
    request,
    setup_of,
    shipped_judge,
    shipped_setup,
)
from support.tree import ROOT

from hapticd.analysis.bases import model_of
from hapticd.analysis.judge import Judge
from hapticd.analysis.loop import spectral_radius
from hapticd.assembly import resolve
from hapticd.assembly.guard_main import answered
from hapticd.mailbox import files
from hapticd.params import GuardSetup, from_plain, to_plain
from hapticd.plant.compose import compose
from hapticd.settings.load import load
from hapticd.zwidth.scenes import device_scene

LENGTH = struct.Struct("<I")
REQUEST = request({"K": 20.0}, n=7)


def test_setup_survives_json_to_the_last_bit() -> None:
    setup = shipped_setup()
    assert from_plain(GuardSetup, json.loads(json.dumps(to_plain(setup)))) == setup


def test_model_in_numbers_is_the_model_of_the_bench() -> None:
    """The same eigenvalues to the last bit, from guard.json and from the device file."""
    scene = device_scene("weir2008")
    params = shipped_setup().model
    assert scene is not None
    assert params is not None
    point = [(100.0, 1.0, 0.003)]
    ours = spectral_radius(model_of(params), point, 1.74)
    assert ours.tolist() == spectral_radius(compose(scene), point, 1.74).tolist()


def test_a_failing_request_is_an_answer_and_the_judge_goes_on() -> None:
    judge = shipped_judge()
    wrong = answered(judge, msgpack.packb(REQUEST | {"basis": "hearsay"}))
    assert wrong["n"] == 7
    assert "hearsay" in wrong["error"]
    assert "error" in answered(judge, b"\xc1")
    assert answered(judge, msgpack.packb(REQUEST))["action"] == "apply"


def test_every_answer_fits_into_a_message() -> None:
    answer = change(shipped_judge(), {"K": 150.0, "B": 1.0, "damping": 1.74})
    assert len(msgpack.packb(answer)) < 64 << 10


def test_an_unstable_circuit_is_never_safe() -> None:
    """Compensated for far more resistance than there is: it oscillates without a display."""
    judge = Judge(setup_of(over_compensated(400.0)))
    verdict = change(judge, {}, now={"damping": 10.0})["verdict"]
    assert verdict["safe"] is False
    assert verdict["allowed"] == {"K": None, "B": None, "M": None}


@contextmanager
def worker(folder: Path) -> Iterator[tuple["subprocess.Popen[str]", socket.socket]]:
    ours, theirs = socket.socketpair()
    command = [sys.executable, "-X", "importtime", "-m", "hapticd.assembly.guard_main"]
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
    resolve.write(folder, load(ROOT / "tests/support/data" / "guard_weir2008.toml"), "guard")
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
