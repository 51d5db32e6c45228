"""Random requests to a guarded display, and every resulting environment in force.

A seed determines a sequence: a policy, a margin, a number of requests and the pauses between them.
A request is any of K, B, M, wall, filters, damping (on, off or at a level), modes, ramps, enable
and disable; some are for a future tick. The guard's answers are applied to the servo's own plan
(`servo.commands`, `servo.plan`). Ramps, slew of the damping and schedule are therefore the same,
tick by tick but without board and law. Stages are posted as by the gateway, when the damping in
effect has the required value and earlier ramps have ended. A newer request replaces the remaining
ones.

All environments are recorded while force is on, including the gain: free, and with a wall in
contact with its spring and damper added. On ramps every eighth tick is recorded, and the steady
ones.

Limitations: a gateway that posts differently; some tests use the real one.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from support.whole_tick import Point

from hapticd.core.environment import Environment
from hapticd.core.errors import HapticdError
from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import COMMAND_VALUES, Command, Result, Value
from hapticd.protocol.commands import posting
from hapticd.protocol.limits import CommandLimits
from hapticd.protocol.schemas import parse
from hapticd.servo.commands import CommandContext, apply_settings, obey
from hapticd.servo.plan import (
    NEVER,
    Plan,
    advance_added,
    damping_count,
    initial_plan,
    wake_tick,
)
from hapticd.servo.safety import State

Answering = Callable[[dict[str, Any]], dict[str, Any]]  # the guard: a request in, its answer out

POLICIES = ("refuse", "clamp", "follow")
PLAIN = {
    "K": 6,
    "B": 4,
    "M": 3,
    "active_damping": 5,
}  # kinds of parameters, and their weights
EVERYTHING = PLAIN | {"wall": 1, "filters": 1}
REQUESTS = 10  # of a sequence
EACH = 8  # ticks between two samples of a ramp
LONGEST_WAIT = 1500  # ticks until all changes have arrived
VALUES = 2  # index in a posting
WALL = {
    Value.WALL_STIFFNESS: "stiffness_n_per_m",
    Value.WALL_VIRTUAL_DAMPING: "virtual_damping_ns_per_m",
    Value.WALL_POSITION: "position_m",
    Value.WALL_SIDE: "side",
}


class Asked(NamedTuple):
    """One request judged by the guard."""

    seed: int
    policy: str
    change: dict[str, Any]
    point: Point  # the requested point, free
    contact: Point | None  # and in contact with its wall
    filters: bool  # whether it requests other filters
    enable: bool
    action: str
    clamped: bool
    text: str


class Flown(NamedTuple):
    """Result of one sequence."""

    asked: list[Asked]
    points: list[Point]  # distinct ones in force
    ends: list[Point]  # the steady ones of them


def display_of(plan: Plan, tick: int | None, params: ServoParams) -> dict[str, Any]:
    """Return the display in force at `tick`, or for None the target of all ramps."""

    def value(place: Value) -> float:
        ramp = plan.values[place]
        return ramp.end if tick is None else ramp.value(tick)

    first, second = plan.filters
    asked = plan.active_damping_asked if plan.active_damping_on else 0.0
    level = asked if tick is None else plan.added
    wall = {name: value(place) for place, name in WALL.items()}
    return {
        "K": value(Value.STIFFNESS),
        "B": value(Value.VIRTUAL_DAMPING),
        "M": value(Value.MASS),
        "wall": wall | {"side": (wall["side"] > 0.0) - (wall["side"] < 0.0)},
        "filters": {
            "velocity_hz": first.frequency_hz,
            "velocity_zeta": first.damping_ratio,
            "acceleration_hz": second.frequency_hz,
            "acceleration_zeta": second.damping_ratio,
        },
        "active_damping": params.device.active_damping.to_value(damping_count(level, params)),
    }


def merged(display: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    """Return `display` after the partial `change`."""
    tables = {name: display[name] | change.get(name, {}) for name in ("wall", "filters")}
    plain = {name: change.get(name, display[name]) for name in ("K", "B", "M", "active_damping")}
    return plain | tables


def points_of(display: dict[str, Any], gain: float = 1.0) -> tuple[Point, Point | None]:
    """Return the environment free, and in contact if there is a wall."""
    filters = display["filters"]
    free = Point(
        gain * display["K"], gain * display["B"], gain * display["M"], display["active_damping"],
        filters["velocity_hz"], filters["velocity_zeta"],
        filters["acceleration_hz"], filters["acceleration_zeta"],
    )  # fmt: skip
    wall = display["wall"]
    share = gain * wall["side"] ** 2
    if not share or not (wall["stiffness_n_per_m"] or wall["virtual_damping_ns_per_m"]):
        return free, None
    return free, free._replace(
        stiffness=free.stiffness + share * wall["stiffness_n_per_m"],
        damping=free.damping + share * wall["virtual_damping_ns_per_m"],
    )


class Plans:
    """The servo's plan over time, and the environments in force."""

    def __init__(self, params: ServoParams) -> None:
        self.params = params
        self.limits = CommandLimits.announced(params)
        self.plan = initial_plan(params)
        self.tick = 1
        self.points: dict[Point, bool] = {}  # and whether it was ever steady

    @property
    def resting(self) -> bool:
        """Whether no change is in progress."""
        return wake_tick(self.plan, self.tick, self.params) == NEVER

    @property
    def ramping(self) -> bool:
        """Whether a value is ramping, except damping."""
        return any(ramp.running(self.tick) for ramp in self.plan.values.values())

    @property
    def effect_ns_per_m(self) -> float:
        """The damping reported by the board."""
        return display_of(self.plan, self.tick, self.params)["active_damping"]

    @property
    def revision(self) -> int:
        """Revision of the environment in force."""
        return self.plan.environment_revision

    def post(self, change: dict[str, Any], revision: int, at_tick: int = 0) -> Result:
        """Post a `set` of `change`, judged for the environment `revision`, as the gateway does."""
        request = parse({"cmd": "set", **change}, self.limits)
        values = list(posting(request, 0)[VALUES])
        values[Value.MASK] += 1 << Value.ENVIRONMENT_REVISION
        values[Value.ENVIRONMENT_REVISION] = revision
        return self._obey(Command.SET, at_tick, tuple(values))

    def switch(self, kind: Command) -> Result:
        """Enable or disable."""
        return self._obey(kind, 0, (0.0,) * COMMAND_VALUES)

    def _obey(self, kind: Command, tick: int, values: tuple[float, ...]) -> Result:
        now = CommandContext(self.tick, self.tick - 1, 0, 0.0, True, 0)
        self.plan, answers = obey(self.plan, (1, kind, 1, tick, values), now, self.params)
        return Result(answers[-1][1])

    def run(self, ticks: int) -> None:
        """Run `ticks` ticks; skip those without an event."""
        end = self.tick + ticks
        while self.tick < end:
            due = self.plan.scheduled[0].tick if self.plan.scheduled else end
            if self.resting and min(due, end) > self.tick + 1:
                self._look(True)
                self.tick = min(due, end) - 1
            self.step()

    def step(self) -> None:
        """Run one tick."""
        self.tick += 1
        while self.plan.scheduled and self.plan.scheduled[0].tick <= self.tick:
            due = self.plan.scheduled[0]
            waiting = self.plan._replace(scheduled=self.plan.scheduled[1:])
            self.plan, _ = apply_settings(waiting, due, self.params)
        self.plan = advance_added(self.plan, self.tick, 1, self.params)
        if self.tick % EACH == 0 or self.resting:
            self._look(self.resting)

    def _look(self, stands: bool) -> None:
        if self.plan.state is not State.ENABLED:
            return
        gain = self.plan.gain.value(self.tick)
        display = display_of(self.plan, self.tick, self.params)
        # the side of a wall has a ramp too
        display["wall"]["side"] = self.plan.values[Value.WALL_SIDE].value(self.tick)
        for point in points_of(display, gain):
            if point is not None:
                rounded = Point(*(float(f"{number:.6g}") for number in point))
                self.points[rounded] = self.points.get(rounded, False) or stands


