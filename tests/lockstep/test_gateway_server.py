"""The gateway with its real sockets, stepped by hand in virtual time."""

import json
import math
import os
import socket as net
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgpack
import numpy as np
import pytest
import zmq
from support.gateway_rig import PATIENCE, START_NS, UNIX_NS, GatewayRig, decoded, packed
from support.gateway_stand_in import setup
from support.raw_peer import RawPeer
from support.tree import ROOT

from hapticd.core.errors import ConfigError, MailboxError
from hapticd.core.units import NS_PER_MS, VirtualClock
from hapticd.gateway.server import REQUESTS_PER_PASS, SETTLING_NS, GatewayServer, run
from hapticd.mailbox.layout import GATEWAY_BEAT_WORD, Command


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[GatewayRig]:
    with GatewayRig(tmp_path) as rig:
        yield rig


def telemetry_tcp(rig: GatewayRig) -> str:
    return str(rig.gateway.endpoints["telemetry"][1])  # type: ignore[index]


# --- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [zmq.DEALER, zmq.REQ])
def test_both_kinds_of_client_are_served(rig: GatewayRig, kind: int) -> None:
    client = rig.client(kind)
    client.send(packed(cmd="set", K=100, id=1))
    frames = rig.receive(client)
    assert decoded(frames)["receipt"]["effective"]["K"] == 100.0
    assert len(frames) == 1


def test_json_client_needs_no_library(rig: GatewayRig) -> None:
    client = rig.client()
    client.send(b'{"cmd":"status","id":"octave"}')
    reply = json.loads(rig.receive(client)[0])
    assert reply["id"] == "octave"
    assert {
        "state",
        "simulated",
        "rate_hz",
        "revision",
        "fault",
        "stages",
        "late",
        "endpoints",
        "servo",
        "events",
    } <= set(reply["result"])
    assert reply["result"]["servo"] == {"granted": "nothing"}


def test_hello_tells_where_and_what(rig: GatewayRig) -> None:
    result = rig.ask(rig.client(), cmd="hello", name="x")["result"]
    assert result["endpoints"] == rig.gateway.endpoints
    assert [topic["name"] for topic in result["topics"]] == [
        "servo",
        "servo.raw",
        "probe",
        "state",
        "event",
        "guard",
        "flight",
    ]
    assert (result["protocol"], len(result["schema_hash"])) == (1, 16)


def test_beat_is_written_every_pass(rig: GatewayRig) -> None:
    for _ in range(3):
        rig.step()
        assert rig.servo.mailbox.load(GATEWAY_BEAT_WORD) == rig.clock.now_ns()


def test_stop_gets_through_an_endless_flood(rig: GatewayRig) -> None:
    flooders = [rig.client() for _ in range(4)]
    other = rig.client()
    rig.ask(other, cmd="enable")
    other.send(packed(cmd="stop"))
    for _ in range(PATIENCE):
        for flooder in flooders:
            for number in range(10):
                if flooder.poll(0, zmq.POLLOUT):
                    flooder.send(packed(cmd="set", K=number))
        before = rig.gateway._commands.counts["requests"]
        rig.step(1)
        assert rig.gateway._commands.counts["requests"] - before <= REQUESTS_PER_PASS
        if other.poll(0):
            break
    assert decoded(other.recv_multipart())["state"] == "stopped"


def test_too_large_a_message_cuts_only_its_sender(rig: GatewayRig) -> None:
    bad = rig.client()
    good = rig.client()
    bad.send(b"x" * 70_000)
    for _ in range(20):
        rig.step()
    assert rig.ask(good, cmd="get")["ok"]
    assert not bad.poll(0)


