"""What a request may hold, and how a wrong one is explained: field, value, unit, limit, remedy."""

from typing import Any

import pytest
from support.gateway_stand_in import setup

from hapticd.core.environment import flat
from hapticd.core.errors import CommandError
from hapticd.mailbox.layout import VALUE_LIMITS
from hapticd.protocol.limits import PLACES, CommandLimits
from hapticd.protocol.schemas import MODELS, json_schema, parse

LIMITS = CommandLimits.announced(setup().servo)
LIST = "the command `schema` lists what is allowed"

ALLOWED: list[dict[str, Any]] = [
    {"cmd": "hello", "name": "script"},
    {"cmd": "get", "v": 1, "id": "a"},
    {"cmd": "set", "K": 100, "B": 1.0, "M": 0, "ramp_s": 0.2, "at_tick": 9, "if_rev": 0},
    {"cmd": "set", "filters": {"velocity_hz": 80.0, "acceleration_zeta": 1}},
    {
        "cmd": "set",
        "wall": {
            "stiffness_n_per_m": 1000,
            "virtual_damping_ns_per_m": 2,
            "position_m": -0.01,
            "side": -1,
        },
    },
    {"cmd": "damping", "value": "on"},
    {"cmd": "damping", "value": 2},
    {"cmd": "perturb", "action": "load", "samples_n": [0.1, -0.2], "offset": 10},
    {"cmd": "perturb", "action": "load", "samples_n": b"\0\0\0\0"},
    {"cmd": "perturb", "action": "start", "loop": True},
    {"cmd": "perturb", "action": "stop"},
    *(
        {"cmd": cmd}
        for cmd in ("enable", "disable", "stop", "reset", "zero", "home", "status", "schema")
    ),
]

WRONG: list[tuple[dict[str, Any], str, str]] = [
    (
        {"cmd": "set", "K": 2e5},
        "K",
        (
            "K = 200000 N/m: beyond the limit -10000..100000 N/m (it is fixed in this version); use"
            " a value within"
        ),
    ),
    (
        {"cmd": "set", "active_damping": 2.5},
        "active_damping",
        (
            "active_damping = 2.5 N s/m: beyond the limit 0..2 N s/m (the device file sets it); use"
            " a value within"
        ),
    ),
    (
        {"cmd": "damping", "value": -0.1},
        "value",
        (
            "active damping = -0.1 N s/m: beyond the limit 0..2 N s/m (the device file sets it);"
            " use a value within"
        ),
    ),
    (
        {"cmd": "set", "filters": {"velocity_hz": 451}},
        "filters.velocity_hz",
        (
            "filters.velocity_hz = 451 Hz: beyond the limit 0.1..450 Hz (it is 0.45 of the servo"
            " rate); use a value within"
        ),
    ),
    (
        {"cmd": "set", "K": "100"},
        "K",
        "K = '100': not a number; send a number in -10000..100000 N/m",
    ),
    (
        {"cmd": "set", "K": True},
        "K",
        "K = True: not a number; send a number in -10000..100000 N/m",
    ),
    (
        {"cmd": "set", "K": None},
        "K",
        "K = None: not a number; send a number in -10000..100000 N/m",
    ),
    (
        {"cmd": "set", "K": float("nan")},
        "K",
        "K = nan: not a finite number; send a number in -10000..100000 N/m",
    ),
    (
        {"cmd": "set", "K": float("inf")},
        "K",
        "K = inf: not a finite number; send a number in -10000..100000 N/m",
    ),
    ({"cmd": "set", "K": 1, "k": 1}, "k", f"k: unknown field, did you mean 'K'?; {LIST}"),
    (
        {"cmd": "set", "wall": {"sides": 1}},
        "wall.sides",
        f"wall.sides: unknown field, did you mean 'side'?; {LIST}",
    ),
    (
        {"cmd": "set", "wall": {"side": 2}},
        "wall.side",
        f"wall.side = 2: not -1, 0 or 1; {LIST}",
    ),
    (
        {"cmd": "set", "wall": {"side": True}},
        "wall.side",
        f"wall.side = True: expected a number, not true or false; {LIST}",
    ),
    (
        {"cmd": "set"},
        "set",
        "set: nothing to set; give one of K, B, M, filters, wall, active_damping,"
        " limit_cycle_faults",
    ),
    (
        {"cmd": "set", "wall": {}, "ramp_s": 1},
        "set",
        "set: nothing to set; give one of K, B, M, filters, wall, active_damping,"
        " limit_cycle_faults",
    ),
    (
        {"cmd": "set", "K": 1, "at_tick": 0},
        "at_tick",
        f"at_tick = 0: Input should be greater than 0; {LIST}",
    ),
    (
        {"cmd": "damping", "value": "ON"},
        "value",
        "active damping = 'ON': not 'on', 'off' or 'auto'; send a number in 0..2 N s/m",
    ),
    ({"cmd": "damping"}, "value", f"value: missing; {LIST}"),
    (
        {"cmd": "perturb", "action": "load"},
        "perturb",
        "perturb: samples_n is missing: load needs the force samples [N]",
    ),
    (
        {"cmd": "perturb", "action": "stop", "loop": True},
        "perturb",
        "perturb: loop does not belong to action stop",
    ),
    (
        {"cmd": "get", "id": -1},
        "id",
        f"id = -1: must be an integer in 0..2^53-1 or 1..64 printable ASCII characters; {LIST}",
    ),
    ({"cmd": "get", "v": True}, "v", f"v = True: not a whole number; {LIST}"),
    ({"cmd": "enable", "force": 1}, "force", f"force: unknown field; {LIST}"),
]


