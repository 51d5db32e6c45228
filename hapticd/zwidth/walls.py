"""Virtual walls: the stiffest wall at each virtual damping on which an impact does not cause
oscillation (Weir 2008, Fig. 2).

The device meets the wall as the scene defines (its start velocity, a force against it). A wall is
stable if after `settle_s` nothing moves back and forth faster than `still_m_per_s`, and the trial
has not diverged. Motion in one direction does not count: into a soft and strongly damped wall the
device creeps for B/K seconds, 0.3 s and more, which is not oscillation. This is neither passivity
nor coupled stability. It is one impact of one device without a hand, as in the plots of many
papers. K is raised step by step; the boundary is the last stable wall below the first unstable one,
refined between the two.

Params -> plan_walls -> Plan -> run_walls -> Result.

With `contact` a level of active damping is that at the wall (`engine.contact`), and not everywhere.

Limitations: a device whose stable walls are not in one piece as K is raised; walls beyond the first
unstable one are not tried.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf

import numpy as np

from hapticd.core.arrays import Values
from hapticd.core.errors import AnalysisError
from hapticd.model.compose import compose
from hapticd.model.model import Model
from hapticd.model.scene import Scene
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.contact import ContactDamping
from hapticd.zwidth.store import Progress, Steps, silent

__all__ = ["WallMapParams", "WallResult", "plan_walls", "run_walls"]

FINER = 6  # steps between the last stable and the first unstable wall


@dataclass(frozen=True, slots=True)
class WallMapParams:
    """`scene` has a wall, and a motion or force towards it. Stiffnesses [N/m] ascend; dampings
    [Ns/m] of the wall; `levels` [Ns/m].
    """

    scene: Scene
    stiffnesses: tuple[float, ...]
    dampings: tuple[float, ...]
    levels: tuple[float, ...] = (0.0, 1.74)
    settle_s: float = 1.5
    still_m_per_s: float = 2e-3
    contact: ContactDamping | None = None  # with each of `levels` at the wall; None: everywhere


@dataclass(frozen=True, eq=False)
class WallPlan:
    """The composed device and its impacts, a line of stiffnesses for each damping and level."""

    params: WallMapParams
    model: Model
    lines: tuple[tuple[float, float], ...]  # level, damping


@dataclass(frozen=True, slots=True)
class Impact:
    """One impact: `late_m_per_s` is the largest speed reached both ways after `settle_s`,
    `deepest_m` the largest penetration.
    """

    active_damping_ns_per_m: float
    wall_stiffness_n_per_m: float
    wall_virtual_damping_ns_per_m: float
    stable: bool
    late_m_per_s: float
    deepest_m: float


@dataclass(frozen=True, slots=True)
class WallLine:
    """The result at one level and wall damping: the stiffest stable wall (0: none), `open` if the
    stiffest wall tried is stable.
    """

    active_damping_ns_per_m: float
    wall_virtual_damping_ns_per_m: float
    highest_n_per_m: float
    open: bool
    impacts: tuple[Impact, ...]

    @property
    def first_unstable_n_per_m(self) -> float:
        """The softest wall that oscillated: the boundary lies between it and `highest_n_per_m`; inf
        if none did.
        """
        return min(
            (impact.wall_stiffness_n_per_m for impact in self.impacts if not impact.stable),
            default=inf,
        )


@dataclass(frozen=True, eq=False)
class WallResult:
    """A line for each level and damping, in the order of the plan."""

    plan: WallPlan
    lines: tuple[WallLine, ...]

    def at(self, level: float) -> tuple[WallLine, ...]:
        """Return the boundary at one active damping, by wall damping."""
        return tuple(line for line in self.lines if line.active_damping_ns_per_m == level)


def plan_walls(params: WallMapParams) -> WallPlan:
    """Plan the impacts. AnalysisError for a scene without a wall, or shorter than the time to
    settle; ConfigError as `compose`.
    """
    scene = params.scene
    if scene.environment.wall.side == 0:
        raise AnalysisError(
            f"scene {scene.name}: it has no wall to hit; give it [environment.wall] with a side, as"
            " scene 'wall'"
        )
    if not params.still_m_per_s > 0.0:
        raise AnalysisError(
            f"a wall at rest at {params.still_m_per_s:g} m/s: must be above 0; 0.002 is usual"
        )
    if not 0.0 <= params.settle_s < scene.seconds:
        raise AnalysisError(
            f"scene {scene.name} lasts {scene.seconds:g} s; to settle {params.settle_s:g} s are"
            " allowed: lengthen it, or allow less"
        )
    if (
        not params.stiffnesses
        or any(np.diff(params.stiffnesses) <= 0.0)
        or params.stiffnesses[0] <= 0.0
    ):
        raise AnalysisError("wall stiffnesses: an ascending list above 0 N/m is needed")
    return WallPlan(params, compose(scene), tuple(product(params.levels, params.dampings)))


def run_walls(plan: WallPlan, tell: Progress = silent) -> WallResult:
    """Run all impacts; each takes milliseconds."""
    steps = Steps(tell, len(plan.lines))
    lines = []
    for level, damping in plan.lines:
        steps.next(f"walls, active damping {level:g} N s/m")
        lines.append(_line(plan, level, damping))
    steps.end()
    return WallResult(plan, tuple(lines))


def _line(plan: WallPlan, level: float, damping: float) -> WallLine:
    impacts = list(_upwards(plan, level, damping, plan.params.stiffnesses))
    stable = [impact.wall_stiffness_n_per_m for impact in impacts if impact.stable]
    if stable and len(stable) < len(impacts):
        between = np.geomspace(stable[-1], impacts[-1].wall_stiffness_n_per_m, FINER + 1)[1:-1]
        impacts += _upwards(plan, level, damping, between.tolist())
    highest = max(
        (impact.wall_stiffness_n_per_m for impact in impacts if impact.stable), default=0.0
    )
    return WallLine(
        level, damping, highest, all(impact.stable for impact in impacts), tuple(impacts)
    )


def _upwards(
    plan: WallPlan, level: float, damping: float, stiffnesses: Sequence[float]
) -> Iterator[Impact]:
    """Yield impacts on ever stiffer walls, up to and including the first unstable one."""
    for stiffness in stiffnesses:
        impact = hit(plan, level, stiffness, damping)
        yield impact
        if not impact.stable:
            return


def hit(plan: WallPlan, level: float, stiffness: float, damping: float) -> Impact:
    """Simulate one impact at active damping `level` [Ns/m] on a wall of `stiffness` [N/m] and
    `damping` [Ns/m].
    """
    scene = plan.params.scene
    params = plan.params
    wall = replace(
        scene.environment.wall, stiffness_n_per_m=stiffness, virtual_damping_ns_per_m=damping
    )
    found = simulate(
        plan.model,
        [[0.0, 0.0, 0.0]],
        scene.seconds,
        active_damping=level,
        contact=params.contact.at(level) if params.contact and level else None,
        environment=replace(scene.environment, wall=wall),
        excitation=scene.excitation,
        start=(scene.start_position_m, scene.start_velocity_m_per_s),
        keep="ticks",
    )
    _, velocity = found.record(0)
    position_m, _ = found.traces(0)
    late = to_and_fro(velocity[int(params.settle_s * found.rate_hz) :])
    deepest = float((wall.side * (position_m - wall.position_m)).max(initial=0.0))
    stable = not found.diverged[0] and late < params.still_m_per_s
    return Impact(level, stiffness, damping, bool(stable), late, deepest)


def to_and_fro(velocity_m_per_s: Values) -> float:
    """Return the largest speed reached both ways [m/s]; 0 for a motion in one direction."""
    return max(
        0.0, float(min(velocity_m_per_s.max(initial=0.0), -velocity_m_per_s.min(initial=0.0)))
    )
