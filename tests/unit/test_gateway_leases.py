"""Leases: who excludes whom from what, for how long, and what becomes of the display."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.gateway_rig import CommandServerRig, packed
from support.gateway_stand_in import StandInServo
from support.guard_stub import StubWorker, stage, verdict

from hapticd.core.errors import CommandError
from hapticd.core.params import LeaseParams
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.guard.status import MOST_RECORDS
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, State, Value
from hapticd.protocol.leases import LATE_NS, Leases

A = b"a"
B = b"b"
WAVE = np.zeros(4, "<f4").tobytes()
CHANGES: dict[str, tuple[dict[str, Any], ...]] = {
    "environment": (
        {"cmd": "set", "K": 100},
        {"cmd": "set", "B": 1},
        {"cmd": "set", "M": 0.01},
        {"cmd": "set", "wall": {"side": 1}},
        {"cmd": "set", "filters": {"velocity_hz": 200.0}},
        {"cmd": "set", "limit_cycle_faults": False},
        {"cmd": "set", "K": 5, "at_tick": 10**6},
        {"cmd": "zero"},
        {"cmd": "home"},
        {"cmd": "enable"},
    ),
    "active_damping": (
        {"cmd": "damping", "value": "on"},
        {"cmd": "damping", "value": 1.0},
        {"cmd": "set", "active_damping": 1.0},
    ),
    "perturbation": (
        {"cmd": "perturb", "action": "load", "samples_n": WAVE},
        {"cmd": "perturb", "action": "stop"},
    ),
}
EVERYTHING = [(part, change) for part, changes in CHANGES.items() for change in changes]
FREE = ({"cmd": "disable"}, {"cmd": "stop"}, {"cmd": "get"}, {"cmd": "status"}, {"cmd": "reset"})


@pytest.fixture
def rig(tmp_path: Path) -> CommandServerRig:
    return CommandServerRig(tmp_path)


def take(rig: CommandServerRig, client: bytes, what: str, **fields: Any) -> dict[str, Any]:
    """The result of a lease that is granted."""
    reply = rig.ask(client, cmd="lease", what=what, **fields)
    assert reply["ok"], reply
    rig.run(2)
    result: dict[str, Any] = reply["result"]
    return result


def idle(rig: CommandServerRig, seconds: float) -> None:
    """Time goes on and nobody asks for anything."""
    for _ in range(round(100 * seconds)):
        rig.run(10)


def put(rig: CommandServerRig, place: Value) -> float:
    """A value as the servo has it."""
    return float(rig.servo.values[place])


def events(rig: CommandServerRig, kind: str = "lease") -> list[dict[str, Any]]:
    return [event for event in rig.journal.drain() if event["kind"] == kind]


# --- who may --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("part", "change"), EVERYTHING, ids=str)
@pytest.mark.parametrize("what", ["environment", "active_damping", "perturbation", "measuring"])
def test_holder_excludes_others_from_what_it_holds_and_from_nothing_else(
    rig: CommandServerRig, what: str, part: str, change: dict[str, Any]
) -> None:
    take(rig, A, what)
    rig.run(3)
    before = list(rig.servo.values), rig.servo.state, len(rig.servo.taken)
    reply = rig.ask(B, **change)
    if what not in (part, "measuring"):
        assert reply["ok"]
        return
    assert reply["error"]["code"] == "leased"
    rig.run(3)
    assert (list(rig.servo.values), rig.servo.state, len(rig.servo.taken)) == before
    assert rig.ask(A, **change)["ok"]


@pytest.mark.parametrize(("part", "change"), EVERYTHING, ids=str)
def test_anyone_may_while_nobody_holds_it_and_leaves_no_lease(
    rig: CommandServerRig, part: str, change: dict[str, Any]
) -> None:
    assert rig.ask(A, **change)["ok"]
    assert rig.server.leases.holder(part) is None
    assert rig.ask(B, **change).get("error", {}).get("code") != "leased"


@pytest.mark.parametrize("what", ["environment", "measuring"])
@pytest.mark.parametrize("request_", FREE, ids=str)
def test_stop_disable_reset_and_questions_are_taken_from_anyone(
    rig: CommandServerRig, what: str, request_: dict[str, Any]
) -> None:
    take(rig, A, what)
    rig.ask(A, cmd="enable" if request_["cmd"] != "reset" else "stop")
    assert rig.ask(B, **request_)["ok"]
    expected = {"disable": State.DISABLED, "stop": State.STOPPED, "reset": State.DISABLED}
    assert rig.servo.state == expected.get(request_["cmd"], State.ENABLED)


def test_refusal_names_holder_time_left_and_remedy(rig: CommandServerRig) -> None:
    rig.ask(A, cmd="hello", name="trial")
    actor = take(rig, A, "environment", ttl_s=2.5)["actor"]
    idle(rig, 0.5)
    error = rig.ask(B, cmd="set", K=5)["error"]
    assert error["message"] == (
        f"set: trial (actor {actor}) holds the lease of environment, for 2.0 s more unless it is"
        " renewed; wait until it ends, or take it over with `hapticd lease release environment`"
    )


def test_two_clients_of_one_name_are_two(rig: CommandServerRig) -> None:
    for client in (A, B):
        rig.ask(client, cmd="hello", name="panel")
    take(rig, A, "active_damping")
    assert rig.ask(B, cmd="damping", value="on")["error"]["code"] == "leased"
    assert rig.ask(B, cmd="lease", what="active_damping")["error"]["code"] == "leased"
    assert (
        rig.ask(B, cmd="lease", what="active_damping", action="release")["error"]["code"]
        == "leased"
    )
    assert rig.ask(A, cmd="damping", value="on")["ok"]


def test_measuring_is_refused_while_another_holds_a_part_of_it(rig: CommandServerRig) -> None:
    take(rig, A, "perturbation")
    assert "holds the lease of perturbation" in str(rig.ask(B, cmd="lease", what="measuring"))
    assert not rig.server.leases.measuring
    rig.run(3)
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 1.0


def test_holder_of_a_part_may_take_more(rig: CommandServerRig) -> None:
    take(rig, A, "environment")
    take(rig, A, "measuring")
    assert rig.ask(A, cmd="lease", what="measuring", action="release")["result"]["released"]
    rig.run(2)
    assert rig.ask(B, cmd="damping", value="on")["ok"]
    assert rig.ask(B, cmd="set", K=1)["error"]["code"] == "leased"


@pytest.mark.parametrize(
    "ttl_s", [0, 0.0, -1.0, 0.19, 60.1, 1e9, float("nan"), float("inf"), "5", True, None]
)
def test_time_to_live_that_is_none_is_refused(rig: CommandServerRig, ttl_s: object) -> None:
    assert rig.ask(A, cmd="lease", what="active_damping", ttl_s=ttl_s)["error"]["code"] == "invalid"
    assert rig.server.leases.holders == ()


@pytest.mark.parametrize(
    "fields",
    [
        {"what": "everything"},
        {},
        {"what": "active_damping", "action": "renew", "ttl_s": 1.0},
        {"what": "active_damping", "action": "release", "take_over": True},
        {"what": "active_damping", "at_end": "explode"},
    ],
)
def test_lease_of_nothing_known_is_refused(rig: CommandServerRig, fields: dict[str, Any]) -> None:
    assert rig.ask(A, cmd="lease", **fields)["error"]["code"] == "invalid"
    assert rig.server.leases.holders == ()


@pytest.mark.parametrize("action", ["renew", "release"])
def test_nobodys_lease_is_neither_renewed_nor_released(rig: CommandServerRig, action: str) -> None:
    reply = rig.ask(A, cmd="lease", what="environment", action=action)
    assert "no client holds the lease of environment" in reply["error"]["message"]


# --- how long -------------------------------------------------------------------------------------


def test_silence_ends_a_lease_and_any_request_renews_it(rig: CommandServerRig) -> None:
    take(rig, A, "environment", ttl_s=1.0)
    for _ in range(5):
        idle(rig, 0.9)
        rig.ask(A, cmd="get")
    idle(rig, 0.95)
    assert rig.server.leases.holder("environment")
    idle(rig, 0.1)
    assert rig.server.leases.holder("environment") is None


def test_requests_of_others_renew_nothing(rig: CommandServerRig) -> None:
    take(rig, A, "environment", ttl_s=1.0)
    for _ in range(3):
        idle(rig, 0.5)
        rig.ask(B, cmd="lease", what="environment")
    assert rig.server.leases.holders == (("environment", rig.server.actors.number(B)),)


def test_lost_lease_is_not_renewed_and_says_why(rig: CommandServerRig) -> None:
    take(rig, A, "environment", ttl_s=1.0)
    idle(rig, 1.1)
    for request in (
        {"cmd": "lease", "what": "environment", "action": "renew"},
        {"cmd": "set", "K": 3},
    ):
        error = rig.ask(A, **request)["error"]
        assert "its holder was silent for 1 s" in error["message"]
    assert rig.ask(B, cmd="set", K=2)["ok"]
    assert rig.ask(A, cmd="damping", value=1.0)["ok"]
    result = rig.ask(A, cmd="lease", what="environment", action="release")["result"]
    assert not result["released"]
    assert rig.ask(A, cmd="set", K=3)["ok"]


def test_follow_does_not_change_an_environment_that_another_has_leased(tmp_path: Path) -> None:
    """Who may switch the damping off does not get at K by that."""
    stages = [stage({"K": 10.0}), stage({"active_damping": 0.0}, after_ramps=True)]
    followed = {"action": "stage", "stages": stages, "verdict": verdict(False)}
    worker = StubWorker()
    rig = CommandServerRig(tmp_path, worker)
    rig.run(MOST_RECORDS)
    assert rig.ask(B, cmd="guard", policy="follow")["ok"]
    assert rig.ask(B, cmd="set", K=100, active_damping=1.5)["ok"]
    take(rig, A, "environment")
    worker.script = lambda request: followed
    error = rig.ask(B, cmd="damping", value="off")["error"]
    assert error["code"] == "leased"
    assert "lease of environment" in error["message"]
    idle(rig, 0.2)
    assert rig.servo.values[Value.STIFFNESS] == 100
    assert rig.servo.values[Value.ACTIVE_DAMPING_ON] == 1


def test_lost_lease_can_be_taken_again(rig: CommandServerRig) -> None:
    take(rig, A, "environment", ttl_s=1.0)
    idle(rig, 1.1)
    take(rig, A, "environment")
    assert rig.ask(A, cmd="set", K=3)["ok"]


def test_end_of_the_connection_ends_a_lease_at_once(rig: CommandServerRig) -> None:
    take(rig, A, "environment", ttl_s=60.0)
    rig.server.leave(A)
    assert rig.ask(B, cmd="set", K=2)["ok"]
    assert rig.server.leases.holders == ()


def test_what_a_dead_client_had_asked_takes_no_lease(rig: CommandServerRig) -> None:
    rig.ask(A, cmd="get")
    rig.server.serve(
        [[A, packed(cmd="get")], [A, packed(cmd="lease", what="environment")]],
        rig.clock.now_ns(),
        in_time=lambda: False,
    )
    rig.server.leave(A)
    rig.server.serve([], rig.clock.now_ns())
    assert rig.server.leases.holders == ()


def test_time_in_which_the_gateway_heard_nobody_does_not_count() -> None:
    """It stood still, or its clock jumped: nobody could have renewed meanwhile."""
    leases = Leases()
    leases.advance(100 * NS_PER_S)
    leases.take("active_damping", 16, "a", 2.0, "hold")
    for jump_ns in (50 * NS_PER_S, -90 * NS_PER_S, LATE_NS + 1):
        assert leases.advance(leases._now_ns + jump_ns) == []
        assert leases.shown()["active_damping"]["left_s"] == 2.0
    now_ns = leases._now_ns
    assert leases.advance(now_ns + LATE_NS) == []
    assert leases.shown()["active_damping"]["left_s"] == 1.5


def test_clients_that_come_and_go_push_no_holder_out(rig: CommandServerRig) -> None:
    take(rig, A, "environment", ttl_s=60.0)
    for number in range(300):
        client = f"c{number}".encode()
        assert rig.ask(client, cmd="set", K=1)["error"]["code"] == "leased"
        rig.server.leave(client)
    assert rig.ask(A, cmd="set", K=1)["ok"]


def test_flood_of_takes_changes_nothing_and_keeps_no_stop_waiting(rig: CommandServerRig) -> None:
    take(rig, A, "measuring")
    rig.run(3)
    before = len(rig.servo.taken)
    flood = [packed(cmd="lease", what="environment") for _ in range(90)]
    replies = rig.send(*flood, packed(cmd="stop"), client=B)
    assert {reply["error"]["code"] for reply in replies} == {"leased"}
    rig.run(1)
    assert rig.servo.state is State.STOPPED
    assert [kind for kind, _ in rig.servo.taken[before:]] == [Command.STOP]


# --- taking over ----------------------------------------------------------------------------------


def test_take_over_moves_nothing_and_refuses_the_former_holder(rig: CommandServerRig) -> None:
    take(rig, A, "environment", at_end="disable")
    rig.ask(A, cmd="set", K=120)
    rig.ask(A, cmd="enable")
    events(rig)
    rig.ask(B, cmd="hello", name="operator")
    take(rig, B, "environment", take_over=True)
    rig.run(5)
    assert (rig.servo.state, put(rig, Value.STIFFNESS)) == (State.ENABLED, 120.0)
    actor = rig.server.actors.number(B)
    message = rig.ask(A, cmd="set", K=3)["error"]["message"]
    assert f"was taken over by operator (actor {actor})" in message
    assert [(event["code"], event["actor"]) for event in events(rig)] == [
        ("lease_taken_over", rig.server.actors.number(A)),
        ("lease_taken", actor),
    ]
    assert rig.ask(B, cmd="set", K=3)["ok"]


def test_former_holder_is_refused_though_nobody_holds_it_now(rig: CommandServerRig) -> None:
    take(rig, A, "environment")
    take(rig, B, "environment", take_over=True)
    rig.ask(B, cmd="lease", what="environment", action="release")
    rig.run(2)
    assert rig.ask(A, cmd="set", K=3)["error"]["code"] == "leased"
    assert rig.ask(b"c", cmd="set", K=3)["ok"]


def test_take_over_of_a_part_ends_the_whole_of_measuring(rig: CommandServerRig) -> None:
    take(rig, A, "measuring")
    rig.run(3)
    take(rig, B, "active_damping", take_over=True)
    rig.run(5)
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 1.0
    assert rig.ask(A, cmd="set", K=3)["error"]["code"] == "leased"
    assert rig.ask(b"c", cmd="set", K=3)["ok"]


def test_what_was_scheduled_by_the_former_holder_is_cancelled(rig: CommandServerRig) -> None:
    take(rig, A, "environment")
    at_tick = rig.view.tick + 100
    assert rig.ask(A, cmd="set", K=300, at_tick=at_tick, id=9)["receipt"]["result"] == "scheduled"
    assert (
        rig.ask(A, cmd="set", active_damping=1.5, at_tick=at_tick)["receipt"]["result"]
        == "scheduled"
    )
    take(rig, B, "environment", take_over=True)
    rig.run(200)
    assert put(rig, Value.STIFFNESS) == 0.0
    assert put(rig, Value.ACTIVE_DAMPING) == 1.5  # was not part of it
    assert [(event["id"], event["result"]) for event in events(rig, "answer")] == [
        (9, "cancelled"),
        (None, "applied"),
    ]


def test_what_anyone_scheduled_before_a_lease_is_cancelled_by_it(rig: CommandServerRig) -> None:
    rig.ask(B, cmd="set", K=300, at_tick=rig.view.tick + 100)
    rig.ask(A, cmd="set", B=1, at_tick=rig.view.tick + 100)
    take(rig, A, "environment")
    idle(rig, 0.2)
    assert (put(rig, Value.STIFFNESS), put(rig, Value.VIRTUAL_DAMPING)) == (0.0, 1.0)


# --- what becomes of the display ------------------------------------------------------------------


def rendering(rig: CommandServerRig, what: str, at_end: str) -> None:
    """A holds `what` and renders under force with damping."""
    take(rig, A, what, at_end=at_end, ttl_s=1.0)
    wall = {"side": 1, "stiffness_n_per_m": 900.0}
    rig.ask(A, cmd="set", K=300, B=2, M=0.01, active_damping=1.5, wall=wall)
    rig.ask(A, cmd="enable")


@pytest.mark.parametrize("dies", [True, False], ids=["dies", "is silent"])
@pytest.mark.parametrize("what", ["environment", "active_damping", "perturbation", "measuring"])
@pytest.mark.parametrize("at_end", ["hold", "zero", "disable"])
def test_holder_that_fails_leaves_what_its_lease_says_and_damping(
    rig: CommandServerRig, what: str, at_end: str, dies: bool
) -> None:
    rendering(rig, what, at_end)
    if dies:
        rig.server.leave(A)
    idle(rig, 1.2)
    places = (Value.STIFFNESS, Value.VIRTUAL_DAMPING, Value.MASS, Value.WALL_STIFFNESS)
    zero = at_end == "zero" and what in ("environment", "measuring")
    left = [0.0] * 4 if zero else [300.0, 2.0, 0.01, 900.0]
    assert [put(rig, place) for place in places] == left
    assert rig.servo.state == (State.DISABLED if at_end == "disable" else State.ENABLED)
    assert (put(rig, Value.ACTIVE_DAMPING), put(rig, Value.ACTIVE_DAMPING_ON)) == (1.5, 1.0)
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 1.0


@pytest.mark.parametrize("what", ["active_damping", "perturbation"])
def test_holder_that_fails_leaves_what_another_holds(rig: CommandServerRig, what: str) -> None:
    rendering(rig, "environment", "zero")
    take(rig, B, what, at_end="zero")
    rig.server.leave(B)
    idle(rig, 0.1)
    assert put(rig, Value.STIFFNESS) == 300.0
    assert rig.ask(A, cmd="set", K=5)["ok"]


@pytest.mark.parametrize("at_end", ["hold", "zero", "disable"])
def test_release_and_take_over_move_nothing(rig: CommandServerRig, at_end: str) -> None:
    rendering(rig, "environment", at_end)
    rig.ask(A, cmd="lease", what="environment", action="release")
    rig.run(10)
    assert (put(rig, Value.STIFFNESS), rig.servo.state) == (300.0, State.ENABLED)


def test_left_out_is_as_configured(tmp_path: Path) -> None:
    rig = CommandServerRig(tmp_path)
    assert {take(rig, A, "environment")[name] for name in ("ttl_s", "at_end")} == {
        LeaseParams().ttl_s,
        LeaseParams().at_end,
    }


def test_what_a_dead_holder_had_scheduled_does_not_come(rig: CommandServerRig) -> None:
    rendering(rig, "environment", "zero")
    rig.ask(A, cmd="set", K=500, at_tick=rig.view.tick + 50)
    rig.server.leave(A)
    idle(rig, 0.2)
    assert put(rig, Value.STIFFNESS) == 0.0


def test_request_of_a_dead_holder_that_still_waits_is_dropped(rig: CommandServerRig) -> None:
    rendering(rig, "environment", "zero")
    waiting = [[A, packed(cmd="get")], [A, packed(cmd="set", K=500)]]
    rig.server.serve(waiting, rig.clock.now_ns(), in_time=lambda: False)
    rig.server.leave(A)
    assert rig.server.serve([], rig.clock.now_ns()) == []
    idle(rig, 0.2)
    assert put(rig, Value.STIFFNESS) == 0.0


@pytest.mark.parametrize("what", ["perturbation", "measuring"])
@pytest.mark.parametrize("how", ["dies", "silent", "released", "taken over"])
def test_perturbation_ends_with_the_lease_that_covers_it(
    rig: CommandServerRig, what: str, how: str
) -> None:
    rendering(rig, what, "hold")
    rig.ask(A, cmd="perturb", action="load", samples_n=WAVE)
    rig.ask(A, cmd="perturb", action="start", loop=True)
    assert rig.servo.perturbing
    end(rig, what, how)
    assert not rig.servo.perturbing
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 1.0
    assert rig.servo.state is State.ENABLED


def end(rig: CommandServerRig, what: str, how: str) -> None:
    if how == "dies":
        rig.server.leave(A)
    elif how == "released":
        rig.ask(A, cmd="lease", what=what, action="release")
    elif how == "taken over":
        take(rig, B, "perturbation", take_over=True)
    idle(rig, 1.2)


# --- measuring, and what the records say ----------------------------------------------------------


def test_faults_are_off_while_measuring_and_before_the_next_command(rig: CommandServerRig) -> None:
    rig.send(packed(cmd="lease", what="measuring"), packed(cmd="enable"), client=A)
    rig.run(1)
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 0.0
    assert rig.server.leases.measuring
    rig.run(1)
    assert [kind for kind, _ in rig.servo.taken] == [Command.CANCEL, Command.SET, Command.ENABLE]


def test_faults_that_are_on_again_after_a_stop_are_off_while_measuring(
    rig: CommandServerRig,
) -> None:
    """The servo has them on again whenever force goes off; the lease stays over a stop."""
    take(rig, A, "measuring", ttl_s=60.0)
    rig.ask(A, cmd="enable")
    rig.ask(B, cmd="stop")
    rig.ask(B, cmd="reset")
    rig.run(5)
    assert rig.server.leases.measuring
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 0.0
    rig.ask(A, cmd="lease", what="measuring", action="release")
    rig.run(5)
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 1.0


@pytest.mark.parametrize("how", ["dies", "silent", "released", "taken over"])
def test_nothing_is_judged_while_measuring_and_again_behind_it(
    rig: CommandServerRig, how: str
) -> None:
    assert rig.ask(B, cmd="guard", policy="refuse")["result"]["policy"] == "refuse"
    assert rig.ask(A, cmd="set", K=100)["error"]["code"] == "guard"
    rendering(rig, "measuring", "hold")
    assert rig.guard.policy == "off"
    assert rig.ask(B, cmd="guard", policy="warn")["error"]["code"] == "leased"
    assert put(rig, Value.STIFFNESS) == 300.0
    end(rig, "measuring", how)
    assert rig.guard.policy == "refuse"
    assert rig.ask(b"c", cmd="set", K=100).get("error", {}).get("code") == "guard"


def test_records_name_the_holders(rig: CommandServerRig) -> None:
    def shown() -> tuple[int, int]:
        return rig.view.record["lease_control"], rig.view.record["lease_active_damping"]

    assert shown() == (0, 0)
    a = take(rig, A, "environment")["actor"]
    b = take(rig, B, "active_damping")["actor"]
    rig.run(5)
    assert shown() == (a, b)
    rig.ask(A, cmd="lease", what="environment", action="release")
    rig.run(5)
    assert shown() == (0, b)


def test_servo_is_told_once(rig: CommandServerRig) -> None:
    take(rig, A, "measuring")
    rig.run(3)
    before = len(rig.servo.taken)
    idle(rig, 0.5)
    assert len(rig.servo.taken) == before


def test_new_servo_is_told_who_holds_what(rig: CommandServerRig) -> None:
    actor = take(rig, A, "measuring", ttl_s=60.0)["actor"]
    rig.servo.mailbox.close()
    rig.servo = StandInServo(rig.folder, rig.clock)
    idle(rig, 0.5)
    assert rig.view.record["lease_control"] == actor
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 0.0
    assert rig.servo.state is State.DISABLED


@pytest.mark.parametrize("at_end", ["zero", "disable"])
def test_what_is_due_at_the_end_of_a_lease_is_not_posted_to_the_next_servo(
    rig: CommandServerRig, at_end: str
) -> None:
    rendering(rig, "environment", at_end)
    rig.servo.mailbox.close()
    rig.pass_time(500)
    rig.server.leave(A)  # no client is left
    rig.look()
    rig.servo = StandInServo(rig.folder, rig.clock)
    idle(rig, 0.5)
    assert rig.servo.taken == []


def test_transition_waits_for_room_in_the_ring(rig: CommandServerRig) -> None:
    rendering(rig, "environment", "disable")
    rig.servo.deaf = True
    while rig.view.mailbox and rig.view.mailbox.post(
        Command.DAMPING, 1, 0, layout.values_of({Value.ACTIVE_DAMPING_ON: 1.0})
    ):
        pass
    rig.server.leave(A)
    rig.look()
    rig.servo.deaf = False
    idle(rig, 1.0)
    assert rig.servo.state is State.DISABLED


@pytest.mark.parametrize("at_end", ["hold", "zero", "disable"])
def test_leases_of_a_gateway_that_died_end_as_configured(tmp_path: Path, at_end: str) -> None:
    """Its connections died with it; that of a lease it does not know how to end."""
    rig = CommandServerRig(tmp_path)
    rendering(rig, "measuring", "hold")
    rig.ask(A, cmd="perturb", action="load", samples_n=WAVE)
    rig.ask(A, cmd="perturb", action="start", loop=True)
    rig.view.drop()
    rig.start_gateway(LeaseParams(at_end=at_end))
    idle(rig, 0.3)
    assert put(rig, Value.STIFFNESS) == (0.0 if at_end == "zero" else 300.0)
    assert rig.servo.state == (State.DISABLED if at_end == "disable" else State.ENABLED)
    assert (rig.view.record["lease_control"], rig.view.record["lease_active_damping"]) == (0, 0)
    assert not rig.servo.perturbing
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 1.0
    assert put(rig, Value.ACTIVE_DAMPING_ON) == 1.0
    assert "of the gateway before" in str(rig.journal.recent)


@pytest.mark.parametrize(("what", "zeroed"), [("environment", True), ("active_damping", False)])
def test_gateway_before_is_known_by_what_its_clients_held(
    rig: CommandServerRig, what: str, zeroed: bool
) -> None:
    rendering(rig, what, "hold")
    rig.ask(A, cmd="perturb", action="load", samples_n=WAVE)
    rig.ask(A, cmd="perturb", action="start", loop=True)
    rig.view.drop()
    rig.start_gateway(LeaseParams(at_end="zero"))
    idle(rig, 0.3)
    assert (put(rig, Value.STIFFNESS) == 0.0) == zeroed
    assert rig.servo.perturbing  # of that lease nothing says that it was held
    assert (rig.view.record["lease_control"], rig.view.record["lease_active_damping"]) == (0, 0)


def test_restart_of_a_gateway_without_leases_moves_nothing(rig: CommandServerRig) -> None:
    rig.ask(A, cmd="set", K=300)
    rig.view.drop()
    rig.start_gateway()
    taken = len(rig.servo.taken)
    idle(rig, 0.3)
    assert put(rig, Value.STIFFNESS) == 300.0
    assert len(rig.servo.taken) - taken <= 1  # it asks what is in force


def test_may_has_no_side_effect_and_speaks_of_the_holder() -> None:
    leases = Leases()
    leases.advance(10 * NS_PER_S)
    leases.take("active_damping", 16, "panel", 1.0, "hold")
    assert leases.may(16, "active_damping") is None
    assert leases.may(17, "environment") is None
    found = leases.may(17, "measuring")
    assert isinstance(found, CommandError)
    assert "panel (actor 16)" in str(found)
    leases.advance(10 * NS_PER_S + 400 * NS_PER_MS)
    assert leases.shown()["active_damping"]["left_s"] == 0.6


# --- all together ---------------------------------------------------------------------------------


def test_leases_stay_over_a_stop_and_a_reset(rig: CommandServerRig) -> None:
    """A stop ends force, not a session: who held the environment has it behind the reset too."""
    take(rig, A, "environment", ttl_s=30.0)
    rig.ask(A, cmd="enable")
    rig.ask(B, cmd="stop")
    rig.ask(B, cmd="reset")
    assert rig.ask(B, cmd="enable")["error"]["code"] == "leased"
    assert rig.ask(A, cmd="enable")["ok"]


def test_two_that_take_over_from_each_other_without_end_keep_no_stop_waiting(
    rig: CommandServerRig,
) -> None:
    """What follows from a lease is done once, however often it was asked for meanwhile."""
    rig.ask(A, cmd="enable")
    rig.servo.deaf = True
    for _ in range(300):
        for client in (A, B):
            rig.send(packed(cmd="lease", what="measuring", take_over=True), client=client)
    rig.servo.deaf = False
    rig.send(packed(cmd="stop"), client=A)
    rig.run(2)
    assert rig.servo.state is State.STOPPED
    idle(rig, 0.5)
    assert rig.view.record["lease_control"] == rig.server.actors.number(B)
    assert put(rig, Value.LIMIT_CYCLE_FAULTS) == 0.0
    assert len(rig.servo.taken) < 100


class Parts:
    """Leases by hand: who has each part, by which lease, and until when."""

    def __init__(self) -> None:
        self.of: dict[str, tuple[int, str, int]] = {}  # actor, what, deadline in ns

    def drop(self, actor: int, what: str) -> None:
        self.of = {part: one for part, one in self.of.items() if one[:2] != (actor, what)}


COVERED = {
    "environment": ("environment",),
    "active_damping": ("active_damping",),
    "perturbation": ("perturbation",),
    "measuring": ("environment", "active_damping", "perturbation"),
}


@pytest.mark.parametrize("seed", range(20))
def test_no_part_ever_has_two_holders_and_every_end_is_told_once(seed: int) -> None:
    """500 random requests of four actors, each of whom holds one lease at a time; against parts
    that are kept by hand.
    """
    random = np.random.default_rng(seed)
    leases = Leases()
    parts = Parts()
    now_ns = 10 * NS_PER_S
    leases.advance(now_ns)
    for _ in range(500):
        actor = int(random.integers(16, 20))
        what = str(random.choice(list(COVERED)))
        ttl_s = float(random.choice([0.2, 1.0, 5.0]))
        mine = {one[1] for one in parts.of.values() if one[0] == actor}
        act = str(random.choice(["take", "over", "release", "heard", "leave", "wait"]))
        others = {parts.of[part][:2] for part in COVERED[what] if part in parts.of} - {
            (actor, one) for one in COVERED
        }
        if act == "wait":
            now_ns += int(random.integers(1, 400)) * NS_PER_MS
            late = {one[:2] for one in parts.of.values() if one[2] <= now_ns}
            ended = leases.advance(now_ns)
            assert {(one.lease.actor, one.lease.what) for one in ended} == late
            assert {one.how for one in ended} <= {"lease_silent"}
            for one in late:
                parts.drop(*one)
        elif act in ("take", "over") and mine <= {what}:
            if others and act == "take":
                with pytest.raises(CommandError, match="holds the lease"):
                    leases.take(what, actor, "x", ttl_s, "hold")
                continue
            ended = leases.take(what, actor, "x", ttl_s, "hold", act == "over")
            assert {(one.lease.actor, one.lease.what) for one in ended} == others
            for one in others:
                parts.drop(*one)
            for part in COVERED[what]:
                parts.of[part] = actor, what, now_ns + round(ttl_s * NS_PER_S)
        elif act == "release" and what in mine:
            assert leases.release(what, actor).how == "lease_released"
            parts.drop(actor, what)
        elif act == "leave":
            assert {one.lease.what for one in leases.leave(actor)} == mine
            for one_what in mine:
                parts.drop(actor, one_what)
        elif act == "heard":
            ttls = {one: leases.shown()[one]["ttl_s"] for one in mine}
            leases.heard(actor)
            parts.of = {
                part: (actor, one[1], now_ns + round(ttls[one[1]] * NS_PER_S))
                if one[0] == actor
                else one
                for part, one in parts.of.items()
            }
        assert {p: (h.actor, h.what) for p in COVERED["measuring"] if (h := leases.holder(p))} == {
            part: one[:2] for part, one in parts.of.items()
        }
        assert leases.measuring == any(one[1] == "measuring" for one in parts.of.values())
