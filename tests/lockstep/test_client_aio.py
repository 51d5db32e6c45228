"""The client of asyncio against a whole gateway in a thread of its own, in virtual time."""

import asyncio
import inspect
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.gateway_rig import GatewayRig, running

from hapticd.client import AsyncClient, Client, Receipt
from hapticd.core.errors import CommandError, DaemonDown
from hapticd.mailbox.layout import Command, State


@pytest.fixture
def folder(runtime: Path) -> Path:
    return runtime / "hapticd"


@pytest.fixture
def rig(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GatewayRig]:
    # a busy machine is no reason to press the page
    monkeypatch.setattr("hapticd.client.aio.STOP_TIMEOUT_S", 10.0)
    with GatewayRig(folder) as rig, running(rig):
        yield rig


def client() -> AsyncClient:
    return AsyncClient(name="test", timeout_s=10.0)


def public(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind) if not name.startswith("_")}


def test_it_has_the_verbs_of_the_client_that_waits() -> None:
    assert public(Client) - public(AsyncClient) == {"messages"}  # endless looks are listen's here
    for name in public(AsyncClient) & public(Client):
        asked = [
            set(inspect.signature(getattr(one, name)).parameters) for one in (Client, AsyncClient)
        ]
        # the event loop keeps every lease alive
        assert asked[0] - asked[1] == ({"keep_alive"} if name == "lease" else set()), name
        assert asked[1] <= asked[0], name


@pytest.mark.usefixtures("rig")
def test_every_verb_is_awaited() -> None:
    async def ask() -> None:
        async with client() as device:
            receipt = await device.set(K=100, B=1, ramp_s=0.1)
            assert isinstance(receipt, Receipt)
            assert (receipt.result, receipt.effective["K"]) == ("applied", 100.0)
            assert (await device.enable()).state == "enabled"
            assert (await device.damping(0.5)).effective["active_damping"] == 0.5
            assert (await device.stop()).state == "stopped"
            assert (await device.reset()).state == "disabled"
            assert (await device.status()).actor_name == "test"
            await device.wait_for("disabled")
            with pytest.raises(CommandError, match=r"beyond the limit 0\.\.2 N s/m"):
                await device.set(active_damping=9)

    asyncio.run(ask())


def test_many_tasks_ask_at_once_and_each_gets_its_own_reply(rig: GatewayRig) -> None:
    async def ask() -> list[Receipt]:
        async with client() as device:
            return await asyncio.gather(*(device.set(K=float(one)) for one in range(40)))

    receipts = asyncio.run(ask())
    assert [one.effective["K"] for one in receipts] == [float(one) for one in range(40)]
    assert sorted(one.revision for one in receipts) == list(range(1, 41))


@pytest.mark.usefixtures("rig")
def test_streams_give_whole_records_while_others_ask() -> None:
    async def ask() -> tuple[np.ndarray, int, str]:
        async with client() as device:
            recorded, found = await asyncio.gather(device.record(0.5), device.get())
            return recorded[0], recorded[1], found.parameters["active_damping_level"]

    records, lost, _ = asyncio.run(ask())
    assert (len(records), lost) == (500, 0)
    assert (np.diff(records["tick"].astype(int)) == 1).all()


@pytest.mark.usefixtures("rig")
def test_listen_gives_states_and_a_waveform_is_loaded_whole() -> None:
    async def ask() -> None:
        async with client() as device:
            assert await device.perturb_load(np.zeros(20_000)) == 20_000
            async for state in device.listen("state"):
                assert state["state"] == "disabled"
                break

    asyncio.run(ask())


@pytest.mark.usefixtures("rig")
def test_a_lease_excludes_others_until_the_context_ends() -> None:
    async def ask() -> None:
        async with client() as device, AsyncClient(name="other", timeout_s=10.0) as other:
            async with device.lease("environment", ttl_s=5.0):
                await device.set(K=10)
                with pytest.raises(CommandError, match="test"):
                    await other.set(K=20)
            assert (await other.set(K=20)).effective["K"] == 20.0

    asyncio.run(ask())


@pytest.mark.usefixtures("rig")
def test_a_lease_that_was_taken_over_is_told_at_its_end() -> None:
    async def ask() -> None:
        async with client() as device, AsyncClient(name="other", timeout_s=10.0) as other:
            with pytest.raises(CommandError, match="were not excluded"):
                async with device.lease("environment", ttl_s=5.0):
                    await other.call("lease", what="environment", take_over=True)

    asyncio.run(ask())


def test_no_daemon_is_told_at_once(folder: Path) -> None:
    async def ask() -> None:
        async with client() as device:
            for verb in (device.get, device.enable, lambda: device.record(1.0)):
                with pytest.raises(DaemonDown, match="no daemon runs there"):
                    await verb()

    asyncio.run(ask())


def test_old_request_does_not_reach_a_later_gateway(folder: Path) -> None:
    async def ask() -> None:
        async with AsyncClient(timeout_s=0.05) as device:
            with pytest.raises(DaemonDown, match=r"enable: no reply from .* within"):
                await device.enable()
            (folder / "command").unlink()
            with GatewayRig(folder) as rig, running(rig):
                device._timeout_s = 10.0
                await device.set(K=1)
                assert [kind for kind, _ in rig.servo.taken] == [Command.SET]

    folder.mkdir(mode=0o700)
    (folder / "command").touch()
    asyncio.run(ask())


def test_client_is_introduced_to_the_next_gateway_before_it_asks(rig: GatewayRig) -> None:
    async def ask() -> None:
        async with client() as device:
            await device.set(K=1)
            rig.restart_gateway()
            await device.mark("first")
            events = (await device.status()).events
            assert [one.name for one in events if one.kind == "mark"] == ["test"]

    asyncio.run(ask())


def test_client_is_introduced_however_late_it_is_connected(folder: Path) -> None:
    async def ask() -> None:
        async with AsyncClient(timeout_s=0.05, name="experiment") as device:
            with pytest.raises(DaemonDown):
                await device.get()
            (folder / "command").unlink()
            with GatewayRig(folder) as rig, running(rig):
                device._timeout_s = 10.0
                await device.set(K=1)
                assert (await device.status()).actor_name == "experiment"

    folder.mkdir(mode=0o700)
    (folder / "command").touch()
    asyncio.run(ask())


def test_stop_without_gateway_presses_the_page_while_another_task_waits(folder: Path) -> None:
    async def ask() -> None:
        async with AsyncClient(timeout_s=0.5) as device:
            waiting = asyncio.create_task(device.get())
            await asyncio.sleep(0)
            assert await device.stop() == Receipt("pressed")
            assert not waiting.done()
            with pytest.raises(DaemonDown):
                await waiting

    with GatewayRig(folder) as rig:  # nobody steps the gateway
        asyncio.run(ask())
        rig.servo.tick()
        assert rig.servo.state is State.STOPPED