class Guarded:
    """A plan with the changes that the guard permits, as through the gateway."""

    def __init__(
        self,
        judge: Answering,
        params: ServoParams,
        policy: str,
        delay_periods: float | None,
        seed: int,
    ) -> None:
        self.judge = judge
        self.plans = Plans(params)
        self.policy = policy
        self.delay_periods = delay_periods
        self.seed = seed
        self.mode = {"mode": "off", "level": params.active_damping_ns_per_m}
        self.expected = 0  # revision for which the next stage was judged
        self.stages: list[dict[str, Any]] = []
        self.scheduled: list[tuple[int, dict[str, Any]]] = []  # tick and change
        self.asked: list[Asked] = []

    def ask(self, change: dict[str, Any], at_tick: int = 0, enable: bool = False) -> str:
        """Judge `change` and apply the guard's answer; return the action."""
        plans = self.plans
        params = plans.params
        ramp_s = change.get("ramp_s", params.safety.default_ramp_s)
        self.scheduled = [one for one in self.scheduled if one[0] > plans.tick]
        target = display_of(plans.plan, None, params)
        earlier = [one for when, one in self.scheduled if at_tick and when <= at_tick]
        later = [one for when, one in self.scheduled if when > at_tick]
        plain = {name: one for name, one in change.items() if name != "ramp_s"}
        answer = self._answer(
            {
                "ask": "change", "n": len(self.asked), "state": plans.plan.state.name.lower(),
                "now": display_of(plans.plan, plans.tick, params), "target": target,
                "enable": enable, "change": plain, "before": earlier, "after": later,
                "policy": self.policy, "basis": "theorem", "margin_ns_per_m": 0.0,
                **self.mode, "delay_periods": self.delay_periods, "ramp_s": ramp_s,
            }
        )  # fmt: skip
        for one in earlier:
            target = merged(target, one)
        free, contact = points_of(merged(target, plain))
        verdict = answer["verdict"]
        self.asked.append(
            Asked(
                self.seed, self.policy, change, free, contact, "filters" in change, enable,
                answer["action"], bool(verdict["clamped"]), verdict["text"],
            )
        )  # fmt: skip
        if answer["action"] != "refuse":
            given = {"ramp_s": change["ramp_s"]} if "ramp_s" in change else {}
            self._do(answer["stages"], at_tick, enable, given)
        return answer["action"]

    def _answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return the guard's answer; an error in its worker is a refusal."""
        try:
            return self.judge(request)
        except HapticdError as error:
            verdict = {"clamped": False, "text": f"error: {error}"}
            return {"action": "refuse", "stages": [], "verdict": verdict}

    def _do(
        self, stages: list[dict[str, Any]], at_tick: int, enable: bool, ramp_s: dict[str, float]
    ) -> None:
        plans = self.plans
        extras = [stage["change"] | ramp_s if stage["change"] else {} for stage in stages]
        changed = [stage | {"change": more} for stage, more in zip(stages, extras, strict=True)]
        if at_tick:
            # earlier entries of the schedule increment the revision
            ahead = sum(when <= at_tick for when, _ in self.scheduled)
            change = changed[0]["change"]
            if not change:  # mode auto accepts no explicit level
                return
            posted = plans.post(change, plans.revision + ahead, at_tick)
            if posted is Result.SCHEDULED and len(stages) == 1:
                self.scheduled = sorted([*self.scheduled, (at_tick, change)], key=_when)
            return
        self.stages = changed
        self.expected = plans.revision
        self._stage()
        if enable:
            self._finish()
            plans.switch(Command.ENABLE)

    def _stage(self) -> None:
        plans = self.plans
        while self.stages:
            stage = self.stages[0]
            least = stage.get("active_damping_at_least")
            if least is not None and plans.effect_ns_per_m < least - 1e-3:
                return
            if stage.get("after_ramps") and plans.ramping:
                return
            self.stages.pop(0)
            if not stage["change"]:
                continue
            if plans.post(stage["change"], self.expected) is not Result.APPLIED:
                self.stages = []  # later stages assume that it is in force
            self.expected += 1

    @property
    def tick(self) -> int:
        """Tick of the servo."""
        return self.plans.tick

    def disable(self) -> None:
        """Switch force off, which ends changes in progress."""
        self.plans.switch(Command.DISABLE)
        self.stages = []

    def choose(self, mode: str) -> None:
        """Set another mode of the active damping."""
        self.mode["mode"] = mode

    def run(self, ticks: int) -> None:
        """Run `ticks` ticks, and continue stages."""
        for _ in range(ticks if self.stages else 0):
            self.plans.step()
            self._stage()
            ticks -= 1
            if not self.stages:
                break
        self.plans.run(ticks)

    def _finish(self) -> None:
        self.run(LONGEST_WAIT)


