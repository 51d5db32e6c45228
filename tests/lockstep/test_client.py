"""The conversation without I/O, and the client against a whole gateway that runs in a thread of
its own, in virtual time.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq
from support.gateway_rig import GatewayRig, running

from hapticd.client import Client, Receipt
from hapticd.client.telemetry import RequestTracker, TimedOut, accepted, receipt_of
from hapticd.core.errors import CommandError, ConfigError, DaemonDown
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, State
from hapticd.protocol.schemas import PROTOCOL_VERSION
from hapticd.protocol.view import RECORD_DTYPE


def ask(
    conversation: RequestTracker, cmd: str = "get", now_ns: int = 0, **fields: object
) -> tuple[int, dict[str, object]]:
    number, payload = conversation.ask(cmd, fields, now_ns, NS_PER_S)
    return number, msgpack.unpackb(payload)


def test_request_carries_number_and_version() -> None:
    conversation = RequestTracker()
    number, request = ask(conversation, "set", K=100.0, B=None)
    assert request == {"cmd": "set", "v": PROTOCOL_VERSION, "id": number, "K": 100.0}
    assert ask(conversation)[0] == number + 1


def test_numbers_may_come_out_of_arrays() -> None:
    _, request = ask(
        RequestTracker(), "set", K=np.int64(3), B=np.float32(0.5), wall={"side": np.int8(-1)}
    )
    assert (request["K"], request["B"], request["wall"]) == (3, 0.5, {"side": -1})
    with pytest.raises(TypeError, match="cannot be sent; use numbers, text, lists and maps"):
        ask(RequestTracker(), "set", K={1})


def test_replies_are_matched_by_number() -> None:
    conversation = RequestTracker()
    first = ask(conversation)[0]
    second = ask(conversation)[0]
    conversation.receive(msgpack.packb({"ok": True, "id": second}))
    assert conversation.outcome(first, 5) is None
    assert conversation.outcome(second, 5) == {"ok": True, "id": second}


def test_timeout_is_a_value() -> None:
    conversation = RequestTracker()
    number, _ = ask(conversation, now_ns=7)
    assert conversation.outcome(number, NS_PER_S + 6) is None
    assert conversation.outcome(number, NS_PER_S + 7) == TimedOut("get", 1.0)


def test_late_reply_is_dropped() -> None:
    conversation = RequestTracker()
    number, _ = ask(conversation)
    conversation.outcome(number, NS_PER_S)
    conversation.receive(msgpack.packb({"ok": True, "id": number}))
    following, _ = ask(conversation, now_ns=NS_PER_S)
    assert conversation.outcome(following, NS_PER_S) is None
    assert not conversation._replies


@pytest.mark.parametrize(
    "payload",
    [b"", b"\xc1", msgpack.packb([1]), msgpack.packb({"id": 99}), msgpack.packb({"id": "1"})],
)
def test_what_is_no_reply_is_dropped(payload: bytes) -> None:
    conversation = RequestTracker()
    number, _ = ask(conversation)
    conversation.receive(payload)
    assert conversation.outcome(number, 5) is None


def test_forgotten_request_takes_no_reply() -> None:
    conversation = RequestTracker()
    number, _ = ask(conversation)
    conversation.forget(number)
    conversation.receive(msgpack.packb({"ok": True, "id": number}))
    assert not conversation._replies


def test_refusal_becomes_an_error() -> None:
    refused = {
        "ok": False,
        "error": {
            "code": "invalid",
            "message": "K is wrong",
            "detail": [{"loc": "K", "msg": "K is wrong"}],
        },
    }
    with pytest.raises(CommandError, match="K is wrong") as caught:
        accepted(refused)
    assert (caught.value.code, caught.value.detail) == (
        "invalid",
        [{"loc": "K", "msg": "K is wrong"}],
    )
    with pytest.raises(DaemonDown, match="no servo answers"):
        accepted({"ok": False, "error": {"code": "servo_down", "message": "no servo answers"}})


def test_receipt_has_the_state() -> None:
    reply = {
        "ok": True,
        "state": "enabled",
        "receipt": {"result": "applied", "revision": 2, "first_tick": 3, "ramp_end_tick": 4},
    }
    assert receipt_of(reply) == Receipt("applied", "enabled", 2, 3, 4, {})


@pytest.mark.parametrize("value", [2**64, -(2**63) - 1, 10**400])
def test_integer_beyond_64_bits_is_refused(value: int) -> None:
    with pytest.raises(CommandError, match=r"an integer of [0-9]+ bits cannot be sent, limit 64"):
        ask(RequestTracker(), "set", K=value)


@pytest.fixture
def folder(runtime: Path) -> Path:
    return runtime / "hapticd"


@pytest.fixture
def rig(folder: Path) -> Iterator[GatewayRig]:
    with GatewayRig(folder) as rig, running(rig):
        yield rig


@pytest.fixture
def client(rig: GatewayRig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    monkeypatch.setattr(
        "hapticd.client.client.STOP_TIMEOUT_S", 10.0
    )  # a busy machine is no reason to press the page
    with Client(name="test", timeout_s=10.0) as client:
        yield client


# --- asking and changing --------------------------------------------------------------------------


def test_set_returns_a_receipt(client: Client) -> None:
    receipt = client.set(
        K=100,
        B=1,
        M=0.010,
        wall={"side": 1},
        filters={"velocity_hz": 90.0},
        active_damping=1.0,
        ramp_s=0.1,
    )
    assert isinstance(receipt, Receipt)
    assert (receipt.result, receipt.state, receipt.revision) == ("applied", "disabled", 1)
    assert receipt.ramp_end_tick > receipt.first_tick
    assert (receipt.effective["K"], receipt.effective["wall"]["side"]) == (100.0, 1)


def test_every_verb_has_its_method(client: Client) -> None:
    assert [client.enable().state, client.disable().state, client.zero().state] == [
        "enabled",
        "disabled",
        "disabled",
    ]
    assert client.damping("on").effective["active_damping"] == 1.74
    assert client.damping(0.5).effective["active_damping"] == 0.5
    assert client.damping("off").effective["active_damping"] == 0.0
    assert [client.stop().state, client.reset().state] == ["stopped", "disabled"]
    assert client.get().parameters["active_damping_level"] == 0.5
    assert client.hello().server == "hapticd"
    assert client.status().state == "disabled"
    assert "$defs" in client.schema()
    assert client.home().state == "homing"


def test_refusal_is_a_command_error(client: Client) -> None:
    with pytest.raises(
        CommandError, match=r"damping = 9 N s/m: beyond the limit 0..2 N s/m"
    ) as caught:
        client.set(active_damping=9)
    assert caught.value.code == "invalid"
    client.stop()
    with pytest.raises(CommandError, match="enable in state stopped") as caught:
        client.enable()
    assert caught.value.exit_code == 5


def test_call_sends_anything(client: Client) -> None:
    assert client.call("get")["ok"]
    with pytest.raises(CommandError, match="unknown command, did you mean 'get'"):
        client.call("gett")


def test_client_is_introduced_by_name(client: Client, rig: GatewayRig) -> None:
    client.set(K=1)
    status = client.status()
    assert status.actor_name == "test"
    assert status.actors[str(status.actor)] == "test"


def test_long_waveform_is_sent_in_chunks(client: Client, rig: GatewayRig) -> None:
    samples_n = np.sin(np.arange(20_000) / 100)
    assert client.perturb_load(samples_n) == 20_000
    counts = np.array(rig.servo.mailbox.waveform[:20_000].tolist())
    assert np.abs(2.0 - counts - samples_n / 1e-3).max() <= 0.5 + 1e-3
    client.enable()
    client.perturb_start(loop=True)
    assert rig.servo.played == (20_000.0, 1.0)
    client.perturb_stop()
    with pytest.raises(CommandError, match=r"samples_n\[2\] = 1.5 N: beyond the limit -1..1 N"):
        client.perturb_load([0.0, 0.0, 1.5])


def test_too_large_a_request_is_not_sent(client: Client) -> None:
    with pytest.raises(CommandError, match=r"a request has at most 65536; send less at once"):
        client.call("perturb", action="load", samples_n=bytes(70_000))
    assert client.call("get")["ok"]


def test_wait_for_returns_in_that_state(client: Client, rig: GatewayRig) -> None:
    press_stop(rig.folder)
    client.wait_for("stopped")
    with pytest.raises(
        CommandError, match="state is 'stopped', not 'enabled', after 0 s"
    ) as caught:
        client.wait_for("enabled", timeout_s=0)
    assert caught.value.code == "timeout"


# --- watching -------------------------------------------------------------------------------------


def test_stream_gives_whole_records(client: Client) -> None:
    blocks = list(client.stream(count=1000))
    records = np.concatenate([block.records for block in blocks])
    assert records.dtype == RECORD_DTYPE
    assert len(records) == 1000
    assert (np.diff(records["tick"].astype(int)) == 1).all()
    assert [block.gap for block in blocks] == [0] * len(blocks)
    assert blocks[0].header["simulated"] is True


def test_record_takes_recorded_time(client: Client) -> None:
    records, lost = client.record(seconds=0.5)
    assert (len(records), lost) == (500, 0)
    assert records["force_n"].tolist() == [1.5] * 500


def test_probe_stream_is_4_khz(client: Client) -> None:
    samples, lost = client.record(0.25, "probe")
    assert (len(samples), lost) == (1000, 0)
    assert (np.diff(samples["index"].astype(int)) == 1).all()


def test_gap_is_reported(client: Client, rig: GatewayRig) -> None:
    stream = client.stream()
    first = next(stream)
    with rig.lock:
        rig.servo.tick(9000)  # more than the ring holds
    lost = 0
    taken = first.header["next"]
    while not lost:
        block = next(stream)
        lost += block.gap
        taken += len(block.records)
        assert block.header["next"] == taken + lost
    stream.close()


def test_listen_gives_states(client: Client, rig: GatewayRig) -> None:
    states = client.listen("state")
    assert next(states)["state"] == "disabled"
    client.enable()
    assert next(state for state in states if state["state"] != "disabled")["state"] == "enabled"
    states.close()


def test_listen_waits_for_events(client: Client, rig: GatewayRig) -> None:
    events = client.listen("event")
    flip = itertools.cycle((State.STOPPED, State.DISABLED))
    publish = rig.servo._publish

    def flipping() -> None:
        rig.servo.state = next(flip)
        publish()

    rig.servo._publish = flipping  # type: ignore[method-assign]
    event = next(events)
    assert (event.kind, {event.before, event.state}) == ("state", {"disabled", "stopped"})
    events.close()


# --- nobody there ---------------------------------------------------------------------------------


def test_no_daemon_is_told_at_once(folder: Path) -> None:
    with Client() as client:
        for ask in (
            client.get,
            client.stop,
            client.enable,
            lambda: next(client.stream()),
            lambda: client.record(1.0),
        ):
            with pytest.raises(
                DaemonDown, match=r"no daemon runs there|start one with `hapticd run`"
            ):
                ask()


def test_dead_socket_times_out(folder: Path) -> None:
    folder.mkdir(mode=0o700)
    for name in ("command", "telemetry"):
        (folder / name).touch()
    with Client(timeout_s=0.05) as client:
        with pytest.raises(
            DaemonDown, match=r"get: no reply from .* within .* s; is `hapticd run` running there"
        ):
            client.get()
        with pytest.raises(
            DaemonDown, match=r"servo.raw: nothing from .* for 0.05 s; see `hapticd status`"
        ):
            next(client.stream())


def test_silent_gateway_times_out(folder: Path) -> None:
    no_reply = pytest.raises(DaemonDown, match=r"get: no reply from")
    with GatewayRig(folder), Client(timeout_s=0.05) as client, no_reply:  # nobody steps the gateway
        client.get()


@contextmanager
def late_gateway(
    folder: Path, in_vain: Callable[[Client], object]
) -> Iterator[tuple[GatewayRig, Client]]:
    """A client that asked in vain before its gateway began; both, once that runs."""
    folder.mkdir(mode=0o700)
    (folder / "command").touch()
    with Client(timeout_s=0.05, name="experiment") as client:
        with pytest.raises(DaemonDown):
            in_vain(client)
        (folder / "command").unlink()
        with GatewayRig(folder) as rig, running(rig):
            client._timeout_s = 10.0
            yield rig, client


def test_old_request_does_not_reach_a_later_gateway(folder: Path) -> None:
    with late_gateway(folder, lambda client: client.enable()) as (rig, client):
        client.set(K=1)
        assert [kind for kind, _ in rig.servo.taken] == [Command.SET]


def test_client_is_introduced_however_late_it_is_connected(folder: Path) -> None:
    with late_gateway(folder, lambda client: client.get()) as (_, client):
        client.set(K=1)
        assert client.status().actor_name == "experiment"


def test_client_is_introduced_to_the_next_gateway_before_it_asks(
    client: Client, rig: GatewayRig
) -> None:
    client.set(K=1)
    rig.restart_gateway()
    client.mark("first")
    events = client.status().events
    assert [one.name for one in events if one.kind == "mark"] == ["test"]


def test_connection_that_is_lost_before_the_request_is_sent_times_out(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.mkdir(mode=0o700)
    with zmq.Context() as context, Client(timeout_s=0.3) as client:
        gateway = context.socket(zmq.ROUTER)
        gateway.bind(f"ipc://{folder}/command")

        def lose() -> None:
            gateway.close(linger=0)
            while client._connection._socket.poll(0, zmq.POLLOUT):
                time.sleep(0.001)

        monkeypatch.setattr(client._connection, "_meet", lose)
        with pytest.raises(DaemonDown, match="no reply"):
            client.get()


def test_stop_without_gateway_presses_the_page(folder: Path) -> None:
    with GatewayRig(folder) as rig, Client() as client:  # nobody steps the gateway
        assert client.stop() == Receipt("pressed")
        rig.servo.tick()
        assert rig.servo.state is State.STOPPED


def test_a_closed_client_still_stops_and_asks_nothing(folder: Path) -> None:
    with GatewayRig(folder) as rig:
        client = Client()
        client.close()
        with pytest.raises(DaemonDown, match="get: this client is closed"):
            client.get()
        assert client.stop() == Receipt("pressed")
        rig.servo.tick()
        assert rig.servo.state is State.STOPPED


def test_servo_down_is_daemon_down(client: Client, rig: GatewayRig) -> None:
    with rig.lock:
        rig.servo_stands = True
        for _ in range(4):
            rig.clock.time_ns += NS_PER_S // 2
            rig.gateway.step(0)
    with pytest.raises(DaemonDown, match="enable: no servo answers; start it with `hapticd run`"):
        client.enable()


# --- the package ------------------------------------------------------------------------------


def test_client_package_names_are_lazy_but_known() -> None:
    import hapticd.client

    assert [getattr(hapticd.client, name).__name__ for name in hapticd.client.__all__] == list(
        hapticd.client.__all__
    )
    assert not hasattr(hapticd.client, "Klient")


def test_closed_client_leaves_no_socket(rig: GatewayRig) -> None:
    client = Client()
    client.get()
    stream = client.stream()
    next(stream)
    client.close()
    client.close()
    with pytest.raises((zmq.ZMQError, DaemonDown)):
        next(stream)


def test_stream_of_a_topic_without_blocks_is_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=r"topic 'sevo\.raw' has no blocks: stream takes servo\.raw or probe, listen takes",
    ):
        next(Client.stream(None, "sevo.raw"))  # type: ignore[arg-type]


def test_errors_are_where_the_client_is() -> None:
    from hapticd import client
    from hapticd.core import errors

    assert (client.CommandError, client.DaemonDown) == (errors.CommandError, errors.DaemonDown)
    assert "Client" in dir(client)


# --- leases ---------------------------------------------------------------------------------------


def test_lease_is_held_inside_its_context_alone(client: Client, folder: Path) -> None:
    with Client(name="other", timeout_s=10.0) as other:
        with client.lease("environment", ttl_s=20.0):
            with pytest.raises(CommandError, match=r"test \(actor \d+\) holds the lease"):
                other.set(K=5)
            client.set(K=7)
            assert client.status().leases["environment"].name == "test"
        assert other.set(K=5).effective["K"] == 5.0
        assert other.status().leases == {}


def test_lease_that_was_lost_is_told_at_its_next_use_and_at_its_end(client: Client) -> None:
    def lose() -> None:
        with client.lease("active_damping", ttl_s=20.0) as lease:
            with Client(name="operator", timeout_s=10.0) as operator:
                operator.lease("active_damping", take_over=True).take()
            for use in (lambda: client.damping("on"), lease.renew, lambda: lease.sleep(9.0)):
                with pytest.raises(CommandError, match="was taken over by operator"):
                    use()

    with pytest.raises(CommandError, match="changes since then were not excluded"):
        lose()
    client.damping("on")


def test_lease_may_be_released_before_its_context_ends(client: Client) -> None:
    with client.lease("active_damping", ttl_s=20.0) as lease:
        assert lease.release() == ""
        assert client.status().leases == {}
    with client.lease("active_damping", ttl_s=20.0) as lease:
        lease.release()
        lease.take()
    assert client.status().leases == {}


def test_error_inside_a_lease_is_the_one_that_is_told(client: Client) -> None:
    def fail() -> None:
        with client.lease("active_damping", ttl_s=20.0):
            client.lease("active_damping").release()
            raise ValueError("my own")

    with pytest.raises(ValueError, match="my own"):
        fail()


def test_long_waits_keep_a_lease(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """Waits are those of virtual time: what counts is that it is renewed in each third of it."""
    now_s = [0.0]
    waits: list[float] = []

    def wait(seconds: float) -> None:
        waits.append(seconds)
        now_s[0] += seconds

    with client.lease("active_damping", ttl_s=20.0) as lease:
        monkeypatch.setattr("hapticd.client.client.time.sleep", wait)
        monkeypatch.setattr("hapticd.client.client.time.monotonic", lambda: now_s[0])
        asked: list[str] = []
        monkeypatch.setattr(lease, "_call", lambda cmd, **fields: asked.append(fields["action"]))
        lease.sleep(60.0)
        monkeypatch.undo()
    assert sum(waits) == pytest.approx(60.0)
    assert max(waits) <= 20.0 / 3
    assert asked == ["renew"] * (len(waits) + 1)
