"""What was cancelled, overtaken or judged without force does not come into force: the command
server, with the guard's judge, in front of the servo itself, on virtual time.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.gateway_rig import decoded, packed
from support.guard_stages import STIFF, Flight

from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import State

NOTHING = {"K": 0.0, "B": 0.0}


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.stack.close()


def send(flight: Flight, *requests: dict[str, Any], client: bytes = b"a") -> None:
    """Requests that come together."""
    messages = [[client, packed(**one)] for one in requests]
    replies = flight.server.serve(messages, flight.stack.clock.now_ns())
    flight.replies = [decoded(reply) for reply in replies]


def until_posted(flight: Flight) -> None:
    """Passes of the gateway, without a tick, until a command is in the servo's ring."""
    for _ in range(10):
        flight.view.refresh(flight.stack.clock.now_ns())
        flight.server.collect(flight.stack.clock.now_ns())
        if flight.stack.gateway.backlog:
            return
    raise AssertionError("nothing was posted")


def enabled(flight: Flight, policy: str) -> None:
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(500)


def stiff_without_damping(records: Any) -> bool:
    """Whether the whole of STIFF was rendered without the damping that it needs."""
    stiff = records["stiffness_n_per_m"] > 100.0
    undamped = records["active_damping_effect_ns_per_m"] < 0.2
    return bool((stiff & undamped & (records["gain"] == 1.0)).any())


# --- stops ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", ["off", "refuse"])
def test_a_stop_that_is_asked_last_stands_though_it_goes_first(flight: Flight, policy: str) -> None:
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="stop")["ok"]
    flight.fly(50)
    send(flight, {"cmd": "perturb", "action": "stop"})  # so that stop and reset meet no one tick
    send(flight, {"cmd": "reset"}, {"cmd": "enable"}, {"cmd": "stop"})
    (refused,) = (one for one in flight.replies if not one["ok"])
    assert refused["error"]["message"].startswith("reset: a stop followed it")
    flight.fly(200)
    assert flight.view.state is State.STOPPED


@pytest.mark.parametrize("by", ["a client", "the stop word"])
def test_a_stop_ends_what_waits_to_be_scheduled(flight: Flight, by: str) -> None:
    enabled(flight, "refuse")
    flight.worker.silent = True
    at = flight.view.tick + 700
    send(flight, {"cmd": "set", "K": 30.0, "at_tick": at})
    flight.fly(5)
    asked = flight.worker.changes[-1]
    if by == "a client":
        send(flight, {"cmd": "stop"}, client=b"b")
    else:
        press_stop(Path(flight.stack.mailbox.folder))
    flight.fly(50)
    send(flight, {"cmd": "reset"}, client=b"b")
    flight.fly(50)
    flight.worker.silent = False
    flight.worker.said.append({**flight.judge.answer(asked), "n": asked["n"]})
    send(flight, {"cmd": "enable"}, client=b"b")
    assert not flight.fly(800)["stiffness_n_per_m"].any()
    # the stop word is not for others to reset within a second
    assert flight.view.state is (State.ENABLED if by == "a client" else State.STOPPED)


@pytest.mark.parametrize("policy", ["off", "refuse"])
def test_a_stop_ends_what_was_to_be_scheduled_before_it(flight: Flight, policy: str) -> None:
    """Both come in one batch, and the stop goes first."""
    enabled(flight, policy)
    at = flight.view.tick + 700
    send(flight, {"cmd": "set", "K": 30.0, "at_tick": at}, {"cmd": "stop"})
    assert "set: a stop followed it" in str([one.get("error") for one in flight.replies])
    for cmd in ("reset", "enable"):
        flight.fly(50)
        send(flight, {"cmd": cmd})
    assert not flight.fly(800)["stiffness_n_per_m"].any()
    assert flight.view.state is State.ENABLED


