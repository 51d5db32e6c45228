"""Apply the policy in force to a change.

The first safe path is taken (`transition_planner`, judged by `safe_region`). Without a safe path:

    refuse   nothing moves
    clamp    up to the first exit from the safe set on the path, and the result is judged again; not
             for filters, and not from outside the set
    follow   for less damping: first the environment shrinks in proportion into the set of that
             damping, then the damping falls; other changes as refuse
    warn     done as requested, in the right order, with a warning
    off      not judged

From outside the set, a path is also accepted if no point is worse than the one before it and the
last point is better. The measures are radius, margin and K, in free space and in contact.

Mode `auto` selects the lowest cached level that leaves the required margin. It selects a lower
level only if that leaves HYSTERESIS more, so that the level does not go up and down with every
change.

Stages must be judged as they are sent. The result of a clamp or a follow is a new plan, and is
judged again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import ceil
from typing import Any

import numpy as np

from hapticd.core.environment import Environment
from hapticd.core.params import STRICT_POLICIES
from hapticd.guard.safe_region import SafeRegion, VerdictBuilder, explain
from hapticd.guard.transition_planner import (
    AXES,
    POINTS,
    Plan,
    Segment,
    Stage,
    TransitionPlanner,
    from_message,
    interpolate,
    moving_groups,
    sampled_segment,
)
from hapticd.model.discrete import edge
from hapticd.protocol.journal import Explanation, Outcome, Reason, Remedy

HYSTERESIS_NS_PER_M = 0.05  # above the required margin, before auto selects a lower level
_HALVINGS = 12  # between the last safe point and the first unsafe one
_SHARES = 41  # of the environment that `follow` tests
_LEVEL_HALVINGS = 6  # between two cached levels: to some hundredths of N s/m
_LEAST_MOVE = 1e-3  # of the path: a clamp to less moves nothing
_WORSE = 1e-9  # tolerance for rounding


def answer_change(
    verdicts: VerdictBuilder,
    region: SafeRegion | Explanation,
    request: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the answer to a request `change`: action, stages and verdict (docs/guard.md).

    `region` is the region to judge by, or the reason why nothing is known. ConfigError for a
    number that is not finite.
    """
    planner = _asked(verdicts, request)
    if request["policy"] == "off":
        region = Explanation.because(Reason.POLICY, "not judged: the policy is off")
    if isinstance(region, Explanation):
        return _unjudged(verdicts, planner, request["policy"], region)
    return _Judged(verdicts, region, planner, request).answer()


def _asked(verdicts: VerdictBuilder, request: Mapping[str, Any]) -> TransitionPlanner:
    """Return the requested change: its start, the changes before and after it, and its level."""
    setup = verdicts.setup
    state = request["state"]
    # while an enable ramps up, a part of the environment acts; if the environment is changing too,
    # count all of it
    gain = float(request.get("gain", 1.0)) if state == "enabled" else 1.0
    reported = from_message(request["now"], setup.environment)
    target = from_message(request["target"], setup.environment)
    level = target.active_damping_ns_per_m
    still = replace(reported, active_damping_ns_per_m=level) == target
    now = reported.scaled(gain) if still else reported
    passed = [reported]
    for one in request["before"]:
        passed.append(target)
        now = target
        target = target.changed(one)
    level = _in_effect(verdicts, now.active_damping_ns_per_m, target.active_damping_ns_per_m)
    return TransitionPlanner(
        now=replace(now, active_damping_ns_per_m=level),
        target=target,
        passed=passed,
        after=request["after"],
        enable=request["enable"],
        moving=request["enable"] or state == "enabled",
        levels=verdicts.levels,
        count_ns_per_m=setup.active_damping_count_ns_per_m,
        change=_with_level(request, target, setup.active_damping_limit_ns_per_m),
        wall_virtual_dampings=request.get("wall_virtual_dampings", ()),
    )


def _in_effect(verdicts: VerdictBuilder, reported: float, asked: float) -> float:
    """Return the level in effect: the requested one, or during a change the cached level below the
    reported one.
    """
    if abs(reported - asked) <= verdicts.setup.active_damping_count_ns_per_m:
        return asked
    return max((level for level in verdicts.levels if level <= reported), default=reported)


