"""Requests in, replies out: receipts, refusals, stops, deadlines, and a servo that comes and goes.

Newtons into probe counts: every sample checked before any is written.
"""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from support.gateway_rig import CommandServerRig, decoded, packed
from support.gateway_stand_in import StandInServo

from hapticd.client.formatting import event_words
from hapticd.core.faults import BY_CODE
from hapticd.mailbox import files, layout
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import (
    COMMAND_VALUES,
    PERTURBATION_SAMPLES,
    Command,
    Result,
    State,
    Value,
)
from hapticd.protocol.answers import Event, answer_of
from hapticd.protocol.commands import refusal
from hapticd.protocol.journal import Actors
from hapticd.usb.frames import StatusBit


@pytest.fixture
def rig(tmp_path: Path) -> CommandServerRig:
    return CommandServerRig(tmp_path)


def test_set_gives_its_own_receipt(rig: CommandServerRig) -> None:
    reply = rig.ask(
        cmd="set",
        id=7,
        K=100,
        B=1,
        M=0.010,
        active_damping=1.74,
        wall={"side": 1},
        filters={"velocity_hz": 200},
    )
    receipt = reply["receipt"]
    assert (reply["ok"], reply["id"], reply["rev"], reply["state"]) == (True, 7, 1, "disabled")
    assert (receipt["result"], receipt["first_tick"], receipt["ramp_end_tick"]) == (
        "applied",
        2,
        52,
    )
    effective = receipt["effective"]
    assert (effective["K"], effective["B"], effective["M"], effective["active_damping"]) == (
        100.0,
        1.0,
        0.010,
        1.74,
    )
    assert effective["wall"]["side"] == 1
    assert effective["filters"]["velocity_hz"] == 200.0


def test_effective_can_be_set_again(rig: CommandServerRig) -> None:
    rig.ask(cmd="set", K=50, B=2, active_damping=1.0, wall={"side": -1, "stiffness_n_per_m": 500.0})
    first = rig.ask(cmd="get")["result"]["parameters"]
    level = first.pop("active_damping_level")
    assert rig.ask(cmd="set", **first)["receipt"]["effective"] == {
        **first,
        "active_damping_level": level,
    }


def test_only_given_values_are_posted(rig: CommandServerRig) -> None:
    rig.servo.deaf = True
    rig.send(packed(cmd="set", K=100, ramp_s=0.5))
    *_, values = rig.servo.mailbox.take() or ()
    assert values[Value.MASK] == (1 << Value.STIFFNESS) + (1 << Value.RAMP_S)
    assert (values[Value.STIFFNESS], values[Value.RAMP_S]) == (100.0, 0.5)


@pytest.mark.parametrize(
    ("value", "meant"),
    [
        ("on", {Value.ACTIVE_DAMPING_ON: 1.0}),
        ("off", {Value.ACTIVE_DAMPING_ON: 0.0}),
        (0, {Value.ACTIVE_DAMPING_ON: 0.0}),
        (1.5, {Value.ACTIVE_DAMPING: 1.5, Value.ACTIVE_DAMPING_ON: 1.0}),
    ],
)
def test_damping_switches_or_sets_level(
    rig: CommandServerRig, value: object, meant: dict[Value, float]
) -> None:
    rig.servo.deaf = True
    rig.send(packed(cmd="damping", value=value))
    _, kind, _, _, values = rig.servo.mailbox.take() or ()
    assert kind == Command.DAMPING
    assert values[Value.MASK] == sum(1 << place for place in meant)
    assert {place: values[place] for place in meant} == meant


def test_json_is_answered_in_json(rig: CommandServerRig) -> None:
    (reply,) = rig.server.serve([[b"a", b'{"cmd":"get","id":"x1"}']], rig.clock.now_ns())
    assert json.loads(reply[-1])["id"] == "x1"


def test_req_socket_gets_its_delimiter_back(rig: CommandServerRig) -> None:
    (reply,) = rig.server.serve([[b"a", b"", packed(cmd="hello")]], rig.clock.now_ns())
    assert reply[:2] == [b"a", b""]


