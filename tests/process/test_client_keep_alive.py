"""A lease that a thread keeps alive: a participant may think, a deadlocked script keeps it, and its
end is that of the process. A lease without it ends when its script hangs.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.daemon import DEADLINE_S, Daemon, shared_daemon, until
from support.tree import ROOT

from hapticd.client import Client

pytestmark = pytest.mark.process
TTL_S = 1.0
PROMPT = "which one was stiffer, 1 or 2? "
HANGS = """
import sys, threading
from hapticd.client import Client

with Client(sys.argv[1], name="holder") as device:
    with device.lease("environment", ttl_s=1.0, at_end="disable", keep_alive=sys.argv[2] == "yes"):
        device.enable()
        print("held", flush=True)
        lock = threading.Lock()
        lock.acquire()
        lock.acquire()
"""


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with shared_daemon() as daemon:
        yield daemon


@pytest.fixture
def other(daemon: Daemon) -> Iterator[Client]:
    with Client(daemon.instance, name="other", timeout_s=DEADLINE_S) as other:
        yield other


def leases(other: Client) -> dict[str, Any]:
    return dict(other.status().leases)


def holder(daemon: Daemon, keep_alive: str) -> "subprocess.Popen[str]":
    """A script that holds a lease of 1 s and whose main thread has deadlocked."""
    command = [sys.executable, "-c", HANGS, daemon.instance, keep_alive]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "held\n"
    return child


def test_lease_that_is_kept_alive_outlives_a_deadlock_and_ends_with_its_process(
    daemon: Daemon, other: Client
) -> None:
    with holder(daemon, "yes") as child:
        time.sleep(3.0 * TTL_S)
        assert "environment" in leases(other)
        child.send_signal(signal.SIGKILL)
        until(lambda: not leases(other), "the end of the lease")
    until(lambda: other.status().state == "disabled", "disabled")


def test_lease_of_a_deadlocked_script_ends_without_it(daemon: Daemon, other: Client) -> None:
    with holder(daemon, "no") as child:
        until(lambda: not leases(other), "the end of the lease")
        child.send_signal(signal.SIGKILL)
    until(lambda: other.status().state == "disabled", "disabled")


def test_participant_may_think_for_six_seconds(daemon: Daemon, tmp_path: Path) -> None:
    """examples/jnd.py, of a daemon with a name: the lease of an answer lives for 5 s."""
    script = ROOT / "examples" / "jnd.py"
    command = [sys.executable, str(script), "--instance", daemon.instance, "--pause", "0.1"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        for seconds in (6.0, 0.0):
            assert child.stdout.read(len(PROMPT)) == PROMPT
            time.sleep(seconds)
            child.stdin.write("1\n")
            child.stdin.flush()
        assert child.stdout.read(len(PROMPT)) == PROMPT
        child.kill()
