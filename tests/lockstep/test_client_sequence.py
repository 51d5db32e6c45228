"""Sequences: looked through as a whole before anything is sent, scheduled by ticks of the servo,
with one receipt a step; how they end early. Virtual time, a whole gateway, the stand-in servo.
"""

import asyncio
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.gateway_rig import GatewayRig, decoded, packed, running
from support.guard_stub import StubWorker, stage, verdict

from hapticd.client import AsyncClient, Client, SequenceError, Step, StepReceipt, step
from hapticd.client.sequence import LEAD_S, Ask, AtRefusal, Pause, exchange
from hapticd.client.telemetry import accepted
from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.gateway import server
from hapticd.mailbox.layout import State

RATE_HZ = 1000
SEEN = 5  # ticks: the gateway looks once in so many


@pytest.fixture
def folder(runtime: Path) -> Path:
    return runtime / "hapticd"


class Script:
    """A client whose clock is the servo's: it steps the rig while it waits for a reply or pauses,
    and notes the tick at which it asked.
    """

    def __init__(self, rig: GatewayRig) -> None:
        self.rig = rig
        self.socket = rig.client()
        self.asked: list[tuple[int, str, dict[str, Any]]] = []
        self.lost: Callable[[], int] = lambda: 0  # slots, so far
        self.before: Callable[[str, dict[str, Any]], HapticdError | None] = lambda cmd, fields: None

    def run(self, *steps: Step, at_refusal: AtRefusal = "disable") -> tuple[StepReceipt, ...]:
        under_way = exchange(steps, at_refusal, "script")
        answer: Any = None
        while True:
            try:
                due = under_way.send(answer)
            except StopIteration as end:
                return tuple(end.value)
            answer = self._pause(due) if isinstance(due, Pause) else self._ask(due)

    def _pause(self, due: Pause) -> None:
        for _ in range(round(due.seconds * RATE_HZ / SEEN)):
            self.rig.step(SEEN)

    def _ask(self, due: Ask) -> Any:
        if due.cmd not in ("hello", "status"):
            self.asked.append((self.rig.servo.ticks, due.cmd, dict(due.fields)))
        if error := self.before(due.cmd, dict(due.fields)):
            return error
        fields = {"cmd": due.cmd, "id": len(self.asked), **due.fields}
        try:
            self.socket.send(packed(**fields))
            reply = accepted(decoded(self.rig.receive(self.socket, ticks=1)))
            if due.cmd == "status":
                reply["result"]["slot"] += self.lost()
            return reply
        except (CommandError, DaemonDown) as error:
            return error


@pytest.fixture
def script(folder: Path) -> Iterator[Script]:
    with GatewayRig(folder) as rig:
        yield Script(rig)


def changes(script: Script) -> list[str]:
    return [cmd for _, cmd, _ in script.asked]


# --- what is done ---------------------------------------------------------------------------------


def test_steps_act_in_their_order_and_have_a_receipt_each(script: Script) -> None:
    done = script.run(step("set", K=200, B=1), step("enable"), step("damping", value=0.5))
    assert [one.result for one in done] == ["applied"] * 3
    assert [one.revision for one in done] == [1, 2, 3]
    assert 0 < done[0].tick < done[1].tick < done[2].tick
    assert script.rig.servo.state is State.ENABLED


def test_a_timed_change_acts_at_exactly_its_tick(script: Script) -> None:
    first, second, third = script.run(
        step("enable"), step("set", K=200, after_s=0.5), step("damping", value="on", after_s=0.25)
    )
    assert second.tick == first.tick + 500
    assert third.tick == second.tick + 250
    assert [one.result for one in (first, second, third)] == ["applied"] * 3


def test_a_change_is_scheduled_shortly_before_its_tick_and_no_sooner(script: Script) -> None:
    at = script.rig.servo.ticks + 3000
    (only,) = script.run(step("set", K=200, at_tick=at))
    ((asked, _, fields),) = script.asked
    assert fields["at_tick"] == only.tick == at
    assert 0.3 * LEAD_S * RATE_HZ < at - asked <= LEAD_S * RATE_HZ


def test_what_the_protocol_does_not_time_is_sent_once_its_tick_has_come(script: Script) -> None:
    at = script.rig.servo.ticks + 400
    enabled, played = script.run(
        step("enable", at_tick=at), step("perturb", action="stop", after_s=0.3)
    )
    assert at <= enabled.tick <= at + 150
    assert played.tick >= enabled.tick + 300
    assert all("at_tick" not in fields for _, _, fields in script.asked)


def test_slots_that_the_servo_lost_do_not_delay_a_step(script: Script) -> None:
    """`at_tick` is the slot which that tick has if none is lost from now on."""
    script.lost = lambda: 100 if script.asked and script.asked[0][0] + 200 < ticks() else 0

    def ticks() -> int:
        return script.rig.servo.ticks

    first, second = script.run(step("enable"), step("set", K=200, after_s=1.0))
    assert second.tick == first.tick + 900


