"""K = 500 N/m, B = 2 N s/m in the hand that shakes them, active damping toggled twenty times: the
command server of the gateway, the guard's judge, the servo, the board and the plant, on virtual
time.
"""

import numpy as np
import pytest
from support.guard_flight import HELD, NEAR, STIFFNESS, flight, passive_m, verdict

from benchmarks.guard_flight import (
    SLACK_J,
)
from hapticd.mailbox.layout import State


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


def test_hand_that_would_shake_it_comes_as_an_event() -> None:
    told = flight("refuse").hands
    assert told
    hand = told[0]["hand"]
    assert hand["radius"] > 1.0
    assert told[0]["text"].startswith("a hand that would shake the device: a ")


WORST_HZ = 114.0  # of both, by `whole_tick`: see test_whole_tick


def test_refuse_leaves_everything_as_it_is() -> None:
    found = flight("refuse")
    off = [reply for word, reply, _ in found.replies if word == "off"]
    assert len(off) >= 5
    for reply in off:
        assert reply["error"]["code"] == "guard"
        assert "short at 114 Hz" in reply["error"]["message"]
        assert verdict(reply)["worst_hz"] == pytest.approx(WORST_HZ, rel=0.02)
        assert verdict(reply)["least_active_damping_ns_per_m"] >= 0.957
    live = found.records[found.records["state"] == State.ENABLED]
    assert np.all(live["active_damping_effect_ns_per_m"] > 1.739)
    assert set(live["stiffness_n_per_m"]) == {STIFFNESS}


def test_clamp_gives_as_little_damping_as_is_safe() -> None:
    found = flight("clamp")
    first = next(reply for word, reply, _ in found.replies if word == "off")
    assert first["ok"]
    assert verdict(first)["clamped"] is True
    assert "clamped" in verdict(first)["text"]
    given = verdict(first)["given"]["active_damping"]
    assert 0.957 <= given < 1.74
    assert first["receipt"]["effective"]["active_damping"] == pytest.approx(given, abs=2e-4)


def test_follow_shrinks_the_environment_before_damping_goes() -> None:
    found = flight("follow")
    _, reply, ended = next(one for one in found.replies if one[0] == "off")
    assert reply["receipt"]["result"] == "staged"
    assert "first the environment" in verdict(reply)["text"]
    assert ended is not None
    assert ended["result"] == "applied"
    live = found.records[found.records["state"] == State.ENABLED]
    falling = live[np.flatnonzero(np.diff(live["active_damping_effect_ns_per_m"]) < 0.0)[0] + 1]
    assert falling["stiffness_n_per_m"] == pytest.approx(verdict(reply)["given"]["K"])
    assert falling["stiffness_n_per_m"] < STIFFNESS
