"""The guard with the judge it has, in front of the real servo, on virtual time: at every tick of a
change in stages the board reports the damping that the environment in force needs.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.gateway_rig import UNIX_NS, decoded, packed
from support.guard_stub import StubWorker

from hapticd.analysis.judge import Judge
from hapticd.assembly.lockstep import LockStep
from hapticd.assembly.resolve import resolve
from hapticd.gateway.desk import Desk
from hapticd.gateway.guard import Guard
from hapticd.gateway.journal import Journal
from hapticd.gateway.view import Records, ServoView, as_records
from hapticd.mailbox import files
from hapticd.params import GuardParams, GuardSetup, from_plain
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load

LEVEL_NS_PER_M = 1.74
STIFF = {"K": 500.0, "B": 2.0}  # passive with that damping, not without


class Flight:
    """A servo, its simulated board, and the gateway's desk with a judge behind it."""

    def __init__(self) -> None:
        settings = load(None)
        setup = resolve(settings, "flight")[files.GUARD_JSON]
        self.judge = Judge(from_plain(GuardSetup, json.loads(json.dumps(setup))))
        params = servo_params(settings, "flight")
        board = board_params(settings)
        assert board is not None
        self.stack = LockStep(params, board)
        self.worker = StubWorker(self.judge.answer)
        self.view = ServoView(Path(self.stack.mailbox.folder), params, lambda: UNIX_NS)
        self.journal = Journal(lambda: UNIX_NS)
        self.guard = Guard(self.view, self.journal, GuardParams(), self.worker)
        self.desk = Desk(self.view, self.journal, lambda cmd: {}, self.guard)
        self.replies: list[dict[str, Any]] = []
        self.fly(20)

    def fly(self, ticks: int) -> Records:
        """Ticks, each with a pass of the gateway; their records."""
        flown = []
        for _ in range(ticks):
            flown.append(self.stack.run(1))
            now_ns = self.stack.clock.now_ns()
            self.view.refresh(now_ns)
            self.replies += [decoded(reply) for reply in self.desk.collect(now_ns)]
        return as_records(b"".join(flown))

    def ask(self, **fields: Any) -> dict[str, Any]:
        """One request and its reply."""
        found = self.desk.serve([[b"a", packed(**fields)]], self.stack.clock.now_ns())
        self.replies = [decoded(reply) for reply in found]
        while not self.replies:
            self.fly(1)
        (reply,) = self.replies
        return reply

    def ends(self) -> list[str]:
        """How changes in stages ended since the last look."""
        return [one["result"] for one in self.journal.drain() if one["kind"] == "answer"]


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    with flight.stack:
        yield flight
        flight.view.drop()


def rendering(flight: Flight, policy: str) -> None:
    """Force on, a stiff environment, and the damping that it needs."""
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="damping", value=LEVEL_NS_PER_M)["ok"]
    flight.fly(300)
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert flight.ask(cmd="set", **STIFF)["receipt"]["result"] == "applied"
    flight.fly(200)


def moving(records: Records) -> np.ndarray:
    """Ticks in which K or B is not yet, or no longer, that of the stiff environment."""
    return (records["stiffness_n_per_m"] < STIFF["K"]) | (records["damping_ns_per_m"] < STIFF["B"])


@pytest.mark.parametrize("policy", ["refuse", "clamp", "follow"])
def test_damping_is_in_effect_before_stiffness_grows(flight: Flight, policy: str) -> None:
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert flight.ask(cmd="set", **STIFF, damping=LEVEL_NS_PER_M)["receipt"]["result"] == "staged"
    records = flight.fly(400)
    assert flight.ends() == ["applied"]
    grows = records["stiffness_n_per_m"] > 0.0
    assert records["stiffness_n_per_m"][-1] == STIFF["K"]
    assert records["damping_effect_ns_per_m"][grows].min() >= 0.999 * LEVEL_NS_PER_M


def test_warned_change_of_both_lets_damping_rise_first_too(flight: Flight) -> None:
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert flight.ask(cmd="set", **STIFF, damping=LEVEL_NS_PER_M)["receipt"]["result"] == "staged"
    records = flight.fly(400)
    grows = records["stiffness_n_per_m"] > 0.0
    assert records["damping_effect_ns_per_m"][grows].min() >= 0.999 * LEVEL_NS_PER_M


