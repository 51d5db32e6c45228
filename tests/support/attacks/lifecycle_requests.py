"""Lives of requests that end in the gateway: by later requests, by their connection, by their
deadline or by their conditions. `lifecycle` describes the attacks.
"""

from random import Random
from typing import Any

from hapticd.guard.status import MOST_RECORDS
from hapticd.mailbox.layout import Command, values_of
from support.attacks.stand import (
    ANSWERS,
    LONG,
    NOTHING,
    RAMP_TICKS,
    SILENT,
    STRICT,
    Chosen,
    Moment,
    Stand,
    judged,
)
from support.guard_stub import refuses, stage, verdict

LEVEL_NS_PER_M = 1.5  # takes the 75 ms for which an enable waits
ENDS = ("disable", "zero", "home", "reset", "stop", "stop and reset unseen")


def staged(asked: dict[str, Any]) -> dict[str, Any]:
    """Damping first; K, and then force, once the board reports it."""
    stages = [
        stage({"active_damping": LEVEL_NS_PER_M}),
        stage({"K": 10.0}, at_least=LEVEL_NS_PER_M),
    ]
    return {"action": "stage", "stages": stages, "verdict": verdict()}


def strict_stand(stand: Stand, policy: str = "refuse") -> None:
    """An environment that pushes, without force, and a policy that judges."""
    stand.push_in_force()
    stand.settle()
    stand.done(cmd="guard", policy=policy)
    stand.fly(2)


# --- an enable that waits in stages ---------------------------------------------------------------


def enable_in_stages(chosen: Chosen, random: Random) -> None:
    """The end comes while the first stage is with the servo, or on its way."""
    with Stand() as stand:
        strict_stand(stand)
        stand.worker.script = staged
        stand.send({"cmd": "enable"})
        for _ in range(4):
            stand.look()
        assert stand.mailbox.backlog == 1, "no stage was posted"
        judged(stand.fly(random.choice((0, random.randrange(1, 60)))))
        stand.worker.silent = chosen["worker"] == SILENT
        _end(stand, chosen["end"])
        stand.judge(LONG, control=chosen["end"] == NOTHING)


def _end(stand: Stand, end: str) -> None:
    if end == "leave":
        stand.server.leave(b"a")
    elif end == "stop and reset unseen":
        for kind in (Command.STOP, Command.RESET):
            stand.mailbox.post(kind, 2, 0, values_of({}))
            judged(stand.fly(2, every=3))
    elif end != NOTHING:
        stand.send({"cmd": end}, client=b"b")
    if end == "stop":
        judged(stand.fly(3))
        stand.send({"cmd": "reset"}, client=b"b")


# --- deadlines ------------------------------------------------------------------------------------


def gateway_stands_still(chosen: Chosen, random: Random) -> None:
    """With the verdict on its line, or with a stage that waits for damping."""
    control = chosen["where"] == NOTHING
    with Stand() as stand:
        strict_stand(stand)
        if chosen["where"] == "stage waits" or (control and random.random() < 0.5):
            stand.worker.script = staged
        stand.send({"cmd": "enable"})
        stand.look()
        if chosen["where"] == "stage waits":
            judged(stand.fly(random.randrange(5, 60)))
        stand.worker.silent = chosen["worker"] == SILENT
        if not control:
            stand.pause(random.randint(8000, 20_000))
            stand.stack.run(random.choice((1, 100)))
        stand.judge(LONG, control)


# --- terms ----------------------------------------------------------------------------------------


LEASE = {"cmd": "lease", "what": "measuring", "action": "take", "at_end": "hold"}
RELEASE = {"cmd": "lease", "what": "measuring", "action": "release"}


def measuring_lease(chosen: Chosen, random: Random) -> None:
    """The holder of the measuring lease schedules a push that would be refused."""
    with Stand() as stand:
        stand.enabled()
        stand.settle()
        stand.done(cmd="guard", policy="refuse")
        stand.fly(2)
        stand.worker.script = refuses
        stand.worker.silent = chosen["worker"] == SILENT
        push = stand.push(stand.tick + random.randrange(20, 60))
        requests = [LEASE, push, *([RELEASE] if chosen["end"] == "release" else [])]
        for batch in [requests] if chosen["sent"] == "together" else [[one] for one in requests]:
            stand.send(*batch)
            judged(stand.fly(random.randrange(4)))
        if chosen["end"] == "leave":
            stand.server.leave(b"a")
        stand.judge(LONG, control=chosen["end"] == NOTHING)


