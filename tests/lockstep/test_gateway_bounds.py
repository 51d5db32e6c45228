"""What clients do costs them service, never the servo its heartbeat: counted, not timed."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.gateway_bounds import command
from support.gateway_rig import GatewayRig, decoded, packed
from support.raw_peer import PING, RawPeer, short

from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.gateway.peers import HANDSHAKE_NS, MOST_PEERS
from hapticd.gateway.server import PASS_NS, SUBSCRIPTIONS_PER_PASS
from hapticd.mailbox.layout import GATEWAY_BEAT_WORD
from hapticd.protocol import flight

COST_NS = 90 * NS_PER_MS  # of a request in these tests, on virtual time
PATIENCE_NS = NS_PER_S  # of the servo with the heartbeat


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[GatewayRig]:
    with GatewayRig(tmp_path) as rig:
        yield rig


def tcp(rig: GatewayRig) -> str:
    return str(rig.gateway.endpoints["telemetry"][1])  # type: ignore[index]


def request(**fields: Any) -> bytes:
    body = packed(**fields)
    return b"\2" + len(body).to_bytes(8, "big") + body


class Beats:
    """The longest time on the rig's clock between two heartbeats."""

    def __init__(self, rig: GatewayRig) -> None:
        self.longest_ns = 0
        mailbox = rig.gateway._view.mailbox
        assert mailbox
        self._last = rig.servo.mailbox.load(GATEWAY_BEAT_WORD)
        beat = mailbox.beat

        def noted(now_ns: int) -> None:
            self.longest_ns = max(self.longest_ns, now_ns - self._last)
            self._last = now_ns
            beat(now_ns)

        mailbox.beat = noted  # type: ignore[method-assign]


def make_slow(rig: GatewayRig, owner: Any, name: str) -> list[int]:
    """Every call of `owner.name` takes COST_NS; the times of the calls."""
    true = getattr(owner, name)
    calls: list[int] = []

    def slow(*arguments: Any) -> Any:
        calls.append(rig.clock.now_ns())
        rig.clock.time_ns += COST_NS
        return true(*arguments)

    setattr(owner, name, slow)
    return calls


# --- time -----------------------------------------------------------------------------------------


def test_heartbeat_goes_on_whatever_requests_cost(rig: GatewayRig) -> None:
    calls = make_slow(rig, rig.gateway._commands, "_attend")
    beats = Beats(rig)
    with RawPeer(rig, command(rig)) as flood:
        flood.send(request(cmd="get") * 200)
        for _ in range(100):
            before = len(calls)
            rig.step(0)
            assert len(calls) - before <= 1 + PASS_NS // COST_NS
    assert len(calls) >= 80
    assert beats.longest_ns <= 2 * COST_NS < PATIENCE_NS


def test_heartbeat_goes_on_under_12000_subscriptions(rig: GatewayRig) -> None:
    calls = make_slow(rig, rig.gateway._publisher, "subscribe")
    beats = Beats(rig)
    with RawPeer(rig, tcp(rig), b"SUB") as flood:
        flood.send(short(b"\1state") * 12_000)
        for _ in range(50):
            before = len(calls)
            rig.step(0)
            assert len(calls) - before <= 1 + PASS_NS // COST_NS
    assert len(calls) >= 40
    assert beats.longest_ns <= 2 * COST_NS


def test_subscriptions_of_a_peer_are_bounded_by_the_names_of_topics(rig: GatewayRig) -> None:
    with RawPeer(rig, tcp(rig), b"SUB") as flood:
        for number in range(3000):
            flood.send(short(b"\1" + b"servo.raw"[: number % 10] + b"x%d" % number))
            flood.send(short(b"\1" + b"servo.raw"[: number % 10]))
        taken = 0
        subscribe = rig.gateway._publisher.subscribe

        def counted(*arguments: Any) -> Any:
            nonlocal taken
            taken += 1
            return subscribe(*arguments)

        rig.gateway._publisher.subscribe = counted  # type: ignore[method-assign]
        while taken < 6000:
            before = taken
            rig.step(0)
            assert taken - before <= SUBSCRIPTIONS_PER_PASS
        (asked,) = rig.gateway._publisher._audience.values()
        assert len(asked._prefixes) == 10
    for _ in range(3):
        rig.step()
    assert not rig.gateway._publisher._audience  # who has gone is forgotten


def test_stop_goes_before_requests_that_wait(rig: GatewayRig) -> None:
    calls = make_slow(rig, rig.gateway._commands, "_attend")
    client = rig.client()
    rig.ask(client, cmd="get")
    with RawPeer(rig, command(rig)) as flood:
        flood.send(request(cmd="get") * 300)
        for _ in range(3):
            rig.step(0)
        client.send(packed(cmd="stop"))
        before = len(calls)
        assert decoded(rig.receive(client, ticks=1))["ok"]
        assert len(calls) - before <= 10


