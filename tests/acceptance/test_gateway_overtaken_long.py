"""What was cancelled, overtaken or judged without force does not come into force: the command
server, with the guard's judge, in front of the servo itself, on virtual time.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from support.guard_stages import LEVEL_NS_PER_M, STIFF, Flight, rendering
from test_gateway_overtaken import enabled, send, until_posted

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


@pytest.mark.parametrize("policy", ["warn", "refuse"])
def test_a_client_that_fails_ends_the_stages_after_the_one_with_the_servo(
    flight: Flight, policy: str
) -> None:
    enabled(flight, policy)
    assert flight.ask(cmd="lease", what="environment", at_end="zero")["ok"]
    flight.fly(5)
    send(flight, {"cmd": "set", **STIFF, "active_damping": LEVEL_NS_PER_M})
    until_posted(flight)
    send(flight, {"cmd": "lease", "what": "environment", "action": "fail"})
    assert not flight.fly(500)["stiffness_n_per_m"].any()


def test_a_client_that_fails_ends_its_stages_of_what_it_has_not_leased(flight: Flight) -> None:
    """The servo has taken the stage of the active damping, and no lease ends that of K."""
    enabled(flight, "refuse")
    assert flight.ask(cmd="lease", what="active_damping", at_end="hold")["ok"]
    flight.fly(5)
    send(flight, {"cmd": "set", **STIFF, "active_damping": LEVEL_NS_PER_M})
    until_posted(flight)
    flight.fly(5)
    send(flight, {"cmd": "lease", "what": "active_damping", "action": "fail"})
    assert not flight.fly(500)["stiffness_n_per_m"].any()


def test_an_end_of_a_former_gateway_brings_nothing_back_later(flight: Flight) -> None:
    """It would weaken what is rendered when the gateway is replaced, but not at its tick."""
    enabled(flight, "refuse")
    assert flight.ask(cmd="set", K=20.0)["ok"]
    at = flight.view.tick + 20
    assert flight.ask(cmd="set", K=30.0, ramp_s=0.0, at_tick=at, until_tick=at + 1500)["ok"]
    flight.fly(50)
    flight.another_gateway()
    flight.fly(650)
    assert flight.ask(cmd="set", K=0.0)["ok"]
    assert flight.fly(1200)["stiffness_n_per_m"][-1] == 0.0


@pytest.mark.parametrize("policy", ["off", "warn"])
@pytest.mark.parametrize("other", [{}, {"cmd": "damping", "value": "off"}])
def test_an_end_of_a_strict_client_raises_nothing_once_another_has_changed_what_it_was_judged_for(
    flight: Flight, policy: str, other: dict[str, Any]
) -> None:
    rendering(flight, policy)
    at = flight.view.tick + 50
    bounded = {**NOTHING, "ramp_s": 0.0, "at_tick": at, "until_tick": at + 700}
    assert flight.ask(cmd="set", **bounded, strict=True)["ok"]
    flight.fly(200)
    send(flight, *filter(None, [other]), client=b"b")
    records = flight.fly(1000)
    assert not stiff_without_damping(records)
    assert records["stiffness_n_per_m"][-1] == (0.0 if other else STIFF["K"])


def test_an_end_that_a_new_gateway_does_not_know_takes_no_damping_away_later(
    flight: Flight,
) -> None:
    enabled(flight, "refuse")
    at = flight.view.tick + 20
    bounded = {"active_damping": LEVEL_NS_PER_M, "at_tick": at, "until_tick": at + 2000}
    assert flight.ask(cmd="set", **bounded)["ok"]
    flight.fly(100)
    flight.another_gateway()
    flight.fly(700)
    flight.ask(cmd="set", **STIFF)
    assert not stiff_without_damping(flight.fly(2500))


def test_an_end_that_nobody_judged_brings_no_strength_back_later(flight: Flight) -> None:
    """It would weaken what is rendered when the policy is strict again, but not at its tick."""
    rendering(flight, "refuse")
    assert flight.ask(cmd="lease", what="measuring")["ok"]
    at = flight.view.tick + 50
    asked = {"K": STIFF["K"] + 5.0, "ramp_s": 0.0, "at_tick": at, "until_tick": at + 1500}
    assert flight.ask(cmd="set", **asked)["receipt"]["result"] == "scheduled"
    flight.fly(100)
    assert flight.ask(cmd="lease", what="measuring", action="release")["ok"]
    flight.fly(5)
    assert flight.ask(cmd="set", **NOTHING)["ok"]
    flight.fly(100)
    assert flight.ask(cmd="damping", value="off")["ok"]
    assert not stiff_without_damping(flight.fly(2000))


def test_force_0_is_not_refused_for_what_an_end_brings_back_and_the_end_does_not_come(
    flight: Flight,
) -> None:
    """The end was judged before its damping went, under a lease of measuring."""
    rendering(flight, "refuse")
    at = flight.view.tick + 50
    asked = {"K": STIFF["K"] + 5.0, "ramp_s": 0.0, "at_tick": at, "until_tick": at + 1000}
    assert flight.ask(cmd="set", **asked)["ok"]
    flight.fly(100)
    assert flight.ask(cmd="lease", what="measuring")["ok"]
    assert flight.ask(cmd="set", K=STIFF["K"] + 20.0, ramp_s=0.0)["ok"]
    assert flight.ask(cmd="damping", value="off")["ok"]
    assert flight.ask(cmd="lease", what="measuring", action="release")["ok"]
    flight.fly(5)
    assert flight.ask(cmd="set", **NOTHING)["ok"]
    flight.fly(100)
    assert not stiff_without_damping(flight.fly(1000))


def test_terms_of_a_new_gateway_are_never_those_of_a_former_one(flight: Flight) -> None:
    """The former one has had more terms than milliseconds."""
    former = set()
    for _ in range(500):
        for policy in ("clamp", "refuse"):
            assert flight.ask(cmd="guard", policy=policy)["ok"]
            former.add(flight.guard.terms_number)
    assert len(former) == 1000
    flight.another_gateway()
    for policy in ("clamp", "refuse") * 50:
        flight.fly(1)
        assert flight.ask(cmd="guard", policy=policy)["ok"]
        assert flight.guard.terms_number not in former


@pytest.mark.parametrize("late", [False, True])
def test_the_end_of_a_change_that_begins_as_it_is_taken_is_judged_too(
    flight: Flight, late: bool
) -> None:
    """Its tick is that in which the servo takes it, so that it is never scheduled."""
    rendering(flight, "refuse")
    at = flight.view.tick + 50
    send(flight, {"cmd": "set", **NOTHING, "ramp_s": 0.0, "at_tick": at, "until_tick": at + 900})
    until_posted(flight)
    if late:
        take = flight.stack.mailbox.take
        flight.stack.mailbox.take = lambda: None  # type: ignore[method-assign]
        flight.stack.run(at - flight.view.tick - 1)
        flight.stack.mailbox.take = take  # type: ignore[method-assign]
    flight.fly(200)
    assert flight.replies[0]["receipt"]["result"] == ("applied" if late else "scheduled")
    assert flight.guard.in_force.target().empty
    assert "error" in flight.ask(cmd="damping", value="off")
    assert not stiff_without_damping(flight.fly(1500))
