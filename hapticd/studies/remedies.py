"""Remedies on one bench: which one lets a display render more, for which device, at what price.

A remedy (`Remedy`) changes a scene: the rate of its servo, the delay of its force, its active
damping, the corner of its velocity filter. All are linear and time-invariant, so the theorem
(`model.theorem`, `model.bases`) judges the sampled loop with them exactly: stable, and passive for
every input and every passive hand, without counting on dry friction. What follows from it has no
interval:

    stiffness   the first failure of K from 0 on, at B = 0, and at the B >= 0 that lets it go
                farthest; M = 0
    volume      of the passive K >= 0, B >= 0 and M, by a grid that reaches beyond it
    rendered    Z at the probe over the asked K / s + B: what a hand feels of the device itself, of
                its active damping and of sampling. The same environment for all remedies of a
                device: half of the stiffness that it renders without one, at that B
    noise       rms force that the law makes of white position noise, that of the encoder's rounding
                (quantum / sqrt(12)), with the loop open: the handle rests. N

A rate changes nothing but the rate: the delay stays what it is in seconds, filters in Hz. The best
corner is the one of `CORNERS` with the largest stiffness at its best B.

Trials (`zwidth.limits`) then search K at that same B, with friction and counts and at the scene's
perturbation. They have a scatter between seeds of the noise and an interval.

The second-order Butterworth low-pass of a difference is, in continuous time, the steady Kalman
estimator of a velocity that white acceleration moves, and its corner (2 pi f)^4 = q / r the only
number of it: the search for a corner is the search for that estimator too.

Limitations: a set that K leaves and enters again; the first exit counts. A scene without the delay,
the circuit or the encoder that a remedy changes is left as it is there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite, nan, sqrt

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats
from hapticd.model.bases import Conditions, Theorem
from hapticd.model.effects import Delay
from hapticd.model.loop import derivatives
from hapticd.model.predict import predicted_impedance
from hapticd.model.scene import DampingStep, Scene
from hapticd.signal.passive_set import PassiveSet, axis_limit, grid
from hapticd.zwidth import limits, outcomes
from hapticd.zwidth.sources import display, level, noise
from hapticd.zwidth.store import Progress, Steps, TrialStore, silent

__all__ = [
    "REMEDIES",
    "RENDERED_HZ",
    "SCENES",
    "RemediesParams",
    "Remedy",
    "Row",
    "run_remedies",
    "treated",
]

SCENES = ("fig4", "light", "heavy", "flexible", "median")
RENDERED_HZ = (5.0, 30.0, 100.0)  # of `Row.rendered`
LOWEST_CORNER_HZ = 25.0
HIGHEST_CORNER = 0.45  # of the rate
CORNERS = (10, 5)  # tried; with --quick
GRID = ((20, 16, 12), (10, 8, 6))  # values of K, B and M; with --quick
ROUNDS = 3  # of VALUES of B: over all, then about the best one before
VALUES = 7
BEYOND = 1.1  # of the ends of a grid over what is known of the set
WIDER = 1.5  # factor of an end beyond which the set goes on
WIDENINGS = 12  # at most
TOLERANCE = 0.05  # of a limit by trials: between seeds it scatters as much
ANGLES = np.pi * (np.arange(1024) + 0.5) / 1024.0  # of the unit circle, for the mean of a spectrum
Passive = Callable[[Floats], Flags]


@dataclass(frozen=True, slots=True)
class Remedy:
    """What is done to a scene; the defaults change nothing."""

    name: str
    faster: float = 1.0  # rate of the servo over the scene's
    delay_share: float = 1.0  # of the scene's delay in seconds that is left
    active_damping_ns_per_m: float = 0.0
    best_corner: bool = False  # of the velocity filter, for each device


REMEDIES = (
    Remedy("as it is"),
    Remedy("best corner", best_corner=True),
    Remedy("2 x rate", 2.0),
    Remedy("4 x rate", 4.0),
    Remedy("half the delay", delay_share=0.5),
    Remedy("no delay", delay_share=0.0),
    Remedy("0.87 N s/m", active_damping_ns_per_m=0.87),
    Remedy("1.74 N s/m", active_damping_ns_per_m=1.74),
    Remedy("3.48 N s/m", active_damping_ns_per_m=3.48),
    Remedy("4 x rate, half the delay", 4.0, 0.5),
    Remedy("4 x rate, 1.74 N s/m", 4.0, active_damping_ns_per_m=1.74),
    Remedy("best corner, 1.74 N s/m", active_damping_ns_per_m=1.74, best_corner=True),
    Remedy("best corner, 4 x rate", 4.0, best_corner=True),
)


@dataclass(frozen=True, slots=True)
class RemediesParams:
    """What is compared, and how: `seconds` and `seeds` of the trials of each row; no seed: none."""

    scenes: tuple[Scene, ...]
    remedies: tuple[Remedy, ...] = REMEDIES
    quick: bool = False  # coarser, without trials
    seconds: float = 90.0
    seeds: int = 4


@dataclass(frozen=True, eq=False)
class Row:
    """A device with a remedy. nan: nothing is passive there, or there is no such number."""

    device: str  # name of the scene
    remedy: str
    rate_hz: float
    delay_s: float
    corner_hz: float  # of the velocity filter
    stiffness_alone_n_per_m: float  # largest K at B = 0
    virtual_damping_ns_per_m: float  # B that lets K go farthest
    stiffness_n_per_m: float  # largest K at that B
    volume: float  # N/m N s/m kg
    asked: tuple[float, float]  # K [N/m], B [N s/m] of `rendered` and `noise_n`
    rendered: Complexes  # (3,) at RENDERED_HZ, Z over what is asked
    noise_n: float  # rms
    trials: limits.AxisLimit | None = None  # of K at the same B


def treated(scene: Scene, remedy: Remedy, corner_hz: float | None = None) -> Scene:
    """The scene with that remedy, and the velocity filter at `corner_hz` if it is given."""
    share = remedy.faster * remedy.delay_share
    effects = tuple(
        replace(one, periods=share * one.periods) if isinstance(one, Delay) else one
        for one in scene.effects
    )
    environment = scene.environment
    if corner_hz is not None:
        low_pass = replace(environment.velocity_filter, frequency_hz=corner_hz)
        environment = replace(environment, velocity_filter=low_pass)
    return replace(
        scene,
        effects=effects,
        environment=environment,
        rate_hz=remedy.faster * scene.rate_hz,
        active_damping=(DampingStep(0.0, remedy.active_damping_ns_per_m),),
    )


def passive_by_theorem(scene: Scene) -> Passive:
    """Whether environments (N, 3) are passive on the scene's device at its active damping."""
    shown = display(scene)
    at = Conditions(level(scene), shown.filters, shown.model.delay_periods, 0.0)
    return partial(Theorem(shown.model).safe, at=at)


