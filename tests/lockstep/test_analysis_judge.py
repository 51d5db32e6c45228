"""The way of a change: its order, what is judged of it, and what each policy makes of it."""

from typing import Any

import numpy as np
import pytest
from support.guard_device import FREE, change, rigid, rigid_judge, setup_of, shipped_judge

from hapticd.core.errors import ConfigError
from hapticd.guard import policies
from hapticd.guard.judge import Judge
from hapticd.guard.safe_region import doubling_text
from hapticd.guard.transition_planner import POINTS
from hapticd.model.coupled import coupled_radius, destabilising_hand

LEVEL = 1.74
DAMPED = {"active_damping": LEVEL}
STIFF = {"K": 150.0, "B": 1.0, "active_damping": LEVEL}  # safe with damping, not without


def stages_of(answer: dict[str, Any]) -> list[dict[str, Any]]:
    return [stage["change"] for stage in answer["stages"]]


def test_damping_rises_before_stiffness_grows() -> None:
    answer = change(shipped_judge(), {"K": 150.0, "B": 1.0, "active_damping": LEVEL})
    assert answer["action"] == "stage"
    assert stages_of(answer) == [{"active_damping": LEVEL}, {"K": 150.0, "B": 1.0}]
    least = answer["stages"][1]["active_damping_at_least"]
    assert LEVEL - 2e-4 < least < LEVEL


def test_stiffness_shrinks_before_damping_falls() -> None:
    answer = change(shipped_judge(), {"K": 10.0, "B": 0.1, "active_damping": 0.0}, now=STIFF)
    assert answer["action"] == "stage"
    assert stages_of(answer) == [{"K": 10.0, "B": 0.1}, {"active_damping": 0.0}]
    assert answer["stages"][1]["after_ramps"]


@pytest.mark.parametrize("policy", ["refuse", "clamp", "follow"])
def test_what_is_not_safe_is_refused_with_reason_and_remedy(policy: str) -> None:
    answer = change(shipped_judge(), {"K": -10.0}, policy=policy)
    assert answer["action"] == "refuse"
    assert answer["stages"] == []
    assert answer["verdict"]["safe"] is False
    assert "ask for" in answer["verdict"]["text"]


def test_warn_does_as_asked_and_tells() -> None:
    answer = change(shipped_judge(), {"K": 500.0, "B": 2.0}, policy="warn")
    assert answer["action"] == "apply"
    assert stages_of(answer) == [{"K": 500.0, "B": 2.0}]
    assert answer["verdict"]["safe"] is False
    assert answer["verdict"]["text"].startswith("warning")
    assert answer["verdict"]["worst_hz"] == pytest.approx(46.0, abs=3.0)


def test_off_judges_nothing() -> None:
    answer = change(shipped_judge(), {"K": 500.0, "B": 2.0}, policy="off")
    assert answer["action"] == "apply"
    assert answer["verdict"]["safe"] is None


def test_clamp_goes_as_far_as_the_first_exit() -> None:
    judge = shipped_judge()
    answer = change(judge, {"K": 500.0}, policy="clamp")
    assert answer["action"] == "apply"
    given = answer["verdict"]["given"]["K"]
    end = change(judge, {}, now={"K": 20.0})["verdict"]["allowed"]["K"][1]
    assert given == pytest.approx(end, rel=0.01)
    assert answer["verdict"]["clamped"]
    assert change(judge, {"K": given})["verdict"]["safe"]
    assert not change(judge, {"K": 1.02 * given})["verdict"]["safe"]