def waiting_for_damping(asked: dict[str, Any]) -> dict[str, Any]:
    """A guard that lets stiffness and force go once the board reports half a newton second per
    metre.
    """
    change = asked.get("change", {})
    waits = "K" in change or asked.get("enable")
    stages = [stage(change, at_least=0.5 if waits else None)]
    return {"action": "apply", "stages": stages, "verdict": verdict()}


@pytest.fixture
def guarded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Script]:
    """With a board whose damping is there 50 ms after the last change was asked for."""
    monkeypatch.setattr(server, "Worker", lambda *_: StubWorker(waiting_for_damping))
    with GatewayRig(folder, start_worker=lambda line: pytest.fail("a process")) as rig:
        script = Script(rig)

        def rise(cmd: str, fields: dict[str, Any]) -> None:
            since = script.asked[-1][0] if script.asked else 0
            rig.servo.effect = 1.0 if rig.servo.ticks > since + 50 else 0.0

        script.before = rise
        yield script


def test_a_change_that_waits_for_its_damping_and_is_then_scheduled_acts_at_its_tick(
    guarded: Script,
) -> None:
    on, stiff, off = guarded.run(
        step("damping", value="on"), step("set", K=300, after_s=1.0), step("disable", after_s=0.2)
    )
    assert [one.result for one in (on, stiff, off)] == ["applied"] * 3
    assert stiff.tick == on.tick + 1000
    assert off.tick >= stiff.tick + 200


def test_force_that_waits_for_its_damping_comes_on_and_the_sequence_goes_on(
    guarded: Script,
) -> None:
    assert guarded.rig.ask(guarded.socket, cmd="guard", policy="refuse")["ok"]
    on, force, soft = guarded.run(
        step("damping", value="on"), step("enable"), step("set", B=1, after_s=0.2)
    )
    assert [one.result for one in (on, force, soft)] == ["applied"] * 3
    assert force.tick > on.tick + 50
    assert soft.tick == force.tick + 200


# --- what is refused before anything is sent ------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (step("set", active_damping=9), r"step 2: active_damping = 9 N s/m: .*limit 0\.\.2 N s/m"),
        (step("set", k=9), "step 2: k: unknown field, did you mean 'K'"),
        (step("dance"), "step 2: 'dance' is not a step of a sequence"),
        (step("perturb", action="load", samples_n=[0.0]), "step 2: .* `perturb_load`"),
        (
            step("perturb", action="start"),
            "step 2: perturb action=start needs enabled, .* disabled",
        ),
        (step("set", K=1, at_tick=1), "step 2: at_tick = 1: that tick, .* comes at"),
        (step("set", K=1, at_tick=10**6, after_s=1.0), "step 2: .* a step has one time"),
        (step("set", K=1, after_s=-1.0), r"step 2: after_s = -1.0: a time in seconds, 0 or more"),
        (step("set", K=1, after_s=float("nan")), "step 2: after_s = nan"),
    ],
)
def test_one_step_that_cannot_be_done_and_nothing_is_sent(
    script: Script, wrong: Step, said: str
) -> None:
    with pytest.raises(CommandError, match=f"nothing was sent: {said}") as caught:
        script.run(step("set", K=200), wrong, step("disable"))
    assert caught.value.code == "invalid"
    assert not isinstance(caught.value, SequenceError)
    assert script.asked == []


def test_every_wrong_step_is_named_at_once(script: Script) -> None:
    with pytest.raises(CommandError) as caught:
        script.run(step("set", active_damping=9), step("enable"), step("zero"))
    assert [item["loc"] for item in caught.value.detail] == ["step 1", "step 3"]  # type: ignore[attr-defined]


def test_states_are_followed_from_step_to_step(script: Script) -> None:
    done = script.run(step("enable"), step("stop"), step("reset"), step("zero"), step("enable"))
    assert all(one.acted for one in done)


@pytest.mark.parametrize("lead_s", [0.0, -1.0, 11.0, float("nan")])
def test_a_lead_that_cannot_be_kept_is_refused(lead_s: float) -> None:
    with pytest.raises(CommandError, match=r"lead_s = .*: outside 0\.\.10 s; leave it out"):
        next(exchange([step("enable")], "disable", "script", lead_s))


# --- how it ends early ----------------------------------------------------------------------------


def refuse_third(cmd: str, fields: dict[str, Any]) -> HapticdError | None:
    return CommandError("refused", "not now; later") if fields.get("K") == 3 else None


@pytest.mark.parametrize(
    ("at_refusal", "state"),
    [("disable", State.DISABLED), ("stop", State.STOPPED), ("hold", State.ENABLED)],
)
def test_refusal_says_which_steps_acted_and_leaves_the_display_as_asked(
    script: Script, at_refusal: AtRefusal, state: State
) -> None:
    script.before = refuse_third
    with pytest.raises(SequenceError) as caught:
        script.run(
            step("enable"),
            step("set", K=2),
            step("set", K=3),
            step("set", K=4),
            at_refusal=at_refusal,
        )
    error = caught.value
    assert [one.result for one in error.receipts] == ["applied", "applied", "refused", "not sent"]
    assert error.receipts[2].text == "not now; later"
    assert str(error).startswith("step 3 of 4 (set K=3): not now; later; steps that acted: 1, 2,")
    assert "did not act: 3, 4; " in str(error)
    assert (error.code, error.state) == ("refused", state.name.lower())
    assert script.rig.servo.state is state
    after = ["set"] if at_refusal == "hold" else ["set", at_refusal]
    assert changes(script)[2:] == after


