"""What scripts see of the guard: warnings, typed verdicts and clients that are strict, against
command server, guard, judge, servo and board on virtual time.
"""

import asyncio
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.gateway_rig import GatewayRig, running
from support.guard_stages import (
    STIFF,
    AsyncServerConnection,
    Flight,
    ServerConnection,
    rendering,
)
from support.guard_stub import StubWorker, stage, verdict

from hapticd.client import AsyncClient, Client, SequenceError, step
from hapticd.core.errors import CommandError, GuardWarning
from hapticd.gateway import server

Clients = Callable[..., Client]


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    with flight.stack:
        yield flight
        flight.view.drop()


@pytest.fixture
def client(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> Clients:
    """Makes clients of the command server; they share a connection."""
    monkeypatch.setattr(
        "hapticd.client.client.GatewayConnection", lambda *_: ServerConnection(flight)
    )
    monkeypatch.setattr(
        "hapticd.client.aio.AsyncConnection", lambda *_: AsyncServerConnection(flight)
    )
    return Client


def told(found: pytest.WarningsRecorder) -> list[GuardWarning]:
    return [one.message for one in found if isinstance(one.message, GuardWarning)]


# --- warnings -------------------------------------------------------------------------------------


def test_mode_that_leaves_too_little_damping_warns_by_asyncio_as_well(
    flight: Flight, client: Clients
) -> None:
    async def ask() -> None:
        async with AsyncClient() as device:
            await device.guard(mode="off")

    rendering(flight, "warn")
    with pytest.warns(GuardWarning, match="with 0 N s/m of active damping"):
        asyncio.run(ask())


# --- strict clients -------------------------------------------------------------------------------


def test_strict_client_enables_nothing_that_is_not_safe(flight: Flight, client: Clients) -> None:
    with pytest.warns(GuardWarning):
        client().set(**STIFF)
    with pytest.raises(CommandError, match="enable: refused"):
        client(strict=True).enable()
    assert flight.fly(300)["gain"].max() == 0.0


# --- sequences ------------------------------------------------------------------------------------


def unsafe_from_300(asked: dict) -> dict:  # type: ignore[type-arg]
    """A guard by which K >= 300 N/m is not safe."""
    change = asked.get("change", {})
    found = verdict(change.get("K", 0.0) < 300.0, "too stiff", given=change)
    refused = asked.get("policy") == "refuse" and not found["safe"]
    stages = [] if refused else [stage(change)]
    return {"action": "refuse" if refused else "apply", "stages": stages, "verdict": found}


@pytest.fixture
def gateway(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GatewayRig]:
    monkeypatch.setattr(server, "Worker", lambda *_: StubWorker(unsafe_from_300))
    with (
        GatewayRig(runtime / "hapticd", start_worker=lambda line: pytest.fail("a process")) as rig,
        running(rig),
    ):
        yield rig


STEPS = (step("set", K=100), step("set", K=300), step("set", K=200))


@pytest.mark.usefixtures("gateway")
def test_sequence_is_done_to_its_end_before_it_warns() -> None:
    with Client(timeout_s=10.0) as device, pytest.warns(GuardWarning, match="too stiff") as found:
        done = device.sequence(STEPS)
    assert [one.result for one in done] == ["applied"] * 3
    assert [one.receipt for one in told(found)] == [done[1]]
    assert found[0].filename == __file__

    with Client(timeout_s=10.0) as device, warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(GuardWarning):
            device.sequence(STEPS)
        assert device.get().parameters["K"] == 200.0


@pytest.mark.usefixtures("gateway")
def test_sequence_that_ends_early_warns_beside_its_error() -> None:
    steps = (step("set", K=300), step("enable"), step("set", K=300, if_rev=0))
    with (
        Client(timeout_s=10.0) as device,
        pytest.warns(GuardWarning),
        pytest.raises(SequenceError, match="step 3"),
    ):
        device.sequence(steps)

    async def ask() -> None:
        async with AsyncClient(timeout_s=10.0) as device:
            await device.sequence(steps)

    with pytest.raises(SequenceError, match="step 3"):  # pytest makes warnings errors
        asyncio.run(ask())


@pytest.mark.usefixtures("gateway")
def test_strict_sequence_ends_at_the_step_that_is_not_safe() -> None:
    with (
        Client(timeout_s=10.0, strict=True) as device,
        pytest.raises(SequenceError, match=r"step 2 of 3 .*too stiff") as caught,
    ):
        device.sequence(STEPS)
    assert caught.value.code == "guard"
    assert caught.value.receipts[1].guard.safe is False