def test_what_a_clamp_leaves_is_judged_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clamp that is too generous gives nothing."""
    monkeypatch.setattr(policies, "_largest", lambda holds, shares: 0.9)
    answer = change(shipped_judge(), {"K": 500.0}, policy="clamp")
    assert answer["action"] == "refuse"
    assert "not safe either" in answer["verdict"]["text"]


def test_the_margin_asked_for_is_left() -> None:
    """Of 2 N s/m a stiffness K takes K T / 2: with 0.5 to be left, K = 3,000 N/m is the end."""
    judge = rigid_judge()
    verdict = change(judge, {}, margin_ns_per_m=0.5)["verdict"]
    assert verdict["allowed"]["K"][1] == pytest.approx(3000.0, rel=2e-3)
    assert change(judge, {"K": 3100.0}, margin_ns_per_m=0.5)["action"] == "refuse"
    assert change(judge, {"K": 3100.0})["action"] == "apply"


def test_clamp_from_outside_is_refused() -> None:
    answer = change(shipped_judge(), {"K": 900.0}, policy="clamp", now={"K": 600.0})
    assert answer["action"] == "refuse"
    assert "outside the safe set already" in answer["verdict"]["text"]


def test_filters_are_not_clamped() -> None:
    filters = {"velocity_hz": 30.0, "acceleration_hz": 20.0}
    answer = change(shipped_judge(), {"filters": filters}, policy="clamp", now={"B": 0.9})
    assert answer["action"] == "refuse"
    assert "filters" in answer["verdict"]["text"]


def test_follow_shrinks_the_environment_before_damping_falls() -> None:
    judge = shipped_judge()
    answer = change(judge, {"active_damping": 0.0}, policy="follow", now=STIFF)
    assert answer["action"] == "stage"
    first, second = stages_of(answer)
    assert second == {"active_damping": 0.0}
    assert answer["stages"][1]["after_ramps"]
    assert 0.0 < first["K"] < STIFF["K"]
    assert first["B"] / first["K"] == pytest.approx(STIFF["B"] / STIFF["K"])
    assert change(judge, {}, now=first)["verdict"]["safe"]


def test_less_damping_is_refused_while_it_is_needed() -> None:
    answer = change(shipped_judge(), {"active_damping": 0.0}, now=STIFF)
    assert answer["action"] == "refuse"
    assert answer["verdict"]["least_active_damping_ns_per_m"] == pytest.approx(10.0 / 14.0)


def test_contact_with_the_wall_is_judged() -> None:
    wall = {
        "stiffness_n_per_m": 800.0,
        "virtual_damping_ns_per_m": 0.0,
        "position_m": 0.01,
        "side": 1,
    }
    answer = change(shipped_judge(), {"wall": wall})
    assert answer["action"] == "refuse"
    verdict = answer["verdict"]
    assert verdict["margin_ns_per_m"] > 0.0
    assert verdict["contact"]["margin_ns_per_m"] < 0.0 or verdict["contact"]["radius"] >= 1.0
    assert "wall" in verdict["text"]
    assert change(shipped_judge(), {"wall": wall | {"side": 0}})["action"] == "apply"


def test_a_wall_that_goes_keeps_its_strength_until_it_is_gone() -> None:
    """K = 900 N/m is safe, and a wall of 280 N/m is; K grows while the wall goes, and both act."""
    judge = rigid_judge(0.5)
    wall = {
        "stiffness_n_per_m": 280.0,
        "virtual_damping_ns_per_m": 0.0,
        "position_m": 0.01,
        "side": 1,
    }
    gone = {"side": 0, "stiffness_n_per_m": 0.0}
    assert change(judge, {"K": 900.0})["action"] == "apply"
    assert change(judge, {"wall": gone}, now={"wall": wall})["action"] == "apply"
    answer = change(judge, {"K": 900.0, "wall": gone}, now={"wall": wall})
    assert stages_of(answer) != [{"K": 900.0, "wall": gone}]


def test_a_wall_that_comes_meets_what_is_still_in_force() -> None:
    """Its side is there at once: K = 740 N/m and a wall of 280 N/m are too much together on a
    device that withstands 1,000 N/m, though K is on its way to 0.
    """
    judge = rigid_judge(0.5)
    wall = {
        "stiffness_n_per_m": 280.0,
        "virtual_damping_ns_per_m": 0.0,
        "position_m": 0.01,
        "side": 0,
    }
    now = {"K": 740.0, "wall": wall}
    assert change(judge, {"wall": {"side": 1}}, now=now | {"K": 700.0})["action"] == "apply"
    answer = change(judge, {"K": 0.0, "wall": {"side": 1}}, now=now)
    assert stages_of(answer) == [{"K": 0.0}, {"wall": {"side": 1}}]
    assert answer["stages"][1]["after_ramps"]


def test_delay_that_was_measured_replaces_the_models() -> None:
    judge = rigid_judge()
    short = change(judge, {"B": 1.5}, delay_periods=0.0)["verdict"]
    late = change(judge, {"B": 1.5}, delay_periods=2.0)["verdict"]
    assert late["margin_ns_per_m"] < short["margin_ns_per_m"] - 0.1
    assert late["delay_periods"] == 2.0
    unknown = change(judge, {"B": 1.5})["verdict"]
    assert unknown["delay_periods"] == 0.0  # the model's own


def test_a_way_through_an_unsafe_point_is_not_taken() -> None:
    """Both ends are safe; with K growing before M has fallen the point between is not."""
    judge = shipped_judge()
    now = {"K": 5.0, "B": 0.9}
    target = {"K": 5.0, "B": 0.0, "M": 0.0}
    moving = change(judge, {"K": 60.0}, now=now, target=target)
    assert moving["action"] == "stage"
    assert moving["stages"][0]["after_ramps"]
    still = change(judge, {"K": 60.0}, now=target)
    assert still["action"] == "apply"


def test_enable_judges_the_whole_gain_ramp() -> None:
    answer = change(shipped_judge(), {}, enable=True, state="disabled", now={"K": 500.0, "B": 2.0})
    assert answer["action"] == "refuse"
    answer = change(shipped_judge(), {}, enable=True, state="disabled", now={"K": 20.0})
    assert answer["action"] == "apply"
    assert 1 < answer["verdict"]["path_points"] <= POINTS


def test_enable_waits_for_damping_that_is_asked_but_not_reported() -> None:
    now = STIFF | {"active_damping": 0.2}
    answer = change(shipped_judge(), {}, enable=True, state="disabled", now=now, target=STIFF)
    assert answer["action"] == "stage"
    assert answer["stages"][0]["active_damping_at_least"] == pytest.approx(LEVEL, abs=2e-4)


def test_enable_in_mode_auto_asks_for_damping_first() -> None:
    now = {"K": 150.0, "B": 1.0}
    answer = change(shipped_judge(), {}, enable=True, state="disabled", now=now, mode="auto")
    assert answer["action"] == "stage"
    first, second = answer["stages"]
    assert first["change"]["active_damping"] > 0.0
    assert first["active_damping_at_least"] is None
    assert second["change"] == {}
    assert second["active_damping_at_least"] == pytest.approx(
        first["change"]["active_damping"], abs=2e-4
    )


def test_a_gain_that_still_rises_spans_a_patch_with_the_change() -> None:
    """B at a tenth of its gain does not carry a K that is there in full."""
    judge = rigid_judge(0.5)
    now = {"K": 500.0, "B": -0.3, "M": 0.05}
    whole = change(judge, {"K": 600.0}, now=now)
    part = change(judge, {"K": 600.0}, now=now, gain=0.1)
    assert whole["verdict"]["path_points"] == POINTS
    assert part["verdict"]["path_points"] == 16  # four by four


def test_what_moves_while_the_gain_rises_may_act_in_full() -> None:
    """The gain is there long before B has gone."""
    now = {"K": 60.0, "B": 0.9, "active_damping": LEVEL}
    target = now | {"B": 0.0}
    asked = {"now": now, "target": target, "gain": 0.4}
    (stage,) = change(shipped_judge(), {"active_damping": 0.0}, **asked)["stages"]
    assert stage["after_ramps"]


def test_scheduled_changes_before_and_after_are_judged() -> None:
    judge = shipped_judge()
    before = change(judge, {"B": 0.9}, before=[{"K": 60.0}])
    after = change(judge, {"B": 0.9}, after=[{"K": 60.0}])
    assert change(judge, {"B": 0.9})["action"] == "apply"
    assert before["action"] == after["action"] == "refuse"


def test_damping_that_is_scheduled_to_go_is_judged_under_what_it_carries() -> None:
    """No environment changes then, only the level: the way of the later change shows it."""
    judge = shipped_judge()
    now = {"K": 150.0, "B": 1.0, "active_damping": 3.0}
    assert change(judge, {"active_damping": 2.5}, now=now)["action"] == "apply"
    assert (
        change(judge, {"active_damping": 2.5}, now=now, after=[{"active_damping": 0.0}])["action"]
        == "refuse"
    )


def test_a_safer_point_may_be_gone_to_from_outside() -> None:
    answer = change(shipped_judge(), {"K": 300.0}, now={"K": 500.0, "B": 2.0})
    assert answer["action"] == "apply"
    assert "safer" in answer["verdict"]["text"]
    worse = change(shipped_judge(), {"K": 700.0}, now={"K": 500.0, "B": 2.0})
    assert worse["action"] == "refuse"


@pytest.mark.parametrize("policy", ["refuse", "clamp", "follow"])
def test_a_device_without_a_model_is_unknown_and_refused(policy: str) -> None:
    answer = change(Judge(setup_of(None)), {"K": 1.0}, policy=policy)
    assert answer["action"] == "refuse"
    assert answer["verdict"]["safe"] is None
    assert answer["verdict"]["basis"] == "unknown"


def test_warn_without_a_model_does_it_and_says_unknown() -> None:
    asked = {"K": 100.0, "active_damping": 1.0}
    answer = change(Judge(setup_of(None)), asked, policy="warn")
    assert stages_of(answer) == [{"active_damping": 1.0}, {"K": 100.0}]
    assert answer["verdict"]["safe"] is None
    assert "unknown" in answer["verdict"]["text"]


def test_auto_takes_the_least_level_that_will_do() -> None:
    judge = shipped_judge()
    answer = change(judge, {"K": 150.0, "B": 1.0}, mode="auto")
    levels = list(judge.verdicts.levels)
    chosen = stages_of(answer)[0]["active_damping"]
    below = levels[levels.index(chosen) - 1]
    assert change(judge, {"K": 150.0, "B": 1.0}, now={"active_damping": chosen})["verdict"]["safe"]
    assert not change(judge, {"K": 150.0, "B": 1.0}, now={"active_damping": below})["verdict"][
        "safe"
    ]


def test_auto_does_not_go_down_for_a_hair() -> None:
    """At the end of what a level holds a little less stiffness keeps the level, much less does
    not.
    """
    judge = shipped_judge()
    levels = list(judge.verdicts.levels)
    low, level = levels[0], levels[1]
    end = change(judge, {}, now={"active_damping": low})["verdict"]["allowed"]["K"][1]
    now = {"K": 1.02 * end, "active_damping": level}
    just_inside = change(judge, {"K": 0.98 * end}, now=now, mode="auto")
    assert stages_of(just_inside) == [{"K": 0.98 * end}]
    far_inside = change(judge, {"K": 0.3 * end}, now=now, mode="auto")
    assert stages_of(far_inside) == [{"K": 0.3 * end}, {"active_damping": low}]


def test_level_is_bounded_by_the_ceiling() -> None:
    judge = Judge(setup_of(rigid(), ceiling=3.0))
    answer = change(judge, {}, mode="level", level=50.0)
    assert stages_of(answer) == [{"active_damping": 3.0}]


def test_a_number_that_is_not_finite_is_an_error() -> None:
    with pytest.raises(ConfigError, match="finite"):
        change(shipped_judge(), {"K": float("nan")})


def test_growth_is_told_by_the_time_in_which_it_doubles() -> None:
    """What each tick of 1 ms multiplies by 2^(1/40) doubles in 40 ms."""
    assert doubling_text(2.0 ** (1 / 40), 1000.0) == "doubles in 40 ms"
    assert doubling_text(2.0 ** (1 / 5000), 1000.0) == "doubles in 5 s"
    assert doubling_text(1.0, 1000.0) == "does not die out"
    verdict = change(shipped_judge(), {"K": 2000.0, "B": 5.0}, policy="warn")["verdict"]
    assert verdict["radius"] > 1.0
    ticks = np.log(2.0) / np.log(verdict["radius"])
    assert f"its motion doubles in {ticks:.3g} ms" in verdict["text"]


def test_hand_is_put_into_words() -> None:
    display = FREE | {"K": 150.0, "B": 1.0}
    asked = {"ask": "hand", "n": 3, "environment": display, "delay_periods": None}
    hand = shipped_judge().answer(asked)["hand"]
    assert hand["radius"] > 1.0
    assert hand["text"].startswith(("a mass of", "a spring of"))
    assert hand["growth"] == f"its motion {doubling_text(hand['radius'], 1000.0)}"
    assert f"{hand['hz']:.3g} Hz" in hand["text"]
    safe = shipped_judge().answer(asked | {"environment": FREE})
    assert safe == {"n": 3, "hand": None}


def test_hand_that_is_named_shakes_harder_than_the_one_where_growth_was_guessed() -> None:
    display = FREE | {"K": 500.0, "B": 2.0}
    judge = shipped_judge()
    asked = {"ask": "hand", "n": 3, "environment": display, "delay_periods": None}
    hand = judge.answer(asked)["hand"]
    verdict = change(judge, {"K": 500.0, "B": 2.0}, policy="warn")["verdict"]
    assert hand["hz"] == pytest.approx(verdict["worst_hz"], rel=0.01)
    assert judge.theorem is not None
    model = judge.theorem.late(judge.theorem.model.delay_periods)
    guessed, _ = destabilising_hand(model, (500.0, 2.0, 0.0)) or pytest.fail("no hand")
    weaker = coupled_radius(model, np.array([[500.0, 2.0, 0.0]]), [guessed])[0, 0]
    assert hand["radius"] > weaker > 1.0


@pytest.mark.parametrize(("scheduled", "side"), [(15, 1), (16, 1), (21, 0), (40, 0)])
def test_more_changes_scheduled_than_points_are_refused_with_the_reason(
    scheduled: int, side: int
) -> None:
    wall = {"stiffness_n_per_m": 10.0, "side": side}
    after = [{"K": 1.0 + place, "wall": wall} for place in range(scheduled)]
    answer = change(rigid_judge(), {"K": 1.0}, after=after)
    assert answer["action"] == "refuse"
    assert f"more than {POINTS} points" in answer["verdict"]["text"]


def test_look_says_what_the_delay_costs_of_stiffness() -> None:
    """Of b = 0.36 N s/m: 2 b / T without a delay, and the closed form of docs/timing.md with it."""
    judge = Judge(setup_of(rigid(0.36), ceiling=1.0))
    asked = {"ask": "look", "n": 1, "target": FREE, "level_on": 1.0, "margin_ns_per_m": 0.0}
    found = judge.answer(asked | {"basis": "measured", "delay_periods": 0.6875})["timing"]
    assert (found["delay_periods"], found["ideal_delay_periods"]) == (0.6875, 0.0)
    for name, physical in (("without_active_damping", 0.36), ("with_active_damping", 1.36)):
        cost = found[name]
        closed = 2e3 * physical / (0.5 + 0.6875 + np.sqrt(0.25 + 2.0 * 0.6875))
        assert cost["stiffness_n_per_m"] == pytest.approx(closed, rel=2e-3)
        assert cost["ideal_stiffness_n_per_m"] == pytest.approx(2e3 * physical, rel=2e-3)
        assert cost["lost_share"] == pytest.approx(1.0 - closed / (2e3 * physical), abs=2e-3)
    assert found["with_active_damping"]["level_ns_per_m"] == 1.0


def test_delay_costs_nothing_that_is_known_without_a_model() -> None:
    asked = {"ask": "look", "n": 1, "target": FREE, "level_on": 1.0, "margin_ns_per_m": 0.0}
    judge = Judge(setup_of(None))
    assert judge.answer(asked | {"basis": "theorem", "delay_periods": 0.5})["timing"] is None