@pytest.mark.parametrize("end", ["disable", "leave", "reset"])
def test_an_enable_that_was_taken_back_is_not_asked_again(flight: Flight, end: str) -> None:
    """The servo refuses it, since a scheduled change came into force before it was taken."""
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    at = flight.view.tick + 20
    assert flight.ask(cmd="set", K=20.0, ramp_s=0.0, at_tick=at)["ok"]
    send(flight, {"cmd": "enable"})
    until_posted(flight)
    take = flight.stack.mailbox.take
    flight.stack.mailbox.take = lambda: None  # type: ignore[method-assign]
    flight.stack.run(at - flight.view.tick + 2)
    flight.stack.mailbox.take = take  # type: ignore[method-assign]
    if end == "leave":
        flight.server.leave(b"a")
    else:
        send(flight, {"cmd": end}, client=b"b")
    flight.fly(100)
    assert flight.view.state is State.DISABLED


# --- clients that leave, or fail: the servo stands from the posting until they are gone -----------


@pytest.mark.parametrize("policy", ["off", "warn", "refuse"])
def test_an_enable_that_the_servo_has_not_taken_ends_with_its_connection(
    flight: Flight, policy: str
) -> None:
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    send(flight, {"cmd": "enable"})
    until_posted(flight)
    flight.server.leave(b"a")
    assert not flight.fly(50)["state"].any()


@pytest.mark.parametrize("ahead", ["disable", "reset"])
def test_an_enable_behind_a_command_of_another_ends_with_its_connection(
    flight: Flight, ahead: str
) -> None:
    enabled(flight, "off")
    if ahead == "reset":
        send(flight, {"cmd": "stop"}, client=b"b")
        flight.fly(50)
    send(flight, {"cmd": ahead}, client=b"b")
    send(flight, {"cmd": "enable"})
    flight.server.leave(b"a")
    flight.fly(50)
    assert flight.view.state is State.DISABLED


@pytest.mark.parametrize("end", ["leave", "fail"])
def test_a_perturbation_that_the_servo_has_not_taken_ends_with_its_client(
    flight: Flight, end: str
) -> None:
    enabled(flight, "warn")
    assert flight.ask(cmd="perturb", action="load", samples_n=[0.1] * 200)["ok"]
    if end == "fail":
        assert flight.ask(cmd="lease", what="perturbation")["ok"]
        flight.fly(5)
    # so that the servo would take a stop that followed it a tick later
    send(flight, {"cmd": "perturb", "action": "stop"}, client=b"b")
    send(flight, {"cmd": "perturb", "action": "start", "loop": True})
    if end == "leave":
        flight.server.leave(b"a")
    else:
        send(flight, {"cmd": "lease", "what": "perturbation", "action": "fail"})
    assert not flight.fly(50)["perturbing"].any()


@pytest.mark.parametrize("policy", ["off", "warn", "refuse"])
def test_a_change_that_the_servo_has_not_taken_ends_with_its_connection_unless_it_ends_force(
    flight: Flight, policy: str
) -> None:
    enabled(flight, policy)
    assert flight.ask(cmd="set", K=20.0)["ok"]
    for stiffness, left in ((30.0, 20.0), (0.0, 0.0)):
        send(flight, {"cmd": "set", "K": stiffness}, client=b"b")
        until_posted(flight)
        flight.server.leave(b"b")
        assert flight.fly(100)["stiffness_n_per_m"][-1] == left


@pytest.mark.parametrize("end", ["nothing", "leave"])
def test_a_change_that_the_servo_has_refused_is_not_judged_again_once_its_client_left(
    flight: Flight, end: str
) -> None:
    """The servo refuses it, since a scheduled change came into force before it was taken."""
    enabled(flight, "refuse")
    at = flight.view.tick + 20
    assert flight.ask(cmd="set", M=0.001, ramp_s=0.0, at_tick=at)["ok"]
    send(flight, {"cmd": "set", "K": 20.0}, client=b"b")
    until_posted(flight)
    take = flight.stack.mailbox.take
    flight.stack.mailbox.take = lambda: None  # type: ignore[method-assign]
    flight.stack.run(at - flight.view.tick + 2)
    flight.stack.mailbox.take = take  # type: ignore[method-assign]
    flight.stack.run(2)
    if end == "leave":
        flight.server.leave(b"b")
    assert flight.fly(200)["stiffness_n_per_m"].any() == (end == "nothing")


