"""Requests in, replies out: receipts, refusals, stops, deadlines, and a servo that comes and goes."""

import json
from pathlib import Path

import pytest
from gateway_rig import DeskRig, decoded, packed
from gateway_stand_in import StandInServo

from hapticd.mailbox import files, layout
from hapticd.mailbox.layout import Command, State, Value


@pytest.fixture
def rig(tmp_path: Path) -> DeskRig:
    return DeskRig(tmp_path)


def test_set_gives_its_own_receipt(rig: DeskRig) -> None:
    reply = rig.ask(cmd="set", id=7, K=100, B=1, M=0.010, damping=1.74, wall={"side": 1}, filters={"velocity_hz": 200})
    receipt = reply["receipt"]
    assert (reply["ok"], reply["id"], reply["rev"], reply["state"]) == (True, 7, 1, "disabled")
    assert (receipt["result"], receipt["first_tick"], receipt["ramp_end_tick"]) == ("applied", 2, 52)
    effective = receipt["effective"]
    assert (effective["K"], effective["B"], effective["M"], effective["damping"]) == (100.0, 1.0, 0.010, 1.74)
    assert effective["wall"]["side"] == 1
    assert effective["filters"]["velocity_hz"] == 200.0


def test_effective_can_be_set_again(rig: DeskRig) -> None:
    rig.ask(cmd="set", K=50, B=2, damping=1.0, wall={"side": -1, "stiffness_n_per_m": 500.0})
    first = rig.ask(cmd="get")["result"]["parameters"]
    level = first.pop("damping_level")
    assert rig.ask(cmd="set", **first)["receipt"]["effective"] == {**first, "damping_level": level}


def test_only_given_values_are_posted(rig: DeskRig) -> None:
    rig.servo.deaf = True
    rig.send(packed(cmd="set", K=100, ramp_s=0.5))
    *_, values = rig.servo.mailbox.take() or ()
    assert values[Value.MASK] == (1 << Value.STIFFNESS) + (1 << Value.RAMP_S)
    assert (values[Value.STIFFNESS], values[Value.RAMP_S]) == (100.0, 0.5)


@pytest.mark.parametrize(
    ("value", "meant"),
    [("on", {Value.ADDED_DAMPING_ON: 1.0}), ("off", {Value.ADDED_DAMPING_ON: 0.0}), (0, {Value.ADDED_DAMPING_ON: 0.0}),
     (1.5, {Value.ADDED_DAMPING: 1.5, Value.ADDED_DAMPING_ON: 1.0})],
)  # fmt: skip
def test_damping_switches_or_sets_level(rig: DeskRig, value: object, meant: dict[Value, float]) -> None:
    rig.servo.deaf = True
    rig.send(packed(cmd="damping", value=value))
    _, kind, _, _, values = rig.servo.mailbox.take() or ()
    assert kind == Command.DAMPING
    assert values[Value.MASK] == sum(1 << place for place in meant)
    assert {place: values[place] for place in meant} == meant


def test_json_is_answered_in_json(rig: DeskRig) -> None:
    (reply,) = rig.desk.serve([[b"a", b'{"cmd":"get","id":"x1"}']], rig.clock.now_ns())
    assert json.loads(reply[-1])["id"] == "x1"


def test_req_socket_gets_its_delimiter_back(rig: DeskRig) -> None:
    (reply,) = rig.desk.serve([[b"a", b"", packed(cmd="hello")]], rig.clock.now_ns())
    assert reply[:2] == [b"a", b""]


def test_state_in_reply_is_not_older_than_command(rig: DeskRig) -> None:
    assert [rig.ask(cmd=cmd)["state"] for cmd in ("enable", "disable", "stop", "reset")] == [
        "enabled", "disabled", "stopped", "disabled",
    ]  # fmt: skip


def test_reply_waits_for_record_in_force(rig: DeskRig) -> None:
    rig.send(packed(cmd="enable"))
    rig.servo._obey()  # the answer is there, the record of that tick is not
    assert rig.look() == []
    assert decoded(rig.run()[0])["state"] == "enabled"


@pytest.mark.parametrize("cmd", ["enable", "zero", "home"])
def test_latched_state_is_refused_early(rig: DeskRig, cmd: str) -> None:
    rig.ask(cmd="stop")
    (reply,) = rig.send(packed(cmd=cmd))
    assert reply["error"]["code"] == "stopped"
    assert (
        reply["error"]["message"]
        == f"{cmd} in state stopped (someone asked for a stop): make sure it is safe, then `hapticd reset`"
    )
    assert rig.servo.mailbox.take() is None


def test_early_refusal_waits_for_settled_state(rig: DeskRig) -> None:
    rig.ask(cmd="stop")
    assert rig.send(packed(cmd="reset"), packed(cmd="enable")) == []
    assert [decoded(reply)["ok"] for reply in rig.run()] == [True, True]
    assert rig.view.state is State.ENABLED


