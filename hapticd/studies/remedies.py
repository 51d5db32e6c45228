"""Linear remedies on one bench: how much more a display renders, for each device, and the price.

A remedy (`Remedy`) changes a scene: the rate of its servo, the delay of its force, its active
damping, the corner of its velocity filter, or the coupling between device and environment. All are
linear and time-invariant, so the theorem (`model.theorem`, `model.bases`) judges the sampled loop
exactly. The loop is stable, and passive for every input and every passive hand, without dry
friction. These numbers of a row therefore have no interval:

    stiffness   the first K to fail from 0 on, at B = 0, and at the B >= 0 with the largest such K;
                M = 0
    volume      of the passive K >= 0, B >= 0 and M, by a grid that contains all of them
    rendered    Z at the probe over the asked K / s + B. The ratio contains the device itself, its
                active damping and the effect of sampling. All remedies of a device render the same
                environment: half of the stiffness of its first row, at the best B of that row
    noise       rms force [N] of the law under white position noise as large as the encoder's
                rounding (quantum / sqrt(12)). The loop is open: the handle rests

A faster loop keeps its delay in seconds and its filters in hertz. The best corner is the one of
`CORNERS` with the largest stiffness at its best B.

Virtual coupling (Colgate, Stanley and Brown 1995; Adams and Hannaford 1999). A spring K_c and a
damper B_c connect the device to a virtual object. Stiffness and best B of this row are those of the
largest coupling: passive with a rigid object, which is felt as K_c and B_c, and with any of the
springs in SPRINGS behind it. The felt law is C_c C_e / (C_c + C_e) with C = K + B H_v (z), for
environments that are stiffer than the coupling too. `rendered` has the asked environment behind it.

Trials (`zwidth.limits`) search K at the same B, with friction, counts and the perturbation of the
scene. Their results differ between seeds of the noise, and have an interval.

The second-order Butterworth low-pass of a difference is, in continuous time, the steady Kalman
estimator of a velocity under white acceleration. Its only number is the corner, (2 pi f)^4 = q / r
with the densities q of the acceleration and r of the noise. The search for a corner covers it.

Limitations: a set that K leaves and enters again (the first exit counts); objects behind a coupling
that are no springs. A remedy has no effect on a scene without the delay, circuit or encoder that it
changes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite, nan, sqrt

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats
from hapticd.model.bases import Conditions, Theorem
from hapticd.model.effects import Delay
from hapticd.model.loop import close_loop, derivatives
from hapticd.model.scene import DampingStep, Scene
from hapticd.model.theorem import circles, lifted_system
from hapticd.zwidth import limits, outcomes
from hapticd.zwidth.passive_set import PassiveSet, axis_limit, grid
from hapticd.zwidth.sources import display
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
ROUNDS = 3  # of VALUES of B: over the whole range, then about the best one so far
VALUES = 7
BEYOND = 1.1  # of the ends of a grid over what is known of the set
WIDER = 1.5  # factor of an end that the set reaches
WIDENINGS = 12  # at most
SPRINGS = np.geomspace(0.01, 100.0, 9)  # behind a coupling, over its own stiffness
TOLERANCE = 0.05  # of a limit by trials: between seeds it scatters as much
ANGLES = np.pi * (np.arange(1024) + 0.5) / 1024.0  # of the unit circle, for the mean of a spectrum
Passive = Callable[[Floats], Flags]


@dataclass(frozen=True, slots=True)
class Remedy:
    """A change of a scene; the defaults change nothing."""

    name: str
    faster: float = 1.0  # rate of the servo over the scene's
    delay_share: float = 1.0  # of the scene's delay in seconds that is left
    active_damping_ns_per_m: float = 0.0
    best_corner: bool = False  # of the velocity filter, for each device
    coupling: bool = False  # a spring and a damper between device and environment


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
    Remedy("virtual coupling", coupling=True),
)


@dataclass(frozen=True, slots=True)
class RemediesParams:
    """Scenes and remedies; `seconds` and `seeds` of the trials of each row. 0 seeds: no trials."""

    scenes: tuple[Scene, ...]
    remedies: tuple[Remedy, ...] = REMEDIES
    quick: bool = False  # coarser, without trials
    seconds: float = 90.0
    seeds: int = 4


@dataclass(frozen=True, eq=False)
class Row:
    """A device with a remedy. nan: nothing is passive, or there is no such number."""

    device: str  # name of the scene
    remedy: str
    rate_hz: float
    delay_s: float
    corner_hz: float  # of the velocity filter
    stiffness_alone_n_per_m: float  # largest K at B = 0
    virtual_damping_ns_per_m: float  # B that lets K go farthest
    stiffness_n_per_m: float  # largest K at that B
    volume: float  # N/m N s/m kg; nan for a coupling
    asked: tuple[float, float]  # K [N/m], B [N s/m] of `rendered` and `noise_n`
    rendered: Complexes  # (3,) at RENDERED_HZ, Z over what is asked
    noise_n: float  # rms
    trials: limits.AxisLimit | None = None  # of K at the same B


def treated(scene: Scene, remedy: Remedy, corner_hz: float | None = None) -> Scene:
    """Return the scene with that remedy, and with the velocity filter at `corner_hz` if given."""
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
    """Return a test whether environments (N, 3) are passive on the scene's device, at its active
    damping.
    """
    shown = display(scene)
    at = Conditions(scene.level_ns_per_m, shown.filters, shown.model.delay_periods, 0.0)
    return partial(Theorem(shown.model).safe, at=at)


def couplings(scene: Scene) -> Passive:
    """Return a test whether couplings K, B, 0 (N, 3) are passive on the scene's device, with a
    rigid object and with springs behind them. A coupling between a fixed device and a spring must
    be stable too: its C plus the spring does not encircle 0.
    """
    shown = display(scene)
    rigid = passive_by_theorem(scene)
    lifted = lifted_system(shown.model, scene.level_ns_per_m, shown.filters)
    unit = np.ones_like(lifted.law[0])  # the condition for any C: |1 + C g|^2 >= R^2 |C|^2
    form = circles(replace(lifted, law=np.stack((unit, 1j * unit, 0.0 * unit)))).form
    centre, excess = 0.5 * (form[1] - 1j * form[2]), form[4]

    def passive(points: Floats) -> Flags:
        found = rigid(points)
        own = points @ lifted.law
        for share in SPRINGS:
            behind = share * np.maximum(points[:, :1], 1.0)
            phase = np.unwrap(np.angle(behind + own))
            c = behind * own / (behind + own)
            outside = 1.0 + 2.0 * (c * centre).real + np.abs(c) ** 2 * excess
            found &= (outside >= 0.0).all(axis=1) & (np.abs(phase[:, -1]) < 1.0)
        return found

    return passive


def largest_stiffness(passive: Passive, virtual_damping_ns_per_m: float) -> float:
    """Return K [N/m] of the first failure at that B and M = 0; nan if K = 0 fails."""
    return axis_limit(passive, 0, limits.REACH[0], (0.0, virtual_damping_ns_per_m, 0.0))


def stiffest(passive: Passive) -> tuple[float, float]:
    """Return (B [N s/m], K [N/m]) at the B >= 0 with the largest K; nan if nothing is passive."""
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
    """Return the scene with that remedy and the best of `count` corners of the velocity filter."""
    highest_hz = HIGHEST_CORNER * remedy.faster * scene.rate_hz
    scenes = [
        treated(scene, remedy, float(hz))
        for hz in np.geomspace(LOWEST_CORNER_HZ, highest_hz, count)
    ]
    stiffness = [stiffest(passive_by_theorem(one))[1] for one in scenes]
    return scenes[int(np.argmax(np.nan_to_num(stiffness, nan=-1.0)))]


def set_volume(passive: Passive, best: tuple[float, float], counts: Sequence[int]) -> float:
    """Return the volume [N/m N s/m kg] of the passive K >= 0, B >= 0 and M; 0 if nothing is
    passive. The grid of so many values includes the (B, K) of `stiffest`, and is widened until it
    contains the set.
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