def test_state_in_reply_is_not_older_than_command(rig: CommandServerRig) -> None:
    assert [rig.ask(cmd=cmd)["state"] for cmd in ("enable", "disable", "stop", "reset")] == [
        "enabled", "disabled", "stopped", "disabled",
    ]  # fmt: skip


def test_reply_waits_for_record_in_force(rig: CommandServerRig) -> None:
    rig.send(packed(cmd="enable"))
    rig.servo._obey()  # the answer is there, the record of that tick is not
    assert rig.look() == []
    assert decoded(rig.run()[0])["state"] == "enabled"


@pytest.mark.parametrize("cmd", ["enable", "zero", "home"])
def test_latched_state_is_refused_early_with_who_stopped(rig: CommandServerRig, cmd: str) -> None:
    rig.ask(cmd="hello", name="second page")
    rig.ask(cmd="stop")
    (reply,) = rig.send(packed(cmd=cmd), client=b"b")
    assert reply["error"]["code"] == "stopped"
    assert (
        reply["error"]["message"]
        == f"{cmd} in state stopped (by second page): make sure it is safe, then `hapticd reset`"
    )
    assert rig.servo.mailbox.take() is None


def test_stop_from_before_this_gateway_is_nobodys_it_knows(rig: CommandServerRig) -> None:
    rig.ask(cmd="stop")
    rig.start_gateway()
    rig.run(2)
    (reply,) = rig.send(packed(cmd="zero"))
    assert "zero in state stopped (a stop was requested): make sure" in reply["error"]["message"]


def test_early_refusal_waits_for_settled_state(rig: CommandServerRig) -> None:
    rig.ask(cmd="stop")
    assert rig.send(packed(cmd="reset"), packed(cmd="enable")) == []
    assert [decoded(reply)["ok"] for reply in rig.run()] == [True, True]
    assert rig.view.state is State.ENABLED


def test_servo_has_the_last_word(rig: CommandServerRig) -> None:
    rig.send(packed(cmd="enable"), packed(cmd="zero"))
    replies = [decoded(reply) for reply in rig.run()]
    assert replies[1]["error"] == {
        "code": "refused_state",
        "message": "zero in state enabled: possible only in disabled; `hapticd disable` first",
        "detail": [],
    }


def test_home_without_a_way_home_says_so(rig: CommandServerRig) -> None:
    rig.ask(cmd="enable")
    assert "device file names no way to home" in rig.ask(cmd="home")["error"]["message"]


def test_if_rev_compares_and_sets(rig: CommandServerRig) -> None:
    assert rig.ask(cmd="set", K=1, if_rev=0)["ok"]
    error = rig.ask(cmd="set", K=2, if_rev=0)["error"]
    assert error["code"] == "refused_revision"
    assert error["message"] == "if_rev = 0: the revision is 1; check the change and ask again"
    replies = rig.send(packed(cmd="set", K=3), packed(cmd="set", K=4, if_rev=1))
    assert replies[0]["error"]["code"] == "busy"


def test_scheduled_set_is_told_twice(rig: CommandServerRig) -> None:
    reply = rig.ask(cmd="set", K=10, at_tick=9, id="later")
    assert (reply["receipt"]["result"], reply["receipt"]["first_tick"]) == ("scheduled", 9)
    assert rig.journal.drain() == []
    rig.run(9)
    (event,) = rig.journal.drain()
    assert (event["kind"], event["id"], event["result"], event["first_tick"]) == (
        "answer",
        "later",
        "applied",
        9,
    )
    assert event["effective"]["K"] == 10.0


def test_late_at_tick_is_refused(rig: CommandServerRig) -> None:
    error = rig.ask(cmd="set", K=10, at_tick=1)["error"]
    assert error["code"] == "refused_late"
    assert error["message"] == "set: at_tick has passed, it is tick 2; choose a later one"


def test_filters_that_are_felt_are_refused_in_words(rig: CommandServerRig, monkeypatch) -> None:
    refused = Result.REFUSED_FILTER
    monkeypatch.setattr(rig.servo, "_apply", lambda one: rig.servo._answer(one[0], refused))
    error = rig.ask(cmd="set", filters={"velocity_hz": 30})["error"]
    assert error["code"] == "refused_filter"
    assert error["message"] == (
        "set: filters change only while the device is disabled, or while damping, mass and the"
        " wall's damping are 0, none of them on its way; `hapticd disable`, then ask again"
    )


