"""The life of a request past the guard: it ends with what was asked after it, with its connection,
with its deadline, with its terms and with its gateway. The command server and a stand-in servo on
virtual time; with the servo itself where its ring, its schedule or its records decide.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.boards import board_params
from support.gateway_rig import CommandServerRig, decoded, packed
from support.guard_stages import LEVEL_NS_PER_M, STIFF, Flight
from support.guard_stub import StubWorker, refuses, stage, verdict
from support.models import servo_params

from hapticd.core.errors import MailboxError
from hapticd.core.units import NS_PER_MS
from hapticd.guard import terms
from hapticd.guard.status import MOST_RECORDS
from hapticd.mailbox.client_side import GatewayMailbox
from hapticd.mailbox.layout import Command, Result, State, Value, values_of
from hapticd.run.lockstep import LockStep

STRICT = ("clamp", "refuse", "follow")


@pytest.fixture
def worker() -> StubWorker:
    return StubWorker()


@pytest.fixture
def rig(tmp_path: Path, worker: StubWorker) -> CommandServerRig:
    rig = CommandServerRig(tmp_path, worker)
    rig.run(MOST_RECORDS)
    return rig


def staged(asked: dict[str, Any]) -> dict[str, Any]:
    """Damping first; force, or K, once the board reports it."""
    stages = [stage({"active_damping": 1.5}), stage({"K": 100.0}, at_least=1.5)]
    return {"action": "stage", "stages": stages, "verdict": verdict()}


def waits_in_stages(rig: CommandServerRig, worker: StubWorker) -> None:
    """An enable of client `a` whose damping does not come."""
    rig.ask(cmd="guard", policy="clamp")
    worker.script = staged
    rig.servo.effect = 0.0
    assert rig.ask(cmd="enable")["receipt"]["result"] == "staged"


def comes(rig: CommandServerRig, ticks: int = 400) -> State:
    """The damping is there; the state when all that may follow has followed."""
    rig.servo.effect = 1.5
    for _ in range(ticks):
        rig.run()
    return rig.servo.state


def answers(rig: CommandServerRig) -> list[str]:
    return [event["result"] for event in rig.journal.drain() if event["kind"] == "answer"]


# --- an enable that waits in stages -----------------------------------------------------------


def test_enable_in_stages_goes_on_once_the_damping_is_there(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    waits_in_stages(rig, worker)
    assert comes(rig) is State.ENABLED


@pytest.mark.parametrize("cmd", ["stop", "disable", "zero"])
def test_enable_in_stages_does_not_come_after_what_was_asked_later(
    rig: CommandServerRig, worker: StubWorker, cmd: str
) -> None:
    waits_in_stages(rig, worker)
    rig.ask(b"b", cmd=cmd)
    if cmd == "stop":
        rig.run(1100)
        rig.ask(b"b", cmd="reset")
    assert comes(rig) is State.DISABLED
    assert answers(rig) == ["cancelled"]


def test_enable_in_stages_names_what_was_asked_later(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    waits_in_stages(rig, worker)
    rig.ask(b"b", cmd="disable")
    (event,) = [one for one in rig.journal.recent if one["kind"] == "answer"]
    assert "disable was asked" in event["text"]


def test_stop_and_reset_without_a_pass_between_end_an_enable_in_stages(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """The gateway sees the same state as before: it compares the count of changes."""
    waits_in_stages(rig, worker)
    for kind in (Command.STOP, Command.RESET):
        assert rig.view.mailbox is not None
        rig.view.mailbox.post(kind, 2, 0, values_of({}))
    rig.servo.tick(5)
    assert rig.servo.state is State.DISABLED
    assert comes(rig) is State.DISABLED
    assert answers(rig) == ["cancelled"]


def test_enable_in_stages_ends_with_its_connection(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    waits_in_stages(rig, worker)
    rig.server.leave(b"a")
    assert comes(rig) is State.DISABLED


def test_change_in_stages_goes_on_though_its_client_has_left(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="guard", policy="clamp")
    worker.script = staged
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=100, active_damping=1.5)
    rig.server.leave(b"a")
    comes(rig)
    assert rig.servo.values[Value.STIFFNESS] == 100.0


@pytest.mark.parametrize("policy", ["warn", *STRICT])
def test_what_a_closed_connection_left_waiting_is_not_carried_out(
    rig: CommandServerRig, worker: StubWorker, policy: str
) -> None:
    rig.ask(cmd="guard", policy=policy)
    worker.silent = True
    rig.send(packed(cmd="set", K=100), client=b"b")  # keeps the others waiting
    rig.send(packed(cmd="enable"), packed(cmd="set", K=5), client=b"a")
    rig.run(2)
    rig.server.leave(b"a")
    worker.silent = False
    for _ in range(2000):
        rig.run()
    assert rig.servo.state is State.DISABLED
    assert rig.servo.values[Value.STIFFNESS] != 5.0


@pytest.mark.parametrize("policy", ["warn", *STRICT])
def test_what_a_failed_holder_left_waiting_is_not_carried_out(
    rig: CommandServerRig, worker: StubWorker, policy: str
) -> None:
    rig.ask(cmd="guard", policy=policy)
    worker.silent = True
    rig.send(packed(cmd="set", K=100), client=b"b")  # keeps the others waiting
    rig.send(packed(cmd="lease", what="environment", at_end="disable"))
    rig.send(packed(cmd="enable"), packed(cmd="set", K=5))
    rig.run(2)
    replies = rig.send(packed(cmd="lease", what="environment", action="fail"))
    worker.silent = False
    replies += [decoded(reply) for _ in range(2000) for reply in rig.run()]
    assert rig.servo.state is State.DISABLED
    assert rig.servo.values[Value.STIFFNESS] != 5.0
    texts = [str(one["error"]) for one in replies if "error" in one]
    assert len([text for text in texts if "its client has failed" in text]) == 2


def test_enable_in_stages_ends_where_its_client_fails(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="lease", what="environment", at_end="disable")
    waits_in_stages(rig, worker)
    rig.ask(cmd="lease", what="environment", action="fail")
    assert comes(rig) is State.DISABLED


def test_change_in_stages_ends_where_its_client_fails(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="guard", policy="clamp")
    rig.ask(cmd="lease", what="environment", at_end="zero")
    worker.script = staged
    rig.servo.effect = 0.0
    rig.ask(cmd="set", K=100, active_damping=1.5)
    rig.ask(cmd="lease", what="environment", action="fail")
    comes(rig)
    assert rig.servo.values[Value.STIFFNESS] == 0.0


# --- deadlines --------------------------------------------------------------------------------


def test_verdict_that_comes_after_the_deadline_is_not_acted_on(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    """The gateway is stopped for 8 s with the worker's answer on its line."""
    rig.ask(cmd="guard", policy="refuse")
    rig.send(packed(cmd="enable"))
    rig.run(1)
    assert worker.changes
    rig.clock.time_ns += 8000 * NS_PER_MS
    replies = [decoded(reply) for _ in range(200) for reply in rig.run()]
    assert [reply["error"]["code"] for reply in replies] == ["timeout"]
    assert rig.servo.state is State.DISABLED


