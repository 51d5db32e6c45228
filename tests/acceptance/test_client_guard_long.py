"""What scripts see of the guard: warnings, typed verdicts and clients that are strict, against
command server, guard, judge, servo and board on virtual time.
"""

import asyncio
import csv
import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.guard_stages import (
    LEVEL_NS_PER_M,
    STIFF,
    AsyncServerConnection,
    Flight,
    ServerConnection,
    rendering,
)
from test_client_guard import Clients, told

import hapticd
from hapticd.client import AsyncClient, Client, GuardVerdict
from hapticd.client.design import Condition, Table
from hapticd.core.errors import CommandError, GuardWarning

POLICIES = ("off", "warn", "clamp", "follow", "refuse")


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


def test_change_that_acts_and_is_not_safe_warns_with_value_margin_and_remedy(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    with pytest.warns(hapticd.GuardWarning) as found:
        receipt = client().damping("off")
    (warning,) = told(found)
    assert receipt.result == "applied"
    assert receipt.guard is not None
    assert warning.receipt is receipt
    assert warning.margin_ns_per_m == receipt.guard.margin_ns_per_m
    assert -2.0 < receipt.guard.margin_ns_per_m < 0.0
    text = str(warning)
    assert "K = 500 N/m, B = 2 N s/m, M = 0 kg with 0 N s/m of active damping" in text
    assert f"margin {warning.margin_ns_per_m:.3g} N s/m" in text
    assert f"{receipt.guard.least_active_damping_ns_per_m:.4g} N s/m" in warning.remedy
    assert warning.remedy in text
    assert found[0].filename == __file__


def test_an_environment_is_warned_about_once_and_another_one_anew(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    device = client()

    def ask() -> None:
        device.damping("off")
        for stiffness in (600, 600, 500, 600, 500):
            device.set(K=stiffness)
            flight.fly(60)

    with pytest.warns(GuardWarning) as found:
        ask()
    assert [one.receipt.guard.given["K"] for one in told(found)] == [500.0, 600.0]
    with pytest.warns(GuardWarning, match="K = 500 N/m"):  # another client
        client().set(K=500)


def test_what_is_safe_or_not_judged_is_not_warned_about(flight: Flight, client: Clients) -> None:
    """Any warning is an error here."""
    rendering(flight, "warn")
    device = client()
    receipt = device.set(K=400)
    assert receipt.guard is not None
    assert receipt.guard.safe is True
    device.guard("off")
    receipt = device.damping("off")
    assert receipt.guard is not None
    assert receipt.guard.safe is None


def test_mode_of_the_guard_that_leaves_too_little_damping_warns_as_well(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    with pytest.warns(GuardWarning, match="with 0 N s/m of active damping"):
        assert client().guard(mode="off").mode == "off"


def test_client_of_asyncio_warns_at_the_line_that_awaits(flight: Flight, client: Clients) -> None:
    async def ask() -> None:
        async with AsyncClient() as device:
            await device.damping("off")

    rendering(flight, "warn")
    with pytest.warns(GuardWarning) as found:
        asyncio.run(ask())
    assert [one.filename for one in found] == [__file__]


def test_warning_that_is_an_error_carries_the_receipt_of_what_acts(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    with pytest.raises(GuardWarning) as caught:  # pytest makes warnings errors
        client().damping("off")
    assert caught.value.receipt.result == "applied"
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.receipt) == (str(caught.value), caught.value.receipt)


def test_verdict_of_a_receipt_and_of_a_refusal_is_typed(flight: Flight, client: Clients) -> None:
    rendering(flight, "refuse")
    device = client()
    wall = {"stiffness_n_per_m": 100.0, "position_m": 5e-3, "side": 1}
    receipt = device.set(wall=wall)
    assert isinstance(receipt.guard, GuardVerdict)
    free, contact = receipt.guard.margin_ns_per_m, receipt.guard.contact
    assert free is not None
    assert contact is not None
    assert contact.margin_ns_per_m is not None
    assert receipt.guard.worse.margin_ns_per_m == min(free, contact.margin_ns_per_m)
    with pytest.raises(CommandError) as caught:
        device.damping("off")
    assert isinstance(caught.value.guard, GuardVerdict)
    assert (caught.value.guard.safe, caught.value.guard.policy) == (False, "refuse")
    assert caught.value.guard.number > receipt.guard.number


def test_table_has_verdict_and_margin_of_each_condition(
    flight: Flight, client: Clients, tmp_path: Path
) -> None:
    rendering(flight, "warn")
    device = client()
    receipts = [device.set(K=400.0)]
    flight.fly(300)
    with pytest.warns(GuardWarning):
        receipts.append(device.damping("off"))
    device.guard("off")
    receipts.append(device.set(K=300.0))
    path = tmp_path / "session.csv"
    with Table(path) as table:
        for receipt in receipts:
            table.begin(receipt, Condition("one", {}))
    with path.open(newline="") as file:
        rows = [(row["guard_safe"], row["guard_margin"]) for row in csv.DictReader(file)]
    margins = [str(one.guard.margin_ns_per_m) for one in receipts[:2] if one.guard]
    assert rows == [("True", margins[0]), ("False", margins[1]), ("", "")]


def still_damped(flight: Flight) -> bool:
    """Whether the board has had the damping and the environment all the time."""
    records = flight.fly(300)
    damped = records["active_damping_effect_ns_per_m"].min() >= 0.999 * LEVEL_NS_PER_M
    return damped and set(records["stiffness_n_per_m"].tolist()) == {STIFF["K"]}


@pytest.mark.parametrize("policy", POLICIES)
def test_nothing_unsafe_acts_that_a_strict_client_asks_for_under(
    flight: Flight, client: Clients, policy: str
) -> None:
    rendering(flight, policy)
    device = client(strict=True)
    with pytest.raises(CommandError, match="short at") as caught:
        device.damping("off")
    assert (caught.value.code, caught.value.guard.policy) == ("guard", "refuse")
    assert still_damped(flight)
    assert device.guard().policy == policy


def test_strict_client_has_no_command_that_goes_past_the_guard(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    device = client(strict=True)
    for ask in (
        lambda: device.set(active_damping=0.0),
        lambda: device.guard(mode="off"),
        lambda: device.call("damping", value="off"),
    ):
        with pytest.raises(CommandError, match="short at"):
            ask()
    assert still_damped(flight)


def test_strict_client_leaves_the_others_as_lax_as_the_policy(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    with pytest.raises(CommandError):
        client(strict=True).damping("off")
    with pytest.warns(GuardWarning):
        assert client().damping("off").result == "applied"


def test_strict_client_of_asyncio_is_refused_too(flight: Flight, client: Clients) -> None:
    async def ask() -> None:
        async with AsyncClient(strict=True) as device:
            await device.damping("off")

    rendering(flight, "warn")
    with pytest.raises(CommandError, match="short at") as caught:
        asyncio.run(ask())
    assert caught.value.code == "guard"
    assert still_damped(flight)


@pytest.mark.parametrize("policy", ["off", "warn"])
def test_strict_client_is_refused_while_nobody_judges_under(
    flight: Flight, client: Clients, policy: str
) -> None:
    rendering(flight, policy)
    flight.worker.give_up("it died")
    device = client(strict=True)
    with pytest.raises(CommandError, match="a client that is not strict") as caught:
        device.set(K=10)
    assert (caught.value.code, caught.value.guard.safe) == ("guard", None)
    assert still_damped(flight)
    assert client().set(K=10).result == "applied"
    assert device.set(K=0, B=0).result == "applied"  # force 0 is never refused


def test_what_a_strict_client_has_scheduled_is_judged_again_where_another_takes_the_damping(
    flight: Flight, client: Clients
) -> None:
    rendering(flight, "warn")
    device = client()
    device.set(K=100, B=1)
    flight.fly(200)
    client(strict=True).set(**STIFF, at_tick=flight.view.tick + 400)
    with pytest.warns(GuardWarning):
        assert device.damping(0.2).result == "applied"
    records = flight.fly(800)
    assert flight.ends() == ["refused"]
    assert set(records["stiffness_n_per_m"].tolist()) == {100.0}
