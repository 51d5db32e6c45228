"""The soak in short: what it counts as lost, and what it holds meanwhile."""

from typing import Any

import pytest
import soak_lockstep
from soak import soak

from hapticd.mailbox.servo_side import ServoMailbox


@pytest.mark.process
def test_nothing_is_lost_in_a_short_soak() -> None:
    found = soak(12.0, seed=1, realtime=False, factor=3.0)
    assert not any(found["lost"].values()), found["lost"]
    assert found["failed"] == ["", ""]
    assert found["commands"] > 0
    assert found["subscribers"] > 0
    assert found["counters"]["missing_in"] > 0  # the board was faulty indeed


def test_nothing_is_lost_in_virtual_time() -> None:
    found = soak_lockstep.fly(hours=0.002, seed=1)
    assert not any(found["lost"].values()), found["lost"]
    assert found["ticks"] == 7200
    assert found["ticks_enabled"] > 3600


def test_one_answer_that_does_not_come_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = ServoMailbox.answer

    def lossy(mailbox: ServoMailbox, seq: int, *rest: Any) -> bool:
        return True if seq == 3 else answer(mailbox, seq, *rest)

    monkeypatch.setattr(ServoMailbox, "answer", lossy)
    found = soak_lockstep.fly(hours=0.001, seed=1)
    assert found["unanswered"] == [3]
    assert found["lost"]["commands without an answer"] == 1