def test_stop_goes_first_in_a_flood(rig: CommandServerRig) -> None:
    rig.send(*[packed(cmd="set", K=k) for k in range(19)], packed(cmd="stop"))
    rig.run()
    assert rig.servo.taken[0][0] == Command.STOP
    assert rig.view.state is State.STOPPED


def test_stop_behind_others_presses_the_page(rig: CommandServerRig) -> None:
    rig.send(*[packed(cmd="set", K=k) for k in range(10)])
    rig.send(packed(cmd="stop"))
    rig.run()
    assert rig.view.state is State.STOPPED
    assert Command.STOP not in [kind for kind, _ in rig.servo.taken]


def test_stop_with_a_full_ring_is_pressed(rig: CommandServerRig) -> None:
    rig.servo.deaf = True
    assert rig.view.mailbox is not None
    while rig.view.mailbox.post(Command.PERTURB_STOP, 2, 0, layout.values_of({})):
        pass
    (reply,) = rig.send(packed(cmd="stop"))
    assert (reply["ok"], reply["receipt"]["result"]) == (True, "pressed")
    rig.run()
    assert rig.view.state is State.STOPPED


def test_stop_needs_nothing_but_its_name(rig: CommandServerRig) -> None:
    assert rig.ask(cmd="stop", v=99, id=10**30 % 2**64, nonsense=[1])["ok"]


def test_stop_is_idempotent(rig: CommandServerRig) -> None:
    assert [rig.ask(cmd="stop")["state"] for _ in range(3)] == ["stopped"] * 3


def test_full_ring_is_busy(rig: CommandServerRig) -> None:
    rig.servo.deaf = True
    rig.send(*[packed(cmd="set", K=k) for k in range(56)])
    (reply,) = rig.send(packed(cmd="set", K=1))
    assert reply["error"]["code"] == "busy"
    assert "56 commands wait" in reply["error"]["message"]


def test_full_ring_has_room_for_a_stop(rig: CommandServerRig) -> None:
    rig.servo.deaf = True
    rig.send(*[packed(cmd="set", K=k) for k in range(57)])
    backlog = rig.view.mailbox.backlog if rig.view.mailbox else 0
    assert rig.send(packed(cmd="stop")) == []
    assert rig.view.mailbox
    assert rig.view.mailbox.backlog == backlog + 1


def test_unanswered_command_times_out(rig: CommandServerRig) -> None:
    rig.servo.mute = True
    rig.send(packed(cmd="enable", id=3))
    assert rig.run(999) == []
    (reply,) = rig.run(1)
    assert decoded(reply)["id"] == 3
    assert decoded(reply)["error"]["code"] == "timeout"
    assert "no answer from the servo within 1 s" in decoded(reply)["error"]["message"]


@pytest.mark.parametrize("servo", ["deaf", "mute"])
@pytest.mark.parametrize(
    ("request_", "undo"),
    [
        ({"cmd": "enable"}, Command.DISABLE),
        ({"cmd": "home"}, Command.DISABLE),
        ({"cmd": "perturb", "action": "start"}, Command.PERTURB_STOP),
        ({"cmd": "set", "K": 1.0}, None),
    ],
)
def test_force_that_was_not_answered_is_taken_back(
    rig: CommandServerRig, request_: dict[str, object], undo: Command | None, servo: str
) -> None:
    """A servo that hung for seconds would obey in its first tick after that, when nobody
    expects it any more. Of one that gives no answer it is not known whether it has obeyed.
    """
    rig.ask(cmd="perturb", action="load", samples_n=[0.1] * 8)
    if request_["cmd"] == "perturb":
        rig.ask(cmd="enable")
    setattr(rig.servo, servo, True)
    rig.send(packed(**request_))
    (reply,) = rig.run(1000)
    message = decoded(reply)["error"]["message"]
    known = undo is not None or servo == "deaf"
    assert message.endswith(
        "it was withdrawn" if known else "it may still act: check with `get` or `status`"
    )
    posted = [rig.servo.mailbox.take() for _ in range(2)]
    # withdrawn and undone: a servo suspended in the middle of taking it has a copy
    expected = [Command.WITHDRAWN, undo] if servo == "deaf" else [undo, None]
    assert [one and one[1] for one in posted] == expected


