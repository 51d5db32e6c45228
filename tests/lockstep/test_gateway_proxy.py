"""A law of one's own through gateway, guard, servo and board on virtual time."""

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import nan
from typing import Any

import msgpack
import pytest
from support.boards import board_params
from support.proxies import RANGE_M, with_range

from benchmarks.guard_attack import shipped_judge
from benchmarks.guarded_stack import CLIENT, GuardedStack
from hapticd.core.errors import CommandError
from hapticd.core.params import LeaseParams, SafetyParams
from hapticd.guard.status import MOST_RECORDS
from hapticd.mailbox.layout import Flag, State
from hapticd.model.params import BoardParams, InjectionParams
from hapticd.protocol.answers import Coupling
from hapticd.protocol.codec import Encoding, encode
from hapticd.run.lockstep import LockStep
from hapticd.run.virtual import VirtualBoard, virtual_board

OTHER = b"other"
SOON = SafetyParams(enable_ramp_s=0.05)
BOARD: BoardParams = board_params(lower_stop_m=-0.03, upper_stop_m=0.03, viscous_ns_per_m=2.0)


@pytest.fixture
def guarded() -> Iterator[GuardedStack]:
    with LockStep(with_range(100.0, SOON), BOARD) as stack:
        yield GuardedStack(stack, shipped_judge().answer, "warn")


def ask(guarded: GuardedStack, client: bytes, **fields: Any) -> dict[str, Any]:
    """The reply to a request of `client`, which is answered at once or within some ticks."""
    request = encode(Encoding.MSGPACK, {"id": 7, **fields})
    replies = guarded.server.serve([[client, request]], guarded.stack.clock.now_ns())
    for *_, payload in replies:
        found: dict[str, Any] = msgpack.unpackb(payload)
        return found
    raise AssertionError("not at once")


def leads(guarded: GuardedStack, **lease: Any) -> None:
    """CLIENT holds the lease, is enabled and has moved the proxy to 5 mm."""
    assert guarded.ask(cmd="lease", what="environment", **lease)["ok"]
    assert guarded.ask(cmd="enable")["ok"]
    guarded.run(60)
    for _ in range(60):
        assert ask(guarded, CLIENT, cmd="proxy", position_m=0.005)["ok"]
        guarded.run()
    assert guarded.view.record["proxy_m"] == 0.005


def test_position_of_a_law_arrives_and_the_reply_has_handle_and_proxy(
    guarded: GuardedStack,
) -> None:
    leads(guarded)
    guarded.run(300)
    found = ask(guarded, CLIENT, cmd="proxy")["result"]
    record = guarded.view.record
    assert found["tick"] == record["tick"]
    assert found["position_m"] == pytest.approx(0.005, abs=1e-4)
    assert found["force_n"] == pytest.approx(-record["stiffness_force_n"])
    assert found["held"] is True
    assert found["fresh"] is True


def test_lost_frame_leaves_the_force_of_the_spring_in_the_reply() -> None:
    board = replace(BOARD, injections=(InjectionParams("drop_in", tick=150),))
    replies = []
    with LockStep(with_range(100.0, SOON), board) as stack:
        guarded = GuardedStack(stack, shipped_judge().answer, "warn")
        leads(guarded)
        for number in range(60):
            replies.append(ask(guarded, CLIENT, cmd="proxy", position_m=1e-4 * number)["result"])
            guarded.run()
    lost = [number for number, one in enumerate(replies) if not one["fresh"]]
    assert len(lost) == 1
    before, found = replies[lost[0] - 1], replies[lost[0]]
    assert abs(before["force_n"]) > 0.01
    assert found["force_n"] == pytest.approx(before["force_n"], abs=0.02)
    assert found["force_n"] != 0.0


def test_proxy_needs_the_lease_of_the_environment_and_force(guarded: GuardedStack) -> None:
    def code(client: bytes = CLIENT, **fields: Any) -> str:
        reply = ask(guarded, client, cmd="proxy", **fields)
        return "" if reply["ok"] else str(reply["error"]["code"])

    assert code() == ""
    assert code(position_m=0.0) == "refused_state"  # disabled
    guarded.ask(cmd="enable")
    assert code(position_m=0.0) == "leased"
    guarded.ask(cmd="lease", what="environment")
    guarded.run(3)
    assert code(position_m=0.0) == ""
    assert code(OTHER, position_m=0.0) == "leased"
    assert code(OTHER) == ""


@pytest.mark.parametrize("position_m", [1.01 * RANGE_M, nan, "0.001", None])
def test_position_outside_the_workspace_or_no_number_is_refused(
    guarded: GuardedStack, position_m: object
) -> None:
    leads(guarded)
    reply = ask(guarded, CLIENT, cmd="proxy", position_m=position_m)
    assert reply["error"]["code"] == "invalid"
    assert guarded.stack.gateway.backlog == 0