def _when(one: tuple[int, dict[str, Any]]) -> int:
    return one[0]


def drawn(random: Random, kinds: Mapping[str, int]) -> dict[str, Any]:
    """Return a change of some parameters, of `kinds` with these weights."""
    change: dict[str, Any] = {}
    count = random.choice((1, 1, 2, 3))
    for kind in random.choices(list(kinds), list(kinds.values()), k=count):
        change |= {kind: _VALUES[kind](random)}
    if random.random() < 0.4:
        change["ramp_s"] = random.choice((0.0, 0.02, 0.2, 1.0))
    return change


def _wall(random: Random) -> dict[str, Any]:
    wall = {
        "stiffness_n_per_m": random.choice((0.0, 10.0 ** random.uniform(2.0, 3.5))),
        "virtual_damping_ns_per_m": random.choice((0.0, random.uniform(0.0, 4.0))),
        "side": random.choice((-1, 0, 1, 1)),
    }
    return dict(random.sample(sorted(wall.items()), random.randint(1, 3)))


def _filters(random: Random) -> dict[str, float]:
    both = {
        "velocity_hz": random.uniform(20.0, 300.0),
        "velocity_zeta": random.uniform(0.4, 1.5),
        "acceleration_hz": random.uniform(20.0, 200.0),
        "acceleration_zeta": random.uniform(0.4, 1.5),
    }
    return dict(random.sample(sorted(both.items()), random.randint(1, 4)))