def test_client_that_leaves_does_not_fill_the_ring_with_what_undoes_its_commands(
    rig: CommandServerRig,
) -> None:
    rig.ask(cmd="perturb", action="load", samples_n=[0.1] * 8)
    assert rig.view.mailbox
    rig.servo.deaf = True
    rig.send(packed(cmd="enable"))
    rig.send(*[packed(cmd="perturb", action="start") for _ in range(55)])
    assert rig.view.mailbox.backlog == 56
    rig.server.leave(b"a")
    posted = [rig.servo.mailbox.take() for _ in range(rig.view.mailbox.backlog)]
    kinds = [one and one[1] for one in posted]
    assert kinds == [Command.WITHDRAWN] * 56 + [Command.DISABLE, Command.PERTURB_STOP]


@pytest.mark.parametrize("request_", [{"cmd": "disable"}, {"cmd": "set", "K": 0, "B": 0, "M": 0}])
def test_what_ends_force_is_obeyed_however_late(
    rig: CommandServerRig, request_: dict[str, object]
) -> None:
    rig.servo.deaf = True
    rig.send(packed(**request_))
    assert rig.run(1000)
    taken = rig.servo.mailbox.take()
    assert taken is not None
    assert taken[1] in (Command.DISABLE, Command.SET)


def test_stop_is_posted_although_its_page_is_gone(rig: CommandServerRig) -> None:
    (rig.folder / files.STOP).unlink()
    rig.send(*[packed(cmd="set", K=k) for k in range(10)])
    rig.send(packed(cmd="stop"))
    rig.run(6)
    assert rig.view.state is State.STOPPED


def test_silent_servo_is_down(rig: CommandServerRig) -> None:
    rig.pass_time(999)
    assert rig.view.alive
    rig.pass_time(1)
    error = rig.send(packed(cmd="set", K=1))[0]["error"]
    assert error["code"] == "servo_down"
    assert (
        error["message"]
        == "set: no servo answers; start it with `hapticd run`, see `hapticd status`"
    )
    assert rig.view.state_name == "down"


def test_silent_servo_still_gets_the_stop_page(rig: CommandServerRig) -> None:
    rig.pass_time(2000)
    assert rig.send(packed(cmd="stop"))[0]["error"]["code"] == "servo_down"
    assert rig.servo.mailbox.stop_word.pressed


def test_gateway_alone_answers_servo_down(tmp_path: Path, rig: CommandServerRig) -> None:
    rig.servo.mailbox.close()
    rig.pass_time(5)
    assert [rig.send(packed(cmd=cmd))[0]["error"]["code"] for cmd in ("get", "enable", "stop")] == [
        "servo_down"
    ] * 3
    assert rig.send(packed(cmd="status"))[0]["state"] == "down"


def test_restarted_servo_is_taken_up(rig: CommandServerRig) -> None:
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


def test_killed_servo_leaves_no_ghost(rig: CommandServerRig) -> None:
    rig.servo.mailbox.close(clean=False)
    rig.servo.mailbox.store(
        layout.EPOCH_WORD, rig.view.mailbox.epoch
    )  # as after SIGKILL: the old file says it lives
    rig.servo = StandInServo(rig.folder, rig.clock)
    rig.servo.tick()
    rig.pass_time(100)
    assert rig.view.life == 2
    assert rig.ask(cmd="set", K=7)["ok"]


def test_what_the_servo_changes_by_itself_is_learnt(rig: CommandServerRig) -> None:
    rig.ask(cmd="set", K=500.0)
    rig.servo.values[Value.STIFFNESS] = 125.0  # as the energy controller cuts it
    rig.servo.values[Value.ENVIRONMENT_REVISION] += 1
    rig.run(3)
    rig.run(3)
    assert rig.ask(cmd="get")["result"]["parameters"]["K"] == 125.0
    posted = len(rig.servo.taken)
    rig.run(50)
    assert len(rig.servo.taken) == posted  # asked once


