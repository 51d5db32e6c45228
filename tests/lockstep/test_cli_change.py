"""An enable in stages from the command line, which waits for the last of them: the enable would end
with the connection that asked for it.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.gateway_rig import GatewayRig, running
from support.guard_stub import StubWorker, stage, verdict

from hapticd.cli import change
from hapticd.cli.app import main
from hapticd.client import Client
from hapticd.gateway import server
from hapticd.mailbox.layout import State, Value

Polls = Callable[[Callable[[], None]], list[float]]


def staged(asked: dict[str, Any]) -> dict[str, Any]:
    """Damping first; force once the board reports it."""
    stages = [stage({"active_damping": 1.5}), stage({}, at_least=1.5)]
    return {"action": "stage", "stages": stages, "verdict": verdict()}


@pytest.fixture
def rig(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GatewayRig]:
    monkeypatch.setattr(server, "Worker", lambda *_: StubWorker(staged))
    with (
        GatewayRig(runtime / "hapticd", start_worker=lambda line: pytest.fail("a process")) as rig,
        running(rig),
        Client(timeout_s=10.0) as client,
    ):
        rig.servo.effect = 0.0  # the damping does not come
        client.guard("refuse")
        yield rig


@pytest.fixture
def polls(monkeypatch: pytest.MonkeyPatch) -> Polls:
    """Has `meanwhile` done at the first wait for the end of the stages; a wait takes `POLL_S` of a
    clock that nothing else moves.
    """

    def replace(meanwhile: Callable[[], None]) -> list[float]:
        waits: list[float] = []

        def sleep(seconds: float) -> None:
            waits.append(seconds)
            if len(waits) == 1:
                meanwhile()

        clock = SimpleNamespace(sleep=sleep, monotonic=lambda: sum(waits))
        monkeypatch.setattr(change, "time", clock)
        return waits

    return replace


def test_enable_in_stages_is_waited_for_and_told_with_its_last_receipt(
    rig: GatewayRig, polls: Polls, capsys: pytest.CaptureFixture[str]
) -> None:
    def damping_comes() -> None:
        assert rig.servo.state is State.DISABLED
        rig.servo.effect = 1.5

    waits = polls(damping_comes)
    assert main(["enable"]) == 0
    assert waits
    assert rig.servo.state is State.ENABLED
    assert rig.servo.values[Value.ACTIVE_DAMPING] == 1.5
    assert capsys.readouterr().out.startswith("enabled: applied at tick")


def test_enable_in_stages_that_is_cancelled_is_refused_with_the_reason(
    rig: GatewayRig, polls: Polls, capsys: pytest.CaptureFixture[str]
) -> None:
    def another_disables() -> None:
        with Client(timeout_s=10.0) as other:
            other.disable()

    polls(another_disables)
    assert main(["enable"]) != 0
    rig.servo.effect = 1.5
    error = " ".join(capsys.readouterr().err.split())
    assert "enable: cancelled: disable was asked meanwhile" in error
    assert rig.servo.state is State.DISABLED


def test_enable_in_stages_is_not_waited_for_without_end(
    rig: GatewayRig,
    polls: Polls,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def servo_stands() -> None:
        rig.servo_stands = True  # and with it the time of the gateway

    monkeypatch.setattr(change, "POLL_S", 5.0)
    waits = polls(servo_stands)
    assert main(["enable"]) != 0
    assert sum(waits) == pytest.approx(change.STAGED_S, abs=2 * change.POLL_S)
    assert "no end of the stages within 60 s" in " ".join(capsys.readouterr().err.split())
