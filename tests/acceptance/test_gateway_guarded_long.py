"""Requests past the guard on virtual time: judged, staged, refused, too late, taken back."""

from pathlib import Path

import pytest
from support.gateway_rig import CommandServerRig, packed
from support.guard_stub import StubWorker, stage, verdict
from test_gateway_guarded import later, under

from hapticd.mailbox.layout import Flag, Value


@pytest.fixture
def worker() -> StubWorker:
    return StubWorker()


@pytest.fixture
def rig(tmp_path: Path, worker: StubWorker) -> CommandServerRig:
    return CommandServerRig(tmp_path, worker)


def test_worker_that_answers_nothing_for_ten_seconds_is_ended(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """Not at once: one that sees a delay for the first time takes long, and keeps what it found."""
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    later(rig, 10_000)
    assert worker.given_up == []
    later(rig, 5)
    assert worker.given_up == ["no answer within 10 s"]
    assert len(worker.asked) == 1


def test_worker_owes_nothing_that_the_one_before_was_asked(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """Else the new one would be ended, 10 s after a question that it never saw."""
    worker.silent = True
    rig.send(packed(cmd="set", K=1))
    later(rig, 510)
    assert rig.guard.owes_verdict
    worker.life += 1
    worker.silent = False
    later(rig, 2)
    assert not rig.guard.owes_verdict
    assert rig.ask(cmd="set", K=2)["guard"]["safe"] is True
    later(rig, 10_000)
    assert worker.given_up == []


def test_auto_takes_nothing_back_from_the_energy_controller(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    level = {"action": "apply", "stages": [stage({"active_damping": 0.7})], "verdict": verdict()}
    worker.script = lambda asked: level if asked["ask"] == "change" else None
    rig.ask(cmd="damping", value="auto")
    for _ in range(60):
        rig.run(100)
    rig.servo.flags = int(Flag.CONTROLLED)
    rig.servo.values[Value.ACTIVE_DAMPING] = 10.0
    rig.servo.values[Value.ENVIRONMENT_REVISION] += 1
    asked = len(worker.changes)
    for _ in range(60):
        rig.run(100)
    assert rig.servo.values[Value.ACTIVE_DAMPING] == 10.0
    assert len(worker.changes) == asked
    rig.servo.flags = 0  # a change has asked anew
    for _ in range(60):
        rig.run(100)
    assert len(worker.changes) > asked