def test_restarted_gateway_learns_the_parameters(rig: CommandServerRig) -> None:
    rig.ask(cmd="set", K=123, wall={"position_m": 0.02})
    rig.start_gateway()
    rig.run()
    rig.run()
    parameters = rig.ask(cmd="get")["result"]["parameters"]
    assert (parameters["K"], parameters["wall"]["position_m"]) == (123.0, 0.02)
    assert rig.servo.revision == 1


def test_each_client_is_an_actor_with_a_name(rig: CommandServerRig) -> None:
    first = rig.ask(b"a", cmd="hello", name="sweep")["result"]["actor"]
    second = rig.ask(b"b", cmd="hello", name="panel")["result"]["actor"]
    rig.ask(b"b", cmd="set", K=1)
    assert second == first + 1
    assert rig.view.record["actor"] == second
    assert rig.server.actors.name(second) == "panel"


def test_actor_table_is_bounded(rig: CommandServerRig) -> None:
    """By the connections that there are, and 64 that have ended."""
    for number in range(1000):
        rig.send(packed(cmd="hello"), client=str(number).encode())
        rig.server.leave(str(number).encode())
    assert len(rig.server.actors.names()) == 64


def test_hello_tells_limits_of_this_device(rig: CommandServerRig) -> None:
    limits = rig.ask(cmd="hello")["result"]["limits"]
    assert limits["active_damping"] == {"low": 0.0, "high": 2.0, "unit": "N s/m"}
    assert limits["filters.velocity_hz"]["high"] == 450.0


def test_schema_carries_units_and_limits(rig: CommandServerRig) -> None:
    schema = rig.ask(cmd="schema")["result"]
    assert schema["$defs"]["Set"]["properties"]["active_damping"]["maximum"] == 2.0
    assert schema["$defs"]["Wall"]["properties"]["stiffness_n_per_m"]["unit"] == "N/m"
    assert set(schema["discriminator"]["mapping"]) == {
        "hello",
        "get",
        "set",
        "damping",
        "enable",
        "disable",
        "stop",
        "reset",
        "zero",
        "home",
        "perturb",
        "proxy",
        "lease",
        "guard",
        "status",
        "dump",
        "mark",
        "schema",
        "withhold",
    }


def test_a_mark_is_an_event_with_words_and_tick(rig: CommandServerRig) -> None:
    actor = rig.ask(cmd="hello", name="trial")["result"]["actor"]
    rig.servo.tick(7)
    rig.view.refresh(rig.clock.now_ns())
    found = rig.ask(cmd="mark", text="the handle is released")["result"]
    event = next(one for one in reversed(rig.journal.recent) if one["kind"] == "mark")
    assert found["tick"] >= 7
    assert (event["tick"], event["actor"]) == (found["tick"], actor)
    words = f"mark: the handle is released (by trial, tick {event['tick']})"
    assert event_words(answer_of(Event, event)) == words
    assert rig.ask(cmd="mark", text="")["error"]["code"] == "invalid"


def test_counts_requests_and_errors(rig: CommandServerRig) -> None:
    rig.send(packed(cmd="hello"), b"junk")
    assert rig.ask(cmd="status")["result"]["requests"] == {
        "requests": 3,
        "errors": 1,
        "timeouts": 0,
    }


def load(rig: CommandServerRig, samples: object, **more: object) -> dict[str, object]:
    return rig.ask(cmd="perturb", action="load", samples_n=samples, **more)


def test_samples_become_counts_of_this_device(rig: CommandServerRig) -> None:
    # count = sign * value / per_count + offset = -value / 1e-3 + 2, halves upwards
    assert load(rig, [0.0, 0.5, -1.0, 1.0, 0.0005])["result"] == {"samples": 5}
    assert rig.servo.mailbox.waveform[:5].tolist() == [2, -498, 1002, -998, 2]


def test_bytes_and_numbers_load_the_same(rig: CommandServerRig) -> None:
    force_n = np.linspace(-0.9, 0.9, 100, dtype="<f4")
    load(rig, force_n.astype(float).tolist())
    first = rig.servo.mailbox.waveform[:100].tolist()
    load(rig, force_n.tobytes())
    assert rig.servo.mailbox.waveform[:100].tolist() == first