Law = Callable[[Complexes], Complexes]  # H_v at some z: force over position


def felt_law(asked: tuple[float, float], coupling: tuple[float, float] | None) -> Law:
    """Return the law of the asked K [N/m] and B [N s/m], behind a coupling if there is one."""

    def law(slope: Complexes) -> Complexes:
        c = asked[0] + asked[1] * slope
        if coupling is None:
            return c
        between = coupling[0] + coupling[1] * slope
        return np.asarray(c * between / (c + between)) if isfinite(coupling[0]) else nan * slope

    return law


def rendered(scene: Scene, asked: tuple[float, float], law: Law) -> Complexes:
    """Return Z at RENDERED_HZ (3,) over the asked K / s + B, without dry friction; nan if nothing
    is asked.
    """
    shown = display(scene)
    k, b = asked
    if not isfinite(k):
        return np.full(len(RENDERED_HZ), nan, np.complex128)
    f = np.array(RENDERED_HZ)
    rate_hz = shown.model.rate_hz
    c = law(derivatives(np.exp(2j * np.pi * f / rate_hz), rate_hz, shown.filters)[0])
    loop = close_loop(shown.model, f, scene.level_ns_per_m, shown.filters)
    z = (1.0 + c * loop.common[1]) / (loop.admittance[0, 0, 0] + c * loop.admittance[0, 0, 1])
    return np.asarray(z / (k / (2j * np.pi * f) + b))