def policy_made_strict(chosen: Chosen, random: Random) -> None:
    """The servo pauses while it has the change to answer, or has just answered it."""
    with Stand() as stand:
        stand.enabled()
        stand.done(cmd="guard", policy=chosen["before"])
        stand.fly(2)
        stand.send(stand.push(stand.tick + random.randrange(20, 60)))
        for _ in range(3):
            stand.look()
        assert stand.mailbox.backlog == 1, "the change was not posted"
        stand.fly(random.randrange(2), every=2)
        stand.worker.silent = chosen["worker"] == SILENT
        if chosen["policy"] != NOTHING:
            stand.send({"cmd": "guard", "policy": chosen["policy"]}, client=b"b")
        for _ in range(random.randrange(3)):
            stand.look()
        stand.judge(LONG, control=chosen["policy"] == NOTHING)


def gateway_beside_servo(chosen: Chosen, random: Random) -> None:
    """Requests come within the first records; the test checks whether they act after these are
    read.
    """
    what = chosen["what"]
    answers = chosen["worker"] == ANSWERS
    with Stand() as stand:
        before = _running(stand, what)
        stand.another_gateway(random.choice(STRICT))
        stand.worker.silent = not answers
        early = stand.fly(random.randrange(1, 300), every=20)
        damping_off = {"cmd": "damping", "value": "off"}
        asked = {"enable": {"cmd": "enable"}, "push": stand.push(), "damping": damping_off}
        stand.send(asked[what])
        early += stand.fly(MOST_RECORDS - 2 - len(early), every=5)
        later = stand.fly(LONG if answers else 600, every=5)
    judged(early)
    assert all(one.active_damping_ns_per_m == before for one in early), "damping moved"
    if what != "damping":
        judged(later, control=answers)
    else:
        assert (later[-1].active_damping_ns_per_m != before) == answers, "damping, later"


def _running(stand: Stand, what: str) -> float:
    """The servo before the gateway came, with damping: its level, N s/m."""
    stand.done(cmd="damping", value=LEVEL_NS_PER_M)
    if what == "push":
        stand.enabled()
    else:
        stand.push_in_force()
    return stand.fly(100, every=10)[-1].active_damping_ns_per_m


# --- a connection that closes ---------------------------------------------------------------------


def closed_connection(chosen: Chosen, random: Random) -> None:
    """A change of another client keeps the guard busy meanwhile, or the servo is suspended."""
    control = chosen["place"] == NOTHING
    silent = chosen["worker"] == SILENT
    with Stand() as stand:
        if chosen["what"] == "push":
            stand.enabled()
            stand.settle()
        else:
            strict_stand(stand)
        stand.done(cmd="guard", policy=chosen["policy"])
        stand.fly(2)
        if chosen["place"] == "ring":
            _post(stand, chosen)
        else:
            _keep_waiting(stand, chosen)
        seen = stand.fly(0 if chosen["place"] == "ring" else random.randrange(8))
        if not control:
            stand.server.leave(b"a")
        seen += _let_go(stand, silent)
    # a strict policy refuses a change without a verdict
    judged(seen, control=control and (chosen["policy"] == "warn" or not silent))


def _asked(stand: Stand, chosen: Chosen) -> dict[str, Any]:
    return stand.push() if chosen["what"] == "push" else {"cmd": "enable"}


def _post(stand: Stand, chosen: Chosen) -> None:
    """The request is in the servo's ring; a strict policy refuses it where no worker answers."""
    stand.worker.silent = chosen["worker"] == SILENT
    stand.send(_asked(stand, chosen))
    for _ in range(3):
        stand.look()
    posted = chosen["policy"] == "warn" or chosen["worker"] == ANSWERS
    assert bool(stand.mailbox.backlog) == posted, "it was not posted"


def _keep_waiting(stand: Stand, chosen: Chosen) -> None:
    """Client b's request is with the worker, and a's waits behind it."""
    waits = _asked(stand, chosen)
    stand.worker.held = True
    stand.worker.silent = chosen["worker"] == SILENT
    stand.send({"cmd": "set", "M": 0.001, "ramp_s": 0.0}, client=b"b")
    stand.look()
    turn = {"in_time": lambda: False} if chosen["place"] == "server" else {}
    stand.send({"cmd": "get"}, waits, **turn)


def _let_go(stand: Stand, silent: bool) -> list[Moment]:
    """Let the worker answer; a silent one times out after half a second, and answers then."""
    stand.worker.held = False
    seen = stand.fly(520, every=20) if silent else []
    stand.worker.silent = False
    stand.send()
    return seen + stand.fly(RAMP_TICKS + 30)
