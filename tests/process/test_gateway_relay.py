"""Telemetry for other computers: who has a key listens, who has none gets nothing, and neither
costs the gateway anything.
"""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
import zmq.auth
from support.raw_peer import HELLO
from support.relay_rig import RelayRig

from hapticd.core.units import NS_PER_S
from hapticd.gateway.relay import MOST_DESCRIPTORS, MOST_REASONS, Connections, address_of
from hapticd.protocol.keys import SERVER_PUBLIC

pytestmark = pytest.mark.process

NO_KEY = "it offers no key"
ENDED = "it ended, or was silent, before it had shown a key"


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[RelayRig]:
    with RelayRig(tmp_path) as rig:
        yield rig


def test_who_has_a_key_listens_and_who_has_none_gets_nothing(rig: RelayRig) -> None:
    zmq.auth.create_certificates(rig.away, "stranger")
    stranger = rig.listener("stranger")
    plain = rig.socket(zmq.SUB, f"tcp://127.0.0.1:{rig.port}", SUBSCRIBE=b"servo.raw")
    server, _ = zmq.curve_keypair()
    misled = rig.with_keys(server, *zmq.auth.load_certificate(rig.away / "friend.key_secret"))
    friend = rig.listener("friend")
    local = rig.subscriber("servo.raw")
    for _ in range(10):
        assert rig.receive(friend)[0] == b"servo.raw"
    assert rig.receive(local)[0] == b"servo.raw"
    assert [one.poll(0) for one in (stranger, plain, misled)] == [0, 0, 0]


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("stranger", "is not known; add a client with `hapticd keys client`"),
        ("plain", NO_KEY),
        ("misled", "it has another server's key"),
        ("silent", ENDED),
    ],
)
def test_who_is_refused_is_told_with_address_and_reason(rig: RelayRig, kind: str, why: str) -> None:
    if kind == "stranger":
        zmq.auth.create_certificates(rig.away, kind)
        rig.listener(kind)
    elif kind == "misled":
        rig.with_keys(zmq.curve_keypair()[0], *zmq.curve_keypair())
    elif kind == "plain":
        rig.socket(zmq.SUB, f"tcp://127.0.0.1:{rig.port}", SUBSCRIBE=b"servo")
    else:
        socket.create_connection(("127.0.0.1", rig.port)).close()
    # both ends see that only one has keys; whoever is first ends it, and it does not come again
    whys = (NO_KEY, ENDED) if kind == "plain" else (why,)
    (event, *_) = rig.until(
        lambda: [one for one in rig.warnings() if any(said in one["text"] for said in whys)]
    )
    # nor has a connection that has ended before the relay looks an address any more
    known = {"stranger": ["127.0.0.1"]}.get(kind, ["127.0.0.1", ""])
    assert event["address"] in known
    assert event["code"] == "listener_refused"
    whom = f" to {event['address']}" if event["address"] else ""
    assert event["text"].startswith(f"telemetry refused{whom}: ")
    assert rig.outside()["refused"] >= 1


def test_key_that_is_made_known_lets_in_at_once_and_one_that_is_removed_does_not(
    rig: RelayRig,
) -> None:
    rig.receive(rig.listener("friend"))
    rig.know("second")
    rig.receive(rig.listener("second"))
    (rig.keys / "clients" / "friend.key").unlink()
    gone = rig.listener("friend")
    rig.until(rig.warnings)
    assert not gone.poll(0)


def test_what_a_listener_sends_is_a_subscription_or_nothing(rig: RelayRig) -> None:
    """Neither a message of several parts nor other bytes reach the gateway's port."""
    taken: list[bytes] = []
    subscribe = rig.gateway._publisher.subscribe

    def noted(identity: bytes, message: bytes, unix_ns: int) -> list[tuple[str, bytes]]:
        taken.append(message)
        return subscribe(identity, message, unix_ns)

    rig.gateway._publisher.subscribe = noted  # type: ignore[method-assign]
    public, secret = zmq.auth.load_certificate(rig.away / "friend.key_secret")
    server, _ = zmq.auth.load_certificate(rig.keys / SERVER_PUBLIC)
    keys = {"CURVE_SERVERKEY": server, "CURVE_PUBLICKEY": public, "CURVE_SECRETKEY": secret}
    writer = rig.socket(zmq.XSUB, f"tcp://127.0.0.1:{rig.port}", **keys)
    for parts in ([b"stop", b"\1more"], [b"stop"], [b"\2"], [b'{"cmd": "stop"}'], [b"\1servo.raw"]):
        writer.send_multipart(parts)
    assert rig.receive(writer)[0] == b"servo.raw"
    assert taken == [b"\1servo.raw"]


def descriptors(process: int | str) -> int:
    return len(os.listdir(f"/proc/{process}/fd"))


