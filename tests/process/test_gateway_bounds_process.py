"""What clients do costs them service, never the servo its heartbeat: counted, not timed."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.gateway_bounds import command
from support.gateway_rig import GatewayRig, packed


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[GatewayRig]:
    with GatewayRig(tmp_path) as rig:
        yield rig


CLIENT = """
import sys, time, zmq
socket = zmq.Context().socket(zmq.DEALER)
socket.setsockopt(zmq.SNDHWM, 0)
socket.setsockopt(zmq.HEARTBEAT_IVL, 50)
socket.connect(sys.argv[1])
for _ in range(4000): socket.send(bytes.fromhex(sys.argv[2]))
print("sent", flush=True)
time.sleep(600)
"""


@pytest.mark.process
def test_killed_clients_that_read_no_reply_do_not_end_the_gateway(rig: GatewayRig) -> None:
    arguments = [command(rig), packed(cmd="schema").hex()]
    for _ in range(3):
        children = [
            subprocess.Popen([sys.executable, "-c", CLIENT, *arguments], stdout=subprocess.PIPE)
            for _ in range(4)
        ]
        for child in children:
            assert child.stdout
            assert child.stdout.readline() == b"sent\n"
        for _ in range(50):
            rig.step(1)
        for child in children:
            child.send_signal(signal.SIGKILL)
            child.wait()
            assert child.stdout
            child.stdout.close()
        for _ in range(50):
            rig.step(1)
    assert rig.ask(rig.client(), cmd="get")["ok"]
