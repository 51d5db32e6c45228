"""Requests past the guard on virtual time: judged, staged, refused, too late, taken back."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.gateway_rig import CommandServerRig, decoded, packed
from support.gateway_stand_in import StandInServo
from support.guard_stub import StubWorker, applies, refuses, stage, verdict

from hapticd.guard.status import MOST_RECORDS
from hapticd.guard.terms import WallSide
from hapticd.mailbox.layout import Command, Flag, State, Value

BOUND = 1 << Value.ENVIRONMENT_REVISION


@pytest.fixture
def worker() -> StubWorker:
    return StubWorker()


@pytest.fixture
def rig(tmp_path: Path, worker: StubWorker) -> CommandServerRig:
    return CommandServerRig(tmp_path, worker)


def under(rig: CommandServerRig, policy: str) -> CommandServerRig:
    """`rig` under `policy`, after as many records as a strict one wants to have seen."""
    rig.run(max(0, MOST_RECORDS - rig.view.seen))
    assert rig.ask(cmd="guard", policy=policy)["result"]["policy"] == policy
    return rig


def later(rig: CommandServerRig, ticks: int = 5) -> list[dict[str, Any]]:
    """Replies of the next ticks."""
    return [decoded(reply) for _ in range(ticks) for reply in rig.run()]


def answers(rig: CommandServerRig) -> list[dict[str, Any]]:
    """Events of kind answer since the last look."""
    return [event for event in rig.journal.drain() if event["kind"] == "answer"]


def two_stages(request: dict[str, Any]) -> dict[str, Any]:
    """Damping first, then K."""
    stages = [stage({"active_damping": 1.5}), stage({"K": 400.0}, at_least=1.5)]
    return {"action": "stage", "stages": stages, "verdict": verdict()}


# --- judged ---------------------------------------------------------------------------------------


def test_without_a_worker_warn_goes_on_at_once_and_says_unknown(tmp_path: Path) -> None:
    rig = CommandServerRig(tmp_path)
    reply = rig.ask(cmd="set", K=100)
    assert reply["ok"]
    assert (reply["guard"]["safe"], reply["guard"]["basis"]) == (None, "unknown")
    assert "there is no guard worker" in reply["guard"]["text"]


@pytest.mark.parametrize("policy", ["clamp", "refuse", "follow"])
def test_without_a_worker_nothing_unjudged_is_done_under(tmp_path: Path, policy: str) -> None:
    rig = under(CommandServerRig(tmp_path), policy)
    for asked in ({"cmd": "set", "K": 1}, {"cmd": "damping", "value": "off"}, {"cmd": "enable"}):
        error = rig.ask(**asked)["error"]
        assert error["code"] == "guard"
        assert error["guard"]["safe"] is None
        assert "`hapticd guard warn`" in error["message"]
    assert rig.servo.taken == []
    assert rig.ask(cmd="disable")["ok"]


def test_question_holds_what_is_in_force_and_what_is_asked(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="set", K=50, B=2, active_damping=1.0)
    rig.ask(cmd="set", K=80, wall={"side": 1}, ramp_s=0.3)
    asked = worker.changes[-1]
    assert (asked["target"]["K"], asked["target"]["B"], asked["target"]["active_damping"]) == (
        50,
        2,
        1,
    )
    assert asked["change"] == {"K": 80, "wall": {"side": 1}}
    assert (asked["ramp_s"], asked["state"], asked["enable"]) == (0.3, "disabled", False)
    assert (asked["policy"], asked["basis"], asked["mode"], asked["level"]) == (
        "warn", "theorem", "off", 1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "change"),
    [
        ("on", {"active_damping": 1.0}),
        ("off", {"active_damping": 0.0}),
        (0.5, {"active_damping": 0.5}),
    ],
)
def test_damping_is_asked_for_as_a_number(
    rig: CommandServerRig, worker: StubWorker, value: object, change: dict[str, float]
) -> None:
    rig.ask(cmd="set", active_damping=1.0)
    rig.ask(cmd="damping", value=value)
    assert worker.changes[-1]["change"] == change


def test_what_changes_no_environment_is_not_asked(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="set", limit_cycle_faults=False)
    rig.ask(cmd="zero")
    rig.ask(cmd="stop")
    assert worker.asked == []


def test_verdict_comes_with_the_receipt(rig: CommandServerRig) -> None:
    reply = rig.ask(cmd="set", K=100)
    assert reply["receipt"]["effective"]["K"] == 100
    assert (reply["guard"]["safe"], reply["guard"]["text"]) == (True, "fine")


def test_refusal_carries_the_verdict_and_nothing_moves(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = refuses
    error = under(rig, "refuse").ask(cmd="damping", value="off")["error"]
    assert (error["code"], error["message"]) == ("guard", "damping: it would ring")
    assert error["guard"]["safe"] is False
    assert rig.servo.taken == []


def test_hand_follows_as_an_event(rig: CommandServerRig, worker: StubWorker) -> None:
    found = {"text": "a mass of 120 g, at 34 Hz", "mass_kg": 0.12, "hz": 34.0, "radius": 1.01}
    found["growth"] = "its motion doubles in 70 ms"
    worker.script = lambda asked: {"hand": found} if asked["ask"] == "hand" else refuses(asked)
    error = under(rig, "refuse").ask(cmd="set", id=9, K=100)["error"]
    later(rig, 2)
    (event,) = [one for one in rig.journal.drain() if one["kind"] == "guard"]
    assert (event["id"], event["cmd"], event["number"]) == (9, "set", error["guard"]["number"])
    assert (event["code"], event["hand"]) == ("hand", found)
    assert event["text"] == (
        "a hand that would shake the device: a mass of 120 g, at 34 Hz; its motion doubles in 70 ms"
    )
    assert worker.asked[-1]["environment"]["K"] == 100


@pytest.mark.parametrize("policy", ["off", "warn"])
def test_change_is_not_bound_under(rig: CommandServerRig, policy: str) -> None:
    under(rig, policy)
    rig.servo.deaf = True
    rig.send(packed(cmd="set", K=100))
    rig.look()
    rig.look()
    command = rig.servo.mailbox.take()
    assert command is not None
    assert not int(command[-1][Value.MASK]) & BOUND


@pytest.mark.parametrize("policy", ["clamp", "refuse", "follow"])
@pytest.mark.parametrize("asked", [{"cmd": "set", "K": 100}, {"cmd": "enable"}])
def test_change_is_bound_to_the_environment_it_was_judged_for_under(
    rig: CommandServerRig, policy: str, asked: dict[str, Any]
) -> None:
    rig.ask(cmd="set", K=1)
    under(rig, policy)
    rig.servo.deaf = True
    rig.send(packed(**asked))
    rig.look()
    rig.look()
    commands = [rig.servo.mailbox.take() for _ in range(2)]
    assert commands[0] is not None
    assert commands[0][1] == Command.TERMS
    command = commands[1]
    assert command is not None
    assert int(command[-1][Value.MASK]) & BOUND
    assert command[-1][Value.TERMS] == commands[0][-1][Value.TERMS]
    assert command[-1][Value.ENVIRONMENT_REVISION] == 1


def test_clamped_values_are_what_is_posted(rig: CommandServerRig, worker: StubWorker) -> None:
    under(rig, "clamp")
    clamped = {"action": "apply", "stages": [stage({"K": 70.0})], "verdict": verdict(clamped=True)}
    worker.script = lambda asked: clamped
    assert rig.ask(cmd="set", K=100)["receipt"]["effective"]["K"] == 70


def test_if_rev_is_compared_again_after_the_verdict(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=5, if_rev=0))
    rig.run()
    rig.servo.revision = 3  # another's change, past this gateway
    rig.run()
    worker.said.append({**applies(worker.changes[-1]), "n": worker.changes[-1]["n"]})
    (reply,) = later(rig)
    assert reply["error"]["code"] == "refused_revision"
    assert "the revision is 3 by now, not 0" in reply["error"]["message"]
    assert rig.servo.taken == []


def test_warned_change_is_in_force_before_its_verdict_and_told_with_it(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """A verdict that changes nothing delays nothing but the reply."""
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    assert later(rig, 50) == []
    assert rig.servo.values[Value.STIFFNESS] == 100
    (asked,) = worker.changes
    assert asked["target"]["K"] == 0
    worker.said.append({**refuses(asked), "n": asked["n"]})
    (reply,) = later(rig)
    assert (reply["receipt"]["first_tick"], reply["guard"]["safe"]) == (2, False)


def test_warned_change_waits_for_no_look(rig: CommandServerRig, worker: StubWorker) -> None:
    """A look takes some 10 ms, twice a second while what is rendered changes."""
    worker.silent = True
    looking(rig)
    assert [one["ask"] for one in worker.asked] == ["look"]
    rig.send(packed(cmd="set", K=100))
    later(rig, 2)
    assert rig.servo.values[Value.STIFFNESS] == 100
    look, change = worker.asked
    worker.said = [{**looked(look), "n": look["n"]}, {**refuses(change), "n": change["n"]}]
    (reply,) = later(rig)
    assert (reply["guard"]["safe"], reply["guard"]["text"]) == (False, "it would ring")


def test_warned_change_waits_for_no_hand(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.script = lambda asked: None if asked["ask"] == "hand" else refuses(asked)
    rig.ask(cmd="set", K=100)
    rig.run(2)
    assert worker.asked[-1]["ask"] == "hand"
    rig.send(packed(cmd="set", K=200))
    later(rig, 2)
    assert rig.servo.values[Value.STIFFNESS] == 200


def test_change_that_is_passive_in_stages_alone_is_warned_about_when_done_at_once(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = two_stages
    reply = rig.ask(cmd="set", K=400, B=1)
    assert reply["receipt"]["result"] == "applied"
    assert (reply["ok"], reply["guard"]["safe"]) == (True, False)
    assert "only in stages" in reply["guard"]["text"]


def test_servo_that_ends_while_a_verdict_is_awaited_ends_the_request(
    rig: CommandServerRig, worker: StubWorker, tmp_path: Path
) -> None:
    worker.silent = True
    rig.send(packed(cmd="set", K=1, id=1))
    later(rig, 5)
    rig.servo.mailbox.close()
    rig.servo = StandInServo(tmp_path, rig.clock)
    rig.clock.time_ns += 200_000_000
    (reply,) = [decoded(one) for one in rig.run(2)]
    assert (reply["id"], reply["error"]["code"]) == (1, "servo_down")


# --- the worker fails -----------------------------------------------------------------------------


def test_no_verdict_within_half_a_second_refuses(rig: CommandServerRig, worker: StubWorker) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    assert later(rig, 500) == []
    (reply,) = later(rig)
    assert (reply["error"]["code"], reply["error"]["guard"]["basis"]) == ("guard", "unknown")
    assert "gave no verdict within 0.5 s" in reply["error"]["message"]
    assert rig.servo.taken == []


def test_worker_that_still_computes_is_not_asked_more(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """What nobody waits for any more would only be computed before what somebody waits for."""
    worker.silent = True
    for number in range(3):
        rig.send(packed(cmd="set", K=number))
        later(rig, 510)
    (first,) = worker.changes
    rig.send(packed(cmd="set", K=7))
    later(rig, 100)
    worker.silent = False
    worker.said.append({**applies(first), "n": first["n"]})
    (reply,) = later(rig)
    assert (reply["receipt"]["effective"]["K"], reply["guard"]["safe"]) == (7, True)


def test_delay_counts_once_the_worker_has_looked_at_it(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = lambda asked: looked(asked) if asked["ask"] == "look" else applies(asked)
    rig.guard.delay.periods = 0.25
    looking(rig)
    rig.guard.delay.periods = 0.5
    rig.ask(cmd="set", K=1)
    assert worker.changes[-1]["delay_periods"] == 0.25
    looking(rig)
    assert worker.asked[-1]["delay_periods"] == 0.5
    rig.ask(cmd="set", K=2)
    assert worker.changes[-1]["delay_periods"] == 0.5
    worker.script = applies  # it answers no more looks
    rig.guard.delay.periods = 0.75
    rig.run(2)
    rig.run(5100)
    rig.ask(cmd="set", K=3)
    assert worker.changes[-1]["delay_periods"] == 0.75


def test_delay_that_a_dead_worker_had_looked_at_does_not_count_for_the_next(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """It has computed nothing for that delay, so nothing speaks against the newest."""
    worker.script = lambda asked: looked(asked) if asked["ask"] == "look" else applies(asked)
    rig.guard.delay.periods = 0.25
    looking(rig)
    rig.guard.delay.periods = 0.5
    rig.ask(cmd="set", K=1)
    assert worker.changes[-1]["delay_periods"] == 0.25
    worker.life += 1
    rig.run()
    rig.ask(cmd="set", K=2)
    assert worker.changes[-1]["delay_periods"] == 0.5


def test_no_verdict_within_half_a_second_goes_on_under_warn(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    assert later(rig, 499) == []
    (reply,) = later(rig)
    assert reply["receipt"]["effective"]["K"] == 100
    assert reply["guard"]["safe"] is None


def test_worker_that_dies_in_the_middle_of_a_request_refuses_it(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    later(rig, 2)
    worker.state = "down"
    (reply,) = later(rig)
    assert reply["error"]["code"] == "guard"


@pytest.mark.parametrize(
    "garbage",
    [
        {},
        {"error": "KeyError"},
        {"action": "apply", "verdict": verdict()},
        {"action": "apply", "stages": [{"change": {"K": "much"}}], "verdict": verdict()},
        {"action": "apply", "stages": [{"change": {"force": 1.0}}], "verdict": verdict()},
        {"action": "apply", "stages": [{}], "verdict": verdict()},
        {"action": "apply", "stages": [[]], "verdict": verdict()},
        {"action": "apply", "stages": 7, "verdict": verdict()},
        {"action": "apply", "stages": [{"change": {"K": {}}}], "verdict": verdict()},
        {"action": "apply", "stages": [{"change": {"wall": 3}}], "verdict": verdict()},
        {"action": "apply", "stages": [stage({"K": 1.0})], "verdict": "fine"},
        {"action": ["apply"], "stages": [stage({"K": 1.0})], "verdict": verdict()},
        {"action": "fire", "stages": [stage({"K": 1.0})], "verdict": verdict()},
    ],
)
def test_garbage_is_no_verdict(
    rig: CommandServerRig, worker: StubWorker, garbage: dict[str, Any]
) -> None:
    under(rig, "refuse")
    worker.script = lambda asked: garbage
    error = rig.ask(cmd="set", K=100)["error"]
    assert (error["code"], error["guard"]["safe"]) == ("guard", None)
    assert rig.servo.taken == []


def test_late_answer_belongs_to_no_question(rig: CommandServerRig, worker: StubWorker) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    later(rig, 510)
    old = worker.changes[0]
    worker.state = "up"
    rig.send(packed(cmd="set", K=3))
    later(rig, 2)
    worker.said.append({**applies(old), "n": old["n"]})
    assert later(rig) == []
    assert rig.servo.taken == []


def test_change_of_policy_voids_a_verdict_on_its_way(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "clamp")
    worker.silent = True
    rig.send(packed(cmd="set", K=100))
    later(rig, 2)
    worker.script = refuses
    worker.silent = False
    under(rig, "refuse")
    first = worker.changes[0]
    worker.said.append({**applies(first), "n": first["n"]})
    (reply,) = later(rig)
    assert reply["error"]["code"] == "guard"
    assert [one["policy"] for one in worker.changes] == ["clamp", "refuse"]


def test_other_terms_void_a_verdict_on_its_way_to_a_strict_client(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "warn")
    worker.silent = True
    assert rig.send(packed(cmd="set", K=10, strict=True)) == []
    later(rig, 2)
    rig.ask(cmd="guard", margin_ns_per_m=0.5)
    worker.silent = False
    worker.script = refuses
    (first,) = worker.changes
    worker.said.append({**applies(first), "n": first["n"]})
    (reply,) = later(rig)
    assert reply["error"]["code"] == "guard"
    asked = [(one["policy"], one["margin_ns_per_m"]) for one in worker.changes]
    assert asked == [("refuse", 0.0), ("refuse", 0.5)]


# --- others, meanwhile ----------------------------------------------------------------------------


def test_stop_waits_for_no_verdict(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.silent = True
    rig.send(*[packed(cmd="set", K=k) for k in range(60)])
    (reply, *_) = [*rig.send(packed(cmd="stop"), client=b"b"), *later(rig, 1)]
    assert reply["ok"]
    assert rig.view.state is State.STOPPED


@pytest.mark.parametrize("cmd", ["stop", "disable"])
def test_enable_does_not_come_after_what_was_asked_after_it(
    rig: CommandServerRig, worker: StubWorker, cmd: str
) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="enable", id=1))
    later(rig, 2)
    rig.send(packed(cmd=cmd, id=2))
    replies = {reply["id"]: reply for reply in later(rig)}
    assert replies[2]["ok"]
    assert replies[1]["error"]["code"] == "refused"
    assert f"{cmd} was asked before it was judged" in replies[1]["error"]["message"]
    worker.said += [{**applies(one), "n": one["n"]} for one in worker.changes]
    assert later(rig) == []
    assert Command.ENABLE not in [kind for kind, _ in rig.servo.taken]


@pytest.mark.parametrize("cmd", ["stop", "disable"])
def test_enable_that_waits_behind_another_request_does_not_come_after(
    rig: CommandServerRig, worker: StubWorker, cmd: str
) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=5, id=1), packed(cmd="enable", id=2))
    later(rig, 2)
    assert not any(one["enable"] for one in worker.changes)
    rig.send(packed(cmd=cmd, id=3), client=b"b")
    replies = {reply["id"]: reply for reply in later(rig)}
    assert replies[3]["ok"]
    assert f"{cmd} was asked before it was judged" in replies[2]["error"]["message"]
    worker.silent = False
    worker.said += [{**applies(one), "n": one["n"]} for one in worker.changes]
    later(rig, 20)
    assert Command.ENABLE not in [kind for kind, _ in rig.servo.taken]


def test_request_that_waits_ends_when_another_takes_the_lease(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    worker.silent = True
    rig.send(packed(cmd="set", K=5, id=1))
    rig.run()
    rig.send(packed(cmd="lease", what="environment", id=2), client=b"b")
    replies = {reply["id"]: reply for reply in later(rig)}
    assert replies[1]["error"]["code"] == "leased"
    worker.said += [{**applies(one), "n": one["n"]} for one in worker.changes]
    later(rig)
    assert rig.servo.values[Value.STIFFNESS] == 0


def test_flood_of_changes_is_bounded(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.silent = True
    replies = rig.send(*[packed(cmd="set", K=k) for k in range(80)])
    assert {reply["error"]["code"] for reply in replies} == {"busy"}
    assert "64 requests wait for the guard" in replies[0]["error"]["message"]


def test_request_waits_for_its_turn_at_most_a_second(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """Also one that was there when the gateway stood still: an enable now would surprise a hand."""
    rig.servo.mute = True
    rig.send(packed(cmd="set", K=1))
    later(rig, 2)
    rig.send(packed(cmd="enable", id=5))
    rig.servo.tick(3000)
    replies = {reply["id"]: reply for reply in map(decoded, rig.look())}
    assert replies[5]["error"]["code"] == "timeout"
    assert Command.ENABLE not in [kind for kind, _ in rig.servo.taken]


def test_change_of_another_in_between_is_judged_anew(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    raced = []

    def race(asked: dict[str, Any]) -> dict[str, Any]:
        if not raced:
            raced.append(rig.servo.values[Value.ENVIRONMENT_REVISION])
            rig.servo.deaf = True
        return applies(asked)

    worker.script = race
    rig.send(packed(cmd="set", K=100))
    rig.look()
    rig.look()  # judged and posted, and not taken yet
    rig.servo.values[Value.STIFFNESS] = 60.0
    rig.servo.values[Value.ENVIRONMENT_REVISION] += 1
    rig.servo.deaf = False
    (reply,) = later(rig, 8)
    assert reply["receipt"]["effective"]["K"] == 100
    assert [one["target"]["K"] for one in worker.changes] == [0, 60]


def test_change_that_is_raced_again_and_again_is_refused(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")

    def obey(command: tuple[Any, ...]) -> None:
        rig.servo.values[Value.ENVIRONMENT_REVISION] += 1
        StandInServo._apply(rig.servo, command)

    rig.servo._apply = obey  # type: ignore[method-assign]
    rig.send(packed(cmd="set", K=100))
    (reply,) = later(rig, 20)
    assert "has changed since this was judged" in reply["error"]["message"]
    assert len(worker.changes) == 3


def test_servo_restart_ends_what_waits(
    rig: CommandServerRig, worker: StubWorker, tmp_path: Path
) -> None:
    worker.silent = True
    rig.send(packed(cmd="set", K=1, id=1), packed(cmd="enable", id=2))
    later(rig, 2)
    rig.servo.mailbox.close()
    rig.servo = StandInServo(tmp_path, rig.clock)
    rig.clock.time_ns += 200_000_000
    replies = [decoded(reply) for reply in rig.run(2)]
    assert {reply["error"]["code"] for reply in replies} == {"servo_down"}
    assert {reply["id"] for reply in replies} == {1, 2}
    worker.silent = False
    worker.said += [{**applies(one), "n": one["n"]} for one in worker.changes]
    assert rig.ask(cmd="set", K=2)["ok"]
    assert rig.servo.taken == [(Command.SET, 16)]


def another_servo(rig: CommandServerRig) -> None:
    """The servo ends, and another one starts in its folder."""
    rig.servo.mailbox.close()
    rig.servo = StandInServo(rig.folder, rig.clock)
    rig.pass_time(200)
    rig.run(2)


# --- scheduled ------------------------------------------------------------------------------------


def test_scheduled_changes_are_judged_with_those_before_and_after(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="set", K=10, at_tick=300)
    rig.ask(cmd="set", B=3, at_tick=100)
    rig.ask(cmd="set", K=20, at_tick=200)
    asked = worker.changes[-1]
    assert (asked["before"], asked["change"], asked["after"]) == (
        [{"B": 3}],
        {"K": 20},
        [{"K": 10}],
    )
    rig.ask(cmd="set", M=0.01)
    assert worker.changes[-1]["before"] == []
    assert worker.changes[-1]["after"] == [{"B": 3}, {"K": 20}, {"K": 10}]


def test_new_servo_is_not_judged_with_the_schedule_of_the_one_before(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """Its ticks begin again, so that what the one before had scheduled would seem to come."""
    rig.ask(cmd="set", K=300, at_tick=5000)
    rig.ask(cmd="set", B=1)
    assert worker.changes[-1]["after"] == [{"K": 300}]
    another_servo(rig)
    rig.ask(cmd="set", B=2)
    assert worker.changes[-1]["after"] == []
    rig.ask(cmd="set", M=0.01, at_tick=6000)
    assert worker.changes[-1]["before"] == []


def test_scheduled_change_is_bound_to_what_those_before_leave(rig: CommandServerRig) -> None:
    under(rig, "refuse")
    rig.ask(cmd="set", B=3, at_tick=rig.servo.ticks + 20)
    rig.ask(cmd="set", K=20, at_tick=rig.servo.ticks + 30)
    later(rig, 40)
    assert [event["result"] for event in answers(rig)] == ["applied", "applied"]
    assert rig.servo.values[Value.STIFFNESS] == 20


def test_scheduled_change_whose_environment_changed_is_judged_at_its_tick(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    rig.ask(cmd="set", K=20, at_tick=rig.servo.ticks + 30)
    rig.ask(cmd="set", B=1)
    later(rig, 60)
    (event,) = answers(rig)
    assert (event["result"], event["effective"]["K"]) == ("applied", 20)
    assert len(worker.changes) == 3


def test_tick_that_has_passed_when_the_verdict_comes_is_refused(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.silent = True
    rig.send(packed(cmd="set", K=5, at_tick=10))
    later(rig, 20)
    (asked,) = worker.changes
    worker.said.append({**applies(asked), "n": asked["n"]})
    (reply,) = later(rig)
    assert "at_tick has passed" in reply["error"]["message"]


# --- stages ---------------------------------------------------------------------------------------


def test_stage_waits_for_the_damping_that_the_board_reports(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = two_stages
    rig.servo.effect = 0.0
    reply = rig.ask(cmd="set", K=400, active_damping=1.5, id="s")
    assert reply["receipt"]["result"] == "staged"
    later(rig, 100)
    assert rig.servo.values[Value.STIFFNESS] == 0
    assert answers(rig) == []
    rig.servo.effect = 1.5
    later(rig, 3)
    (event,) = answers(rig)
    assert (event["id"], event["result"], event["effective"]["K"]) == ("s", "applied", 400)


def test_stage_waits_for_the_ramps_of_the_one_before(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "follow")
    stages = [stage({"K": 10.0}), stage({"active_damping": 0.0}, after_ramps=True)]
    worker.script = lambda asked: {"action": "stage", "stages": stages, "verdict": verdict()}
    rig.ask(cmd="damping", value="off")
    later(rig, 45)
    assert answers(rig) == []
    later(rig, 10)
    assert answers(rig)[0]["result"] == "applied"


def test_newer_request_supersedes_what_is_left(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.script = two_stages
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=400, active_damping=1.5, id="old")
    worker.script = applies
    rig.ask(cmd="set", M=0.01, id="new")
    (event,) = answers(rig)
    assert (event["id"], event["result"]) == ("old", "superseded")
    assert worker.changes[-1]["target"]["active_damping"] == 1.5
    rig.servo.effect = 1.5
    later(rig, 5)
    assert rig.servo.values[Value.STIFFNESS] == 0


def test_newer_request_that_is_refused_supersedes_nothing(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    worker.script = two_stages
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=400, active_damping=1.5)
    worker.script = refuses
    assert not rig.ask(cmd="set", M=0.01)["ok"]
    rig.servo.effect = 1.5
    later(rig, 5)
    assert answers(rig)[0]["result"] == "applied"


@pytest.mark.parametrize("cmd", ["stop", "disable"])
def test_end_of_force_cancels_what_is_left(
    rig: CommandServerRig, worker: StubWorker, cmd: str
) -> None:
    rig.ask(cmd="enable")
    worker.script = two_stages
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=400, active_damping=1.5)
    assert rig.ask(cmd=cmd)["ok"]
    rig.servo.effect = 1.5
    later(rig, 5)
    (event,) = answers(rig)
    assert event["result"] == "cancelled"
    assert "the environment in force stays" in event["text"]
    assert rig.servo.values[Value.STIFFNESS] == 0


@pytest.mark.parametrize("latched", [State.STOPPED, State.FAULT])
def test_stages_that_began_in_disabled_end_when_the_servo_is(
    rig: CommandServerRig, worker: StubWorker, latched: State
) -> None:
    """No force ends there, but whoever resets must not find another environment than he left."""
    worker.script = two_stages
    rig.servo.effect = 0.0
    assert rig.ask(cmd="set", K=400, active_damping=1.5)["receipt"]["result"] == "staged"
    rig.servo.state = latched
    later(rig, 2)
    rig.servo.state = State.DISABLED
    rig.servo.effect = 1.5
    later(rig, 100)
    (event,) = answers(rig)
    assert event["result"] == "cancelled"
    assert f"the servo is {latched.name.lower()}" in event["text"]
    assert rig.servo.values[Value.STIFFNESS] == 0


@pytest.mark.parametrize("terms", [{"policy": "refuse"}, {"basis": "predicted"}])
def test_stage_judged_by_other_terms_does_not_come_into_force_under_a_strict_policy(
    rig: CommandServerRig, worker: StubWorker, terms: dict[str, str]
) -> None:
    under(rig, "clamp" if "basis" in terms else "warn")
    worker.script = two_stages
    rig.servo.effect = 0.0
    assert rig.ask(cmd="set", K=400, active_damping=1.5)["receipt"]["result"] == "staged"
    assert rig.ask(cmd="guard", **terms)["ok"]
    rig.servo.effect = 1.5
    later(rig, 5)
    (event,) = answers(rig)
    assert event["result"] == "cancelled"
    assert event["code"] == "other_terms"
    assert rig.servo.values[Value.STIFFNESS] == 0


def test_stage_goes_on_where_the_same_terms_are_asked_for_again(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    under(rig, "refuse")
    worker.script = two_stages
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=400, active_damping=1.5)
    under(rig, "refuse")
    rig.servo.effect = 1.5
    later(rig, 5)
    assert rig.servo.values[Value.STIFFNESS] == 400


def test_what_was_scheduled_by_other_terms_does_not_come_into_force_under_a_strict_policy(
    rig: CommandServerRig,
) -> None:
    tick = rig.servo.ticks + 100
    assert rig.ask(cmd="set", K=70, at_tick=tick)["receipt"]["result"] == "scheduled"
    rig.ask(cmd="guard", policy="refuse")
    later(rig, 150)
    assert rig.servo.values[Value.STIFFNESS] == 0
    (event,) = answers(rig)
    assert (event["cmd"], event["result"]) == ("set", "cancelled")


def test_what_is_scheduled_by_the_terms_in_force_stays(rig: CommandServerRig) -> None:
    under(rig, "refuse")
    rig.ask(cmd="set", K=70, at_tick=rig.servo.ticks + 100)
    under(rig, "refuse")
    later(rig, 150)
    assert rig.servo.values[Value.STIFFNESS] == 70


def test_what_a_gateway_before_scheduled_does_not_come_into_force_under_a_strict_policy(
    rig: CommandServerRig,
) -> None:
    rig.ask(cmd="set", B=1)
    rig.ask(cmd="set", K=70, at_tick=rig.servo.ticks + 100)
    rig.start_gateway()
    rig.ask(cmd="guard", policy="refuse")
    later(rig, 150)
    assert rig.servo.values[Value.STIFFNESS] == 0


def test_what_a_strict_gateway_before_scheduled_does_not_come_into_force(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """Its terms had another number, after as many changes."""
    under(rig, "refuse")
    rig.ask(cmd="set", K=70, at_tick=rig.servo.ticks + 100)
    rig.start_gateway()
    rig.ask(cmd="guard", policy="refuse")
    later(rig, 150)
    assert rig.servo.values[Value.STIFFNESS] == 0


def test_stages_are_bound_one_after_the_other(rig: CommandServerRig, worker: StubWorker) -> None:
    under(rig, "refuse")
    worker.script = two_stages
    rig.ask(cmd="set", K=400, active_damping=1.5)
    later(rig, 5)
    assert answers(rig)[0]["result"] == "applied"
    assert len(worker.changes) == 1


def test_damping_that_never_comes_ends_the_change(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = two_stages
    rig.servo.effect = 0.2
    rig.ask(cmd="set", K=400, active_damping=1.5)
    later(rig, 2500)
    (event,) = answers(rig)
    assert event["result"] == "cancelled"
    assert "the board reports 0.2 of 1.5 N s/m" in event["text"]
    assert rig.servo.values[Value.STIFFNESS] == 0


def test_enable_waits_for_a_change_in_stages(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.script = two_stages
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=400, active_damping=1.5)
    worker.script = applies
    rig.send(packed(cmd="enable"))
    later(rig, 10)
    assert rig.view.state is State.DISABLED
    rig.servo.effect = 1.5
    later(rig, 5)
    assert rig.view.state is State.ENABLED
    assert rig.servo.values[Value.STIFFNESS] == 400


# --- modes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "mode"),
    [
        ({"cmd": "damping", "value": "on"}, "level"),
        ({"cmd": "damping", "value": 1.0}, "level"),
        ({"cmd": "damping", "value": "off"}, "off"),
        ({"cmd": "damping", "value": "auto"}, "auto"),
        ({"cmd": "set", "active_damping": 0.5}, "level"),
        ({"cmd": "guard", "mode": "auto"}, "auto"),
    ],
)
def test_mode_follows_what_was_asked(
    rig: CommandServerRig, asked: dict[str, Any], mode: str
) -> None:
    assert rig.ask(**asked)["ok"]
    assert rig.ask(cmd="guard")["result"]["mode"] == mode


def test_auto_without_a_worker_is_refused(tmp_path: Path) -> None:
    rig = CommandServerRig(tmp_path)
    error = rig.ask(cmd="damping", value="auto")["error"]
    assert error["code"] == "guard"
    assert rig.ask(cmd="guard")["result"]["mode"] == "off"


def test_auto_chooses_anew_by_itself(rig: CommandServerRig, worker: StubWorker) -> None:
    rig.ask(cmd="damping", value="auto")
    level = {"action": "apply", "stages": [stage({"active_damping": 0.7})], "verdict": verdict()}
    worker.script = lambda asked: level if asked["ask"] == "change" else None
    later(rig, 2)
    for _ in range(60):
        rig.run(100)
    assert worker.changes[-1]["mode"] == "auto"
    assert rig.servo.values[Value.ACTIVE_DAMPING] == 0.7
    taken = len(rig.servo.taken)
    for _ in range(60):
        rig.run(100)
    assert len(rig.servo.taken) == taken  # nothing is posted while nothing changes


def test_damping_off_ends_auto_before_its_verdict_is_there(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    level = {"action": "apply", "stages": [stage({"active_damping": 0.7})], "verdict": verdict()}
    worker.script = lambda asked: level if asked["ask"] == "change" else None
    rig.ask(cmd="damping", value="auto")
    for _ in range(45):
        rig.run(100)
    assert rig.servo.values[Value.ACTIVE_DAMPING_ON] == 1.0
    # over what was asked it thinks, over a level of mode auto it does not
    worker.script = lambda asked: level if asked.get("mode") == "auto" else None
    rig.send(packed(cmd="damping", value="off"))
    rig.run(3)
    assert rig.servo.values[Value.ACTIVE_DAMPING_ON] == 0.0
    for _ in range(60):
        rig.run(100)
    assert rig.servo.values[Value.ACTIVE_DAMPING_ON] == 0.0
    assert rig.ask(cmd="guard")["result"]["mode"] == "off"


# --- looks ----------------------------------------------------------------------------------------


def looking(rig: CommandServerRig, wanted: bool = True) -> list[dict[str, Any]]:
    """What the topic `guard` says within the next second."""
    told = []
    for _ in range(100):
        rig.run(10)
        told += rig.guard.messages(rig.clock.now_ns(), 0, wanted)
    return told


def looked(request: dict[str, Any], safe: bool = True) -> dict[str, Any]:
    """An answer to a look."""
    more = {"margin_ns_per_m": 0.2, "allowed": {"K": [0.0, 90.0]}}
    seen = {
        "without_active_damping": more,
        "with_active_damping": {"level": request["level_on"], **more},
    }
    return {"verdict": verdict(safe, "as it is"), **seen}


def test_topic_tells_twice_a_second_with_and_without_damping(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = lambda asked: looked(asked) if asked["ask"] == "look" else applies(asked)
    rig.ask(cmd="set", K=30, active_damping=1.0)
    told = looking(rig)
    assert len(told) >= 2
    second = told[-1]
    assert second["verdict"]["text"] == "as it is"
    assert second["with_active_damping"]["level"] == 1.0
    assert second["without_active_damping"]["allowed"] == {"K": [0.0, 90.0]}
    assert (second["policy"], second["mode"], second["worker"]) == ("warn", "level", "up")
    assert worker.asked[-1]["target"]["K"] == 30


def test_nobody_is_asked_again_and_again_while_nobody_listens(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = lambda asked: looked(asked) if asked["ask"] == "look" else applies(asked)
    assert looking(rig, wanted=False) == []
    looking(rig, wanted=False)
    assert len(worker.asked) == 1
    rig.ask(cmd="set", K=30)
    looking(rig, wanted=False)
    # the verdict on the change tells as much as a look would
    assert [one["ask"] for one in worker.asked] == ["look", "change"]
    assert rig.ask(cmd="guard")["result"]["verdict"]["text"] == "fine"


def test_topic_says_unknown_without_a_worker(tmp_path: Path) -> None:
    told = looking(CommandServerRig(tmp_path))
    assert told[-1]["verdict"]["safe"] is None
    assert told[-1]["worker"] == "none"


def test_verdict_on_what_was_in_force_before_is_not_told_as_that_on_what_is(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = looked
    looking(rig)
    assert rig.ask(cmd="guard")["result"]["verdict"]["text"] == "as it is"
    worker.script = lambda asked: applies(asked) | {"verdict": verdict(False, "it would ring")}
    rig.ask(cmd="set", K=1e4)
    found = rig.ask(cmd="guard")["result"]
    assert found["verdict"] is None
    assert found["unjudged"] == "no verdict yet on the environment in force: it is being judged"
    worker.script = lambda asked: (
        looked(asked, safe=False) if asked["ask"] == "look" else {"hand": None}
    )
    looking(rig)
    found = rig.ask(cmd="guard")["result"]
    assert (found["verdict"]["safe"], found["unjudged"]) == (False, "")


def test_before_any_verdict_what_is_true_is_said(tmp_path: Path) -> None:
    rig = CommandServerRig(tmp_path)
    found = rig.ask(cmd="guard")["result"]
    nothing = "nothing is rendered (K, B, M and the wall are 0); there is no guard worker"
    assert (found["verdict"], found["unjudged"]) == (None, nothing)
    rig.ask(cmd="set", wall={"stiffness_n_per_m": 10})
    found = rig.ask(cmd="guard")["result"]
    assert found["unjudged"].startswith("no verdict yet on the environment in force")


def test_look_by_another_margin_is_not_believed(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.silent = True
    looking(rig)
    worker.silent = False
    (question,) = worker.asked
    rig.ask(cmd="guard", margin_ns_per_m=0.5)
    worker.said.append({**looked(question), "n": question["n"]})
    rig.run()
    assert rig.ask(cmd="guard")["result"]["verdict"] is None
    worker.script = looked
    looking(rig)
    assert worker.asked[-1]["margin_ns_per_m"] == 0.5
    assert rig.ask(cmd="guard")["result"]["verdict"]["text"] == "as it is"


def test_delays_say_which_one_is_counted_on(rig: CommandServerRig, worker: StubWorker) -> None:
    worker.hello["delay_periods"] = 0.125
    worker.script = looked
    assert rig.ask(cmd="guard")["result"]["delays"] == {
        "counted_periods": 0.125,
        "measured": False,
        "measured_p99_periods": None,
        "model_periods": 0.125,
    }
    rig.guard.delay.periods = 0.25
    looking(rig)
    rig.guard.delay.periods = 0.5
    found = rig.ask(cmd="guard")["result"]["delays"]
    assert (found["measured"], found["counted_periods"]) == (True, 0.25)
    assert found["measured_p99_periods"] == 0.5


def test_cost_of_the_delay_is_that_of_the_last_look(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    worker.script = lambda asked: looked(asked) | {"timing": {"periods": asked["delay_periods"]}}
    assert rig.ask(cmd="guard")["result"]["timing"] is None
    looking(rig)
    assert rig.ask(cmd="guard")["result"]["timing"] == {"measured": False, "periods": None}
    rig.guard.delay.periods = 0.25
    looking(rig)
    assert rig.ask(cmd="guard")["result"]["timing"] == {"measured": True, "periods": 0.25}
    worker.script = looked  # of a device without a model
    looking(rig)
    assert rig.ask(cmd="guard")["result"]["timing"] == {"measured": True, "periods": 0.25}


def test_environment_that_is_passive_no_more_is_warned_about(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """The delay has grown, and nobody asked for anything."""
    safe = [True]
    worker.script = lambda asked: looked(asked, safe[0])
    looking(rig)
    safe[0] = False
    looking(rig)
    looking(rig)
    warnings = [event for event in rig.journal.drain() if event["kind"] == "warning"]
    assert len(warnings) == 1
    assert warnings[0]["code"] == "not_passive"
    assert warnings[0]["text"].endswith("no longer known to be passive: as it is")


# --- gateway restart ------------------------------------------------------------------------------


def test_gateway_that_comes_later_judges_what_is_in_force(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="set", K=70, active_damping=1.0)
    rig.start_gateway()
    later(rig, 3)
    rig.ask(cmd="set", B=1)
    assert (worker.changes[-1]["target"]["K"], worker.changes[-1]["target"]["active_damping"]) == (
        70,
        1,
    )


def test_side_of_a_wall_counts_until_its_ramp_has_ended() -> None:
    """A record rounds the side; the second half of its ramp says 0 while the wall still acts."""

    def records(*rows: tuple[int, int]) -> Any:
        return np.array(list(rows), [("wall_side", "<i4"), ("flags", "<u4")])

    moving = int(Flag.RAMPING)
    side = WallSide()
    side.follow(records((-1, 0), (-1, moving), (0, moving)))
    assert side.value == -1
    side.follow(records((0, moving)))
    assert side.value == -1
    side.follow(records((0, moving), (0, 0)))
    assert side.value == 0


def test_wall_on_its_way_out_is_judged_as_it_was(rig: CommandServerRig, worker: StubWorker) -> None:
    """No record holds its damping, and the second half of its ramp says that there is no wall."""
    wall = {"stiffness_n_per_m": 500.0, "virtual_damping_ns_per_m": 3.0, "side": 1}
    rig.ask(cmd="set", wall=wall)
    rig.guard.in_force.follow(np.array([(1, 0)], [("wall_side", "<i4"), ("flags", "<u4")]))
    rig.ask(cmd="set", B=1)
    rig.servo.flags = int(Flag.RAMPING)
    rig.ask(cmd="set", wall={"side": 0, "virtual_damping_ns_per_m": 0.0})
    rig.ask(cmd="set", B=2)
    now = worker.changes[-1]["now"]["wall"]
    assert (now["side"], now["virtual_damping_ns_per_m"]) == (1, 3.0)
    rig.servo.flags = 0
    rig.run()
    rig.ask(cmd="set", B=3)
    now = worker.changes[-1]["now"]["wall"]
    assert (now["side"], now["virtual_damping_ns_per_m"]) == (0, 0.0)
