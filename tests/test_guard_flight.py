"""K = 500 N/m, B = 2 N s/m in the hand that shakes them, active damping toggled twenty times: the
desk of the gateway, the guard's judge, the servo, the board and the plant, on virtual time.
"""

from functools import lru_cache
from random import Random
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.whole_tick import SETTLED, Display, Point, gripping, radius

from benchmarks.guard_attack import shipped_judge
from benchmarks.guard_desk import GuardedStack
from benchmarks.guard_flight import (
    GRIPPING,
    SLACK_J,
    Balance,
    plain_servo,
    records,
    rigid_board,
    striking,
)
from hapticd.assembly.lockstep import LockStep
from hapticd.faults import BY_NUMBER
from hapticd.mailbox.layout import State

STIFFNESS = 500.0
DAMPING = 2.0
WORST_HZ = 114.0  # of both, by `whole_tick`: see test_whole_tick
TOGGLES = 20
STRIKES_S = tuple(np.arange(0.4, 12.0, 0.37).tolist())
HELD = ("refuse", "clamp", "follow")
NEAR = 1.5  # a passive display at the edge of its set, little damped, may add so much
SHIPPED = Display(rotor_kg=0.008, rotor_ns_per_m=0.36, delay_periods=0.125)
HAND = gripping(0.3, 3200.0)


class Flight(NamedTuple):
    """What a flight left."""

    replies: list[tuple[str, dict[str, Any], dict[str, Any] | None]]  # asked, reply, later event
    balance: Balance
    records: np.ndarray
    hands: list[dict[str, Any]]


@lru_cache(maxsize=4)
def flight(policy: str, rendered: bool = True) -> Flight:
    """Toggled twenty times at random under `policy`."""
    random = Random("toggles")
    asked = []
    with LockStep(plain_servo(), rigid_board(GRIPPING)) as stack:
        balance = Balance(stack, striking(STRIKES_S))
        desk = GuardedStack(stack, shipped_judge().answer, policy)
        if rendered:
            assert desk.ask(cmd="damping", value=1.74)["ok"]
            desk.run(200)
            assert desk.ask(cmd="set", K=STIFFNESS, B=DAMPING)["ok"]
            desk.run(100)
        assert desk.ask(cmd="enable")["ok"]
        desk.run(400)
        for _ in range(TOGGLES if rendered else 0):
            wanted = random.choice(("on", "off"))
            asked.append((wanted, desk.send(cmd="damping", value=wanted)))
            desk.run(random.randrange(20, 300))
        desk.run(300 if rendered else 4000)
        replies = [(word, desk.replies[number], desk.ended(number)) for word, number in asked]
        hands = [one for one in desk.events if one["kind"] == "guard"]
        return Flight(replies, balance, records(stack), hands)


def passive_m() -> float:
    """How far the hand goes where nothing is rendered."""
    return flight("refuse", rendered=False).balance.furthest_m


