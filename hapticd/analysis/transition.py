"""How a change is made: which parts of it, in which order, and whether the whole way is safe.

A change asks for K, B, M, a wall, filters or a level of active damping. Judged is not only where it
ends but the way there, at most POINTS points of it, before anything moves:

    what ramps        the line from what is in force now to what is asked; where an earlier change
                      is still under way too, the patch that both span, with its corners
    enable            the gain from 0 to 1, which scales every force
    damping           the levels on the way, of those that are kept
    scheduled         this change comes after those before it, and those after it come after it

Each environment of the way is judged in free space and in contact. The order is: damping rises
before K and B grow; K and B shrink before damping falls. Each `Stage` waits for what the board
reports as damping, or for the ramps of the stage before, never for a time. If one way is not safe
the next is tried: with what is under way brought to its end first, with what shrinks first, with
what grows first. A longer ramp goes through the same points, so none is asked for.

    refuse   nothing moves unless the end and the way are safe
    clamp    as far as the first exit from the safe set on the way, the result judged again; not for
             filters, and not from outside
    follow   for less damping, first the environment shrinks in proportion into the set of that
             damping, then the damping falls; everything else as refuse
    warn     done as asked, in the right order, and told
    off      not judged

From outside the set a way is also taken on which every point is no worse than the one before it
(radius, margin and K, in free space and in contact) and the last one is better.

Mode `auto` takes the least of the kept levels that leaves the margin asked for. It goes down only
to a level that leaves HYSTERESIS more, so that it does not go up and down with every change.

What would break it: ramps of several earlier changes under way at once, which are taken as one; or
a parameter that moves without being asked here.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from hapticd.analysis.allowed import (
    Basis,
    Conditions,
    Display,
    Judgement,
    Measured,
    Predicted,
    Reading,
    Theorem,
    cached_levels,
    model_of,
)
from hapticd.analysis.coupled import Hand, coupled_radius, shaking_hand
from hapticd.analysis.linearise import Perturbation
from hapticd.errors import AnalysisError
from hapticd.params import FilterParams, GuardSetup, WallParams

POINTS = 20  # of a whole way
HYSTERESIS_NS_PER_M = 0.05  # more than the margin asked for, before auto goes down
NOT_COVERED = ("contact switching", "varying delay")
STRICT = ("refuse", "clamp", "follow")
POLICIES = ("off", "warn", *STRICT)
_CLAMP_STEPS = 12  # halvings of the way between the last safe point and the first that is not
_FOLLOW_STEPS = 41  # shares of the environment that are looked at
_LEAST_MOVE = 1e-3  # of the way: a clamp to less moves nothing
_WORSE = 1e-9  # a rounding is not worse
_GROWS = 1.0 + 1e-9  # radius in a hand; 1 within rounding is a mode of the hand without loss


class Stage(NamedTuple):
    """One command of a change, and what it waits for."""

    change: dict[str, Any]  # fields as in `set`, absolute values
    damping_at_least: float | None = None  # N s/m that the board has to report before
    after_ramps: bool = False  # ramps before it must have ended

    def plain(self) -> dict[str, Any]:
        """As it is sent."""
        return self._asdict()


class Leg(NamedTuple):
    """A part of a way: from what is in force, with what is still under way, to what is asked."""

    start: Display  # in force
    under_way: Display  # where the ramps in force would end
    end: Display
    gain: bool = False  # the gain goes from 0 to 1 at its end


class Plan(NamedTuple):
    """Stages with the way that they take."""

    stages: list[Stage]
    legs: list[Leg]
    end: Display


class Judge:
    """Answers requests about displays on the device of `setup`; plain maps in and out.

    The same requests give the same answers. AnalysisError for a request that makes no sense.
    """

    def __init__(self, setup: GuardSetup) -> None:
        self.setup = setup
        self.levels = cached_levels(setup.damping_limit_ns_per_m, setup.added_damping_ns_per_m)
        self.theorem = None if setup.model is None else Theorem(model_of(setup.model))
        self._cold = list(self.levels)

    def hello(self, pid: int) -> dict[str, Any]:
        """What the worker says first."""
        return {
            "hello": {
                "model": self.theorem is not None,
                "model_hash": self.setup.model_hash,
                "config_hash": self.setup.config_hash,
                "basis": self.setup.guard.basis,
                "pid": pid,
            }
        }

    def warm(self, delay_periods: float | None = None) -> bool:
        """Prepare one more level; False when all are."""
        if self.theorem is None or not self._cold:
            return False
        rendered = self.setup.environment
        filters = rendered.velocity_filter, rendered.acceleration_filter
        spare = self.setup.guard.margin_ns_per_m
        delay = self._delay(delay_periods)
        self.theorem.prepare(Conditions(self._cold.pop(0), filters, delay, spare))
        return bool(self._cold)

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to one request: `change`, `look` or `hand`."""
        asks = {"change": self._change, "look": self._look, "hand": self._hand}
        ask = request.get("ask")
        if ask not in asks:
            raise AnalysisError(f"the guard is asked {ask!r}; it knows {', '.join(asks)}")
        return {"n": request.get("n"), **asks[ask](request)}

    # --- what is asked ----------------------------------------------------------------------------

    def _change(self, request: Mapping[str, Any]) -> dict[str, Any]:
        policy = request["policy"]
        if policy not in POLICIES:
            raise AnalysisError(f"policy {policy!r}; there are {', '.join(POLICIES)}")
        judgement, unknown = self._judgement(request)
        way = _Way(self, judgement, request)
        if policy == "off":
            return way.not_judged("not judged: the policy is off")
        if judgement is None:
            return way.unknown(unknown)
        return way.judged()

    def _look(self, request: Mapping[str, Any]) -> dict[str, Any]:
        judgement, unknown = self._judgement(request)
        target = self.display(request["target"])
        if judgement is None:
            nothing = {"margin_ns_per_m": None, "allowed": None}
            return {
                "verdict": self.verdict(None, target, "", unknown, []),
                "without_damping": nothing,
                "with_damping": {"level": request["level_on"], **nothing},
            }
        safe = judgement.safe([target])[0]
        on = min(float(request["level_on"]), self.setup.damping_limit_ns_per_m)
        text = self.sentence(judgement, target, safe)
        return {
            "verdict": self.verdict(judgement, target, "", text, [target], safe),
            "without_damping": self._seen(judgement, target._replace(added_ns_per_m=0.0)),
            "with_damping": {
                "level": on,
                **self._seen(judgement, target._replace(added_ns_per_m=on)),
            },
        }

    def _seen(self, judgement: Judgement, display: Display) -> dict[str, Any]:
        worse = self.worse(judgement, display)
        allowed = judgement.allowed(display, self.setup.lowest, self.setup.highest)
        return {"margin_ns_per_m": worse.margin_ns_per_m, "allowed": allowed}

    def _hand(self, request: Mapping[str, Any]) -> dict[str, Any]:
        if self.theorem is None:
            return {"hand": None}
        display = self.display(request["display"])
        model = self.theorem.late(self._delay(request.get("delay_periods")))
        level = display.added_ns_per_m
        best: dict[str, Any] | None = None
        for place, point in enumerate(display.points()):
            if point[0] < 0.0:
                continue
            found = shaking_hand(model, point, level, display.filters)
            if found is None:
                continue
            hand, hz = found
            radius = float(
                coupled_radius(model, np.array([point]), [hand], level, display.filters)[0, 0]
            )
            if radius > _GROWS and (best is None or radius > best["radius"]):
                best = in_words(hand, hz, place == 1) | {"hz": hz, "radius": radius}
        return {"hand": best}

    # --- what it is made of -----------------------------------------------------------------------

    def display(self, plain: Mapping[str, Any]) -> Display:
        """The display of these fields. AnalysisError for a number that is not finite."""
        rendered = self.setup.environment
        start = Display(0.0, 0.0, 0.0, WallParams(), _filters_of(rendered), 0.0)
        return changed(start, plain)

    def _delay(self, asked: float | None) -> float:
        if asked is not None:
            return float(asked)
        return 0.0 if self.theorem is None else self.theorem.model.delay_periods

    def _judgement(self, request: Mapping[str, Any]) -> tuple[Judgement | None, str]:
        """How to judge it, or None and why not."""
        found = self._basis(request["basis"])
        if isinstance(found, str):
            return None, found
        delay = self._delay(request.get("delay_periods"))
        return Judgement(found, delay, float(request["margin_ns_per_m"])), ""

    def _basis(self, asked: str) -> Basis | str:
        if asked.startswith("measured"):
            measured = self.setup.measured
            if measured is None:
                return "unknown: no .zwidth file is named; set [guard] measured"
            if measured.refused:
                return f"unknown: {measured.file} does not count: {measured.refused}"
            return Measured(measured)
        if asked not in ("theorem", "predicted"):
            raise AnalysisError(f"basis {asked!r}; there are theorem, predicted and measured")
        if self.theorem is None:
            return (
                "unknown: this device has no model; give its file a [model], or measure it and set"
                " [guard] basis = 'measured'"
            )
        if asked == "theorem":
            return self.theorem
        return Predicted(self.theorem, Perturbation(self.setup.psd_n2_per_hz, self.setup.band_hz))

    def worse(self, judgement: Judgement, display: Display) -> Reading:
        """The reading of free space or contact, whichever is worse."""
        free = judgement.reading(display)
        contact = judgement.in_contact(display)
        if contact is None or contact.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return min(free, contact, key=lambda one: one.margin_ns_per_m or 0.0)

    def sentence(self, judgement: Judgement, display: Display, safe: bool) -> str:
        """What is known of a display, in one sentence."""
        where = (
            f"K = {display.stiffness_n_per_m:g} N/m, B = {display.damping_ns_per_m:g} N s/m,"
            f" M = {1e3 * display.mass_kg:g} g with {display.added_ns_per_m:g} N s/m of damping"
        )
        if display.stiffness_n_per_m < 0.0:
            return f"{where}: K < 0 pushes away and is active at low frequencies; ask for K >= 0"
        free = judgement.reading(display)
        worst = self.worse(judgement, display)
        side = "" if worst == free else " in the wall"
        if worst.margin_ns_per_m is None:
            kind = "inside" if safe else "not inside"
            return f"{where}: {kind} what {judgement.basis.name} holds"
        if worst.radius is not None and worst.radius >= 1.0:
            return (
                f"{where}: unstable by itself{side}, each tick times {worst.radius:.5g}; ask for"
                " less, or for more damping"
            )
        margin = worst.margin_ns_per_m
        if not safe:
            asked = judgement.spare_ns_per_m
            return (
                f"{where}: {asked - margin:.3g} N s/m short{side} at {worst.worst_hz:.3g} Hz"
                f" ({judgement.basis.name}); ask for less, or for more damping"
            )
        return f"{where}: {margin:.3g} N s/m to spare{side}, least at {worst.worst_hz:.3g} Hz"

    def verdict(
        self,
        judgement: Judgement | None,
        display: Display,
        policy: str,
        text: str,
        path: Sequence[Display],
        safe: bool | None = None,
        given: Display | None = None,
        clamped: bool = False,
    ) -> dict[str, Any]:
        """What is told of `display`, judged along `path`; `given` is where the stages lead."""
        known = judgement is not None
        free = judgement.reading(display) if judgement else Reading(None, None, None)
        contact = judgement.in_contact(display) if judgement else None
        return {
            "safe": safe if known else None,
            "policy": policy,
            "basis": judgement.basis.name if judgement else "unknown",
            **free._asdict(),
            "contact": None if contact is None else contact._asdict(),
            "delay_periods": judgement.delay_periods if judgement else None,
            "allowed": (
                judgement.allowed(display, self.setup.lowest, self.setup.highest)
                if judgement
                else None
            ),
            "least_damping_ns_per_m": (
                judgement.least_level(display, self.levels) if judgement else None
            ),
            "clamped": clamped,
            "given": plain_of(display if given is None else given),
            "path_points": sum(len(one.points()) for one in path),
            "not_covered": list(self.not_covered()),
            "text": text,
        }

    def not_covered(self) -> tuple[str, ...]:
        """What no verdict promises."""
        ends = self.setup.environment.workspace.stiffness_n_per_m > 0.0
        return (*NOT_COVERED, "soft ends of the workspace") if ends else NOT_COVERED