def test_refused_change_moves_nothing(flight: Flight) -> None:
    rendering(flight, "refuse")
    error = flight.ask(cmd="damping", value="off")["error"]
    assert error["guard"]["least_damping_ns_per_m"] is not None
    records = flight.fly(300)
    assert not moving(records).any()
    assert records["damping_effect_ns_per_m"].min() >= 0.999 * LEVEL_NS_PER_M


def test_follow_shrinks_the_environment_before_damping_falls(flight: Flight) -> None:
    rendering(flight, "follow")
    reply = flight.ask(cmd="damping", value="off")
    assert reply["receipt"]["result"] == "staged"
    records = flight.fly(600)
    assert flight.ends() == ["applied"]
    last = records[-1]
    assert (last["damping_effect_ns_per_m"], last["added_damping_ns_per_m"]) == (0.0, 0.0)
    assert 0.0 < last["stiffness_n_per_m"] < STIFF["K"]
    falls = records["damping_effect_ns_per_m"] < 0.999 * LEVEL_NS_PER_M
    assert set(records["stiffness_n_per_m"][falls].tolist()) == {last["stiffness_n_per_m"]}
    given = {name: reply["guard"]["given"][name] for name in ("K", "B", "M")}
    again = flight.ask(cmd="set", **given)
    assert again["guard"]["safe"] is True


def test_clamp_goes_as_far_as_is_safe_and_says_so(flight: Flight) -> None:
    rendering(flight, "clamp")
    asked = 10.0 * STIFF["K"]
    reply = flight.ask(cmd="set", K=asked)
    assert reply["guard"]["clamped"] is True
    found = flight.fly(200)[-1]["stiffness_n_per_m"]
    assert STIFF["K"] < found < asked
    assert found == reply["guard"]["given"]["K"]


def test_unsafe_change_under_warn_is_done_and_told_with_its_frequency(flight: Flight) -> None:
    rendering(flight, "warn")
    reply = flight.ask(cmd="damping", value="off")
    assert (reply["ok"], reply["guard"]["safe"]) == (True, False)
    assert f"{reply['guard']['worst_hz']:.3g} Hz" in reply["guard"]["text"]


def test_auto_damps_when_passivity_needs_it_and_not_otherwise(flight: Flight) -> None:
    assert flight.ask(cmd="guard", policy="refuse", mode="auto")["ok"]
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert flight.fly(1)[-1]["added_damping_ns_per_m"] == 0.0
    assert flight.ask(cmd="set", **STIFF)["ok"]
    records = flight.fly(600)
    grows = records["stiffness_n_per_m"] > 0.0
    level = records[-1]["added_damping_ns_per_m"]
    assert 0.0 < level < LEVEL_NS_PER_M
    assert records["damping_effect_ns_per_m"][grows].min() >= 0.999 * level
    assert flight.ask(cmd="set", K=20, B=0)["ok"]
    assert flight.fly(1500)[-1]["added_damping_ns_per_m"] == 0.0


def test_stop_in_the_middle_of_a_change_cancels_the_rest(flight: Flight) -> None:
    rendering(flight, "follow")
    flight.ask(cmd="damping", value="off")
    assert flight.ask(cmd="stop")["state"] == "stopped"
    flight.fly(100)
    assert flight.ends() == ["cancelled"]
    assert flight.fly(1)[-1]["added_damping_asked_ns_per_m"] > 0.0


def test_toggled_damping_never_outruns_the_environment(flight: Flight) -> None:
    """Each request supersedes the one before, wherever its way stands."""
    rendering(flight, "follow")
    pauses = np.random.default_rng(7).integers(5, 250, 20).tolist()
    flown = []
    for place, pause in enumerate(pauses):
        flight.ask(cmd="damping", value="off" if place % 2 == 0 else "on")
        flown.append(flight.fly(pause))
    for record in np.concatenate(flown)[::7]:
        level = float(record["damping_effect_ns_per_m"])
        bare = {"wall": {"side": 0}, "M": 0.0, "damping": level}
        now = bare | {
            "K": float(record["stiffness_n_per_m"]),
            "B": float(record["damping_ns_per_m"]),
        }
        question = {
            "ask": "look",
            "now": now,
            "target": now,
            "delay_periods": None,
            "margin_ns_per_m": 0.0,
            "basis": "theorem",
            "level_on": level,
        }
        assert flight.judge.answer(question)["verdict"]["safe"] is True, now
