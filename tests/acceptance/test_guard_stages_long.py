"""The guard with the judge it has, in front of the real servo, on virtual time: at every tick of a
change in stages the board reports the damping that the environment in force needs.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from support.guard_stages import LEVEL_NS_PER_M, STIFF, Flight, rendering

from hapticd.core.arrays import Records


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    with flight.stack:
        yield flight
        flight.view.drop()


def test_toggled_damping_never_outruns_the_environment(flight: Flight) -> None:
    """Each request supersedes the one before, wherever its way stands."""
    rendering(flight, "follow")
    pauses = np.random.default_rng(7).integers(5, 250, 20).tolist()
    flown = []
    for place, pause in enumerate(pauses):
        flight.ask(cmd="damping", value="off" if place % 2 == 0 else "on")
        flown.append(flight.fly(pause))
    for record in np.concatenate(flown)[::7]:
        level = float(record["active_damping_effect_ns_per_m"])
        bare = {"wall": {"side": 0}, "M": 0.0, "active_damping": level}
        now = bare | {
            "K": float(record["stiffness_n_per_m"]),
            "B": float(record["virtual_damping_ns_per_m"]),
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


def moving(records: Records) -> np.ndarray:
    """Ticks in which K or B is not yet, or no longer, that of the stiff environment."""
    return (records["stiffness_n_per_m"] < STIFF["K"]) | (
        records["virtual_damping_ns_per_m"] < STIFF["B"]
    )


@pytest.mark.parametrize("policy", ["refuse", "clamp", "follow"])
def test_damping_is_in_effect_before_stiffness_grows(flight: Flight, policy: str) -> None:
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert (
        flight.ask(cmd="set", **STIFF, active_damping=LEVEL_NS_PER_M)["receipt"]["result"]
        == "staged"
    )
    records = flight.fly(400)
    assert flight.ends() == ["applied"]
    grows = records["stiffness_n_per_m"] > 0.0
    assert records["stiffness_n_per_m"][-1] == STIFF["K"]
    assert records["active_damping_effect_ns_per_m"][grows].min() >= 0.999 * LEVEL_NS_PER_M


def test_warned_change_of_both_lets_damping_rise_first_too(flight: Flight) -> None:
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert (
        flight.ask(cmd="set", **STIFF, active_damping=LEVEL_NS_PER_M)["receipt"]["result"]
        == "staged"
    )
    records = flight.fly(400)
    grows = records["stiffness_n_per_m"] > 0.0
    assert records["active_damping_effect_ns_per_m"][grows].min() >= 0.999 * LEVEL_NS_PER_M


def test_refused_change_moves_nothing(flight: Flight) -> None:
    rendering(flight, "refuse")
    error = flight.ask(cmd="damping", value="off")["error"]
    assert error["guard"]["least_active_damping_ns_per_m"] is not None
    records = flight.fly(300)
    assert not moving(records).any()
    assert records["active_damping_effect_ns_per_m"].min() >= 0.999 * LEVEL_NS_PER_M


def test_follow_shrinks_the_environment_before_damping_falls(flight: Flight) -> None:
    rendering(flight, "follow")
    reply = flight.ask(cmd="damping", value="off")
    assert reply["receipt"]["result"] == "staged"
    records = flight.fly(600)
    assert flight.ends() == ["applied"]
    last = records[-1]
    assert (last["active_damping_effect_ns_per_m"], last["active_damping_ns_per_m"]) == (0.0, 0.0)
    assert 0.0 < last["stiffness_n_per_m"] < STIFF["K"]
    falls = records["active_damping_effect_ns_per_m"] < 0.999 * LEVEL_NS_PER_M
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
    assert flight.fly(1)[-1]["active_damping_ns_per_m"] == 0.0
    assert flight.ask(cmd="set", **STIFF)["ok"]
    records = flight.fly(600)
    grows = records["stiffness_n_per_m"] > 0.0
    level = records[-1]["active_damping_ns_per_m"]
    assert 0.0 < level < LEVEL_NS_PER_M
    assert records["active_damping_effect_ns_per_m"][grows].min() >= 0.999 * level
    assert flight.ask(cmd="set", K=20, B=0)["ok"]
    assert flight.fly(1500)[-1]["active_damping_ns_per_m"] == 0.0


def test_stop_in_the_middle_of_a_change_cancels_the_rest(flight: Flight) -> None:
    rendering(flight, "follow")
    flight.ask(cmd="damping", value="off")
    assert flight.ask(cmd="stop")["state"] == "stopped"
    flight.fly(100)
    assert flight.ends() == ["cancelled"]
    assert flight.fly(1)[-1]["active_damping_asked_ns_per_m"] > 0.0
