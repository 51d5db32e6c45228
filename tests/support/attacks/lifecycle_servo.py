"""Lives of commands that end in the servo: bounded, scheduled, played, without a number, or left by
another gateway. `lifecycle` describes the attacks.
"""

from random import Random

from hapticd.mailbox.layout import COMMAND_VALUES, Command
from hapticd.model.params import InjectionParams
from support.attacks.stand import (
    LONG,
    NOTHING,
    RAMP_TICKS,
    SILENT,
    Chosen,
    Moment,
    Stand,
    judged,
)

LASTS = 20  # ticks of a bounded push
LATE = 3  # ticks from the end of a push to a motor without force
END_TICKS = 30  # from a stop to no force


def bounded_push(chosen: Chosen, random: Random) -> None:
    """The gateway's event comes before the push, or during it."""
    with Stand() as stand:
        stand.enabled()
        stand.settle()
        stand.done(cmd="guard", policy=chosen["policy"])
        begin = stand.tick + 30
        stand.done(**stand.push(begin, until_tick=begin + LASTS))
        seen = stand.fly(random.randrange(5, 30 + LASTS - 5))
        seen += _after(stand, chosen["after"], random)
    until = begin + LASTS + LATE
    judged([one for one in seen if one.tick > until])
    if chosen["after"] != "another gateway":  # whose conditions may precede the push
        judged([one for one in seen if begin <= one.tick <= until], control=True)


def _after(stand: Stand, after: str, random: Random) -> list[Moment]:
    stand.worker.silent = after == "worker silent"
    stand.stack.gateway_alive = after != "gateway gone"
    if after == "another gateway":
        stand.another_gateway(random.choice(("warn", "refuse")))
    return stand.fly(LONG, every=2 * LONG if after == "gateway gone" else 1)


def former_gateway(chosen: Chosen, random: Random) -> None:
    """The command that the former gateway scheduled may be the servo's first one."""
    strict = chosen["policy"] != NOTHING
    policy = chosen["policy"] if strict else "warn"
    former = policy if chosen["place"] == "later" and random.random() < 0.5 else "warn"
    with Stand(policy=former) as stand:
        if former != "warn":
            stand.settle()
        if chosen["place"] == "later":
            stand.enabled()
        stand.done(**stand.push(stand.tick + random.randrange(100, 140)))
        _next_gateway(stand, former, random)
        if chosen["place"] == "first command":
            stand.enabled()
        stand.worker.silent = chosen["worker"] == SILENT
        stand.send({"cmd": "guard", "policy": policy})
        stand.judge(LONG, control=not strict)


def _next_gateway(stand: Stand, former: str, random: Random) -> None:
    """Start the next gateway, configured as the `former` one was; its requests count again."""
    stand.another_gateway(former)
    stand.fly(random.randrange(2, 20))


def client_numbers(chosen: Chosen, random: Random) -> None:
    """Client b is the first client of its gateway, as a was of the former one."""
    with Stand() as stand:
        if chosen["left"] == "stop":
            _strangers_stop(stand, chosen, random)
            return
        stand.enabled()
        stand.done(**stand.push(stand.tick + random.randrange(40, 60)))
        stand.another_gateway(chosen["policy"])
        stand.fly(random.randrange(2, 10))
        stand.worker.silent = chosen["worker"] == SILENT
        if chosen["left"] == "schedule":
            stand.done(b"b", cmd="lease", what="environment", action="take")
        # a strict gateway drops the schedule of its predecessor
        stand.judge(LONG, control=chosen["left"] == NOTHING and chosen["policy"] == "warn")


def _strangers_stop(stand: Stand, chosen: Chosen, random: Random) -> None:
    """Within the second for which a stop is its client's to reset."""
    stand.push_in_force()
    stand.done(cmd="stop")
    stand.fly(random.randrange(30, 60))
    stand.another_gateway("off")
    stand.fly(random.randrange(2, 10))
    stand.worker.silent = chosen["worker"] == SILENT
    for cmd in ("reset", "enable"):
        stand.send({"cmd": cmd}, client=b"b")
        judged(stand.fly(4))
    stand.judge(2 * RAMP_TICKS)