def test_what_came_during_a_standstill_is_dropped(rig: GatewayRig) -> None:
    """Its senders have given up; an enable that acts now would surprise somebody's hand. A stop
    is a stop.
    """
    client = rig.client()
    other = rig.client()
    rig.ask(client, cmd="get")
    client.send(packed(cmd="enable", id=1))
    rig.servo.tick(1500)  # the servo goes on without the gateway
    error = decoded(rig.receive(client, ticks=0))["error"]
    assert (error["code"], error["message"]) == (
        "timeout",
        "enable: the gateway stalled for more than 1 s and dropped this request; repeat it",
    )
    assert rig.ask(other, cmd="stop")["ok"] or rig.servo.mailbox.stop_word.pressed
    assert not [kind for kind, _ in rig.servo.taken if kind == Command.ENABLE]
    rig.servo.tick(SETTLING_NS // NS_PER_MS)
    assert rig.ask(client, cmd="reset")["ok"]
    assert rig.ask(client, cmd="enable")["state"] == "enabled"


def test_subscription_bomb_is_cut_off(rig: GatewayRig) -> None:
    """Topics have names of a few bytes."""
    listener = rig.subscriber("servo")
    with RawPeer(rig, telemetry_tcp(rig), b"SUB") as bomber:
        bomber.send(b"\2" + (2000).to_bytes(8, "big"))  # its length alone is enough
        assert bomber.cut_off()
    assert rig.receive(listener)[0] == b"servo"


def test_foreign_bytes_on_the_port_harm_nobody(rig: GatewayRig) -> None:
    port = int(rig.gateway.endpoints["telemetry"][1].rsplit(":", 1)[1])  # type: ignore[index]
    strangers = [net.create_connection(("127.0.0.1", port)) for _ in range(60)]
    for number, stranger in enumerate(strangers[:40]):
        stranger.sendall(os.urandom(17 * (number + 1)))
    subscriber = rig.subscriber("servo.raw")
    assert rig.receive(subscriber)[0] == b"servo.raw"
    assert rig.ask(rig.client(), cmd="get")["ok"]
    for stranger in strangers:
        stranger.close()


def test_multipart_nonsense_is_answered(rig: GatewayRig) -> None:
    client = rig.client()
    client.send_multipart([b"a", b"b", packed(cmd="get")])
    assert decoded(rig.receive(client))["error"]["code"] == "malformed"


def test_telemetry_socket_ignores_what_is_no_subscription(rig: GatewayRig) -> None:
    endpoint = rig.gateway.endpoints["telemetry"][0]  # type: ignore[index]
    strange = rig.socket(zmq.XSUB, endpoint)
    for message in ([b""], [b"\1servo", b"more"], [b"\5"], [b"\xff" * 1000]):
        strange.send_multipart(message)
    strange.send(b"\1state")
    assert rig.receive(strange)[0] == b"state"


# --- telemetry ------------------------------------------------------------------------------------


def plotjuggler_decodes(frames: list[bytes]) -> list[dict[str, Any]]:
    """What PlotJuggler >= 3.16 does with a ZeroMQ message: two frames, topic as text, msgpack
    array of maps = batch.
    """
    topic, payload = frames
    topic.decode()
    batch = msgpack.unpackb(payload)
    assert isinstance(batch, list)
    for sample in batch:
        assert isinstance(sample, dict)
        assert all(isinstance(name, str) for name in sample)
        assert isinstance(sample["timestamp"], float)
        assert all(
            isinstance(value, (bool, int, float)) and math.isfinite(value)
            for value in sample.values()
        )
    return batch


def test_plotjuggler_plots_servo_as_it_is(rig: GatewayRig) -> None:
    endpoint = rig.gateway.endpoints["telemetry"][1]  # type: ignore[index]
    assert str(endpoint).startswith("tcp://127.0.0.1:")
    plotjuggler = rig.socket(zmq.SUB, str(endpoint), SUBSCRIBE=b"servo")
    batches = [plotjuggler_decodes(rig.receive(plotjuggler)) for _ in range(5)]
    samples = [sample for batch in batches for sample in batch]
    assert {len(batch) for batch in batches} == {20}
    assert np.diff([sample["seq"] for sample in samples]).tolist() == [1] * 99
    assert np.diff([sample["timestamp"] for sample in samples]) == pytest.approx(1e-3, abs=1e-6)
    assert samples[0]["timestamp"] == pytest.approx(UNIX_NS / 1e9, abs=60)


def test_plotjuggler_layout_names_only_what_is_sent(rig: GatewayRig) -> None:
    layout = ElementTree.parse(ROOT / "examples" / "plotjuggler.xml")
    names = [curve.get("name") for curve in layout.iter("curve")]
    sample = plotjuggler_decodes(rig.receive(rig.subscriber("servo")))[0]
    assert len(names) == 6
    assert set(names) <= {f"servo/{name}" for name in sample}


def test_servo_alone_never_brings_servo_raw(rig: GatewayRig) -> None:
    plotjuggler = rig.subscriber("servo")
    assert {rig.receive(plotjuggler)[0] for _ in range(20)} == {b"servo"}


def test_servo_raw_seen_through_the_prefix_is_harmless(rig: GatewayRig) -> None:
    plotjuggler = rig.subscriber("servo")
    recorder = rig.subscriber("servo.raw")
    assert {rig.receive(recorder)[0] for _ in range(5)} == {b"servo.raw"}
    for _ in range(20):
        topic, payload = rig.receive(plotjuggler)
        content = msgpack.unpackb(payload)
        assert isinstance(content, list if topic == b"servo" else dict)


def test_state_comes_on_subscription(rig: GatewayRig) -> None:
    for _ in range(3):  # three late joiners, each gets the last value although nothing changed
        late = rig.subscriber("state")
        topic, payload = rig.receive(late, ticks=0)
        assert (topic, msgpack.unpackb(payload)["state"]) == (b"state", "disabled")


def test_every_message_has_two_frames(rig: GatewayRig) -> None:
    everything = rig.subscriber("")
    rig.ask(rig.client(), cmd="stop")
    topics = set()
    for _ in range(40):
        frames = rig.receive(everything)
        assert len(frames) == 2
        topics.add(frames[0])
    assert topics == {b"servo", b"servo.raw", b"probe", b"state", b"event", b"guard"}


# --- addresses, claims, files ---------------------------------------------------------------------


def test_socket_files_are_for_user_and_group(rig: GatewayRig) -> None:
    for name in ("command", "telemetry"):
        assert stat.S_IMODE((rig.folder / name).stat().st_mode) == 0o660
    assert json.loads((rig.folder / "endpoints.json").read_text()) == rig.gateway.endpoints


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    with GatewayRig(tmp_path) as rig:
        rig.step()
    assert not {"command", "telemetry", "endpoints.json"} & set(os.listdir(tmp_path))


def test_second_gateway_is_refused(rig: GatewayRig) -> None:
    with pytest.raises(MailboxError, match=r"a gateway .* already runs"):
        GatewayServer(rig.folder, setup(), rig.clock)
    assert rig.ask(rig.client(), cmd="get")["ok"]


def test_next_gateway_takes_over(tmp_path: Path) -> None:
    for _ in range(2):
        gateway = GatewayServer(tmp_path, setup(), VirtualClock(START_NS))
        gateway.step(0)
        gateway.close()


def test_taken_port_falls_back_to_a_free_one(tmp_path: Path) -> None:
    with net.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with GatewayRig(tmp_path, telemetry_port=port) as rig:
            tcp = rig.gateway.endpoints["telemetry"][1]  # type: ignore[index]
            assert tcp.startswith("tcp://127.0.0.1:")
            assert not tcp.endswith(f":{port}")
            told = f"port {port} is taken, telemetry is at {tcp} instead"
            assert rig.gateway.endpoints["elsewhere"] == told
            events = rig.gateway._status()["events"]
            assert told in [one.get("text") for one in events if one["kind"] == "warning"]


def test_other_instance_leaves_the_usual_port_alone() -> None:
    from hapticd.gateway.server import port_for

    usual = setup(telemetry_port=9872).gateway
    assert (port_for(usual, "default"), port_for(usual, "other")) == (9872, 0)
    assert port_for(setup(telemetry_port=5000).gateway, "other") == 5000


def test_foreign_address_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"gateway.tcp_host = '203.0.113.7': .*; name an address of this machine"
    ):
        GatewayServer(
            tmp_path, setup(tcp_host="203.0.113.7", allow_insecure=True), VirtualClock(START_NS)
        )
    GatewayServer(tmp_path, setup(), VirtualClock(START_NS)).close()