def test_positions_that_the_servo_has_not_taken_do_not_fill_the_ring(
    guarded: GuardedStack,
) -> None:
    leads(guarded)
    codes = [
        ask(guarded, CLIENT, cmd="proxy", position_m=0.004).get("error", {}).get("code")
        for _ in range(100)
    ]
    assert codes == [None, None, *["busy"] * 98]
    assert guarded.ask(cmd="stop")["ok"]
    assert guarded.view.state is State.STOPPED


def test_client_that_leaves_leaves_the_proxy_and_its_environment_ends(
    guarded: GuardedStack,
) -> None:
    leads(guarded, at_end="zero")
    ask(guarded, CLIENT, cmd="proxy", position_m=0.006)
    guarded.server.leave(CLIENT)
    guarded.run(5)
    assert guarded.view.record["proxy_m"] == pytest.approx(0.006, abs=1e-3)
    guarded.run(200)
    record = guarded.view.record
    assert record["stiffness_n_per_m"] == record["proxy_m"] == record["force_n"] == 0.0


def test_silent_holder_is_held_before_its_lease_ends(guarded: GuardedStack) -> None:
    leads(guarded, at_end="hold", ttl_s=0.5)
    guarded.run(150)
    assert guarded.view.record["flags"] & Flag.PROXY_HELD
    assert guarded.view.record["lease_control"]
    guarded.run(450)
    record = guarded.view.record
    assert not record["lease_control"]
    assert record["proxy_m"] == 0.005
    assert record["stiffness_n_per_m"] == 100.0
    assert LeaseParams().at_end == "zero"


def test_stop_during_motion_ends_force_and_proxy(guarded: GuardedStack) -> None:
    leads(guarded)
    ask(guarded, CLIENT, cmd="proxy", position_m=-0.015)
    guarded.run(5)
    assert guarded.view.record["proxy_m"] < 0.004
    guarded.send(cmd="stop")
    for _ in range(40):
        ask(guarded, CLIENT, cmd="proxy", position_m=-0.015)
        guarded.run()
    record = guarded.view.record
    assert record["state"] == State.STOPPED
    assert record["proxy_m"] == record["force_n"] == 0.0


def test_guard_judges_the_spring_of_a_proxy_like_any_other(guarded: GuardedStack) -> None:
    guarded.run(MOST_RECORDS)
    assert guarded.ask(cmd="damping", value=2.0)["ok"]
    guarded.run(200)
    assert guarded.ask(cmd="guard", policy="refuse")["ok"]
    leads(guarded)
    assert guarded.ask(cmd="set", K=-10.0)["error"]["code"] == "guard"
    assert guarded.view.record["stiffness_n_per_m"] == 100.0


# --- the callable ---------------------------------------------------------------------------------


@pytest.fixture
def device() -> Iterator[VirtualBoard]:
    with virtual_board() as device:
        device.set(K=100, active_damping=1, ramp_s=0)
        device.enable()
        yield device


def test_callable_moves_the_proxy_on_virtual_time(device: VirtualBoard) -> None:
    felt: list[Coupling] = []

    def law(now: Coupling) -> float:
        felt.append(now)
        return 0.004

    with device.lease("environment", ttl_s=1.0):
        last = device.follow_law(law, rate_hz=100.0, duration_s=0.5)
    assert len(felt) == 50
    assert last.proxy_m == 0.004
    steps = [round(1e3 * (after.time_s - one.time_s)) for one, after in pairwise(felt[1:])]
    assert steps == [10] * len(steps)


def test_law_ends_with_none_or_with_its_error(device: VirtualBoard) -> None:
    with device.lease("environment", ttl_s=1.0):
        assert device.follow_law(lambda _: None).proxy_m == 0.0
        with pytest.raises(ZeroDivisionError):
            device.follow_law(lambda _: 1 / 0)


def test_law_ends_when_force_ends(device: VirtualBoard) -> None:
    def law(now: Coupling) -> float:
        if now.proxy_m == 0.004:
            device.call("disable")
        return 0.004

    with (
        device.lease("environment", ttl_s=1.0),
        pytest.raises(CommandError, match="only in enabled"),
    ):
        device.follow_law(law)
    assert device.newest["proxy_m"] == 0.0


def test_law_of_the_asynchronous_client_keeps_its_pace_on_virtual_time(
    device: VirtualBoard,
) -> None:
    felt: list[float] = []

    def law(now: Coupling) -> float:
        felt.append(now.time_s)
        return 0.0

    async def follow() -> None:
        async with device.aio() as client, client.lease("environment"):
            await client.follow_law(law, rate_hz=100.0, duration_s=0.2)

    asyncio.run(follow())
    steps = [round(1e3 * (after - one)) for one, after in pairwise(felt[1:])]
    assert len(steps) >= 18
    assert steps == [10] * len(steps)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, nan])
def test_rate_of_a_law_that_is_not_above_0_is_refused_before_any_request(
    device: VirtualBoard, rate_hz: float
) -> None:
    felt: list[Coupling] = []
    with pytest.raises(CommandError, match="must be above 0") as refused:
        device.follow_law(lambda now: felt.append(now), rate_hz)
    assert refused.value.code == "invalid"
    assert not felt