def test_servo_has_the_last_word(rig: DeskRig) -> None:
    rig.send(packed(cmd="enable"), packed(cmd="zero"))
    replies = [decoded(reply) for reply in rig.run()]
    assert replies[1]["error"] == {
        "code": "refused", "message": "zero in state enabled: possible only in disabled", "detail": [],
    }  # fmt: skip


def test_home_without_a_way_home_says_so(rig: DeskRig) -> None:
    rig.ask(cmd="enable")
    assert "device file names no way to home" in rig.ask(cmd="home")["error"]["message"]


def test_if_rev_compares_and_sets(rig: DeskRig) -> None:
    assert rig.ask(cmd="set", K=1, if_rev=0)["ok"]
    error = rig.ask(cmd="set", K=2, if_rev=0)["error"]
    assert error["code"] == "refused"
    assert error["message"] == "if_rev = 0: the revision is 1; look at what changed and ask again"
    replies = rig.send(packed(cmd="set", K=3), packed(cmd="set", K=4, if_rev=1))
    assert replies[0]["error"]["code"] == "busy"


def test_scheduled_set_is_told_twice(rig: DeskRig) -> None:
    reply = rig.ask(cmd="set", K=10, at_tick=9, id="later")
    assert (reply["receipt"]["result"], reply["receipt"]["first_tick"]) == ("scheduled", 9)
    assert rig.journal.drain() == []
    rig.run(9)
    (event,) = rig.journal.drain()
    assert (event["kind"], event["id"], event["result"], event["first_tick"]) == ("answer", "later", "applied", 9)
    assert event["effective"]["K"] == 10.0


def test_late_at_tick_is_refused(rig: DeskRig) -> None:
    error = rig.ask(cmd="set", K=10, at_tick=1)["error"]
    assert error["code"] == "refused"
    assert error["message"] == "set: at_tick has passed, it is tick 2; choose a later one"


def test_stop_goes_first_in_a_flood(rig: DeskRig) -> None:
    rig.send(*[packed(cmd="set", K=k) for k in range(19)], packed(cmd="stop"))
    rig.run()
    assert rig.servo.taken[0][0] == Command.STOP
    assert rig.view.state is State.STOPPED


def test_stop_behind_others_presses_the_page(rig: DeskRig) -> None:
    rig.send(*[packed(cmd="set", K=k) for k in range(10)])
    rig.send(packed(cmd="stop"))
    rig.run()
    assert rig.view.state is State.STOPPED
    assert Command.STOP not in [kind for kind, _ in rig.servo.taken]


def test_stop_with_a_full_ring_is_pressed(rig: DeskRig) -> None:
    rig.servo.deaf = True
    assert rig.send(*[packed(cmd="get" if k < 0 else "set", K=k) for k in range(64)]) == []
    (reply,) = rig.send(packed(cmd="stop"))
    assert (reply["ok"], reply["receipt"]["result"]) == (True, "pressed")
    rig.run()
    assert rig.view.state is State.STOPPED


def test_stop_needs_nothing_but_its_name(rig: DeskRig) -> None:
    assert rig.ask(cmd="stop", v=99, id=10**30 % 2**64, nonsense=[1])["ok"]


def test_stop_is_idempotent(rig: DeskRig) -> None:
    assert [rig.ask(cmd="stop")["state"] for _ in range(3)] == ["stopped"] * 3


def test_full_ring_is_busy(rig: DeskRig) -> None:
    rig.servo.deaf = True
    rig.send(*[packed(cmd="set", K=k) for k in range(64)])
    (reply,) = rig.send(packed(cmd="set", K=1))
    assert reply["error"]["code"] == "busy"
    assert "64 commands wait" in reply["error"]["message"]


def test_unanswered_command_times_out(rig: DeskRig) -> None:
    rig.servo.mute = True
    rig.send(packed(cmd="enable", id=3))
    assert rig.run(999) == []
    (reply,) = rig.run(1)
    assert decoded(reply)["id"] == 3
    assert decoded(reply)["error"]["code"] == "timeout"
    assert "no answer from the servo within 1 s" in decoded(reply)["error"]["message"]


@pytest.mark.parametrize(
    ("request_", "undo"),
    [
        ({"cmd": "enable"}, Command.DISABLE),
        ({"cmd": "home"}, Command.DISABLE),
        ({"cmd": "perturb", "action": "start"}, Command.PERTURB_STOP),
        ({"cmd": "set", "K": 1.0}, None),
    ],
)
def test_force_that_was_not_answered_is_taken_back(rig: DeskRig, request_: dict[str, object], undo: Command | None) -> None:
    """A servo that hung for seconds would obey in its first tick after that, when nobody expects it any more."""
    rig.ask(cmd="perturb", action="load", samples_n=[0.1] * 8)
    if request_["cmd"] == "perturb":
        rig.ask(cmd="enable")
    rig.servo.deaf = True
    rig.send(packed(**request_))
    (reply,) = rig.run(1000)
    message = decoded(reply)["error"]["message"]
    assert message.endswith("it is taken back" if undo else "whether it acts is open, ask with `get` or `status`")
    posted = [rig.servo.mailbox.take() for _ in range(2)]
    assert [one and one[1] for one in posted][1] == undo


