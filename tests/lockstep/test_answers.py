"""Answers of the daemon are frozen dataclasses with all that it sends, and are the one schema."""

import ast
import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest
from pydantic import TypeAdapter
from support.gateway_stand_in import setup
from support.tree import ROOT

import hapticd
from benchmarks.guard_attack import shipped_judge
from hapticd.client.telemetry import accepted, receipt_of
from hapticd.core.environment import Environment
from hapticd.core.errors import CommandError
from hapticd.core.units import UNITS
from hapticd.gateway.tick_times import PERCENTILES
from hapticd.guard.delivered import Estimate
from hapticd.protocol import answers
from hapticd.protocol.answers import (
    Event,
    Get,
    GuardStatus,
    Hello,
    LeaseHeld,
    Receipt,
    Status,
    answer_of,
)
from hapticd.protocol.limits import CommandLimits
from hapticd.protocol.schemas import ANSWERS, json_schema

NUMBERS_WITHOUT_UNIT = {
    *("actor", "actors", "revision", "epoch", "tick", "slot", "first_tick", "ramp_end_tick"),
    *("homed", "perturbing", "gain", "counters", "requests", "waiting", "number", "stages"),
    *("pid", "protocol", "count", "path_points", "radius", "low", "high", "ratio", "commanded"),
    *("timestamp", "lost_share", "loop_gain", "loop_gain_at_ceiling", "least_loop_gain"),
    *("id", "seq", "lost", "times", "hz", "by_actor", "port", "percent"),
    *("allowed", "seconds"),  # their units stand in the comments
}
KINDS = [one for name in answers.__all__ if dataclasses.is_dataclass(one := getattr(answers, name))]


@pytest.fixture(scope="module")
def board() -> Iterator[Any]:
    with hapticd.virtual_board() as board:
        board.damping(1.5)
        board.sleep(0.5)
        board.set(K=100, B=1)
        board.enable()
        board.sleep(1.0)
        yield board


def names(kind: Any) -> set[str]:
    return {one.name for one in dataclasses.fields(kind)}


def sent(board: Any, cmd: str, **fields: Any) -> dict[str, Any]:
    found: dict[str, Any] = board.call(cmd, **fields)["result"]
    return found


def whole_guard(board: Any) -> dict[str, Any]:
    """The answer to `guard` once the judge has looked at what is in force."""
    plain = sent(board, "guard")
    asked = {"ask": "look", "target": Environment(50.0, 1.0).message(), "level_on": 1.0}
    terms = {name: plain[name] for name in ("basis", "margin_ns_per_m")}
    looked = shipped_judge().answer({**asked, **terms, "delay_periods": 0.5})
    return plain | {"verdict": looked["verdict"], "timing": looked["timing"]}


def test_nested_answers_have_every_field_that_is_sent(board: Any) -> None:
    assert sent(board, "get")["in_force"].keys() == names(answers.InForce)
    assert sent(board, "guard")["delays"].keys() == names(answers.Delays)
    looked = whole_guard(board)
    assert looked["verdict"].keys() <= names(answers.GuardVerdict)
    assert looked["timing"].keys() | {"measured"} == names(answers.Timing)
    assert looked["timing"]["with_active_damping"].keys() == names(answers.TimingCost)
    lease = sent(board, "lease", what="environment")
    assert lease.keys() - {"what"} == names(LeaseHeld)
    assert sent(board, "status")["leases"]["environment"].keys() == names(LeaseHeld)
    ended = sent(board, "lease", what="environment", action="release")
    assert ended.keys() == names(answers.LeaseReleased)
    assert names(answers.Delivered) == set(Estimate._fields)
    assert names(answers.StageTimes) == {"count", "max_us", *PERCENTILES}
    reply = board.call("set", K=90)
    assert reply["receipt"].keys() | {"state", "guard"} == names(Receipt)


def test_real_replies_satisfy_the_schema(board: Any) -> None:
    """Strictly: a number where a number is promised."""
    for cmd, kind in (("hello", Hello), ("get", Get), ("status", Status), ("guard", GuardStatus)):
        plain = json.dumps(sent(board, cmd), default=str)
        TypeAdapter(kind).validate_json(plain, strict=True)


def noted() -> Iterator[tuple[str, set[str]]]:
    """(module, names of fields) of each event that the source notes."""
    for path in sorted((ROOT / "hapticd").rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if ".note(" in text else ():
            match node:
                case ast.Call(func=ast.Attribute(attr="note"), args=[_, *_], keywords=fields):
                    yield path.name, {one.arg for one in fields if one.arg}


def test_every_field_of_an_event_is_in_its_class() -> None:
    found = list(noted())
    modules = {module for module, _ in found}
    assert {"publisher.py", "lease_server.py", "command_server.py", "status.py"} <= modules
    for module, fields in found:
        assert fields - {"unix_ns"} <= names(Event), module


def test_event_is_read_with_the_answer_and_the_hand_inside_it() -> None:
    plain = {"kind": "answer", "guard": {"safe": False}, "hand": {"hz": 34.0}, "colour": 1}
    event = answer_of(Event, plain)
    assert event.guard == answers.GuardVerdict(safe=False)
    assert event.hand == answers.Hand(hz=34.0)
    assert event.tick == -1


def test_schema_of_the_protocol_describes_every_field_of_the_answers() -> None:
    defined = json_schema(CommandLimits.announced(setup().servo))["$defs"]
    for one in ANSWERS:
        assert defined[f"{one.__name__}Answer"]["properties"].keys() == names(one)


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_has_its_unit_in_its_name(kind: Any) -> None:
    for one in dataclasses.fields(kind):
        if "int" in str(one.type) or "float" in str(one.type):
            unit = any(one.name.endswith(suffix) for suffix in UNITS)
            assert unit or one.name in NUMBERS_WITHOUT_UNIT, one.name


@pytest.mark.parametrize("kind", KINDS)
def test_answers_are_frozen(kind: Any) -> None:
    assert kind.__dataclass_params__.frozen


def test_answers_of_a_newer_daemon_are_read(board: Any) -> None:
    """Unknown fields at any depth are left out; fields that are not sent have their defaults."""
    plain = whole_guard(board)
    newer = msgpack.unpackb(msgpack.packb(plain))
    newer["colour"] = 1
    newer["timing"]["colour"] = newer["verdict"]["colour"] = newer["delays"]["colour"] = 1
    assert answer_of(GuardStatus, newer) == answer_of(GuardStatus, plain)
    reply = {"receipt": {"result": "applied", "colour": 1}, "state": "enabled", "colour": 1}
    assert receipt_of(reply) == Receipt("applied", state="enabled")
    refusal = {"error": {"code": "guard", "guard": {"safe": False, "contact": {"colour": 1}}}}
    with pytest.raises(CommandError) as caught:
        accepted(refusal)
    assert caught.value.guard == answers.GuardVerdict(safe=False, contact=answers.GuardReading())


def test_client_does_without_pydantic() -> None:
    code = (
        "import sys, hapticd.client, hapticd.client.client, hapticd.client.aio,"
        " hapticd.client.sequence; sys.exit('pydantic' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
