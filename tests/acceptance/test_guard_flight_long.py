"""K = 500 N/m, B = 2 N s/m in the hand that shakes them, active damping toggled twenty times: the
command server of the gateway, the guard's judge, the servo, the board and the plant, on virtual
time.
"""

import pytest
from support.guard_flight import HELD, NEAR, flight, passive_m, verdict

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