def test_requests_that_wait_are_bounded(rig: GatewayRig) -> None:
    make_slow(rig, rig.gateway._commands, "_attend")
    flooders = [RawPeer(rig, command(rig)) for _ in range(4)]
    for flood in flooders:
        flood.send(request(cmd="get", id=7) * 100)
    for _ in range(60):
        rig.step(0)
    said = b"".join(flood.read() or b"" for flood in flooders)
    assert b"100 requests wait for the gateway already; slow down and ask again" in said
    assert len(rig.gateway._commands._queue) <= 100
    for flood in flooders:
        flood.socket.close()


def test_ring_that_waited_is_published_in_parts(rig: GatewayRig) -> None:
    """After a standstill of the gateway, no pass encodes it all."""
    subscriber = rig.subscriber("servo.raw")
    rig.receive(subscriber)
    rig.servo.tick(6000)
    taken = []
    add = rig.gateway._publisher.flight.add

    def counted(block: Any, now_ns: int) -> None:
        taken[-1] += len(block.records)
        add(block, now_ns)

    rig.gateway._publisher.flight.add = counted  # type: ignore[method-assign]
    while sum(taken) < 6000:
        taken.append(0)
        rig.step(10)
    assert max(taken) <= 1024
    assert rig.gateway._publisher.feed.lost == 0


# --- memory ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", [b"", bytes(200)])
def test_endless_multipart_message_cuts_its_sender_off(rig: GatewayRig, part: bytes) -> None:
    with RawPeer(rig, command(rig)) as endless:
        endless.send(short(part, 1) * 20)
        assert endless.cut_off()
    assert rig.ask(rig.client(), cmd="get")["ok"]


def test_endless_multipart_subscription_cuts_its_sender_off(rig: GatewayRig) -> None:
    with RawPeer(rig, tcp(rig), b"XSUB") as endless:
        endless.send(short(b"\1servo", 1) * 20)
        assert endless.cut_off()


def test_pings_that_nobody_reads_the_answers_to_are_bounded(rig: GatewayRig) -> None:
    with RawPeer(rig, command(rig)) as deaf:
        for _ in range(600):
            deaf.send(PING * 50)
            rig.step(1)
        (peer,) = rig.gateway._sockets.command._peers.values()
        assert len(peer.queue) <= 200
    assert rig.ask(rig.client(), cmd="get")["ok"]


def test_connections_are_bounded(rig: GatewayRig) -> None:
    crowd = [RawPeer(rig, tcp(rig), b"SUB") for _ in range(MOST_PEERS)]
    for _ in range(20):
        rig.step()
    late = RawPeer(rig, tcp(rig), b"SUB")
    assert late.cut_off()
    assert all(one.read() is not None for one in crowd)
    crowd.pop().socket.close()
    for _ in range(5):
        rig.step()
    crowd.append(RawPeer(rig, tcp(rig), b"SUB"))
    assert not crowd[-1].cut_off()
    for one in [*crowd, late]:
        one.socket.close()


def test_crowd_at_the_port_leaves_the_socket_file_free(rig: GatewayRig) -> None:
    """Whoever can reach TCP cannot keep recorders and pages of this computer out."""
    crowd = [RawPeer(rig, tcp(rig), b"SUB") for _ in range(MOST_PEERS)]
    for _ in range(20):
        rig.step()
    local = rig.subscriber("servo.raw")
    assert rig.receive(local)[0] == b"servo.raw"
    for one in crowd:
        one.socket.close()


def test_silent_stranger_is_dropped_in_3_s(rig: GatewayRig) -> None:
    stranger = RawPeer(rig, command(rig), introduced=False)
    rig.step(0)
    began_ns = rig.clock.now_ns()
    for _ in range(1000):
        if stranger.read() is None:
            break
        rig.step(10)
    assert HANDSHAKE_NS <= rig.clock.now_ns() - began_ns < HANDSHAKE_NS + 100 * NS_PER_MS
    stranger.socket.close()


# --- death ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("heartbeat", [False, True])
def test_peer_that_dies_behind_a_full_queue_harms_nobody(rig: GatewayRig, heartbeat: bool) -> None:
    """libzmq aborted here, by its own heartbeat timer or by the peer's PING, in its issue 4364."""
    for _ in range(20):
        with RawPeer(rig, command(rig)) as dying:
            dying.send(request(cmd="schema") * 220)
            dying.send(PING * 20 if heartbeat else b"")
            rig.step(1)
    for _ in range(300):
        rig.step(10)
    assert rig.ask(rig.client(), cmd="get")["ok"]
    assert len(rig.gateway._sockets.command._peers) == 1


# --- recordings -----------------------------------------------------------------------------------


def test_one_recording_is_written_at_a_time(
    rig: GatewayRig, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(50):
        rig.step(20)
    free = threading.Event()
    begun = []

    def write(*arguments: Any) -> None:
        begun.append(arguments[0])
        free.wait()

    monkeypatch.setattr(flight, "write_flight", write)
    client = rig.client()
    replies = [rig.ask(client, cmd="dump") for _ in range(200)]
    free.set()
    assert replies[0]["ok"]
    assert {reply["error"]["code"] for reply in replies[1:]} == {"busy"}
    assert "its event `flight` tells when it is" in replies[1]["error"]["message"]
    rig.gateway._publisher.flight.close()
    assert len(begun) == 1
    assert rig.ask(client, cmd="dump")["ok"]