def test_an_enable_of_a_holder_that_has_failed_does_not_come(flight: Flight) -> None:
    assert flight.ask(cmd="lease", what="environment", at_end="hold")["ok"]
    flight.fly(5)
    send(flight, {"cmd": "enable"})
    until_posted(flight)
    send(flight, {"cmd": "lease", "what": "environment", "action": "fail"})
    assert not flight.fly(50)["state"].any()


# --- schedules ------------------------------------------------------------------------------------


@pytest.mark.parametrize("before", ["off", "warn", "measuring"])
@pytest.mark.parametrize("asked", [{"cmd": "set", **STIFF}, {"cmd": "enable"}])
def test_what_the_servo_has_not_taken_ends_with_the_terms_it_was_posted_under(
    flight: Flight, before: str, asked: dict[str, Any]
) -> None:
    if asked["cmd"] == "set":
        enabled(flight, "warn")
    assert flight.ask(cmd="guard", policy="refuse" if before == "measuring" else before)["ok"]
    if before == "measuring":
        assert flight.ask(cmd="lease", what="measuring")["ok"]
        flight.fly(5)
    send(flight, asked)
    until_posted(flight)
    if before == "measuring":
        send(flight, {"cmd": "lease", "what": "measuring", "action": "release"})
    else:
        send(flight, {"cmd": "guard", "policy": "refuse"}, client=b"b")
    flight.server.collect(flight.stack.clock.now_ns())
    flight.fly(100)
    assert flight.view.state is (State.ENABLED if asked["cmd"] == "set" else State.DISABLED)
    assert flight.guard.in_force.target().empty


def test_an_end_brings_nothing_back_once_its_clients_lease_ended_at_zero(flight: Flight) -> None:
    enabled(flight, "refuse")
    assert flight.ask(cmd="lease", what="environment", at_end="zero")["ok"]
    assert flight.ask(cmd="set", K=20.0)["ok"]
    flight.fly(50)
    at = flight.view.tick + 50
    assert flight.ask(cmd="set", K=30.0, ramp_s=0.0, at_tick=at, until_tick=at + 500)["ok"]
    flight.fly(100)
    flight.server.leave(b"a")
    assert flight.fly(600)["stiffness_n_per_m"][-1] == 0.0


def test_the_end_of_a_push_is_not_replaced_by_what_is_scheduled_for_its_tick(
    flight: Flight,
) -> None:
    """What came in its place would be refused, since it was judged for what the end leaves."""
    enabled(flight, "refuse")
    at = flight.view.tick + 20
    assert flight.ask(cmd="set", K=30.0, at_tick=at, until_tick=at + 200)["ok"]
    flight.fly(50)
    assert flight.ask(cmd="set", K=20.0, at_tick=at + 200)["ok"]
    flight.worker.silent = True
    assert flight.fly(600)["stiffness_n_per_m"][-1] == 20.0


def test_bounded_changes_that_overlap_bring_no_push_back(flight: Flight) -> None:
    enabled(flight, "refuse")
    at = flight.view.tick + 50
    for begin, stiffness in ((at, 30.0), (at + 100, 20.0)):
        asked = {"K": stiffness, "at_tick": begin, "until_tick": begin + 200}
        assert flight.ask(cmd="set", ramp_s=0.0, **asked)["ok"]
    records = flight.fly(400)
    rendered = dict(zip(records["tick"].tolist(), records["stiffness_n_per_m"], strict=True))
    assert [rendered[at + after] for after in (50, 150, 250, 350)] == [30.0, 20.0, 0.0, 0.0]


@pytest.mark.parametrize("policy", ["off", "warn"])
def test_a_push_of_a_strict_client_ends_whatever_another_has_changed(
    flight: Flight, policy: str
) -> None:
    enabled(flight, policy)
    at = flight.view.tick + 50
    bounded = {"K": 30.0, "ramp_s": 0.0, "at_tick": at, "until_tick": at + 200}
    assert flight.ask(cmd="set", **bounded, strict=True)["ok"]
    flight.fly(100)
    send(flight, {"cmd": "set", "M": 0.001}, client=b"b")
    assert flight.fly(400)["stiffness_n_per_m"][-1] == 0.0
