"""Real processes that misbehave: stopped, killed, gone."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest
import zmq
from support.gateway_rig import GatewayRig, packed

from hapticd.client.blocks import BlockDecoder
from hapticd.core.units import NS_PER_S

pytestmark = pytest.mark.process

SUBSCRIBER = """
import os, signal, sys, zmq
socket = zmq.Context().socket(zmq.SUB)
socket.subscribe(sys.argv[2])
socket.connect(sys.argv[1])
socket.recv_multipart()
print("listening", flush=True)
os.kill(os.getpid(), signal.SIGSTOP)
"""
COMMANDER = """
import os, signal, sys, zmq
socket = zmq.Context().socket(zmq.DEALER)
socket.connect(sys.argv[1])
socket.send(bytes.fromhex(sys.argv[2]))
print("sent", flush=True)
socket.recv()
"""


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[GatewayRig]:
    with GatewayRig(tmp_path) as rig:
        yield rig


def start(script: str, *arguments: str) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", script, *arguments], stdout=subprocess.PIPE)


def said(rig: GatewayRig, child: "subprocess.Popen[bytes]") -> bytes:
    """The child's first line, while the rig goes on."""
    assert child.stdout
    os.set_blocking(child.stdout.fileno(), False)
    while not (line := child.stdout.readline()):
        assert child.poll() is None
        rig.step()
    return line


def memory_kb() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4


def test_stopped_subscriber_harms_nobody(rig: GatewayRig) -> None:
    endpoint = str(rig.gateway.endpoints["telemetry"][0])  # type: ignore[index]
    child = start(SUBSCRIBER, endpoint, "servo.raw")
    try:
        assert said(rig, child) == b"listening\n"
        os.waitpid(child.pid, os.WUNTRACED)
        healthy = rig.subscriber("servo.raw")
        decoder = BlockDecoder()
        gaps = [decoder.decode(rig.receive(healthy, ticks=20)[1]).gap for _ in range(500)]
        before = memory_kb()
        gaps += [decoder.decode(rig.receive(healthy, ticks=20)[1]).gap for _ in range(2500)]  # 50 s
        assert sum(gaps) == 0
        assert rig.gateway._publisher.feed.lost == 0
        assert memory_kb() - before < 10_000  # a queue without end would hold 23 MB
    finally:
        child.kill()
        child.wait()
        assert child.stdout
        child.stdout.close()


@pytest.mark.parametrize("cmd", ["set", "enable"])
def test_client_killed_after_send_leaves_a_defined_state(rig: GatewayRig, cmd: str) -> None:
    request = packed(cmd="set", K=77) if cmd == "set" else packed(cmd="enable")
    children = [
        start(COMMANDER, str(rig.gateway.endpoints["command"]), request.hex()) for _ in range(3)
    ]
    for child in children:
        assert child.stdout
        child.stdout.read(4)
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
    other = rig.client()
    for _ in range(100):
        rig.step()
    status = rig.ask(other, cmd="get")
    assert status["ok"]
    assert status["state"] in ("disabled", "enabled")
    assert rig.ask(other, cmd="set", K=5)["receipt"]["effective"]["K"] == 5.0
    assert status["rev"] in range(4)


def test_idle_connections_harm_nobody(rig: GatewayRig) -> None:
    endpoint = str(rig.gateway.endpoints["command"])
    idle = [rig.socket(zmq.DEALER, endpoint) for _ in range(100)]
    rig.step()
    other = rig.client()
    other.send(packed(cmd="status"))
    assert msgpack.unpackb(rig.receive(other)[0])["ok"]
    assert len(idle) == 100


HOLDER = """
import signal, sys, zmq
socket = zmq.Context().socket(zmq.DEALER)
socket.connect(sys.argv[1])
for request in sys.argv[2:]:
    socket.send(bytes.fromhex(request))
    socket.recv()
print("held", flush=True)
signal.pause()
"""


@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "stopped"])
def test_client_that_dies_or_hangs_loses_its_lease(rig: GatewayRig, kill: int) -> None:
    """Killed: at once, long before its 1 s is over; stopped: after that."""
    lease = packed(cmd="lease", what="measuring", ttl_s=1.0, at_end="disable")
    requests = [lease, packed(cmd="set", K=77), packed(cmd="enable")]
    child = start(HOLDER, str(rig.gateway.endpoints["command"]), *(one.hex() for one in requests))
    other = rig.client()
    try:
        assert said(rig, child) == b"held\n"
        refused = rig.ask(other, cmd="set", K=5)
        assert refused["error"]["code"] == "leased"
        begin_ns = rig.clock.now_ns()
        child.send_signal(kill)
        if kill == signal.SIGKILL:
            child.wait()
        while rig.ask(other, cmd="status")["result"]["leases"]:
            assert rig.clock.now_ns() - begin_ns < 2 * NS_PER_S
        lasted_ns = rig.clock.now_ns() - begin_ns
        assert (lasted_ns > NS_PER_S // 2) == (kill == signal.SIGSTOP)
        for _ in range(10):
            rig.step()
        status = rig.ask(other, cmd="status")["result"]
        assert status["state"] == "disabled"
        assert status["limit_cycle_faults"]["force_at_limit"] == "on"
        assert [one["code"] for one in status["events"] if one["kind"] == "lease"] == [
            "lease_taken",
            "lease_gone" if kill == signal.SIGKILL else "lease_silent",
        ]
        assert rig.ask(other, cmd="set", K=5)["ok"]
    finally:
        child.kill()
        child.wait()
        assert child.stdout
        child.stdout.close()