def largest_stiffness(passive: Passive, virtual_damping_ns_per_m: float) -> float:
    """K [N/m] of the first failure at that B and M = 0; nan if K = 0 fails."""
    return axis_limit(passive, 0, limits.REACH[0], (0.0, virtual_damping_ns_per_m, 0.0))


def stiffest(passive: Passive) -> tuple[float, float]:
    """(B [N s/m], K [N/m]): the B >= 0 at which K goes farthest; nan if nothing is passive."""
    low = 0.0
    high = axis_limit(passive, 1, limits.REACH[1])
    if not isfinite(high):
        return nan, nan
    for _ in range(ROUNDS):
        tried = np.linspace(low, high, VALUES)
        found = [largest_stiffness(passive, float(each)) for each in tried]
        best = int(np.nanargmax(found))
        low = tried[max(best - 1, 0)]
        high = tried[min(best + 1, VALUES - 1)]
    return float(tried[best]), found[best]


def best_corner(scene: Scene, remedy: Remedy, count: int) -> Scene:
    """The scene with that remedy and, of `count` corners of the velocity filter, the best one."""
    highest_hz = HIGHEST_CORNER * remedy.faster * scene.rate_hz
    scenes = [
        treated(scene, remedy, float(hz))
        for hz in np.geomspace(LOWEST_CORNER_HZ, highest_hz, count)
    ]
    stiffness = [stiffest(passive_by_theorem(one))[1] for one in scenes]
    return scenes[int(np.argmax(np.nan_to_num(stiffness, nan=-1.0)))]


