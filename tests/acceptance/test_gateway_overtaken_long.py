"""What was cancelled, overtaken or judged without force does not come into force: the command
server, with the guard's judge, in front of the servo itself, on virtual time.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from support.guard_stages import LEVEL_NS_PER_M, STIFF, Flight, rendering
from test_gateway_overtaken import enabled, send

from hapticd.mailbox.layout import State

NOTHING = {"K": 0.0, "B": 0.0}


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.stack.close()


def stiff_without_damping(records: Any) -> bool:
    """Whether the whole of STIFF was rendered without the damping that it needs."""
    stiff = records["stiffness_n_per_m"] > 100.0
    undamped = records["active_damping_effect_ns_per_m"] < 0.2
    return bool((stiff & undamped & (records["gain"] == 1.0)).any())


def test_what_is_scheduled_waits_for_an_enable_in_stages(flight: Flight) -> None:
    """Judged without force, its ways would not be: the damping would go before K does."""
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    assert flight.ask(cmd="damping", value=LEVEL_NS_PER_M)["ok"]
    assert flight.ask(cmd="set", **STIFF)["ok"]
    assert flight.ask(cmd="enable")["receipt"]["result"] == "staged"
    at = flight.view.tick + 800
    send(flight, {"cmd": "set", **NOTHING, "ramp_s": 5.0, "active_damping": 0.0, "at_tick": at})
    assert not stiff_without_damping(flight.fly(1500))
    assert flight.view.state is State.ENABLED


@pytest.mark.parametrize("terms", ["another gateway", "policy", "measuring"])
def test_an_end_that_others_judged_brings_no_strength_back(flight: Flight, terms: str) -> None:
    """K is taken away for a while, and meanwhile its damping is."""
    rendering(flight, "refuse")
    if terms == "policy":
        assert flight.ask(cmd="guard", policy="warn")["ok"]
    if terms == "measuring":
        assert flight.ask(cmd="lease", what="measuring")["ok"]
    at = flight.view.tick + 50
    asked = flight.ask(cmd="set", **NOTHING, ramp_s=0.02, at_tick=at, until_tick=at + 1200)
    assert asked["receipt"]["result"] == "scheduled"
    flight.fly(200)
    if terms == "another gateway":
        flight.another_gateway()
        flight.fly(650)
        assert flight.ask(cmd="guard", policy="refuse")["ok"]
        flight.fly(5)
    assert flight.ask(cmd="damping", value="off")["ok"]
    if terms == "policy":
        assert flight.ask(cmd="guard", policy="refuse")["ok"]
    if terms == "measuring":
        assert flight.ask(cmd="lease", what="measuring", action="release")["ok"]
    records = flight.fly(at + 1300 - flight.view.tick)
    assert not stiff_without_damping(records)
    assert records["stiffness_n_per_m"][-1] == 0.0


def test_the_ends_of_changes_that_overlap_are_judged_as_they_come(flight: Flight) -> None:
    """The second end takes over what the first one brings back: damping must not go behind it."""
    rendering(flight, "refuse")
    at = flight.view.tick + 50
    for begin, end, stiffness in ((at, at + 100, 0.0), (at + 50, at + 200, 5.0)):
        asked = {**NOTHING, "K": stiffness, "at_tick": begin, "until_tick": end}
        assert flight.ask(cmd="set", ramp_s=0.0, **asked)["ok"]
    refused = flight.ask(cmd="set", active_damping=0.0, at_tick=at + 400)
    assert refused["error"]["guard"]["given"]["K"] == STIFF["K"]
    assert not stiff_without_damping(flight.fly(1500))


def test_an_end_of_another_sign_brings_nothing_back(flight: Flight) -> None:
    enabled(flight, "warn")
    assert flight.ask(cmd="set", K=-20.0)["ok"]
    at = flight.view.tick + 20
    assert flight.ask(cmd="set", K=0.0, at_tick=at, until_tick=at + 400)["ok"]
    flight.fly(50)
    assert flight.ask(cmd="set", K=30.0)["ok"]
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    assert flight.fly(600)["stiffness_n_per_m"][-1] == 30.0


def test_an_end_that_was_cancelled_refuses_nothing(flight: Flight) -> None:
    rendering(flight, "refuse")
    at = flight.view.tick + 50
    assert flight.ask(cmd="set", **NOTHING, ramp_s=0.02, at_tick=at, until_tick=at + 1200)["ok"]
    flight.fly(200)
    for cmd in ("stop", "reset"):
        assert flight.ask(cmd=cmd)["ok"]
        flight.fly(100)
    assert flight.ask(cmd="damping", value="off")["ok"]