def verdict(reply: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = reply["guard"] if reply["ok"] else reply["error"]["guard"]
    return found


def environments(found: np.ndarray) -> list[Point]:
    """What the records say was in force, each once."""
    live = found[found["state"] == State.ENABLED]
    columns = ("stiffness_n_per_m", "damping_ns_per_m", "mass_kg", "damping_effect_ns_per_m")
    scaled = [live["gain"] * live[name] for name in columns[:3]]
    rows = np.stack((*scaled, live[columns[3]]), axis=1)
    return [Point(*row) for row in np.unique(rows.round(6), axis=0).tolist()]


@pytest.mark.parametrize("policy", HELD)
def test_guarded_handle_never_rings(policy: str) -> None:
    """It moves about as far as in the same hand, under the same strikes, with nothing rendered,
    which is passive; nothing is given away at the motor beyond credited damping, 5 mJ and what was
    booked.
    """
    found = flight(policy)
    assert found.balance.furthest_m <= NEAR * passive_m()
    assert found.balance.worst_j <= SLACK_J
    assert found.balance.worst_motion_j <= SLACK_J
    assert set(found.records["state"]) <= {State.DISABLED, State.ENABLED}


@pytest.mark.parametrize("policy", HELD)
def test_recording_holds_nothing_that_the_hand_would_shake(policy: str) -> None:
    points = environments(flight(policy).records)
    assert len(points) > 20  # the ramps are in it
    assert radius(SHIPPED, points).max() <= SETTLED
    assert radius(SHIPPED, points, HAND).max() <= SETTLED


def test_refuse_leaves_everything_as_it_is() -> None:
    found = flight("refuse")
    off = [reply for word, reply, _ in found.replies if word == "off"]
    assert len(off) >= 5
    for reply in off:
        assert reply["error"]["code"] == "guard"
        assert "short at 114 Hz" in reply["error"]["message"]
        assert verdict(reply)["worst_hz"] == pytest.approx(WORST_HZ, rel=0.02)
        assert verdict(reply)["least_damping_ns_per_m"] >= 0.957
    live = found.records[found.records["state"] == State.ENABLED]
    assert np.all(live["damping_effect_ns_per_m"] > 1.739)
    assert set(live["stiffness_n_per_m"]) == {STIFFNESS}


def test_clamp_gives_as_little_damping_as_is_safe() -> None:
    found = flight("clamp")
    first = next(reply for word, reply, _ in found.replies if word == "off")
    assert first["ok"]
    assert verdict(first)["clamped"] is True
    assert "clamped" in verdict(first)["text"]
    given = verdict(first)["given"]["damping"]
    assert 0.957 <= given < 1.74
    assert first["receipt"]["effective"]["damping"] == pytest.approx(given, abs=2e-4)


def test_follow_shrinks_the_environment_before_damping_goes() -> None:
    found = flight("follow")
    _, reply, ended = next(one for one in found.replies if one[0] == "off")
    assert reply["receipt"]["result"] == "staged"
    assert "first the environment" in verdict(reply)["text"]
    assert ended is not None
    assert ended["result"] == "applied"
    live = found.records[found.records["state"] == State.ENABLED]
    falling = live[np.flatnonzero(np.diff(live["damping_effect_ns_per_m"]) < 0.0)[0] + 1]
    assert falling["stiffness_n_per_m"] == pytest.approx(verdict(reply)["given"]["K"])
    assert falling["stiffness_n_per_m"] < STIFFNESS


@pytest.mark.parametrize("policy", [*HELD, "warn"])
def test_every_reply_says_what_was_done_and_why(policy: str) -> None:
    for word, reply, _ in flight(policy).replies:
        if reply["ok"]:
            assert reply["receipt"]["result"] in ("applied", "staged")
        elif reply["error"]["code"] != "guard":
            # after the fault nothing is judged
            assert policy == "warn"
            continue
        said = verdict(reply)
        assert said["policy"] == policy
        assert said["basis"] == "theorem"
        assert said["not_covered"] == ["contact switching", "varying delay"]
        assert "N s/m" in said["text"]
        if word == "off" and said["safe"] is False:
            assert "ask for less, or for more active damping" in said["text"]


def test_warn_names_the_frequency_at_which_it_rings_before_energy_ends_it() -> None:
    found = flight("warn")
    first = next(reply for word, reply, _ in found.replies if word == "off")
    assert first["ok"]
    assert verdict(first)["safe"] is False
    assert "warning" in verdict(first)["text"]
    assert found.balance.worst_j > 10 * SLACK_J
    assert found.balance.furthest_m > 2 * NEAR * passive_m()
    ended = int(np.flatnonzero(found.records["state"] == State.FAULT)[0])
    assert BY_NUMBER[int(found.records["fault"][ended])].code == "energy"
    ringing = found.records["position_m"][ended - 60 : ended]
    crossings = np.flatnonzero(np.diff(np.sign(ringing - ringing.mean())))
    hz = 500.0 * (len(crossings) - 1) / (crossings[-1] - crossings[0])
    assert hz == pytest.approx(verdict(first)["worst_hz"], rel=0.06)


def test_hand_that_would_shake_it_comes_as_an_event() -> None:
    told = flight("refuse").hands
    assert told
    hand = told[0]["hand"]
    assert hand["radius"] > 1.0
    assert told[0]["text"].startswith("a hand that would shake the device: a ")
