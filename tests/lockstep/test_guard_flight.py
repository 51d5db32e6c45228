"""K = 500 N/m, B = 2 N s/m in the hand that shakes them, active damping toggled twenty times: the
command server of the gateway, the guard's judge, the servo, the board and the plant, on virtual
time.
"""

import numpy as np
import pytest
from support.guard_flight import STIFFNESS, flight, verdict

from hapticd.mailbox.layout import State

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