@pytest.mark.parametrize("plain", ALLOWED, ids=str)
def test_request_is_understood(plain: dict[str, Any]) -> None:
    given = parse(plain, LIMITS).given
    assert given == plain


def details(error: CommandError) -> list[dict[str, Any]]:
    assert isinstance(error.detail, list)
    return error.detail


@pytest.mark.parametrize(("plain", "loc", "message"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_wrong_request_is_explained(plain: dict[str, Any], loc: str, message: str) -> None:
    with pytest.raises(CommandError) as caught:
        parse(plain, LIMITS)
    assert caught.value.code == "invalid"
    (item,) = details(caught.value)
    assert (item["loc"], item["msg"]) == (loc, message)
    assert str(caught.value) == message


def test_number_beyond_its_limit_is_told_in_fields() -> None:
    with pytest.raises(CommandError) as caught:
        parse({"cmd": "set", "K": 200000.0}, LIMITS)
    (item,) = details(caught.value)
    found = {name: item[name] for name in ("value", "unit", "low", "high")}
    assert found == {"value": 200000.0, "unit": "N/m", "low": -1e4, "high": 1e5}


def test_unknown_command_lists_the_known() -> None:
    with pytest.raises(CommandError) as caught:
        parse({"cmd": "sett"}, LIMITS)
    assert (
        str(caught.value)
        == f"cmd = sett: unknown command, did you mean 'set'?; known: {', '.join(MODELS)}"
    )


@pytest.mark.parametrize("cmd", ["\ud800", 5, None, ["set"], {"set": 1}, "x" * 10_000])
def test_strange_command_is_no_echo(cmd: object) -> None:
    with pytest.raises(CommandError) as caught:
        parse({"cmd": cmd}, LIMITS)
    assert len(str(caught.value)) < 300
    assert str(caught.value).isascii()


def test_every_wrong_field_has_its_line() -> None:
    with pytest.raises(CommandError) as caught:
        parse({"cmd": "set", "K": "a", "B": None, "no": 1}, LIMITS)
    assert [item["loc"] for item in caught.value.detail] == ["K", "B", "no"]  # type: ignore[attr-defined]


def test_details_are_bounded() -> None:
    with pytest.raises(CommandError) as caught:
        parse({"cmd": "set", **{f"é{n}" + "x" * 500: n for n in range(60)}}, LIMITS)
    assert len(caught.value.detail) == 8  # type: ignore[arg-type]
    assert len(str(caught.value)) < 3000


def test_other_protocol_version_is_refused() -> None:
    with pytest.raises(
        CommandError, match="v = 2: this gateway speaks 1; use a client of the same release"
    ) as caught:
        parse({"cmd": "get", "v": 2}, LIMITS)
    assert caught.value.code == "unsupported_version"


def test_limits_are_the_mailbox_table() -> None:
    assert LIMITS.of["K"][:3] == VALUE_LIMITS[PLACES["K"]]
    assert set(PLACES) <= set(LIMITS.of)


def test_limit_itself_is_allowed() -> None:
    for name, value in (("K", 1e5), ("K", -1e4), ("active_damping", 2.0), ("active_damping", 0.0)):
        assert parse({"cmd": "set", name: value}, LIMITS).given[name] == value


def test_schema_and_limits_name_the_same_fields() -> None:
    properties = json_schema(LIMITS)["$defs"]
    leaves = {name for name, field in properties["Set"]["properties"].items() if "unit" in field}
    leaves |= {
        f"{part.lower()}.{name}"
        for part in ("Filters", "Wall")
        for name in properties[part]["properties"]
    }
    assert leaves == set(PLACES)
    assert not any(
        field.get("default", ...) is None for name, field in flat(properties) if name == "default"
    )