def noise_at_rest(scene: Scene, law: Law) -> float:
    """Return the rms force [N] of the law under white position noise as large as the encoder's
    rounding; nan without an encoder.
    """
    model = display(scene).model
    if model.encoder_quantum_m is None:
        return nan
    slope, _ = derivatives(np.exp(1j * ANGLES), model.rate_hz, display(scene).filters)
    gain = sqrt(float(np.mean(np.abs(law(slope)) ** 2)))
    return gain * model.encoder_quantum_m / sqrt(12.0)


def judged(
    scene: Scene, asked: tuple[float, float] | None, remedy: Remedy, quick: bool
) -> tuple[Scene, Row]:
    """Return the scene with the remedy, and its row by theory. `asked` None: half of its own
    stiffness.
    """
    own = (
        best_corner(scene, remedy, CORNERS[quick]) if remedy.best_corner else treated(scene, remedy)
    )
    passive = couplings(own) if remedy.coupling else passive_by_theorem(own)
    best = stiffest(passive)
    asked = asked or (0.5 * best[1], best[0])
    law = felt_law(asked, (best[1], best[0]) if remedy.coupling else None)
    return own, Row(
        device=scene.name,
        remedy=remedy.name,
        rate_hz=own.rate_hz,
        delay_s=display(own).model.delay_periods / own.rate_hz,
        corner_hz=own.environment.velocity_filter.frequency_hz,
        stiffness_alone_n_per_m=largest_stiffness(passive, 0.0),
        virtual_damping_ns_per_m=best[0],
        stiffness_n_per_m=best[1],
        volume=nan if remedy.coupling else set_volume(passive, best, GRID[quick]),
        asked=asked,
        rendered=rendered(own, asked, law),
        noise_n=noise_at_rest(own, law),
    )


def run_remedies(
    params: RemediesParams, store: TrialStore, tell: Progress = silent
) -> tuple[Row, ...]:
    """Return the rows of all remedies on all devices, by theory, then by the trials that the store
    lacks. The first remedy sets the asked environment. ConfigError as `compose` and `simulate`.
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
    coupled = {one.name for one in params.remedies if one.coupling}  # no sum of K, B and M
    tried = [one for one in found if one[1].remedy not in coupled]
    plans = [limits.plan_limits(_searched(params, *one)) for one in tried]
    results = iter(limits.run_plans(plans, store, tell))
    return tuple(
        row if row.remedy in coupled else replace(row, trials=next(results).limits[0])
        for _, row in found
    )


def _searched(params: RemediesParams, scene: Scene, row: Row) -> limits.LimitsParams:
    base = (0.0, np.nan_to_num(row.virtual_damping_ns_per_m), 0.0)
    given = outcomes.Conditions(scene, params.seconds, scene.noise)
    return limits.LimitsParams(
        given,
        (scene.level_ns_per_m,),
        axes=(0,),
        seeds=params.seeds,
        base=base,
        tolerance=TOLERANCE,
    )