def _with_level(
    request: Mapping[str, Any], target: Environment, ceiling_ns_per_m: float
) -> Mapping[str, Any]:
    """Return the change with the level of mode `level`, unless it contains another."""
    change: Mapping[str, Any] = request["change"]
    level = min(float(request["level"]), ceiling_ns_per_m)
    named = request["mode"] != "level" or "active_damping" in change
    if named or level == target.active_damping_ns_per_m:
        return change
    return {**change, "active_damping": level}


def _unjudged(
    verdicts: VerdictBuilder, planner: TransitionPlanner, policy: str, why: Explanation
) -> dict[str, Any]:
    """Return the answer to a change without a judgement. Strict policies refuse it; the others
    apply it in the right order.
    """
    wanted = planner.wanted
    given = wanted
    outcome = Outcome.UNKNOWN
    stages = planner.plans()[0].stages
    if policy in STRICT_POLICIES:
        why = why.and_reason(Reason.POLICY, f"the policy {policy!r} refuses what is unknown")
        outcome = Outcome.REFUSED
        given = planner.target
        stages = []
    elif policy == "off":
        outcome = Outcome.NOT_JUDGED
        stages = [Stage(wanted.fields(planner.change))]
    return _answer(stages, verdicts.of(None, wanted, policy, outcome, why, [], given))