def test_stage_is_not_posted_after_its_deadline(rig: CommandServerRig, worker: StubWorker) -> None:
    """The damping came while the gateway was stopped."""
    waits_in_stages(rig, worker)
    rig.servo.effect = 1.5
    rig.servo.tick(1)
    rig.clock.time_ns += 20_000 * NS_PER_MS
    assert comes(rig) is State.DISABLED
    assert answers(rig) == ["cancelled"]


@pytest.mark.parametrize(("stood_ms", "state"), [(4100, State.ENABLED), (4200, State.DISABLED)])
def test_deadline_of_a_stage_is_4_s_its_ramp_and_the_rise_of_the_damping(
    rig: CommandServerRig, worker: StubWorker, stood_ms: int, state: State
) -> None:
    """The ramp takes 50 ms; all of 2 N s/m at 20 N s/m in a second, 100 ms."""
    waits_in_stages(rig, worker)
    rig.servo.effect = 1.5
    rig.servo.tick(1)
    rig.clock.time_ns += stood_ms * NS_PER_MS
    assert comes(rig) is state


# --- terms ------------------------------------------------------------------------------------


def test_policy_made_strict_before_a_scheduled_change_is_answered_reaches_it(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.servo.deaf = True
    rig.send(packed(cmd="set", K=70, at_tick=rig.servo.ticks + 100))
    rig.look()
    rig.send(packed(cmd="guard", policy="refuse"))
    rig.look()
    rig.servo.deaf = False
    rig.run(300)
    assert rig.servo.values[Value.STIFFNESS] == 0.0


def test_what_was_scheduled_under_measuring_does_not_outlive_it(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="guard", policy="refuse")
    rig.run(1)
    worker.script = refuses
    rig.ask(cmd="lease", what="measuring", action="take")
    scheduled = rig.ask(cmd="set", K=70, at_tick=rig.servo.ticks + 100)
    assert scheduled["receipt"]["result"] == "scheduled"
    rig.ask(cmd="lease", what="measuring", action="release")
    rig.look()
    rig.run(300)
    assert rig.servo.values[Value.STIFFNESS] == 0.0


def test_first_command_of_a_servo_is_not_obeyed_under_another_gateway(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="set", K=70, at_tick=rig.servo.ticks + 100)
    rig.start_gateway()
    rig.ask(cmd="guard", policy="refuse")
    rig.look()
    rig.run(300)
    assert rig.servo.values[Value.STIFFNESS] == 0.0


@pytest.mark.parametrize("policy", STRICT)
def test_nothing_is_judged_before_the_delay_is_known(
    tmp_path: Path, worker: StubWorker, policy: str
) -> None:
    """Less active damping is the dangerous direction, so no change passes by its direction."""
    rig = CommandServerRig(tmp_path, worker)
    rig.ask(cmd="guard", policy=policy)
    rig.send(packed(cmd="damping", value="off"))
    replies = [decoded(one) for _ in range(95) for one in rig.pass_time(10)]
    assert [one["error"]["code"] for one in replies] == ["guard"]
    assert worker.changes == []
    for cmd in ("disable", "stop"):
        assert rig.ask(cmd=cmd)["ok"]


def test_change_waits_for_the_delay_and_is_judged_then(tmp_path: Path, worker: StubWorker) -> None:
    rig = CommandServerRig(tmp_path, worker)
    rig.ask(cmd="guard", policy="refuse")
    rig.send(packed(cmd="set", K=100))
    replies = [decoded(one) for _ in range(MOST_RECORDS + 20) for one in rig.run()]
    assert [one["ok"] for one in replies] == [True]
    assert rig.servo.values[Value.STIFFNESS] == 100.0


def test_terms_that_could_not_be_kept_are_tried_again(
    rig: CommandServerRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object) -> None:
        raise MailboxError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(terms, "write_terms", no_room)
        rig.ask(cmd="guard", policy="refuse")
        rig.run(2000)
    warnings = [one for one in rig.journal.recent if one["code"] == "terms_not_kept"]
    assert len(warnings) == 1
    rig.run(1100)
    rig.start_gateway()
    rig.run(5)
    assert rig.guard.policy == "refuse"


# --- another gateway --------------------------------------------------------------------------


def test_client_numbers_go_on_with_the_next_gateway(rig: CommandServerRig) -> None:
    first = rig.ask(b"a", cmd="hello", name="a")["result"]["actor"]
    rig.start_gateway()
    rig.run(2)
    assert rig.ask(b"b", cmd="hello", name="b")["result"]["actor"] > first


def test_perturbation_that_was_leased_ends_with_its_gateway(rig: CommandServerRig) -> None:
    rig.ask(cmd="perturb", action="load", samples_n=[0.1] * 100)
    rig.ask(cmd="enable")
    rig.ask(cmd="lease", what="perturbation", action="take")
    rig.ask(cmd="perturb", action="start", loop=True)
    assert rig.servo.perturbing
    rig.start_gateway()
    rig.run(1)
    rig.run(5)
    assert not rig.servo.perturbing


def test_perturbation_without_a_lease_goes_on_with_the_next_gateway(rig: CommandServerRig) -> None:
    rig.ask(cmd="perturb", action="load", samples_n=[0.1] * 100)
    rig.ask(cmd="enable")
    rig.ask(cmd="perturb", action="start", loop=True)
    rig.start_gateway()
    rig.run(1)
    rig.run(5)
    assert rig.servo.perturbing


def test_enable_that_a_dead_gateway_left_in_the_ring_is_refused() -> None:
    """The servo stands while its gateway dies and another comes."""
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        stack.gateway.beat(stack.clock.now_ns())
        seq = stack.gateway.post(Command.ENABLE, 16, 0, values_of({}))
        stack.gateway.close()
        stack.clock.sleep_until_ns(stack.clock.now_ns() + 3000 * NS_PER_MS)
        stack.gateway = GatewayMailbox(stack.mailbox.folder)
        stack.gateway.beat(stack.clock.now_ns())
        stack.run(3)
        results = {one.seq: one.result for one in stack.gateway.answers()}
        assert results[seq] is Result.REFUSED_NO_GATEWAY


# --- bounded changes --------------------------------------------------------------------------


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.stack.close()


def bounded(flight: Flight, policy: str, **fields: Any) -> tuple[dict[str, Any], int]:
    """The reply to a change of 20 ticks that begins 50 ticks from now, and its begin."""
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    begin = flight.view.tick + 50
    return flight.ask(cmd="set", ramp_s=0.0, at_tick=begin, until_tick=begin + 20, **fields), begin


PUSH = {"stiffness_n_per_m": 25.0, "virtual_damping_ns_per_m": 0.0, "position_m": 0.02, "side": -1}


@pytest.mark.parametrize("policy", ["warn", *STRICT])
@pytest.mark.parametrize("after", ["nothing", "the worker is silent", "another gateway"])
def test_bounded_push_ends_at_its_tick(flight: Flight, policy: str, after: str) -> None:
    reply, begin = bounded(flight, policy, wall=PUSH)
    assert reply["receipt"]["result"] == "scheduled"
    if after == "the worker is silent":
        flight.worker.silent = True
    if after == "another gateway":
        flight.another_gateway()
        flight.ask(cmd="guard", policy="refuse")
    records = flight.fly(200)
    pushed = records["tick"][abs(records["force_n"]) > 0.1]
    assert len(pushed) <= 22
    assert pushed.max(initial=0) < begin + 25


@pytest.mark.parametrize("policy", STRICT)
def test_bounded_level_of_active_damping_ends_at_its_tick(flight: Flight, policy: str) -> None:
    reply, begin = bounded(flight, policy, active_damping=LEVEL_NS_PER_M)
    assert reply["ok"]
    flight.worker.silent = True
    records = flight.fly(400)
    asked = records["active_damping_asked_ns_per_m"]
    assert asked[records["tick"] == begin + 1] > 1.7
    assert asked[records["tick"] == begin + 21] == 0.0


def test_unsafe_bounded_change_is_refused_and_schedules_nothing(flight: Flight) -> None:
    reply, _ = bounded(flight, "refuse", **STIFF)
    assert reply["error"]["code"] == "guard"
    records = flight.fly(200)
    assert not records["stiffness_n_per_m"].any()
    assert flight.stack.loop.state[0].plan.scheduled == ()


@pytest.mark.parametrize("policy", ["off", "warn", "refuse"])
def test_bounded_change_whose_end_has_passed_does_not_begin(flight: Flight, policy: str) -> None:
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    tick = flight.view.tick
    late = flight.ask(cmd="set", K=50.0, ramp_s=0.0, at_tick=tick - 40, until_tick=tick - 20)
    unbounded = flight.ask(cmd="set", K=50.0, ramp_s=0.0, until_tick=tick + 1)
    assert [late["ok"], unbounded["ok"]] == [False, False]
    assert not flight.fly(200)["stiffness_n_per_m"].any()


def test_force_0_is_not_refused_though_the_worker_is_silent(flight: Flight) -> None:
    flight.ask(cmd="guard", policy="refuse")
    flight.ask(cmd="set", K=50.0)
    flight.worker.silent = True
    assert flight.ask(cmd="set", K=0.0, B=0.0, M=0.0)["ok"]
    assert "error" in flight.ask(cmd="damping", value="off")


def scheduled(flight: Flight) -> tuple[Any, ...]:
    return tuple(flight.stack.loop.state[0].plan.scheduled)


def test_bounded_change_that_does_not_begin_leaves_no_end(flight: Flight) -> None:
    """Terms made strict before its tick cancel it; what others set meanwhile stays."""
    reply, begin = bounded(flight, "warn", K=40.0)
    assert reply["receipt"]["result"] == "scheduled"
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    assert flight.ask(cmd="set", K=30.0, ramp_s=0.0)["ok"]
    assert scheduled(flight) == ()
    records = flight.fly(200)
    assert set(records["stiffness_n_per_m"][records["tick"] > begin]) == {30.0}


def test_bounded_change_for_whose_end_there_is_no_room_does_not_begin(flight: Flight) -> None:
    flight.ask(cmd="guard", policy="warn")
    tick = flight.view.tick
    for place in range(15):
        assert flight.ask(cmd="set", K=1.0 + place, at_tick=tick + 2000 + place)["ok"]
    begin = flight.view.tick + 50
    reply = flight.ask(cmd="set", K=50.0, ramp_s=0.0, at_tick=begin, until_tick=begin + 20)
    assert not reply["ok"]
    assert len(scheduled(flight)) == 15
    assert not flight.fly(200)["stiffness_n_per_m"].any()


def test_bounded_change_brings_back_what_was_there_when_it_began(flight: Flight) -> None:
    """K is changed between the request and its tick."""
    reply, begin = bounded(flight, "warn", K=40.0)
    assert reply["ok"]
    assert flight.ask(cmd="set", K=25.0, ramp_s=0.0)["ok"]
    records = flight.fly(200)
    rendered = dict(zip(records["tick"].tolist(), records["stiffness_n_per_m"], strict=True))
    assert [rendered[begin + after] for after in (-1, 5, 19, 25)] == [25.0, 40.0, 40.0, 25.0]
    assert scheduled(flight) == ()


# --- while the servo has it ------------------------------------------------------------------


@pytest.mark.parametrize("end", ["nothing", "disable", "reset", "leave"])
def test_enable_whose_first_stage_is_with_the_servo_is_taken_back(
    rig: CommandServerRig, worker: StubWorker, end: str
) -> None:
    rig.ask(cmd="guard", policy="clamp")
    worker.script = staged
    rig.servo.effect = 0.0
    rig.servo.deaf = True
    rig.send(packed(cmd="enable"))
    for _ in range(3):
        rig.run()
    assert rig.view.mailbox is not None
    assert rig.view.mailbox.backlog == 2  # the terms, and the first stage
    if end == "leave":
        rig.server.leave(b"a")
    elif end != "nothing":
        rig.send(packed(cmd=end), client=b"b")
    rig.servo.deaf = False
    for _ in range(3):
        rig.run()
    assert comes(rig) is (State.ENABLED if end == "nothing" else State.DISABLED)


def test_what_was_scheduled_in_one_batch_with_a_measuring_lease_does_not_outlive_it(
    rig: CommandServerRig, worker: StubWorker
) -> None:
    rig.ask(cmd="guard", policy="refuse")
    rig.run(1)
    worker.script = refuses
    rig.send(
        packed(cmd="lease", what="measuring", action="take"),
        packed(cmd="set", K=70, at_tick=rig.servo.ticks + 100),
        packed(cmd="lease", what="measuring", action="release"),
    )
    rig.look()
    rig.run(300)
    assert rig.servo.values[Value.STIFFNESS] == 0.0


@pytest.mark.parametrize("pause_ms", [0, 3000])
def test_what_a_dead_gateway_left_in_the_ring_does_not_come_into_force(pause_ms: int) -> None:
    """The servo stands while its gateway dies and another comes, at once or later."""
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        stack.gateway.beat(stack.clock.now_ns())
        stiff = values_of({Value.STIFFNESS: 70.0, Value.RAMP_S: 0.0})
        left = [
            stack.gateway.post(Command.SET, 16, 0, stiff),
            stack.gateway.post(Command.ENABLE, 16, 0, values_of({})),
            stack.gateway.post(Command.STOP, 16, 0, values_of({})),
        ]
        stack.gateway.close()
        stack.clock.sleep_until_ns(stack.clock.now_ns() + pause_ms * NS_PER_MS)
        stack.gateway = GatewayMailbox(stack.mailbox.folder)
        stack.gateway.beat(stack.clock.now_ns())
        own = stack.gateway.post(Command.SET, 16, 0, values_of({Value.MASS: 0.0}))
        stack.run(5)
        results = {one.seq: one.result for one in stack.gateway.answers()}
        expected = [Result.REFUSED_NO_GATEWAY] * 2 + [Result.APPLIED] * 2
        assert [results[seq] for seq in (*left, own)] == expected
        plan = stack.loop.state[0].plan
        assert plan.values[Value.STIFFNESS].end == 0.0
        assert plan.state is State.STOPPED