def set_volume(passive: Passive, best: tuple[float, float], counts: Sequence[int]) -> float:
    """Volume [N/m N s/m kg] of the passive K >= 0, B >= 0 and M by a grid of so many values, about
    the (B, K) of `stiffest`, that is widened until the set ends inside; 0 if nothing is passive.
    """
    if not isfinite(best[1]):
        return 0.0
    base = (0.5 * best[1], 0.5 * best[0], 0.0)
    low, high = (axis_limit(passive, 2, sign * limits.REACH[2], base) for sign in (1.0, -1.0))
    ends = {
        "K max": BEYOND * best[1],
        "B max": BEYOND * axis_limit(passive, 1, limits.REACH[1]),
        "M min": BEYOND * low,
        "M max": BEYOND * high,
    }
    for _ in range(WIDENINGS):
        axes = (
            np.linspace(0.0, ends["K max"], counts[0]),
            np.linspace(0.0, ends["B max"], counts[1]),
            np.linspace(ends["M min"], ends["M max"], counts[2]),
        )
        found = PassiveSet.of(axes, np.where(passive(grid(axes)), 1.0, -1.0))
        beyond = [name for name in found.open_ends() if name in ends]
        if not beyond:
            break
        ends |= {name: WIDER * ends[name] for name in beyond}
    return found.volume()


def rendered(scene: Scene, asked: tuple[float, float]) -> Complexes:
    """Z over the asked K / s + B at RENDERED_HZ (3,), no dry friction; nan if nothing is asked."""
    shown = display(scene)
    k, b = asked
    if not isfinite(k):
        return np.full(len(RENDERED_HZ), nan, np.complex128)
    f = np.array(RENDERED_HZ)
    z = predicted_impedance(
        shown.model, (k, b, 0.0), f, level(scene), shown.filters, recorded=False
    )
    return np.asarray(z / (k / (2j * np.pi * f) + b))


def noise_at_rest(scene: Scene, asked: tuple[float, float]) -> float:
    """Rms force [N] of the law under white position noise as large as the encoder's rounding."""
    model = display(scene).model
    if model.encoder_quantum_m is None:
        return nan
    k, b = asked
    slope, _ = derivatives(np.exp(1j * ANGLES), model.rate_hz, display(scene).filters)
    gain = sqrt(float(np.mean(np.abs(k + b * slope) ** 2)))
    return gain * model.encoder_quantum_m / sqrt(12.0)


def judged(
    scene: Scene, asked: tuple[float, float] | None, remedy: Remedy, quick: bool
) -> tuple[Scene, Row]:
    """The scene with the remedy, and its row by theory; `asked` None: half of its own stiffness."""
    own = (
        best_corner(scene, remedy, CORNERS[quick]) if remedy.best_corner else treated(scene, remedy)
    )
    passive = passive_by_theorem(own)
    best = stiffest(passive)
    asked = asked or (0.5 * best[1], best[0])
    return own, Row(
        device=scene.name,
        remedy=remedy.name,
        rate_hz=own.rate_hz,
        delay_s=display(own).model.delay_periods / own.rate_hz,
        corner_hz=own.environment.velocity_filter.frequency_hz,
        stiffness_alone_n_per_m=largest_stiffness(passive, 0.0),
        virtual_damping_ns_per_m=best[0],
        stiffness_n_per_m=best[1],
        volume=set_volume(passive, best, GRID[quick]),
        asked=asked,
        rendered=rendered(own, asked),
        noise_n=noise_at_rest(own, asked),
    )


def run_remedies(
    params: RemediesParams, store: TrialStore, tell: Progress = silent
) -> tuple[Row, ...]:
    """All remedies on all devices, the first remedy being what the others are compared with: by
    theory, then by the trials that the store lacks. ConfigError as `compose` and `simulate`.
    """
    steps = Steps(tell, len(params.scenes) * len(params.remedies))
    found: list[tuple[Scene, Row]] = []
    for scene in params.scenes:
        asked = None
        for remedy in params.remedies:
            steps.next(f"{scene.name}, {remedy.name}")
            found.append(judged(scene, asked, remedy, params.quick))
            asked = found[-1][1].asked
    steps.end()
    if params.quick or not params.seeds:
        return tuple(row for _, row in found)
    plans = [limits.plan_limits(_searched(params, *one)) for one in found]
    pairs = zip(found, limits.run_plans(plans, store, tell), strict=True)
    return tuple(replace(row, trials=result.limits[0]) for (_, row), result in pairs)


def _searched(params: RemediesParams, scene: Scene, row: Row) -> limits.LimitsParams:
    base = (0.0, np.nan_to_num(row.virtual_damping_ns_per_m), 0.0)
    given = outcomes.Conditions(scene, params.seconds, noise(scene))
    return limits.LimitsParams(
        given, (level(scene),), axes=(0,), seeds=params.seeds, base=base, tolerance=TOLERANCE
    )