_VALUES: dict[str, Callable[[Random], Any]] = {
    "K": lambda random: random.choice(
        (0.0, *(10.0 ** random.uniform(1.0, 3.6) for _ in range(4)), -20.0)
    ),
    "B": lambda random: random.choice((0.0, random.uniform(-1.5, 6.0))),
    "M": lambda random: random.choice((0.0, random.uniform(-0.015, 0.02))),
    "active_damping": lambda random: random.choice((0.0, 0.0, 1.74, random.uniform(0.0, 4.0))),
    "wall": _wall,
    "filters": _filters,
}  # fmt: skip


def fly(
    seed: int, judge: Answering, params: ServoParams, delay_periods: float | None = None
) -> Flown:
    """Run the sequence of `seed`."""
    random = Random(f"guard {seed}")
    policy = POLICIES[seed % len(POLICIES)]
    if random.random() < 0.15:
        params = replace(params, environment=_configured(params, random))
    enable_ramp_s = random.choice((0.02, 0.1, 0.5))
    params = replace(params, safety=replace(params.safety, enable_ramp_s=enable_ramp_s))
    guarded = Guarded(judge, params, policy, delay_periods, seed)
    if random.random() < 0.3:
        guarded.ask(drawn(random, EVERYTHING))  # an environment before force
        guarded.run(random.randrange(LONGEST_WAIT))
    guarded.ask({}, enable=True)
    for _ in range(REQUESTS):
        guarded.run(random.choice((0, random.randrange(60), random.randrange(600), 900, 900)))
        request(guarded, random)
    guarded.run(LONGEST_WAIT)
    points = guarded.plans.points
    return Flown(guarded.asked, list(points), [point for point, stood in points.items() if stood])


def _configured(params: ServoParams, random: Random) -> Environment:
    """Return an environment that a configuration may render at start, inside the set or not."""
    return replace(
        params.environment,
        stiffness_n_per_m=_VALUES["K"](random),
        virtual_damping_ns_per_m=_VALUES["B"](random),
        mass_kg=_VALUES["M"](random),
    )


def request(guarded: Any, random: Random, kinds: Mapping[str, int] = EVERYTHING) -> None:
    """Send one client request to `guarded`, a `Guarded` or an object with the same interface."""
    kind = random.random()
    if kind < 0.06:
        guarded.disable()
        guarded.run(random.randrange(100))
        if random.random() < 0.5:
            guarded.ask(drawn(random, kinds))
            guarded.run(random.choice((0, random.randrange(300))))
        guarded.ask({}, enable=True)
    elif kind < 0.1:
        guarded.choose(random.choice(("off", "off", "level", "auto")))
    else:
        soon = guarded.tick + random.randrange(5, 400) if random.random() < 0.15 else 0
        guarded.ask(drawn(random, kinds), soon)
