"""A law of one's own in a process: it moves the proxy of a running daemon, and kill -9 leaves the
proxy where it is until its lease has ended the environment.
"""

import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from support.daemon import DEADLINE_S, Daemon, shared_daemon, until

from hapticd.client import Client

pytestmark = pytest.mark.process
LAW = """
import sys
from math import sin
from hapticd.client import Client

def law(felt):
    if felt.proxy_m > 0.002 and sys.argv[2] == "waits":
        print("moving", flush=True)
        sys.stdin.read()
    return min(0.004, felt.proxy_m + 1e-4)

with Client(sys.argv[1], name="law") as device:
    with device.lease("environment", ttl_s=1.0, at_end=sys.argv[3]):
        device.set(K=100, B=1)
        device.enable()
        device.follow_law(law, rate_hz=200.0)
"""


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with shared_daemon() as daemon:
        yield daemon


@pytest.fixture
def other(daemon: Daemon) -> Iterator[Client]:
    with Client(daemon.instance, name="other", timeout_s=DEADLINE_S) as other:
        yield other
        other.disable()


def started(daemon: Daemon, how: str, at_end: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-c", LAW, daemon.instance, how, at_end]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def ended(law: "subprocess.Popen[Any]") -> None:
    law.kill()
    law.communicate()


def test_killed_law_leaves_the_proxy_and_its_lease_ends_the_environment(
    daemon: Daemon, other: Client
) -> None:
    law = started(daemon, "goes on", "zero")
    try:
        until(lambda: other.proxy().proxy_m == 0.004, "the law moves the proxy")
        law.send_signal(signal.SIGKILL)
        until(lambda: not other.status().leases, "its lease ends with its connection")
        until(lambda: other.proxy().stiffness_n_per_m == 0.0, "the environment goes to 0")
        until(lambda: other.proxy().proxy_m == 0.0, "the proxy ends with the spring")
    finally:
        ended(law)


def test_killed_law_with_an_environment_that_is_held_leaves_the_proxy_for_good(
    daemon: Daemon, other: Client
) -> None:
    law = started(daemon, "goes on", "hold")
    try:
        until(lambda: other.proxy().proxy_m == 0.004, "the law moves the proxy")
        law.send_signal(signal.SIGKILL)
        until(lambda: not other.status().leases, "its lease ends with its connection")
        until(lambda: other.proxy().held, "the proxy is held")
        for _ in range(50):
            assert other.proxy().proxy_m == 0.004
        assert other.get().parameters["K"] == 100.0
        other.disable()
        until(lambda: other.proxy().proxy_m == 0.0, "the proxy ends with the force")
    finally:
        ended(law)


def test_silent_law_is_held_while_its_process_lives(daemon: Daemon, other: Client) -> None:
    law = started(daemon, "waits", "zero")
    try:
        assert law.stdout is not None
        assert law.stdout.readline() == "moving\n"
        until(lambda: other.proxy().held, "the proxy is held")
        assert 0.0 < other.proxy().proxy_m < 0.004
        until(lambda: not other.status().leases, "a silent holder loses its lease")
        assert law.poll() is None
        until(lambda: other.proxy().proxy_m == 0.0, "the proxy ends with the spring")
    finally:
        ended(law)