class _Way:
    """One `change`: what it asks for, the ways there, and which is taken."""

    def __init__(
        self, judge: Judge, judgement: Judgement | None, request: Mapping[str, Any]
    ) -> None:
        self.judge = judge
        self.judgement = judgement
        self.policy: str = request["policy"]
        self.enable = bool(request["enable"])
        self.moving = self.enable or request["state"] == "enabled"
        self.now = judge.display(request["now"])
        self.target = judge.display(request["target"])
        for one in request["before"]:
            self.now = self.target
            self.target = changed(self.target, one)
        self.now = self.now._replace(added_ns_per_m=self._in_effect())
        self.after = [dict(one) for one in request["after"]]
        self.asked = dict(request["change"])
        self.change = self._with_mode(request)
        self.wanted = changed(self.target, self.change)

    # --- answers ----------------------------------------------------------------------------------

    def not_judged(self, text: str) -> dict[str, Any]:
        """Done as asked, at once."""
        verdict = self.judge.verdict(None, self.wanted, self.policy, text, [])
        return _answer([Stage(self.change)], verdict)

    def unknown(self, why: str) -> dict[str, Any]:
        """Nothing is known of this device: refused where safety was asked for."""
        if self.policy in STRICT:
            text = f"{why}; the policy {self.policy!r} refuses what is unknown"
            verdict = self.judge.verdict(None, self.target, self.policy, text, [])
            return _answer([], verdict)
        stages = self._ways(self.wanted)[0].stages
        return _answer(stages, self.judge.verdict(None, self.wanted, self.policy, why, []))

    def judged(self) -> dict[str, Any]:
        """The first way that is safe, or what the policy makes of it."""
        assert self.judgement is not None
        ways = self._ways(self.wanted)
        plan = next((way for way in ways if self.is_safe(way)), None)
        if plan is not None:
            text = self.judge.sentence(self.judgement, self.wanted, True)
            return self._taken(plan, True, text)
        ends_safe = self.judgement.safe([self.wanted])[0]
        text = self._trouble(ways[0], ends_safe)
        safer = next((way for way in ways if self._is_safer(way)), None)
        if safer is not None:
            return self._taken(safer, False, f"{text}; taken all the same: it is safer than now")
        if self.policy == "warn":
            return self._taken(ways[0], False, f"warning: {text}")
        if self.policy == "clamp":
            return self._clamped(ways[0], text)
        if self.policy == "follow" and self.wanted.added_ns_per_m < self.target.added_ns_per_m:
            return self._followed(text)
        return self._refused(f"refused: {text}")

    def _taken(
        self,
        plan: Plan,
        safe: bool,
        text: str,
        given: Display | None = None,
        clamped: bool = False,
    ) -> dict[str, Any]:
        path = self.path(plan)
        verdict = self.judge.verdict(
            self.judgement,
            self.wanted,
            self.policy,
            text,
            path,
            safe,
            plan.end if given is None else given,
            clamped,
        )
        return _answer(plan.stages, verdict)

    def _refused(self, text: str) -> dict[str, Any]:
        path = self.path(self._ways(self.wanted)[0])
        verdict = self.judge.verdict(
            self.judgement, self.wanted, self.policy, text, path, False, self.target
        )
        return _answer([], verdict)

    def _trouble(self, way: Plan, ends_safe: bool) -> str:
        assert self.judgement is not None
        if not ends_safe:
            return self.judge.sentence(self.judgement, self.wanted, False)
        path = self.path(way)
        flags = self.judgement.safe(path)
        bad = next((one for one, flag in zip(path, flags, strict=True) if not flag), path[-1])
        return f"on the way, {self.judge.sentence(self.judgement, bad, False)}"

    # --- what is asked for ------------------------------------------------------------------------

    def _with_mode(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The change with the level of damping that the mode asks for."""
        mode = request["mode"]
        change = dict(self.asked)
        ceiling = self.judge.setup.damping_limit_ns_per_m
        if mode == "level" and "damping" not in change:
            change["damping"] = min(float(request["level"]), ceiling)
        elif mode == "auto" and self.judgement is not None:
            change["damping"] = self._least(changed(self.target, change))
        if change.get("damping") == self.target.added_ns_per_m and "damping" not in self.asked:
            del change["damping"]
        return change

    def _least(self, display: Display) -> float:
        """The level of mode `auto`: the least that will do; down only with some to spare."""
        assert self.judgement is not None
        present = self.target.added_ns_per_m
        levels = self.judge.levels
        needed = self.judgement.least_level(display, levels)
        if needed is None:
            return max(present, self._most_spare(display))
        if needed >= present:
            return needed
        spare = self.judgement.spare_ns_per_m + HYSTERESIS_NS_PER_M
        easy = Judgement(self.judgement.basis, self.judgement.delay_periods, spare)
        lower = easy.least_level(display, [level for level in levels if level < present])
        return present if lower is None else lower

    def _most_spare(self, display: Display) -> float:
        """The level with the largest margin, where none is enough."""
        assert self.judgement is not None
        judgement = self.judgement

        def margin(level: float) -> float:
            found = self.judge.worse(judgement, display._replace(added_ns_per_m=level))
            return found.margin_ns_per_m or 0.0

        return max(self.judge.levels, key=margin)

    def _in_effect(self) -> float:
        """The level in effect: that which is asked for, or while it is on its way the kept one
        below.
        """
        reported = self.now.added_ns_per_m
        asked = self.target.added_ns_per_m
        if abs(reported - asked) <= self.judge.setup.damping_count_ns_per_m:
            return asked
        return max((level for level in self.judge.levels if level <= reported), default=reported)

    # --- ways -------------------------------------------------------------------------------------

    def _ways(self, wanted: Display) -> list[Plan]:
        """The ways to `wanted`, in the order in which they are tried."""
        if not self.moving:
            leg = Leg(wanted, wanted, wanted)
            return [Plan([Stage(self._fields(wanted))], [leg], wanted)]
        if self.enable:
            return [self._enabling(False), self._enabling(True)]
        damping = {"damping": wanted.added_ns_per_m} if "damping" in self.change else {}
        rest = {name: value for name, value in self.change.items() if name != "damping"}
        rest = _absolute(rest, wanted)
        here = self.target.added_ns_per_m
        if not rest:
            only = [[Stage(damping)], [Stage(damping, after_ramps=True)]]
            return [self.plan(stages) for stages in only]
        orders = [
            [Stage(rest)],
            [Stage(rest, after_ramps=True)],
            *_split(rest, self.target, wanted),
        ]
        if not damping or wanted.added_ns_per_m == here:
            whole = [
                [stages[0]._replace(change=stages[0].change | damping), *stages[1:]]
                for stages in orders
            ]
            waiting = [[_waits(stages[0], self._reported(here)), *stages[1:]] for stages in whole]
            late = self.now.added_ns_per_m < self.target.added_ns_per_m
            return [self.plan(stages) for stages in (whole + waiting if late else whole)]
        if wanted.added_ns_per_m > here:
            level = self._reported(wanted.added_ns_per_m)
            rising = [[Stage(damping), _waits(stages[0], level), *stages[1:]] for stages in orders]
            return [self.plan(stages) for stages in rising]
        falling = [[*stages, Stage(damping, after_ramps=True)] for stages in orders]
        return [self.plan(stages) for stages in falling]

    def _fields(self, wanted: Display) -> dict[str, Any]:
        """The change as absolute values, those of `wanted`."""
        return _absolute(self.change, wanted)

    def _reported(self, level: float) -> float:
        """What the board reports at least when it has that level: a count less."""
        return max(0.0, level - self.judge.setup.damping_count_ns_per_m)

    def _enabling(self, waits: bool) -> Plan:
        end = self.wanted
        start = end if waits else end._replace(added_ns_per_m=self.now.added_ns_per_m)
        stage = Stage(self._fields(end))
        stages = [_waits(stage, self._reported(end.added_ns_per_m))] if waits else [stage]
        return Plan(stages, [Leg(start, start, end, gain=True)], end)

    def plan(self, stages: list[Stage]) -> Plan:
        """The way that these stages take, from what is in force."""
        now = self.now
        target = self.target
        legs = []
        for stage in stages:
            if stage.damping_at_least is not None:
                now = now._replace(added_ns_per_m=target.added_ns_per_m)
            if stage.after_ramps:
                now = target._replace(added_ns_per_m=now.added_ns_per_m)
            end = changed(target, stage.change)
            legs.append(Leg(now, target, end))
            target = end
        return Plan(stages, legs, target)

    def path(self, plan: Plan) -> list[Display]:
        """At most POINTS points of the way of `plan`, and of what is scheduled after it; each
        part has its end among them.
        """
        legs = list(plan.legs)
        target = plan.end
        for one in self.after:
            end = changed(target, one)
            legs.append(Leg(target, target, end))
            target = end
        size = max(len(display.points()) for leg in legs for display in (leg.start, leg.end))
        room = POINTS // size
        if len(legs) > room:
            raise AnalysisError(
                f"{len(legs)} changes after each other: at most {room} are judged; schedule fewer"
            )
        share = [room // len(legs)] * len(legs)
        for place in range(room % len(legs)):
            share[place] += 1
        levels = self.judge.levels
        return [
            display
            for leg, count in zip(legs, share, strict=True)
            for display in sampled(leg, count, levels)
        ]

    def is_safe(self, plan: Plan) -> bool:
        """Whether all of its way is."""
        assert self.judgement is not None
        return all(self.judgement.safe(self.path(plan)))

    def _is_safer(self, plan: Plan) -> bool:
        """Whether it leads from outside the set to a better point, no point worse than the one
        before.
        """
        assert self.judgement is not None
        if self.enable or not self.moving or self.judgement.safe([self.now])[0]:
            return False
        if any(_groups(leg) > 1 for leg in plan.legs):
            return False
        keys = [self._merit(one) for one in [self.now, *self.path(plan)]]
        if any(value is None for key in keys for value in key):
            return False
        merits = np.array(keys, np.float64)
        steps = np.diff(merits, axis=0)
        return bool((steps >= -_WORSE).all() and (merits[-1] - merits[0] > _WORSE).any())

    def _merit(self, display: Display) -> list[float | None]:
        """What must not fall on the way to a safer point: margin, radius and K, free and in
        contact.
        """
        assert self.judgement is not None
        free = self.judgement.reading(display)
        contact = self.judgement.in_contact(display) or free
        merit: list[float | None] = [min(display.stiffness_n_per_m, 0.0)]
        for one in (free, contact):
            radius = one.radius
            merit += [one.margin_ns_per_m, None if radius is None else -max(radius, 1.0)]
        return merit

    # --- policies ---------------------------------------------------------------------------------

    def _clamped(self, way: Plan, text: str) -> dict[str, Any]:
        """As far as the first exit, the result judged again."""
        assert self.judgement is not None
        if "filters" in self.change:
            return self._refused(f"refused: {text}; filters are not clamped")
        if self.enable or not self.moving:
            return self._refused(f"refused: {text}; there is no way to clamp to")
        if not all(self.judgement.safe([self.now, self.target])):
            return self._refused(
                f"refused: {text}; the display is outside the safe set already: ask for a point"
                " inside"
            )
        stages = self._shortened(way)
        plan = self.plan(stages)
        if not stages or plan.end == self.target:
            return self._refused(f"refused: {text}; nothing of it is safe")
        if not self.is_safe(plan):
            return self._refused(f"refused: {text}; what is left of it is not safe either")
        given = self.judge.sentence(self.judgement, plan.end, True)
        return self._taken(plan, False, f"clamped: {text}; given is {given}", clamped=True)

    def _shortened(self, way: Plan) -> list[Stage]:
        """The stages of `way`, each as far as its own way is safe."""
        target = self.target
        kept: list[Stage] = []
        for stage in way.stages:
            leg = self.plan([*kept, stage]).legs[-1]
            share = self._exit(leg)
            if share < _LEAST_MOVE:
                continue
            end = between(leg.under_way, leg.end, share, self.judge.levels)
            kept.append(stage._replace(change=_absolute(stage.change, end)))
            target = end
        return kept if target != self.target else []

    def _exit(self, leg: Leg) -> float:
        """The share of a leg up to which all of it is safe."""
        assert self.judgement is not None
        levels = self.judge.levels

        def part(share: float) -> Leg:
            return leg._replace(end=between(leg.under_way, leg.end, share, levels))

        def holds(share: float) -> bool:
            assert self.judgement is not None
            return all(self.judgement.safe(sampled(part(share), 4, levels)))

        inside = 0.0
        outside = 1.0
        for share in np.linspace(0.0, 1.0, POINTS)[1:].tolist():
            if not holds(share):
                outside = share
                break
            inside = share
        if inside == 1.0:
            return 1.0
        for _ in range(_CLAMP_STEPS):
            middle = 0.5 * (inside + outside)
            if holds(middle):
                inside = middle
            else:
                outside = middle
        return inside

    def _followed(self, text: str) -> dict[str, Any]:
        """The environment into the smaller set first, then less damping."""
        assert self.judgement is not None
        shares = np.linspace(1.0, 0.0, _FOLLOW_STEPS).tolist()
        displays = [self.wanted.scaled(share) for share in shares]
        flags = self.judgement.safe(displays)
        if not any(flags) or "filters" in self.change:
            return self._refused(f"refused: {text}; no smaller environment would do either")
        share = self._largest(shares, flags)
        small = self.wanted.scaled(share)
        first = Stage(_environment(small, self.wanted))
        plan = self.plan([first, Stage({"damping": self.wanted.added_ns_per_m}, after_ramps=True)])
        if not self.is_safe(plan):
            return self._refused(f"refused: {text}; the way into the smaller set is not safe")
        given = self.judge.sentence(self.judgement, plan.end, True)
        return self._taken(plan, False, f"followed: {text}; first the environment: {given}")

    def _largest(self, shares: Sequence[float], flags: Sequence[bool]) -> float:
        """The largest share that is safe, between that of `shares` and the one above."""
        assert self.judgement is not None
        place = list(flags).index(True)
        inside = shares[place]
        outside = shares[place - 1] if place else inside
        for _ in range(_CLAMP_STEPS):
            middle = 0.5 * (inside + outside)
            if self.judgement.safe([self.wanted.scaled(middle)])[0]:
                inside = middle
            else:
                outside = middle
        return inside


def _answer(stages: list[Stage], verdict: dict[str, Any]) -> dict[str, Any]:
    at_once = len(stages) == 1 and stages[0].damping_at_least is None
    at_once = at_once and not stages[0].after_ramps
    action = "refuse" if not stages else "apply" if at_once else "stage"
    return {"action": action, "stages": [stage.plain() for stage in stages], "verdict": verdict}


def _waits(stage: Stage, level: float) -> Stage:
    return stage._replace(damping_at_least=level)


def _filters_of(rendered: Any) -> tuple[FilterParams, FilterParams]:
    return rendered.velocity_filter, rendered.acceleration_filter


# --- displays ------------------------------------------------------------------------------------


def changed(display: Display, change: Mapping[str, Any]) -> Display:
    """The display with the fields of a `set`: K, B, M, parts of wall and filters, damping.

    AnalysisError for a number that is not finite.
    """
    _require_finite(change)
    stiffness, damping, mass = (
        float(change.get(name, value)) for name, value in zip("KBM", display.free, strict=True)
    )
    wall = replace(display.wall, **dict(change.get("wall") or {}))
    filters = change.get("filters") or {}
    first, second = (
        replace(
            one,
            frequency_hz=filters.get(f"{name}_hz", one.frequency_hz),
            damping_ratio=filters.get(f"{name}_zeta", one.damping_ratio),
        )
        for name, one in zip(("velocity", "acceleration"), display.filters, strict=True)
    )
    level = float(change.get("damping", display.added_ns_per_m))
    return Display(stiffness, damping, mass, wall, (first, second), level)


def _require_finite(table: Mapping[str, Any], where: str = "") -> None:
    for name, value in table.items():
        if isinstance(value, Mapping):
            _require_finite(value, f"{where}{name}.")
        elif isinstance(value, float) and not isfinite(value):
            raise AnalysisError(f"{where}{name} = {value}: the guard judges finite numbers only")


def plain_of(display: Display) -> dict[str, Any]:
    """The fields of a display, as they are sent."""
    first, second = display.filters
    wall = display.wall
    stiffness, damping, mass = display.free
    return {
        "K": stiffness,
        "B": damping,
        "M": mass,
        "wall": {
            "stiffness_n_per_m": wall.stiffness_n_per_m,
            "damping_ns_per_m": wall.damping_ns_per_m,
            "position_m": wall.position_m,
            "side": wall.side,
        },
        "filters": {
            "velocity_hz": first.frequency_hz,
            "velocity_zeta": first.damping_ratio,
            "acceleration_hz": second.frequency_hz,
            "acceleration_zeta": second.damping_ratio,
        },
        "damping": display.added_ns_per_m,
    }


def _absolute(change: Mapping[str, Any], display: Display) -> dict[str, Any]:
    """The fields that `change` names, with the values of `display`."""
    whole = plain_of(display)
    return {
        name: (
            {inner: whole[name][inner] for inner in value}
            if isinstance(value, Mapping)
            else whole[name]
        )
        for name, value in change.items()
        if name in whole
    }


def _environment(display: Display, other: Display) -> dict[str, Any]:
    """The fields of its environment that may differ from those of `other`."""
    whole = plain_of(display)
    if other.wall.side == 0:
        return {name: whole[name] for name in "KBM"}
    return {name: whole[name] for name in ("K", "B", "M", "wall")}


def _split(rest: dict[str, Any], here: Display, wanted: Display) -> Iterable[list[Stage]]:
    """What shrinks and what grows one after the other, either first; nothing if all go one way."""
    new = dict(zip("KBM", wanted.free, strict=True))
    old = dict(zip("KBM", here.free, strict=True))
    shrinking = {name for name in rest if name in new and abs(new[name]) < abs(old[name])}
    one = {name: value for name, value in rest.items() if name in shrinking}
    other = {name: value for name, value in rest.items() if name not in shrinking}
    if not one or not other:
        return []
    return [
        [Stage(one), Stage(other, after_ramps=True)],
        [Stage(other), Stage(one, after_ramps=True)],
    ]


def between(one: Display, other: Display, share: float, levels: Sequence[float] = ()) -> Display:
    """The display a share of the way from one to the other. Filters, and side and place of a
    wall, are those of the other; a level strictly between is one of `levels`, if any is.
    """

    def part(start: float, end: float) -> float:
        return end if share >= 1.0 else start + share * (end - start)

    wall = replace(
        other.wall,
        stiffness_n_per_m=part(one.wall.stiffness_n_per_m, other.wall.stiffness_n_per_m),
        damping_ns_per_m=part(one.wall.damping_ns_per_m, other.wall.damping_ns_per_m),
    )
    level = _kept(one.added_ns_per_m, other.added_ns_per_m, share, levels)
    stiffness, damping, mass = (part(*pair) for pair in zip(one.free, other.free, strict=True))
    return Display(stiffness, damping, mass, wall, other.filters, level)


def _kept(start: float, end: float, share: float, levels: Sequence[float]) -> float:
    """The level a share of the way: one that is kept, not beyond that share; or the start."""
    if share >= 1.0 or start == end:
        return end
    exact = start + share * (end - start)
    inside = [level for level in levels if min(start, exact) <= level <= max(start, exact)]
    return min(inside, key=lambda level: abs(level - exact), default=start)


def _groups(leg: Leg) -> int:
    """How many things move by themselves: what is asked, what is under way, the damping."""
    asked, under_way = _parts(leg)
    return asked + under_way + (leg.start.added_ns_per_m != leg.end.added_ns_per_m)


def _parts(leg: Leg) -> tuple[bool, bool]:
    """Whether what was asked moves the environment, and whether something else is under way."""
    asked = leg.end._replace(added_ns_per_m=leg.under_way.added_ns_per_m) != leg.under_way
    left = any(
        start != end and before == end
        for start, before, end in zip(
            _numbers(leg.start), _numbers(leg.under_way), _numbers(leg.end), strict=True
        )
    )
    return asked or leg.gain, left


def _numbers(display: Display) -> tuple[float, ...]:
    wall = display.wall
    return (*display.free, wall.stiffness_n_per_m, wall.damping_ns_per_m)


def sampled(leg: Leg, count: int, levels: Sequence[float] = ()) -> list[Display]:
    """At most `count` displays of a leg, its end the last: the line if one thing moves, a grid
    with all corners if several do.
    """
    if leg.gain:  # damping that is still on its way does not count before it is there
        here = leg.end._replace(added_ns_per_m=leg.start.added_ns_per_m)
        rising = [here.scaled((place + 1) / (count - 1)) for place in range(count - 1)]
        return [*rising, leg.end]
    groups = _groups(leg)
    if groups <= 1:
        return [between(leg.start, leg.end, (place + 1) / count, levels) for place in range(count)]
    side = int(count ** (1.0 / groups) + 1e-9)
    if side < 2:
        raise AnalysisError(
            "several ramps under way at once leave no room to judge this change too; wait for them"
        )
    shares = np.linspace(0.0, 1.0, side).tolist()
    asked, left = _parts(leg)
    moves = leg.start.added_ns_per_m != leg.end.added_ns_per_m
    grid = product(
        shares if asked else (1.0,), shares if left else (1.0,), shares if moves else (1.0,)
    )
    return [_patch(leg, *place, levels) for place in grid]


def _patch(leg: Leg, asked: float, left: float, level: float, levels: Sequence[float]) -> Display:
    """A leg's display with what was asked, what was under way and damping at shares of their
    own.
    """
    fast = between(leg.start, leg.end, asked)
    slow = between(leg.start, leg.end, left)
    still = [
        before == end
        for before, end in zip(_numbers(leg.under_way), _numbers(leg.end), strict=True)
    ]
    numbers = [
        s if own else f for own, s, f in zip(still, _numbers(slow), _numbers(fast), strict=True)
    ]
    wall = replace(leg.end.wall, stiffness_n_per_m=numbers[3], damping_ns_per_m=numbers[4])
    added = _kept(leg.start.added_ns_per_m, leg.end.added_ns_per_m, level, levels)
    return Display(numbers[0], numbers[1], numbers[2], wall, leg.end.filters, added)


def in_words(hand: Hand, hz: float, in_wall: bool) -> dict[str, Any]:
    """A hand as one thing that can be imagined: its mass, or its spring to the ground; small tuned
    masses beside it, which serve images, are left out.
    """
    where = f"at {hz:.3g} Hz" + (", in the wall" if in_wall else "")
    mass_kg = float(hand.mass_kg[0])
    if mass_kg > 0.0:
        return {"text": f"a mass of {1e3 * mass_kg:.3g} g, {where}", "mass_kg": mass_kg}
    # what is left at node 0 once the joints to the other nodes are taken away
    stiffness = float(hand.stiffness_n_per_m[0].sum())
    return {
        "text": f"a spring of {stiffness:.3g} N/m, {where}",
        "stiffness_n_per_m": stiffness,
    }