def test_crowd_without_keys_occupies_the_relay_and_nobody_else(rig: RelayRig) -> None:
    """More connections than the relay has descriptors: it refuses the rest, the gateway's own
    descriptors stay free, and who is listening goes on.
    """
    friend = rig.listener("friend")
    rig.receive(friend)
    before = descriptors("self")
    crowd = [socket.create_connection(("127.0.0.1", rig.port)) for _ in range(200)]
    try:
        for one in crowd:
            one.sendall(HELLO[:1])
        relay = rig.outside()["pid"]
        rig.until(lambda: descriptors(relay) > 150)
        assert descriptors("self") == before + len(crowd)
        client = rig.client()
        for _ in range(20):
            assert rig.ask(client, cmd="get", v=1, id=1)["ok"]
            assert rig.receive(friend)[0] == b"servo.raw"
            # the limit is one of numbers: line and listener keep those of this process
            assert descriptors(relay) <= MOST_DESCRIPTORS + 2
    finally:
        for one in crowd:
            one.close()
    # they are gone, and who has a key is let in again
    rig.receive(rig.listener("friend"))


def test_relay_that_is_killed_comes_back_at_its_port(rig: RelayRig) -> None:
    port = rig.port
    friend = rig.listener("friend")
    rig.receive(friend)
    relay = rig.gateway._sockets.relay._relay  # type: ignore[union-attr]
    process = relay._process
    assert process
    process.kill()
    rig.until(lambda: rig.outside()["relay"] == "down")
    rig.clock.time_ns += 3 * NS_PER_S
    rig.until(lambda: rig.outside()["relay"] == "up")
    while friend.poll(0):
        friend.recv_multipart()
    assert rig.receive(friend)[0] == b"servo.raw"  # libzmq connects again by itself
    assert rig.port == port


def test_relay_ends_with_its_gateway(rig: RelayRig) -> None:
    process = rig.gateway._sockets.relay._relay._process  # type: ignore[union-attr]
    assert process
    rig.gateway._sockets.relay._relay._socket.close()  # type: ignore[union-attr]
    assert process.wait(60) == 0  # type: ignore[attr-defined]


def test_flood_of_refusals_is_a_few_lines() -> None:
    seen = Connections()
    for number in range(10_000):
        seen.refuse(f"10.0.{number % 256}.{number // 256}", "it offers no key")
    assert seen.total == 10_000
    assert len(seen.refused) == MOST_REASONS + 1
    assert seen.refused["", "others"] == 10_000 - MOST_REASONS


@pytest.mark.parametrize("broken", ["no key", "a folder"])
def test_key_that_cannot_be_read_is_told_and_lets_nobody_in(rig: RelayRig, broken: str) -> None:
    path = rig.keys / "clients" / "second.key"
    if broken == "no key":
        path.write_text("secret = none\n")
    else:
        path.mkdir()
    told = rig.until(lambda: rig.outside()["unreadable"])
    assert list(told) == ["second.key"]
    assert str(path) in told["second.key"]
    (event,) = rig.until(lambda: [one for one in rig.warnings() if "second.key" in one["text"]])
    assert event["text"].startswith("second.key cannot be used: ")
    rig.receive(rig.listener("friend"))


def test_key_that_is_edited_in_place_counts_at_once(rig: RelayRig) -> None:
    """Neither a name nor the time of the folder changes."""
    rig.receive(rig.listener("friend"))
    zmq.auth.create_certificates(rig.away, "new")
    known = rig.keys / "clients" / "friend.key"
    known.write_text((rig.away / "new.key").read_text())
    rig.receive(rig.listener("new"))
    gone = rig.listener("friend")
    rig.until(rig.warnings)
    assert not gone.poll(0)


def test_why_the_relay_ends_is_told_once(rig: RelayRig) -> None:
    secret = rig.keys / "server.key_secret"
    secret.chmod(0o644)  # the next one refuses it
    os.kill(rig.outside()["pid"], signal.SIGKILL)
    rig.until(lambda: "exit code -9" in rig.outside()["trouble"])
    for _ in range(2):
        rig.clock.time_ns += 3 * NS_PER_S
        rig.until(lambda: "readable by others; chmod 600" in rig.outside()["trouble"])
        rig.until(lambda: rig.outside()["relay"] == "down")
    texts = [one["text"] for one in rig.warnings()]
    assert len([text for text in texts if "chmod 600" in text]) == 1
    secret.chmod(0o600)
    rig.clock.time_ns += 3 * NS_PER_S
    rig.until(lambda: not rig.outside()["trouble"])


def test_descriptor_that_is_another_sockets_by_now_has_no_address(tmp_path: Path) -> None:
    """The socket file of the gateway has a path, of which the first letter was told."""
    with socket.socket(socket.AF_UNIX) as listener, socket.socket(socket.AF_UNIX) as line:
        listener.bind(str(tmp_path / "inside"))
        listener.listen()
        line.connect(str(tmp_path / "inside"))
        assert address_of(line.fileno()) == ""