def test_a_fault_between_two_steps_ends_it(script: Script) -> None:
    def fault(cmd: str, fields: dict[str, Any]) -> None:
        if script.asked and script.rig.servo.ticks > script.asked[0][0] + 300:
            script.rig.servo.state = State.FAULT

    script.before = fault
    with pytest.raises(SequenceError, match="the servo is 'fault' and not 'enabled'") as caught:
        script.run(step("enable"), step("disable", after_s=2.0))
    assert [one.result for one in caught.value.receipts] == ["applied", "not sent"]
    assert caught.value.state == "fault"
    assert script.rig.servo.ticks < 1000  # and not after two seconds


def test_a_scheduled_step_that_is_cancelled_did_not_act(script: Script) -> None:
    other = script.rig.client()

    def lease(cmd: str, fields: dict[str, Any]) -> None:
        if changes(script) == ["set", "set"] and cmd == "status" and not taken:
            taken.append(script.rig.ask(other, cmd="lease", what="environment", take_over=True))

    taken: list[Any] = []
    script.before = lease
    with pytest.raises(SequenceError, match="the lease of another client came first") as caught:
        script.run(step("set", K=1), step("set", K=2, after_s=0.4), step("set", K=3, after_s=0.4))
    assert taken[0]["ok"]
    assert [one.result for one in caught.value.receipts] == ["applied", "cancelled", "not sent"]
    assert script.rig.servo.values[2] != 2.0


def test_a_lost_daemon_is_stopped_and_said_to_be_unknown(script: Script) -> None:
    def lost(cmd: str, fields: dict[str, Any]) -> HapticdError | None:
        gone = "enable" in changes(script) and cmd in ("set", "status")
        return DaemonDown("no reply within 2 s") if gone else None

    script.before = lost
    with pytest.raises(SequenceError, match="stop was asked for, the servo is 'unknown'") as caught:
        script.run(step("enable"), step("set", K=2))
    assert caught.value.code == "servo_down"
    assert isinstance(caught.value.__cause__, DaemonDown)
    assert script.rig.servo.state is State.STOPPED
    assert script.asked[-1][1] == "stop"


def test_a_step_whose_reply_was_lost_is_open_and_not_denied(script: Script) -> None:
    def lost(cmd: str, fields: dict[str, Any]) -> HapticdError | None:
        return DaemonDown("no reply within 2 s") if cmd == "enable" else None

    script.before = lost
    with pytest.raises(SequenceError, match="steps that acted: 1, open: 2;") as caught:
        script.run(step("set", K=2), step("enable"))
    assert caught.value.receipts[1].result == "unknown"


def test_how_it_ended_travels_between_processes() -> None:
    error = SequenceError("refused", "step 1", (StepReceipt(step("enable")),), "disabled")
    again = pickle.loads(pickle.dumps(error))
    assert (again.code, str(again), again.receipts, again.state) == (
        "refused",
        "step 1",
        error.receipts,
        "disabled",
    )


# --- by the clients -------------------------------------------------------------------------------

STEPS = (step("set", K=200, B=1), step("enable"), step("damping", value=0.5), step("stop"))


@pytest.fixture
def patient(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GatewayRig]:
    for module in ("client", "aio"):  # a busy machine is no reason to press the page
        monkeypatch.setattr(f"hapticd.client.{module}.STOP_TIMEOUT_S", 10.0)
    with GatewayRig(folder) as rig, running(rig):
        yield rig


def test_the_client_that_waits_does_a_sequence(patient: GatewayRig) -> None:
    with Client(name="test", timeout_s=10.0) as device:
        done = device.sequence(STEPS)
        assert [one.result for one in done] == ["applied"] * 4
        assert [one.revision for one in done] == [1, 2, 3, 4]
        with pytest.raises(CommandError, match=r"step 1: enable needs .*the servo is stopped"):
            device.sequence([step("enable")])


def test_the_client_of_asyncio_awaits_the_same(patient: GatewayRig) -> None:
    async def main() -> tuple[StepReceipt, ...]:
        async with AsyncClient(name="test", timeout_s=10.0) as device:
            return await device.sequence(STEPS)

    assert [one.revision for one in asyncio.run(main())] == [1, 2, 3, 4]


@pytest.mark.usefixtures("runtime")
def test_no_daemon_and_nothing_is_begun() -> None:
    with Client(timeout_s=0.1) as device, pytest.raises(DaemonDown, match="no daemon runs there"):
        device.sequence(STEPS)
