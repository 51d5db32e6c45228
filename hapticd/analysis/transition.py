"""What is done with a change: the requests of the gateway to the guard's worker, and the policies.

`Judge` answers plain maps with plain maps (docs/guard.md). Where a change leads to is judged, and
at most 20 points of the way there (`ways`), in free space and in contact, by the basis asked for
(`allowed`). The first way that is safe is taken. If none is:

    refuse   nothing moves
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

What would break it: answering from anything but the request and the setup; the same request has the
same answer, and tests and lock-step flights rely on it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hapticd.analysis.allowed import (
    Basis,
    Conditions,
    Judgement,
    Measured,
    Predicted,
    Reading,
    Theorem,
    cached_levels,
    model_of,
)
from hapticd.analysis.coupled import coupled_radius, shaking_hand
from hapticd.analysis.displays import (
    Display,
    Point,
    between,
    changed,
    environment_of,
    fields_of,
    plain_of,
)
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.ways import POINTS, Leg, Plan, Request, Stage, Ways, groups, sampled
from hapticd.analysis.words import in_words, sentence
from hapticd.errors import AnalysisError
from hapticd.params import GuardSetup, WallParams
from hapticd.plant.model import Model

HYSTERESIS_NS_PER_M = 0.05  # more than the margin asked for, before auto goes down
NOT_COVERED = ("contact switching", "varying delay")
STRICT = ("refuse", "clamp", "follow")
POLICIES = ("off", "warn", *STRICT)
MODES = ("off", "level", "auto")
_HALVINGS = 12  # of the way between the last safe point and the first that is not
_SHARES = 41  # of the environment that `follow` looks at
_LEAST_MOVE = 1e-3  # of the way: a clamp to less moves nothing
_WORSE = 1e-9  # a rounding is not worse
_GROWS = 1.0 + 1e-9  # radius in a hand; 1 within rounding is a mode of the hand without loss
_NOTHING = Reading(None, None, None)


class Judge:
    """Answers requests about displays on the device of `setup`; plain maps in and out.

    The same requests give the same answers. AnalysisError for a request that makes no sense.
    """

    def __init__(self, setup: GuardSetup) -> None:
        self.setup = setup
        self.levels = cached_levels(setup.damping_limit_ns_per_m, setup.added_damping_ns_per_m)
        self.theorem = None if setup.model is None else Theorem(model_of(setup.model))
        self._cold = list(self.levels)
        self._warm_delay = self._delay(None)

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

    def warm(self) -> bool:
        """Prepare one more level for the delay that was last asked about; False when all are."""
        if self.theorem is None or not self._cold:
            return False
        rendered = self.setup.environment
        filters = rendered.velocity_filter, rendered.acceleration_filter
        spare = self.setup.guard.margin_ns_per_m
        at = Conditions(self._cold.pop(0), filters, self._warm_delay, spare)
        self.theorem.prepare(at)
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
        _require_known("policy", request["policy"], POLICIES)
        _require_known("mode", request["mode"], MODES)
        judgement, unknown = self._judgement(request)
        if judgement is None or request["policy"] == "off":
            return _Unjudged(self, request).answer(unknown)
        return _Judged(self, judgement, request).answer()

    def _look(self, request: Mapping[str, Any]) -> dict[str, Any]:
        judgement, unknown = self._judgement(request)
        target = self.display(request["target"])
        if judgement is None:
            nothing: dict[str, Any] = {"margin_ns_per_m": None, "allowed": {}}
            return {
                "verdict": self.verdict(None, target, "", unknown, []),
                "without_damping": nothing,
                "with_damping": {"level": request["level_on"], **nothing},
            }
        safe = judgement.safe([target])[0]
        on = min(float(request["level_on"]), self.setup.damping_limit_ns_per_m)
        text = sentence(judgement, target, safe)
        return {
            "verdict": self.verdict(judgement, target, "", text, [target], safe),
            "without_damping": self._seen(judgement, target._replace(added_ns_per_m=0.0)),
            "with_damping": {
                "level": on,
                **self._seen(judgement, target._replace(added_ns_per_m=on)),
            },
        }

    def _seen(self, judgement: Judgement, display: Display) -> dict[str, Any]:
        worse = judgement.worse(display)
        allowed = judgement.allowed(display, self.setup.lowest, self.setup.highest)
        return {"margin_ns_per_m": worse.margin_ns_per_m, "allowed": allowed}

    def _hand(self, request: Mapping[str, Any]) -> dict[str, Any]:
        if self.theorem is None:
            return {"hand": None}
        display = self.display(request["display"])
        model = self.theorem.late(self._delay(request.get("delay_periods")))
        found = [
            self._shaker(model, point, display, in_wall=place == 1)
            for place, point in enumerate(display.points())
            if point[0] >= 0.0
        ]
        hands = [one for one in found if one is not None]
        return {"hand": max(hands, key=lambda one: float(one["radius"]), default=None)}

    @staticmethod
    def _shaker(
        model: Model, point: Point, display: Display, in_wall: bool
    ) -> dict[str, Any] | None:
        level = display.added_ns_per_m
        found = shaking_hand(model, point, level, display.filters)
        if found is None:
            return None
        hand, hz = found
        at = np.array([point])
        radius = float(coupled_radius(model, at, [hand], level, display.filters)[0, 0])
        if radius <= _GROWS:
            return None
        return in_words(hand, hz, in_wall) | {"hz": hz, "radius": radius}

    # --- what it is made of -----------------------------------------------------------------------

    def display(self, plain: Mapping[str, Any]) -> Display:
        """The display of these fields. AnalysisError for a number that is not finite."""
        rendered = self.setup.environment
        filters = rendered.velocity_filter, rendered.acceleration_filter
        start = Display(0.0, 0.0, 0.0, WallParams(), filters, 0.0)
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
        if delay != self._warm_delay:
            self._warm_delay = delay
            self._cold = list(self.levels)
        spare = float(request["margin_ns_per_m"])
        return Judgement(found, delay, spare, min(delay, self._delay(None))), ""

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
        known = _of_nothing() if judgement is None else self._known(judgement, display)
        return {
            "safe": safe,
            "policy": policy,
            **known,
            "clamped": clamped,
            "given": plain_of(display if given is None else given),
            "path_points": sum(len(one.points()) for one in path),
            "not_covered": self._not_covered(),
            "text": text,
        }

    def _known(self, judgement: Judgement, display: Display) -> dict[str, Any]:
        contact = judgement.in_contact(display)
        return {
            "basis": judgement.basis.name,
            **judgement.reading(display)._asdict(),
            "contact": None if contact is None else contact._asdict(),
            "delay_periods": judgement.delay_periods,
            "allowed": judgement.allowed(display, self.setup.lowest, self.setup.highest),
            "least_damping_ns_per_m": judgement.least_level(display, self.levels),
        }

    def _not_covered(self) -> list[str]:
        """What no verdict promises."""
        ends = self.setup.environment.workspace.stiffness_n_per_m > 0.0
        return [*NOT_COVERED, "soft ends of the workspace"] if ends else [*NOT_COVERED]


def _of_nothing() -> dict[str, Any]:
    return {
        "basis": "unknown",
        **_NOTHING._asdict(),
        "contact": None,
        "delay_periods": None,
        "allowed": {},
        "least_damping_ns_per_m": None,
    }


def _require_known(what: str, asked: object, known: Sequence[str]) -> None:
    if asked not in known:
        raise AnalysisError(f"{what} {asked!r}; there are {', '.join(known)}")


class _Asked:
    """One `change` as it is asked for: where it starts, with what before and after it."""

    def __init__(self, judge: Judge, request: Mapping[str, Any]) -> None:
        self.judge = judge
        self.policy: str = request["policy"]
        # while an enable still comes up only a part of the display acts
        gain = float(request.get("gain", 1.0)) if request["state"] == "enabled" else 1.0
        self.now = judge.display(request["now"]).scaled(gain)
        self.target = judge.display(request["target"])
        self.passed = [judge.display(request["now"])]
        for one in request["before"]:
            self.passed.append(self.target)
            self.now = self.target
            self.target = changed(self.target, one)
        self.now = self.now._replace(added_ns_per_m=self._in_effect())
        self.asked: dict[str, Any] = dict(request["change"])
        self.request = request

    def _in_effect(self) -> float:
        """The level in effect: that which is asked for, or while it is on its way the kept one
        below.
        """
        reported = self.now.added_ns_per_m
        asked = self.target.added_ns_per_m
        if abs(reported - asked) <= self.judge.setup.damping_count_ns_per_m:
            return asked
        return max((level for level in self.judge.levels if level <= reported), default=reported)

    def ways(self, change: dict[str, Any]) -> Ways:
        """The ways of `change`."""
        enable = bool(self.request["enable"])
        return Ways(
            Request(
                now=self.now,
                target=self.target,
                wanted=changed(self.target, change),
                change=change,
                passed=self.passed,
                after=[dict(one) for one in self.request["after"]],
                enable=enable,
                moving=enable or self.request["state"] == "enabled",
                levels=self.judge.levels,
                count_ns_per_m=self.judge.setup.damping_count_ns_per_m,
            )
        )

    def with_level(self) -> dict[str, Any]:
        """The change with the level of mode `level`, where it names no other."""
        change = dict(self.asked)
        if self.request["mode"] == "level" and "damping" not in change:
            ceiling = self.judge.setup.damping_limit_ns_per_m
            level = min(float(self.request["level"]), ceiling)
            if level != self.target.added_ns_per_m:
                change["damping"] = level
        return change


class _Unjudged(_Asked):
    """A change about which nothing is known, or was to be known."""

    def answer(self, why: str) -> dict[str, Any]:
        """Refused where safety was asked for, otherwise done in the right order."""
        change = self.with_level()
        ways = self.ways(change)
        wanted = ways.request.wanted
        if self.policy in STRICT:
            text = f"refused: {why}; the policy {self.policy!r} refuses what is unknown"
            return _answer([], self._verdict(wanted, text, self.target))
        if self.policy == "off":
            stage = Stage(fields_of(change, wanted))
            return _answer([stage], self._verdict(wanted, "not judged: the policy is off", wanted))
        return _answer(ways.plans()[0].stages, self._verdict(wanted, why, wanted))

    def _verdict(self, wanted: Display, text: str, given: Display) -> dict[str, Any]:
        return self.judge.verdict(None, wanted, self.policy, text, [], given=given)


class _Judged(_Asked):
    """A change that is judged, and what the policy makes of it."""

    def __init__(self, judge: Judge, judgement: Judgement, request: Mapping[str, Any]) -> None:
        super().__init__(judge, request)
        self.judgement = judgement
        self.change = self._with_auto() if request["mode"] == "auto" else self.with_level()
        self.way = self.ways(self.change)
        self.wanted = self.way.request.wanted
        self.plans = self.way.plans()

    def answer(self) -> dict[str, Any]:
        """The first way that is safe, or what the policy makes of it."""
        plan = next((plan for plan in self.plans if self._is_safe(plan)), None)
        if plan is not None:
            return self._taken(plan, sentence(self.judgement, self.wanted, True), safe=True)
        text = self._trouble()
        safer = next((plan for plan in self.plans if self._is_safer(plan)), None)
        if safer is not None:
            return self._taken(safer, f"{text}; taken all the same: it is safer than now")
        if self.policy == "warn":
            return self._taken(self.plans[0], f"warning: {text}")
        if self.policy == "clamp":
            return self._clamped(text)
        if self.policy == "follow" and self.wanted.added_ns_per_m < self.target.added_ns_per_m:
            return self._followed(text)
        return self._refused(text)

    # --- answers ----------------------------------------------------------------------------------

    def _taken(
        self, plan: Plan, text: str, safe: bool = False, clamped: bool = False
    ) -> dict[str, Any]:
        path = self.way.path(plan)
        verdict = self.judge.verdict(
            self.judgement, self.wanted, self.policy, text, path, safe, plan.end, clamped
        )
        return _answer(plan.stages, verdict)

    def _refused(self, text: str, why: str = "") -> dict[str, Any]:
        whole = f"refused: {text}; {why}" if why else f"refused: {text}"
        path = self.way.path(self.plans[0])
        verdict = self.judge.verdict(
            self.judgement, self.wanted, self.policy, whole, path, False, self.target
        )
        return _answer([], verdict)

    def _trouble(self) -> str:
        """Why the first way is not safe: its end, or a point on it."""
        if not self.judgement.safe([self.wanted])[0]:
            return sentence(self.judgement, self.wanted, False)
        path = self.way.path(self.plans[0])
        if not path:
            return (
                f"more than {POINTS} points would have to be judged at once; wait for ramps under"
                " way, or schedule less"
            )
        path = [*path, *self.way.mixture(self.plans[0])]
        flags = self.judgement.safe(path)
        bad = next((one for one, flag in zip(path, flags, strict=True) if not flag), path[-1])
        return f"on the way, {sentence(self.judgement, bad, False)}"

    # --- damping that is chosen -------------------------------------------------------------------

    def _with_auto(self) -> dict[str, Any]:
        """The change with the level of mode `auto`, whatever level it names."""
        level = self._least(changed(self.target, self.asked))
        rest = {name: value for name, value in self.asked.items() if name != "damping"}
        return rest if level == self.target.added_ns_per_m else rest | {"damping": level}

    def _least(self, display: Display) -> float:
        """The least level that will do; down only with some to spare. Where none will, the one
        with the largest margin, and not less than now.
        """
        present = self.target.added_ns_per_m
        levels = self.judge.levels
        needed = self.judgement.least_level(display, levels)
        if needed is None:
            return max(present, self._most_spare(display))
        if needed >= present:
            return needed
        spare = self.judgement.spare_ns_per_m + HYSTERESIS_NS_PER_M
        mine = self.judgement
        easy = Judgement(mine.basis, mine.delay_periods, spare, mine.least_delay_periods)
        lower = easy.least_level(display, [level for level in levels if level < present])
        return present if lower is None else lower

    def _most_spare(self, display: Display) -> float:
        def margin(level: float) -> float:
            found = self.judgement.worse(display._replace(added_ns_per_m=level))
            return found.margin_ns_per_m or 0.0

        return max(self.judge.levels, key=margin)

    # --- what is safe, or safer -------------------------------------------------------------------

    def _is_safe(self, plan: Plan) -> bool:
        if not self.judgement.all_safe(self.way.path(plan)):
            return False
        return all(self.judgement.safe(self.way.mixture(plan)))

    def _is_safer(self, plan: Plan) -> bool:
        """Whether it leads from outside the set to a better point, no point worse than the one
        before.
        """
        request = self.way.request
        if request.enable or not request.moving or self.judgement.safe([self.now])[0]:
            return False
        path = self.way.path(plan)
        if not path or any(groups(leg) > 1 for leg in plan.legs):
            return False
        merits = np.array([self._merit(one) for one in [self.now, *path]])
        steps = np.diff(merits, axis=0)
        return bool((steps >= -_WORSE).all() and (merits[-1] - merits[0] > _WORSE).any())

    def _merit(self, display: Display) -> list[float]:
        """What must not fall on the way to a safer point: K, margin and radius, free and in
        contact. A basis without margins says nan, which is never better.
        """
        free = self.judgement.reading(display)
        contact = self.judgement.in_contact(display) or free
        merit = [min(display.stiffness_n_per_m, 0.0)]
        for one in (free, contact):
            margin = one.margin_ns_per_m
            radius = one.radius
            merit.append(np.nan if margin is None else margin)
            merit.append(np.nan if radius is None else -max(radius, 1.0))
        return merit

    # --- clamp ------------------------------------------------------------------------------------

    def _clamped(self, text: str) -> dict[str, Any]:
        """As far as the first exit, the result judged again."""
        request = self.way.request
        if "filters" in self.change:
            return self._refused(text, "filters are not clamped")
        if request.enable or not request.moving:
            return self._refused(text, "there is no way to clamp to")
        if not all(self.judgement.safe([self.now, self.target])):
            why = "the display is outside the safe set already: ask for a point inside"
            return self._refused(text, why)
        plan = self.way.plan(self._shortened())
        if plan.end == self.target:
            return self._refused(text, "nothing of it is safe")
        if not self._is_safe(plan):
            return self._refused(text, "what is left of it is not safe either")
        given = sentence(self.judgement, plan.end, True)
        return self._taken(plan, f"clamped: {text}; given is {given}", clamped=True)

    def _shortened(self) -> list[Stage]:
        """The stages of the first way, each as far as its own part is safe."""
        kept: list[Stage] = []
        for stage in self.plans[0].stages:
            leg = self.way.plan([*kept, stage]).legs[-1]
            share = self._exit(leg)
            if share >= _LEAST_MOVE:
                end = between(leg.under_way, leg.end, share, self.judge.levels)
                kept.append(stage._replace(change=fields_of(stage.change, end)))
        return kept

    def _exit(self, leg: Leg) -> float:
        """The share of a leg up to which all of it is safe."""
        levels = self.judge.levels

        def holds(share: float) -> bool:
            end = between(leg.under_way, leg.end, share, levels)
            part = leg._replace(end=end)
            return self.judgement.all_safe(sampled(part, 2 ** max(1, groups(part)), levels))

        return _largest(holds, np.linspace(0.0, 1.0, POINTS).tolist())

    # --- follow -----------------------------------------------------------------------------------

    def _followed(self, text: str) -> dict[str, Any]:
        """The environment into the smaller set first, then less damping."""
        small = None if "filters" in self.change else self._smaller()
        if small is None:
            return self._refused(text, "no smaller environment would do either")
        first = Stage(environment_of(small, self.wanted))
        second = Stage({"damping": self.wanted.added_ns_per_m}, after_ramps=True)
        plan = self.way.plan([first, second])
        if not self._is_safe(plan):
            return self._refused(text, "the way into the smaller set is not safe")
        given = sentence(self.judgement, plan.end, True)
        return self._taken(plan, f"followed: {text}; first the environment: {given}")

    def _smaller(self) -> Display | None:
        """The largest share of the environment that is safe with less damping; None for none."""
        shares = np.linspace(0.0, 1.0, _SHARES).tolist()
        flags = self.judgement.safe([self.wanted.scaled(share) for share in shares])
        if not any(flags):
            return None
        inside = max(place for place, flag in enumerate(flags) if flag)

        def holds(share: float) -> bool:
            return self.judgement.safe([self.wanted.scaled(share)])[0]

        return self.wanted.scaled(_largest(holds, shares[inside : inside + 2]))


def _largest(holds: Callable[[float], bool], shares: Sequence[float]) -> float:
    """The share at which `holds` first ends on the way along `shares`, the first of which holds."""
    inside = shares[0]
    outside = None
    for share in shares[1:]:
        if not holds(share):
            outside = share
            break
        inside = share
    for _ in range(_HALVINGS if outside is not None else 0):
        assert outside is not None
        middle = 0.5 * (inside + outside)
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return inside


def _answer(stages: list[Stage], verdict: dict[str, Any]) -> dict[str, Any]:
    at_once = len(stages) == 1 and stages[0].damping_at_least is None
    at_once = at_once and not stages[0].after_ramps
    action = "refuse" if not stages else "apply" if at_once else "stage"
    return {"action": action, "stages": [stage.plain() for stage in stages], "verdict": verdict}