def test_stop_is_posted_although_its_page_is_gone(rig: DeskRig) -> None:
    (rig.folder / files.STOP).unlink()
    rig.send(*[packed(cmd="set", K=k) for k in range(10)])
    rig.send(packed(cmd="stop"))
    rig.run(6)
    assert rig.view.state is State.STOPPED


def test_silent_servo_is_down(rig: DeskRig) -> None:
    rig.pass_time(999)
    assert rig.view.alive
    rig.pass_time(1)
    error = rig.send(packed(cmd="set", K=1))[0]["error"]
    assert error["code"] == "servo_down"
    assert error["message"] == "set: no servo answers; start it with `hapticd run`, see `hapticd status`"
    assert rig.view.state_name == "down"


def test_silent_servo_still_gets_the_stop_page(rig: DeskRig) -> None:
    rig.pass_time(2000)
    assert rig.send(packed(cmd="stop"))[0]["error"]["code"] == "servo_down"
    assert rig.servo.mailbox.stop_words[0] == 1


def test_gateway_alone_answers_servo_down(tmp_path: Path, rig: DeskRig) -> None:
    rig.servo.mailbox.close()
    rig.pass_time(5)
    assert [rig.send(packed(cmd=cmd))[0]["error"]["code"] for cmd in ("get", "enable", "stop")] == ["servo_down"] * 3
    assert rig.send(packed(cmd="status"))[0]["state"] == "down"


def test_restarted_servo_is_taken_up(rig: DeskRig) -> None:
    rig.ask(cmd="set", K=100)
    rig.servo.mute = True
    rig.send(packed(cmd="set", K=5, id=1))
    rig.servo.mailbox.close()
    rig.servo = StandInServo(rig.folder, rig.clock)
    rig.servo.tick()
    (reply,) = rig.pass_time(100)
    assert decoded(reply)["error"]["code"] == "servo_down"
    assert "ended before it answered" in decoded(reply)["error"]["message"]
    rig.run()
    assert rig.ask(cmd="get")["rev"] == 0
    assert rig.ask(cmd="set", K=7)["receipt"]["revision"] == 1


def test_killed_servo_leaves_no_ghost(rig: DeskRig) -> None:
    rig.servo.mailbox.close(clean=False)
    rig.servo.mailbox.store(layout.EPOCH_WORD, rig.view.mailbox.epoch)  # as after SIGKILL: the old file says it lives
    rig.servo = StandInServo(rig.folder, rig.clock)
    rig.servo.tick()
    rig.pass_time(100)
    assert rig.view.life == 2
    assert rig.ask(cmd="set", K=7)["ok"]


def test_restarted_gateway_learns_the_parameters(rig: DeskRig) -> None:
    rig.ask(cmd="set", K=123, wall={"position_m": 0.02})
    rig.start_gateway()
    rig.run()
    rig.run()
    parameters = rig.ask(cmd="get")["result"]["parameters"]
    assert (parameters["K"], parameters["wall"]["position_m"]) == (123.0, 0.02)
    assert rig.servo.revision == 1


def test_each_client_is_an_actor_with_a_name(rig: DeskRig) -> None:
    first = rig.ask(b"a", cmd="hello", name="sweep")["result"]["actor"]
    second = rig.ask(b"b", cmd="hello", name="panel")["result"]["actor"]
    rig.ask(b"b", cmd="set", K=1)
    assert second == first + 1
    assert rig.view.record["actor"] == second
    assert rig.desk.actors.name(second) == "panel"


def test_actor_table_is_bounded(rig: DeskRig) -> None:
    for number in range(1000):
        rig.send(packed(cmd="hello"), client=str(number).encode())
    assert len(rig.desk.actors.names()) == 64


def test_hello_tells_limits_of_this_device(rig: DeskRig) -> None:
    limits = rig.ask(cmd="hello")["result"]["limits"]
    assert limits["damping"] == {"low": 0.0, "high": 2.0, "unit": "N s/m"}
    assert limits["filters.velocity_hz"]["high"] == 450.0


def test_schema_carries_units_and_limits(rig: DeskRig) -> None:
    schema = rig.ask(cmd="schema")["result"]
    assert schema["$defs"]["Set"]["properties"]["damping"]["maximum"] == 2.0
    assert schema["$defs"]["Wall"]["properties"]["stiffness_n_per_m"]["unit"] == "N/m"
    assert set(schema["discriminator"]["mapping"]) == {
        "hello", "get", "set", "damping", "enable", "disable", "stop", "reset", "zero", "home", "perturb", "status", "dump",
        "schema",
    }  # fmt: skip


def test_counts_requests_and_errors(rig: DeskRig) -> None:
    rig.send(packed(cmd="hello"), b"junk")
    assert rig.ask(cmd="status")["result"]["requests"] == {"requests": 3, "errors": 1, "timeouts": 0}
