"""What clients do costs them service, never the servo its heartbeat: counted, not timed."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.gateway_bounds import command
from support.gateway_rig import GatewayRig
from support.raw_peer import RawPeer
from test_gateway_bounds import request

from hapticd.protocol import flight


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[GatewayRig]:
    with GatewayRig(tmp_path) as rig:
        yield rig


def memory_kb() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4


def test_replies_that_nobody_reads_are_bounded(rig: GatewayRig) -> None:
    other = rig.client()
    with RawPeer(rig, command(rig)) as deaf:
        rig.step()
        before = memory_kb()
        sent = 0
        for _ in range(1500):  # a reply to `schema` has some 10 kB
            sent += deaf.send(request(cmd="schema"))
            rig.step(1)
        assert sent == 1500 * len(request(cmd="schema"))
        assert memory_kb() - before < 5000
        assert rig.ask(other, cmd="get")["ok"]


def test_requests_kept_for_a_recording_are_bounded(rig: GatewayRig, runtime: Path) -> None:
    """Some 2 kHz of changes for a minute would be 100 MB, and a second of encoding."""
    for _ in range(1200):
        rig.servo.tick(10)
        for _ in range(20):
            rig.servo.mailbox.note(rig.servo.ticks, ((1, 1, 16, 0, (0.0,) * 20),))
        rig.step(0)
        rig.gateway._publisher.flight.follow(rig.clock.now_ns())
    kept = rig.gateway._publisher.flight._requests
    assert len(kept) == flight.REQUESTS_KEPT
    reply = rig.ask(rig.client(), cmd="dump")
    rig.gateway._publisher.flight.close()
    header = flight.read_flight(Path(reply["result"]["path"])).header
    assert len(header["requests"]) == flight.REQUESTS_KEPT
    # no replay leads over the last request that had to go, ten ticks before the first one kept
    assert max(header["breaks"]) == header["requests"][0][0] - 10
