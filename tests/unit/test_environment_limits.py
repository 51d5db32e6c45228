"""How much K, B and M a client may ask for: bounds that keep out mistaken units."""

from dataclasses import replace

import pytest
from support.gateway_stand_in import setup

from hapticd.core.errors import CommandError
from hapticd.core.params import EnvironmentLimits, ServoParams, from_plain, to_plain
from hapticd.protocol.limits import WIDEST, CommandLimits, environment_limits
from hapticd.protocol.schemas import json_schema, parse

WEIR = {"K": [0.0, 1958.8], "B": [-11.03, 32.54], "M": [-0.0814, 0.14153]}
STATED = EnvironmentLimits((-1e3, -50.0, -0.5), (5e4, 200.0, 1.0))


def servo(limits: EnvironmentLimits | None, commissioning: bool = False) -> ServoParams:
    known = setup().servo
    device = replace(known.device, environment_limits=limits, commissioning=commissioning)
    return replace(known, device=device)


def test_an_end_is_ten_times_what_is_passive_there_and_never_beyond_the_mailbox() -> None:
    """B below -100 N s/m is the mailbox's to refuse, and no K below 0 is passive."""
    found = environment_limits(WEIR)
    assert found.lowest == (-1e3, -100.0, -0.814)
    assert found.highest == (19600.0, 325.0, 1.42)
    stiff = environment_limits({"K": [0.0, 1e5], "B": [-90.0, 900.0], "M": [-0.5, 8.0]})
    assert stiff.highest == WIDEST.highest
    assert stiff.lowest == (-1e3, -100.0, -1.0)


def test_an_end_of_which_nothing_is_known_is_the_stated_one() -> None:
    assert environment_limits({}) == STATED
    assert environment_limits({"K": None, "B": None, "M": None}) == STATED
    assert environment_limits({"K": [0.0, 0.0], "B": [0.0, 0.0], "M": [0.0, 0.0]}) == STATED
    found = environment_limits({"B": [0.0, 3.0]})
    assert (found.lowest[1], found.highest[1]) == (-50.0, 30.0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"M": 10},
            "M = 10 kg: beyond the limit -0.814..1.42 kg (of this device, against mistaken units);"
            " in kg; did you mean 0.010?",
        ),
        ({"M": 60.0}, "in kg; did you mean 0.060?"),
        ({"M": -5}, "in kg; did you mean -0.005?"),
        ({"M": 2.5}, "in kg; did you mean 0.0025?"),
        (
            {"K": 2e4},
            "K = 20000 N/m: beyond the limit -1000..19600 N/m (of this device, against mistaken"
            " units); use a value within",
        ),
        ({"B": 1740}, "B = 1740 N s/m: beyond the limit -100..325 N s/m"),
        ({"K": -2000}, "K = -2000 N/m: beyond the limit -1000..19600 N/m"),
    ],
)
def test_value_beyond_is_refused_with_unit_limit_and_what_was_meant(
    given: dict[str, float], said: str
) -> None:
    limits = CommandLimits.announced(servo(environment_limits(WEIR)))
    with pytest.raises(CommandError) as caught:
        parse({"cmd": "set", **given}, limits)
    assert caught.value.code == "invalid"
    assert said in str(caught.value)


def test_mass_that_is_no_number_of_grams_either_is_not_guessed() -> None:
    limits = CommandLimits.announced(servo(environment_limits(WEIR)))
    assert "use a value within" in limits.complaint("M", 9000.0)


def test_limit_itself_may_be_asked_for() -> None:
    limits = CommandLimits.announced(servo(environment_limits(WEIR)))
    for given in ({"M": 1.42}, {"M": -0.814}, {"K": 19600}, {"B": -100}):
        parse({"cmd": "set", **given}, limits)


def test_clients_and_pages_are_told_the_same_limits() -> None:
    """A sequence is checked by what the daemon announced, a page by its `hello`."""
    params = servo(environment_limits(WEIR))
    device = params.device
    own = CommandLimits(
        params.realtime.rate_hz,
        device.active_damping_limit_ns_per_m,
        device.environment_limits,
        device.commissioning,
        device.probe_limit_n,
    )
    assert CommandLimits.announced(params).of == own.of
    assert own.plain()["M"] == {"low": -0.814, "high": 1.42, "unit": "kg"}
    assert json_schema(own)["$defs"]["Set"]["properties"]["M"]["maximum"] == 1.42
    assert from_plain(ServoParams, to_plain(params)) == params


def test_box_of_unverified_signs_stays_the_narrower_one() -> None:
    limits = CommandLimits.announced(servo(environment_limits(WEIR), commissioning=True))
    assert "0..100 N/m (the signs of this device are not verified" in limits.complaint("K", 300.0)
    assert not limits.allows("M", 0.010)


def test_without_bounds_the_mailbox_alone_limits() -> None:
    """As on a scene that the bench simulates."""
    limits = CommandLimits.announced(servo(None))
    assert limits.allows("M", 10.0)
    assert "it is fixed in this version" in limits.complaint("K", 2e5)