def dead_gateways_ring(chosen: Chosen, random: Random) -> None:
    """The servo pauses from the posting to the heartbeat of the next gateway."""
    left = chosen["left"]
    with Stand() as stand:
        if left == "push" or (left == NOTHING and random.random() < 0.5):
            stand.enabled()
            waits = stand.push()
        else:
            stand.push_in_force()
            waits = {"cmd": "enable"}
        stand.done(cmd="guard", policy="off")
        stand.fly(random.randrange(1, 20))
        stand.send(waits)
        assert stand.mailbox.backlog == 1, "nothing is in the ring"
        if left == "enable and a pause":
            stand.pause(random.randint(1000, 4000))
        stand.worker.silent = chosen["worker"] == SILENT
        if left != NOTHING:
            stand.another_gateway("refuse")
        stand.judge(RAMP_TICKS + 30, control=left == NOTHING)


# --- perturbations --------------------------------------------------------------------------------

LOST_TICK = 200  # of the first frame that does not come
FRAMES = InjectionParams("drop_in", tick=LOST_TICK, count=7)
PRESS = InjectionParams("emergency_stop", tick=LOST_TICK, value=0.004)
FAULTS = {
    "frames lost": ((FRAMES,), (1, 6)),
    "stop behind lost frames": ((FRAMES, PRESS), (1, 6)),
    "torque withheld": ((PRESS,), (1, 3)),
    NOTHING: ((), (1, 6)),
}


def mute_perturbation(chosen: Chosen, random: Random) -> None:
    """At the probe's own motor."""
    injections, late = FAULTS[chosen["while"]]
    with Stand(*injections) as stand:
        stand.enabled()
        stand.done(cmd="perturb", action="load", samples_n=[random.uniform(0.05, 0.2)] * 200)
        stand.done(cmd="guard", policy="refuse")
        stand.worker.silent = chosen["worker"] == SILENT
        stand.fly(LOST_TICK + random.randint(*late) - stand.tick, every=3)
        stand.send({"cmd": "perturb", "action": "start", "loop": True})
        assert stand.mailbox.backlog, "the gateway refused, so the servo was not asked"
        played = [one.tick for one in stand.fly(60) if one.probe_n]
        assert bool(played) == (chosen["while"] == NOTHING), f"it played in ticks {played[:5]}"


# --- masks ----------------------------------------------------------------------------------------

LOST = "slots lost"  # from then on the servo counts a slot for the ticks of every command


def masks(chosen: Chosen, random: Random) -> None:
    """The other numbers of the command are the same, or 0."""
    with Stand() as stand:
        stand.push_in_force()
        if chosen["state"] == "enabled":
            stand.enabled()
        if chosen["slots"] == LOST:
            stand.pause(random.randint(3, 5))
            stand.fly(2)
            assert stand.view.record["slot"] > stand.view.record["tick"], "no slot is lost"
        stand.done(cmd="guard", policy="refuse")
        stand.worker.silent = chosen["worker"] == SILENT
        mask = float(chosen["mask"])
        others = random.choice((mask, 0.0))
        values = (mask, *[others] * (COMMAND_VALUES - 1))
        stand.mailbox.post(Command[chosen["kind"]], 16, 0, values)
        seen = stand.fly(random.randrange(2, 20))
        pushes = chosen["state"] == "enabled"
        assert all(one.pushes == pushes for one in seen), "force came, or went"
        if chosen["state"] == "disabled":
            stand.done(cmd="guard", policy="off")
            stand.enabled()
        stand.judge(2, control=True)
        stand.done(cmd="stop")
        stand.fly(END_TICKS)
        stand.judge(10)