def test_chunks_follow_each_other(rig: CommandServerRig) -> None:
    load(rig, [0.1] * 10)
    assert load(rig, [0.2] * 5, offset=10)["result"] == {"samples": 15}
    assert rig.servo.mailbox.waveform[9:12].tolist() == [-98, -198, -198]
    error = load(rig, [0.3], offset=14)["error"]
    assert error["message"] == "offset = 14 samples: 15 are loaded; send the chunks in order"


def test_chunk_of_another_client_is_refused(rig: CommandServerRig) -> None:
    """Two that load at once would play a mixture."""
    load(rig, [0.1] * 10, client=b"a")
    load(rig, [0.2] * 10, client=b"b")
    error = load(rig, [0.1] * 5, offset=10, client=b"a")["error"]
    assert (
        error["message"] == "offset = 10 samples: another client's are loaded; begin with offset 0"
    )
    assert load(rig, [0.2] * 5, offset=10, client=b"b")["result"] == {"samples": 15}


@pytest.mark.parametrize("bad", [1.001, -1.001])
def test_sample_beyond_limit_is_named(rig: CommandServerRig, bad: float) -> None:
    load(rig, [0.0] * 4)
    error = load(rig, [0.5, bad], offset=4)["error"]
    assert error["code"] == "invalid"
    assert error["detail"] == [
        {
            "loc": "samples_n.5",
            "msg": (
                f"samples_n[5] = {bad} N: beyond the limit -1..1 N (the device file sets it); use"
                " a value within"
            ),
            "value": pytest.approx(bad, rel=1e-6),
            "unit": "N",
            "low": -1.0,
            "high": 1.0,
        }
    ]
    assert rig.servo.mailbox.waveform[4] == 0


def test_sample_that_is_no_number_is_named(rig: CommandServerRig) -> None:
    error = load(rig, np.array([0.0, np.nan], "<f4").tobytes())["error"]
    assert error["detail"][0]["loc"] == "samples_n.1"
    assert error["detail"][0]["value"] is None


def test_broken_bytes_are_refused(rig: CommandServerRig) -> None:
    message = load(rig, b"\0\0\0")["error"]["message"]
    assert (
        message == "samples_n has 3 bytes: not whole little-endian float32; send 4 bytes a sample"
    )


def test_too_long_a_waveform_is_refused(rig: CommandServerRig) -> None:
    rig.server._waveform._life = rig.view.life
    rig.server._waveform._samples = PERTURBATION_SAMPLES
    message = load(rig, [0.1], offset=PERTURBATION_SAMPLES)["error"]["message"]
    assert (
        message
        == "samples_n: 524289 samples are beyond the limit 524288 samples (131 s); shorten it or"
        " play it in a loop"
    )


def test_start_tells_the_length(rig: CommandServerRig) -> None:
    load(rig, [0.1] * 7)
    rig.ask(cmd="enable")
    assert rig.ask(cmd="perturb", action="start", loop=True)["ok"]
    assert rig.servo.played == (7.0, 1.0)
    assert rig.servo.perturbing


def test_playing_waveform_is_not_overwritten(rig: CommandServerRig) -> None:
    load(rig, [0.1] * 7)
    rig.ask(cmd="enable")
    rig.ask(cmd="perturb", action="start")
    assert load(rig, [0.2])["error"]["code"] == "busy"
    rig.ask(cmd="perturb", action="stop")
    assert load(rig, [0.2])["ok"]


def test_waveform_is_loaded_while_others_wait_for_something_else(rig: CommandServerRig) -> None:
    """But not behind a start that has no answer yet."""
    rig.send(packed(cmd="set", K=1))
    assert rig.send(packed(cmd="perturb", action="load", samples_n=[0.1] * 7))[0]["ok"]
    rig.run()
    rig.ask(cmd="enable")
    rig.send(packed(cmd="perturb", action="start"))
    (reply,) = rig.send(packed(cmd="perturb", action="load", samples_n=[0.2]))
    assert reply["error"]["code"] == "busy"


