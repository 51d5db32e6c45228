"""What clients asked of the guard survives the gateway as far as it is no laxer than configured,
and no longer than the servo; and it is said.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.gateway_rig import CommandServerRig, packed
from support.guard_stub import StubWorker

from hapticd.core.params import GuardParams
from hapticd.guard.terms import Terms, read_terms, stricter_of, write_terms
from hapticd.mailbox.files import GUARD_TERMS


@pytest.fixture
def rig(tmp_path: Path) -> CommandServerRig:
    return CommandServerRig(tmp_path, StubWorker())


def started_anew(rig: CommandServerRig) -> dict[str, Any]:
    """What the next gateway of the same servo goes by."""
    rig.start_gateway()
    rig.run(3)
    found: dict[str, Any] = rig.ask(cmd="guard")["result"]
    return found


def configured(rig: CommandServerRig, **guard: Any) -> CommandServerRig:
    """`rig` with the gateway configured like that."""
    rig.setup = replace(rig.setup, guard=GuardParams(**guard))
    started_anew(rig)
    return rig


def warnings(rig: CommandServerRig) -> list[str]:
    return [str(one["text"]) for one in rig.journal.drain() if one["kind"] == "warning"]


@pytest.mark.parametrize("policy", ["clamp", "refuse", "follow"])
def test_stricter_policy_survives_the_gateway_and_it_is_said(
    rig: CommandServerRig, policy: str
) -> None:
    rig.ask(cmd="guard", policy=policy, margin_ns_per_m=0.2)
    found = started_anew(rig)
    assert (found["policy"], found["margin_ns_per_m"]) == (policy, 0.2)
    (text,) = warnings(rig)
    assert f"the guard was asked for {policy} by theorem, margin 0.2" in text
    assert "the configuration is warn by theorem, margin 0 N s/m" in text


@pytest.mark.parametrize("policy", ["off", "warn"])
def test_laxer_policy_ends_with_the_gateway_and_it_is_said(
    rig: CommandServerRig, policy: str
) -> None:
    configured(rig, policy="refuse", margin_ns_per_m=0.3)
    rig.ask(cmd="guard", policy=policy, margin_ns_per_m=0.0, basis="predicted")
    found = started_anew(rig)
    assert (found["policy"], found["margin_ns_per_m"]) == ("refuse", 0.3)
    assert found["basis"] == "theorem"
    (text,) = warnings(rig)
    assert f"the guard was asked for {policy} by predicted" in text
    assert "the guard judges under refuse by theorem" in text


def test_mode_auto_goes_on(rig: CommandServerRig) -> None:
    assert rig.ask(cmd="damping", value="auto")["ok"]
    rig.run(3)
    assert started_anew(rig)["mode"] == "auto"
    assert "damping auto" in warnings(rig)[0]


def test_what_the_new_gateway_is_asked_for_counts(rig: CommandServerRig) -> None:
    rig.ask(cmd="guard", policy="refuse")
    rig.start_gateway()
    rig.send(packed(cmd="guard", policy="clamp"))
    rig.run(3)
    assert rig.ask(cmd="guard")["result"]["policy"] == "clamp"


def test_nothing_is_said_where_nothing_was_asked_for(rig: CommandServerRig) -> None:
    assert started_anew(rig)["policy"] == "warn"
    assert warnings(rig) == []


def test_terms_end_with_their_servo(rig: CommandServerRig) -> None:
    rig.ask(cmd="guard", policy="refuse")
    mailbox = rig.view.mailbox
    assert mailbox is not None
    epoch = mailbox.header.start_ns
    rig.run()
    found = read_terms(rig.folder, epoch)
    assert found is not None
    assert found.policy == "refuse"
    assert read_terms(rig.folder, epoch + 1) is None


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", "null", '{"epoch": 7}', '{"epoch": 7, "policy": "none", "basis": "theorem",'
     ' "margin_ns_per_m": 0, "auto": false}', '{"epoch": 7, "policy": "off", "basis": "theorem",'
     ' "margin_ns_per_m": NaN, "auto": false}', '{"epoch": 7, "policy": "off", "basis": 3,'
     ' "margin_ns_per_m": 0, "auto": false}'],
)  # fmt: skip
def test_terms_that_are_damaged_are_none(tmp_path: Path, text: str) -> None:
    (tmp_path / GUARD_TERMS).write_text(text)
    assert read_terms(tmp_path, 7) is None


def test_terms_come_back_as_they_were_kept(tmp_path: Path) -> None:
    terms = Terms("follow", "predicted", 0.25, True)
    write_terms(tmp_path, 7, terms)
    assert read_terms(tmp_path, 7) == terms


@pytest.mark.parametrize(
    ("chosen", "configured", "counts"),
    [
        ("off", "warn", "warn"),
        ("warn", "off", "warn"),
        ("warn", "clamp", "clamp"),
        ("follow", "refuse", "follow"),
        ("clamp", "refuse", "clamp"),
        ("refuse", "off", "refuse"),
    ],
)
def test_no_policy_is_laxer_than_configured(chosen: str, configured: str, counts: str) -> None:
    found = stricter_of(Terms(chosen, "theorem", 0.1), Terms(configured, "predicted", 0.4))
    assert found == Terms(counts, "theorem", 0.4)