def test_too_long_a_path_is_a_config_error(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 30)
    with pytest.raises(ConfigError, match="a socket file has at most 107; use a shorter folder"):
        GatewayServer(folder, setup(), VirtualClock(START_NS))


def test_gateway_alone_serves_status(tmp_path: Path) -> None:
    clock = VirtualClock(START_NS)
    gateway = GatewayServer(tmp_path, setup(), clock)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    client = context.socket(zmq.DEALER)
    client.connect(str(gateway.endpoints["command"]))
    replies = []
    for cmd in ("status", "get"):
        client.send(packed(cmd=cmd))
        while not client.poll(1):
            gateway.step(0)
        replies.append(decoded(client.recv_multipart()))
    context.destroy(linger=0)
    gateway.close()
    assert (
        replies[0]["state"],
        replies[0]["result"]["servo_alive"],
        replies[0]["result"]["simulated"],
    ) == ("down", False, True)
    assert replies[1]["error"]["code"] == "servo_down"


def test_run_ends_when_told(tmp_path: Path) -> None:
    said: list[str] = []
    run(
        tmp_path,
        setup,
        VirtualClock(START_NS),
        lambda: len(said) == 1,
        lambda: said.append("ready"),
    )
    assert said == ["ready"]
    assert not (tmp_path / "command").exists()


# --- leases ---------------------------------------------------------------------------------------


def test_lease_is_shown_at_once_in_state_and_event_and_ends_with_its_connection(
    rig: GatewayRig,
) -> None:
    states = rig.subscriber("state")
    rig.receive(states)
    holder = rig.client()
    rig.ask(holder, cmd="hello", name="trial")
    actor = rig.ask(holder, cmd="lease", what="perturbation", ttl_s=30.0)["result"]["actor"]
    begin_ns = rig.clock.now_ns()
    while not (leases := msgpack.unpackb(rig.receive(states)[1])["leases"]):
        pass
    assert rig.clock.now_ns() - begin_ns < 500 * NS_PER_MS
    assert (leases["perturbation"]["name"], leases["perturbation"]["actor"]) == ("trial", actor)
    holder.close()
    while msgpack.unpackb(rig.receive(states)[1])["leases"]:
        assert rig.clock.now_ns() - begin_ns < 900 * NS_PER_MS
    events = rig.ask(rig.client(), cmd="status")["result"]["events"]
    codes = [one["code"] for one in events if one["kind"] == "lease"]
    assert codes == ["lease_taken", "lease_gone"]