def test_waveform_does_not_outlive_its_servo(rig: CommandServerRig) -> None:
    load(rig, [0.1] * 7)
    rig.view.life += 1
    assert rig.ask(cmd="perturb", action="start")["error"]["message"].startswith(
        "perturb start: no waveform is loaded"
    )


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (
            Result.REFUSED_NOT_HOMED,
            "enable: the device has no position origin: none was made yet, or it was lost with the"
            " link, the board or the encoder; `hapticd home` or `hapticd zero` first",
        ),
        (
            Result.REFUSED_DEVICE,
            "enable: the board is not the one of its device file (serial: other; probe: none); plug"
            " in the right one, or correct the device file",
        ),
        (
            Result.REFUSED_RATE,
            "enable: a pair of transfers takes 800 us on this bus, too long for 1000 Hz; set"
            " realtime.rate_hz to at most 820 Hz, or give the board a bus of its own",
        ),
    ],
)
def test_board_that_is_barred_is_refused_in_words(
    rig: CommandServerRig, result: Result, said: str
) -> None:
    transport = {"pair_us": 800.0, "rate_hz": 820.0}
    rig.servo.mailbox.report(
        {"differences": ["serial: other", "probe: none"], "transport": transport}
    )
    error = refusal(
        Answer(1, result, 0, 0, 0, 0, ()), "enable", rig.view, Actors(rig.view.next_actor)
    )
    assert (error.code, str(error)) == (result.name.lower(), said)


def test_reset_is_refused_by_the_emergency_stop_and_not_by_what_it_ended(
    rig: CommandServerRig,
) -> None:
    answer = Answer(1, Result.REFUSED_CAUSE, BY_CODE["stop"].number, 0, 0, 0, ())
    rig.view.record = {"status": int(StatusBit.EMERGENCY_STOP)}
    error = refusal(answer, "reset", rig.view, Actors(rig.view.next_actor))
    said = "the emergency stop is pressed, so the board makes no force; release it, then ask again"
    assert str(error) == f"reset: {said}"
    rig.view.record = {"status": 0}
    assert "a stop was requested" in str(
        refusal(answer, "reset", rig.view, Actors(rig.view.next_actor))
    )


def test_stop_behind_many_commands_is_one_clients_stop(rig: CommandServerRig) -> None:
    rig.servo.deaf = True
    rig.send(*[packed(cmd="set", K=k) for k in range(4)])
    rig.send(packed(cmd="stop"))
    assert rig.servo.mailbox.stop_word.presser == rig.server.actors.number(b"a")


@pytest.mark.parametrize(
    ("owner", "whose"),
    [
        (16, "operator (actor 16)"),
        (2, "stop word (actor 2)"),
        (99, "a client that has gone (actor 99)"),
        (0, "more than one client"),
    ],
)
def test_stop_of_somebody_else_is_refused_with_whose_it_is(
    rig: CommandServerRig, owner: int, whose: str
) -> None:
    actors = Actors(itertools.count(16).__next__)
    actors.call(b"a", "operator")
    effective = [0.0] * COMMAND_VALUES
    effective[Value.STOP_OWNER] = owner
    answer = Answer(1, Result.REFUSED_OWNER, 1, 0, 2000, 2740, tuple(effective))
    error = refusal(answer, "reset", rig.view, actors)
    assert (error.code, str(error)) == (
        "refused_owner",
        f"reset: stop was pressed by {whose} less than 1 s ago and is not for others to reset; look"
        " whether it is safe, and ask again in 0.74 s",
    )


def test_scheduled_change_whose_tick_comes_in_the_same_look_has_its_reply(
    rig: CommandServerRig,
) -> None:
    """Both answers of the servo are there at once: the first is the reply, the second an event."""
    asked = packed(cmd="set", K=5.0, at_tick=rig.servo.ticks + 3)
    assert rig.send(asked) == []
    replies = [decoded(one) for one in rig.run(6)]
    assert [one["receipt"]["result"] for one in replies] == ["scheduled"]
    assert [one["result"] for one in rig.journal.recent if one["kind"] == "answer"] == ["applied"]
    assert not rig.server._guarded._scheduled._changes  # or every later verdict would count it