class _Judged:
    """A judged change, and the answer that the policy gives."""

    def __init__(
        self,
        verdicts: VerdictBuilder,
        region: SafeRegion,
        planner: TransitionPlanner,
        request: Mapping[str, Any],
    ) -> None:
        self.verdicts = verdicts
        self.region = region
        self.policy: str = request["policy"]
        self.levels = verdicts.levels
        self.target = planner.target
        if request["mode"] == "auto":
            planner = replace(planner, change=self._with_auto(request["change"]))
        self.planner = planner
        self.path: Callable[[Plan], list[Environment]] = cache(planner.path)
        self.wanted = planner.wanted
        self.plans = planner.plans()

    def answer(self) -> dict[str, Any]:
        plan = next((plan for plan in self.plans if self._is_safe(plan)), None)
        if plan is not None:
            return self._taken(plan, Outcome.SAFE, explain(self.region, self.wanted, True))
        why = self._trouble()
        safer = next((plan for plan in self.plans if self._is_safer(plan)), None)
        if safer is not None:
            all_the_same = "applied: it is safer than the present environment"
            return self._taken(safer, Outcome.SAFER, why.and_reason(Reason.SAFER, all_the_same))
        if self.policy == "warn":
            return self._taken(self.plans[0], Outcome.WARNING, why)
        if self.policy == "clamp":
            return self._clamped(why)
        if (
            self.policy == "follow"
            and self.wanted.active_damping_ns_per_m < self.target.active_damping_ns_per_m
        ):
            return self._followed(why)
        return self._refused(why)

    # --- answers ----------------------------------------------------------------------------------

    def _taken(self, plan: Plan, outcome: Outcome, why: Explanation) -> dict[str, Any]:
        return _answer(plan.stages, self._verdict(plan, outcome, why, plan.end))

    def _refused(self, why: Explanation) -> dict[str, Any]:
        return _answer([], self._verdict(self.plans[0], Outcome.REFUSED, why, self.target))

    def _verdict(
        self, plan: Plan, outcome: Outcome, why: Explanation, given: Environment
    ) -> dict[str, Any]:
        path = self.path(plan)
        return self.verdicts.of(self.region, self.wanted, self.policy, outcome, why, path, given)

    def _trouble(self) -> Explanation:
        """Return why the first path is unsafe: its end, or a point on it."""
        if not self.region.safe([self.wanted])[0]:
            return explain(self.region, self.wanted, False)
        path = self.path(self.plans[0])
        if not path:
            many = Explanation.because(
                Reason.TOO_MANY_POINTS, f"more than {POINTS} points would have to be judged at once"
            )
            return many.and_remedy(Remedy.WAIT, "wait for ramps under way, or schedule less")
        path = [*path, *self.planner.mixture(self.plans[0])]
        flags = self.region.safe(path)
        bad = next((one for one, flag in zip(path, flags, strict=True) if not flag), path[-1])
        return explain(self.region, bad, False, "on the way, ")

    # --- choice of the damping --------------------------------------------------------------------

    def _with_auto(self, change: Mapping[str, Any]) -> dict[str, Any]:
        """Return `change` with the level of mode `auto`, which replaces any requested level."""
        level = self._least(self.target.changed(change))
        rest = {name: value for name, value in change.items() if name != "active_damping"}
        present = self.target.active_damping_ns_per_m
        return rest if level == present else rest | {"active_damping": level}

    def _least(self, environment: Environment) -> float:
        """Return the lowest sufficient level; a lower level than now needs additional margin. If
        none is sufficient, return the level with the largest margin, at least the present one.
        """
        present = self.target.active_damping_ns_per_m
        needed = self.region.least_level(environment, self.levels)
        if needed is None:
            return max(present, self._most_spare(environment))
        if needed >= present:
            return needed
        spare = self.region.spare_ns_per_m + HYSTERESIS_NS_PER_M
        easy = replace(self.region, spare_ns_per_m=spare)
        lower = easy.least_level(environment, [one for one in self.levels if one < present])
        return present if lower is None else lower

    def _most_spare(self, environment: Environment) -> float:
        def margin(level: float) -> float:
            found = self.region.worse(replace(environment, active_damping_ns_per_m=level))
            return found.margin_ns_per_m or 0.0

        return max(self.levels, key=margin)

    # --- safe or safer ----------------------------------------------------------------------------

    def _is_safe(self, plan: Plan) -> bool:
        if not self.region.all_safe(self.path(plan)):
            return False
        return all(self.region.safe(self.planner.mixture(plan)))

    def _is_safer(self, plan: Plan) -> bool:
        """Return whether the plan leads from outside the set to a better point, without a point
        worse than the one before.
        """
        now = self.planner.now
        if self.planner.enable or not self.planner.moving or self.region.safe([now])[0]:
            return False
        path = self.path(plan)
        if not path or any(moving_groups(segment) > 1 for segment in plan.segments):
            return False
        merits = np.array([self._merit(one) for one in [now, *path]])
        steps = np.diff(merits, axis=0)
        return bool((steps >= -_WORSE).all() and (merits[-1] - merits[0] > _WORSE).any())

    def _merit(self, environment: Environment) -> list[float]:
        """Return the values that must not fall on the way to a safer point: K, margin and radius,
        in free space and in contact. A basis without margins gives nan, which never counts as
        better.
        """
        free = self.region.reading(environment)
        contact = self.region.in_contact(environment) or free
        merit = [min(environment.stiffness_n_per_m, 0.0)]
        for one in (free, contact):
            margin = one.margin_ns_per_m
            radius = one.radius
            merit.append(np.nan if margin is None else margin)
            merit.append(np.nan if radius is None else -max(radius, 1.0))
        return merit

    # --- clamp ------------------------------------------------------------------------------------

    def _clamped(self, why: Explanation) -> dict[str, Any]:
        """Go up to the first exit, and judge the result again."""
        planner = self.planner
        if "filters" in planner.change:
            return self._not_clamped(why, "filters are not clamped")
        if planner.enable or not planner.moving:
            return self._not_clamped(why, "there is no safe change to clamp to")
        if not all(self.region.safe([planner.now, self.target])):
            inside = why.and_remedy(Remedy.POINT_INSIDE, "for a point inside")
            return self._not_clamped(inside, "the environment is outside the safe set already")
        plan = planner.plan(self._shortened())
        if plan.end == self.target:
            return self._not_clamped(why, "nothing of it is safe")
        if not self._is_safe(plan):
            return self._not_clamped(why, "the clamped change is not safe either")
        given = f"given is {self._spare(plan.end)}"
        return self._taken(plan, Outcome.CLAMPED, why.and_reason(Reason.GIVEN, given))

    def _not_clamped(self, why: Explanation, text: str) -> dict[str, Any]:
        return self._refused(why.and_reason(Reason.NOT_CLAMPED, text))

    def _spare(self, environment: Environment) -> str:
        return explain(self.region, environment, True).reasons[0].text

    def _shortened(self) -> list[Stage]:
        """Return the stages of the first path, each up to the end of its safe part."""
        kept: list[Stage] = []
        for stage in self.plans[0].stages:
            segment = self.planner.plan([*kept, stage]).segments[-1]
            share = self._exit(segment)
            end = interpolate(segment.under_way, segment.end, share, self.levels)
            lower = self._lowered(segment.end.active_damping_ns_per_m, end)
            if share >= _LEAST_MOVE or lower != end:
                kept.append(stage._replace(change=lower.fields(stage.change)))
        return kept

    def _lowered(self, asked_ns_per_m: float, end: Environment) -> Environment:
        """Return `end` with its damping as close to the requested lower level as is safe. The level
        is rounded up to a count. The cached levels are some tenths of N s/m apart.
        """
        safe = end.active_damping_ns_per_m
        unsafe = max((one for one in self.levels if one < safe), default=0.0)
        unsafe = max(unsafe, asked_ns_per_m)
        if unsafe >= safe:
            return end

        def lower(share: float) -> float:
            return safe + share * (unsafe - safe)

        def holds(share: float) -> bool:
            return self.region.safe([replace(end, active_damping_ns_per_m=lower(share))])[0]

        level = lower(_largest(holds, (0.0, 1.0), _LEVEL_HALVINGS))
        count = self.planner.count_ns_per_m
        counted = ceil(level / count) * count if count > 0.0 else level
        return replace(end, active_damping_ns_per_m=min(counted, end.active_damping_ns_per_m))

    def _exit(self, segment: Segment) -> float:
        """Return the share of a segment up to which all of it is safe."""
        levels = self.levels

        def holds(share: float) -> bool:
            end = interpolate(segment.under_way, segment.end, share, levels)
            part = segment._replace(end=end)
            return self.region.all_safe(
                sampled_segment(part, 2 ** max(1, moving_groups(part)), levels)
            )

        return _largest(holds, np.linspace(0.0, 1.0, POINTS).tolist())

    # --- follow -----------------------------------------------------------------------------------

    def _followed(self, why: Explanation) -> dict[str, Any]:
        small = None if "filters" in self.planner.change else self._smaller()
        if small is None:
            text = "no smaller environment is safe either"
            return self._refused(why.and_reason(Reason.NOT_FOLLOWED, text))
        names = (*AXES, "wall") if self.wanted.wall.side else AXES
        first = Stage({name: small.message()[name] for name in names})
        second = Stage({"active_damping": self.wanted.active_damping_ns_per_m}, after_ramps=True)
        plan = self.planner.plan([first, second])
        if not self._is_safe(plan):
            text = "the way into the smaller set is not safe"
            return self._refused(why.and_reason(Reason.NOT_FOLLOWED, text))
        given = f"first the environment: {self._spare(plan.end)}"
        return self._taken(plan, Outcome.FOLLOWED, why.and_reason(Reason.GIVEN, given))

    def _smaller(self) -> Environment | None:
        """Return the largest share of the environment that is safe with less damping; None without
        any.
        """
        shares = np.linspace(0.0, 1.0, _SHARES).tolist()
        flags = self.region.safe([self.wanted.scaled(share) for share in shares])
        if not any(flags):
            return None
        inside = max(place for place, flag in enumerate(flags) if flag)

        def holds(share: float) -> bool:
            return self.region.safe([self.wanted.scaled(share)])[0]

        return self.wanted.scaled(_largest(holds, shares[inside : inside + 2]))


def _largest(
    holds: Callable[[float], bool], shares: Sequence[float], halvings: int = _HALVINGS
) -> float:
    """Return the share at which `holds` first fails along `shares`; it is true at the first one."""
    inside = shares[0]
    for share in shares[1:]:
        if not holds(share):
            return edge(holds, inside, share, halvings)
        inside = share
    return inside


def _answer(stages: list[Stage], verdict: dict[str, Any]) -> dict[str, Any]:
    at_once = len(stages) == 1 and stages[0].active_damping_at_least is None
    at_once = at_once and not stages[0].after_ramps
    action = "refuse" if not stages else "apply" if at_once else "stage"
    return {"action": action, "stages": [stage._asdict() for stage in stages], "verdict": verdict}
