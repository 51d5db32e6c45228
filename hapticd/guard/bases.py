"""How it is known whether environments are safe: three answers.

    theorem     without friction, for every input and every hand: the sampled loop is stable
                (`loop`), K >= 0, and the device has damping to spare (`theorem`) at all
                frequencies (`rational`)
    predicted   with Coulomb friction as it is at a stated perturbation (`predict`), stability
                included. A motion much larger than that is damped less
    measured    inside what a bench measured: between the limits of K, B and M on their axes, with
                the set taken as their hull, sum |q| / limit <= 1. For a rigid device the set is
                convex (Re Z is affine in K, B, M), and limits on its axes are in it

For the theorem everything that no environment changes is kept for each level, delay and pair of
filters: what the device is without a law (`theorem.opened`, most of the work), its lift, the
condition as a rational function, its tick. Twenty points then cost one to two milliseconds, nearly
all of it eigenvalues.

What is kept of levels is at most LEVELS, evenly up to the ceiling of the circuit, with the level
that `damping on` means.

Limitations: a delay that changes from tick to tick; `theorem` and `predicted` know one.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.environment import Point
from hapticd.core.params import MeasuredLevel, MeasuredParams, ModelParams, OutputParams
from hapticd.model.blueprint import StateVariable
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import Filters, Tick, radii, tick_of
from hapticd.model.model import InputColumns, Model, Output, Outputs, frozen
from hapticd.model.predict import Prediction, predict
from hapticd.model.rational import Rational, positive_everywhere, rational
from hapticd.model.theorem import (
    NOWHERE,
    LiftedSystem,
    OpenLoop,
    lifted_system,
    lifted_worst,
    open_loop,
    outside_circles,
)

__all__ = ["Conditions", "Theorem"]

LEVELS = 16
_KEPT = 4 * LEVELS  # of lifts, circles and ticks: levels, some delays, filters
_SLACK = 1e-9  # N s/m: a margin equal to what is asked for is enough
_ROUNDING = 1e-12  # of the largest K, B or M, beside a line
_BETWEEN = 1e-4  # N s/m by which the margin, looked for at angles alone, may be too large


class Conditions(NamedTuple):
    """What one judgement of points holds for."""

    active_damping_ns_per_m: float  # level of active damping
    filters: Filters
    delay_periods: float
    spare_ns_per_m: float  # margin that has to be left


class Reading(NamedTuple):
    """How safe a point is; None where the basis does not say."""

    margin_ns_per_m: float | None  # damping to spare
    worst_hz: float | None  # where it is least
    radius: float | None  # spectral radius of a tick


class Theorem:
    """Stable, and passive for every input and hand without friction."""

    name = "theorem"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.rate_hz: float | None = model.rate_hz
        # the device with a delay, the same object each time
        self.late: Callable[[float], Model] = lru_cache(LEVELS)(self._delayed)
        # how safe a point is; the margin of an unstable loop is that of its impedance alone
        self.reading: Callable[[Point, Conditions], Reading] = lru_cache(_KEPT)(self._look)
        opened: Callable[[float], OpenLoop] = partial(open_loop, model)
        self._opened = lru_cache(LEVELS + 8)(opened)
        self._lifted: Callable[[float, Filters, float], LiftedSystem] = lru_cache(_KEPT)(self._lift)
        self._everywhere: Callable[[Conditions], Rational | None] = lru_cache(_KEPT)(self._draw)
        self._ticks: Callable[[float, Filters, float], Tick] = lru_cache(_KEPT)(self._tick)

    def prepare(self, at: Conditions) -> None:
        """Compute what is kept for these conditions."""
        self._everywhere(at)
        self._ticks(at.active_damping_ns_per_m, at.filters, at.delay_periods)

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """Whether each of `points` (N, 3) is safe, with the margin asked for. What lies between two
        safe points of a convex set is safe: outside of all circles, and stable as they are.
        """
        found = self._everywhere(at)
        ends = line_ends(points) if found is not None and found.convex else None
        if ends is not None and self._sure(points[ends], at).all():
            return np.ones(len(points), np.bool_)
        return self._sure(points, at)

    def _sure(self, points: Floats, at: Conditions) -> Flags:
        hopeful = self.hopeful(points, at)
        if hopeful.any():
            tick = self._ticks(at.active_damping_ns_per_m, at.filters, at.delay_periods)
            hopeful[hopeful] = radii(tick, points[hopeful]) < 1.0
            hopeful[hopeful] = positive_everywhere(self._everywhere(at), points[hopeful])
        return hopeful

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """What `safe` says, or where that is much cheaper: whether those of a connected set are
        safe as soon as one of them is. Here at some angles, and without stability: an eigenvalue
        that crosses |z| = 1 does so where -1/C = G, inside a circle, so a connected set outside the
        circles is stable as a whole or not at all.
        """
        found = self._everywhere(at)
        seen = NOWHERE if found is None else found.circles
        return np.asarray((points[:, 0] >= 0.0) & outside_circles(seen, points))

    def _look(self, point: Point, at: Conditions) -> Reading:
        lifted = self._lifted(at.active_damping_ns_per_m, at.filters, at.delay_periods)
        tick = self._ticks(at.active_damping_ns_per_m, at.filters, at.delay_periods)
        kbm = np.array([point])
        found = lifted_worst(lifted, kbm[0], self.model.rate_hz)
        return Reading(found.margin_ns_per_m, found.worst_hz, float(radii(tick, kbm)[0]))

    def _delayed(self, delay_periods: float) -> Model:
        return replace(self.model, delay_periods=delay_periods)

    def _lift(self, level: float, filters: Filters, delay_periods: float) -> LiftedSystem:
        return lifted_system(self.late(delay_periods), level, filters, self._opened(level))

    def _draw(self, at: Conditions) -> Rational | None:
        late = self.late(at.delay_periods)
        return rational(late, at.active_damping_ns_per_m, at.filters, at.spare_ns_per_m + _BETWEEN)

    def _tick(self, level: float, filters: Filters, delay_periods: float) -> Tick:
        return tick_of(self.late(delay_periods), level, filters)


class Predicted:
    """Passive and stable with friction as it is at a perturbation."""

    name = "predicted"

    def __init__(self, theorem: Theorem, perturbation: Perturbation) -> None:
        self.rate_hz = theorem.rate_hz
        self._theorem = theorem
        self._perturbation = perturbation

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """As of `Theorem`."""
        return self._enough(self._predict(points, at), at)

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """Without stability, for which every friction takes a map of its own."""
        return self._enough(self._predict(points, at, stability=False), at)

    def reading(self, point: Point, at: Conditions) -> Reading:
        """How safe a point is; the radius is that with the linearised friction, without it where
        Re Z decided.
        """
        found = self._predict(np.array([point]), at)
        radius = float(found.spectral_radius[0])
        return Reading(
            float(found.margin_ns_per_m[0]),
            float(found.worst_hz[0]),
            self._theorem.reading(point, at).radius if np.isnan(radius) else radius,
        )

    def _predict(self, points: Floats, at: Conditions, stability: bool = True) -> Prediction:
        return predict(
            self._theorem.late(at.delay_periods),
            points,
            at.active_damping_ns_per_m,
            at.filters,
            self._perturbation,
            stability=stability,
        )

    @staticmethod
    def _enough(found: Prediction, at: Conditions) -> Flags:
        return found.passive & (found.margin_ns_per_m >= at.spare_ns_per_m - _SLACK)


class Measured:
    """Inside the limits that a bench measured, at the level of damping then or more."""

    def __init__(self, measured: MeasuredParams) -> None:
        self.name = f"measured {measured.file}"
        self.rate_hz: float | None = None
        self._measured = measured

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """As of `Theorem`. A margin in N s/m is not known: none may be asked for."""
        level = self._level(at.active_damping_ns_per_m)
        corners = tuple(one.frequency_hz for one in at.filters if one is not None)
        if level is None or at.spare_ns_per_m > 0.0 or corners != self._measured.corners_hz:
            return np.zeros(len(points), np.bool_)
        high = (level.stiffness_n_per_m, level.virtual_damping_high_ns_per_m, level.mass_high_kg)
        low = (0.0, level.virtual_damping_low_ns_per_m, level.mass_low_kg)
        ends = np.where(points >= 0.0, high, low)
        shares = np.divide(points, ends, out=np.full(points.shape, np.inf), where=ends != 0.0)
        shares[points == 0.0] = 0.0
        return np.asarray(shares.sum(axis=1) <= 1.0)

    hopeful = safe

    def reading(self, point: Point, at: Conditions) -> Reading:
        """Limits say nothing of how far inside a point is."""
        return Reading(None, None, None)

    def _level(self, active_damping_ns_per_m: float) -> MeasuredLevel | None:
        below = [
            one
            for one in self._measured.levels
            if one.active_damping_ns_per_m <= active_damping_ns_per_m * (1.0 + 1e-3) + 1e-6
        ]
        return below[-1] if below else None


# `rate_hz` of a basis is that of the ticks that its radius is of; None: it knows no radius
Basis = Theorem | Predicted | Measured


def line_ends(points: Floats) -> list[int] | None:
    """The two of `points` (N, 3) between which all others lie; None if they are on no line, or
    two or less.
    """
    if len(points) < 3:
        return None
    first = int(np.argmax(np.abs(points - points[0]).sum(axis=1)))
    last = int(np.argmax(np.abs(points - points[first]).sum(axis=1)))
    way = points[last] - points[first]
    shares = (points - points[first]) @ way / max(float(way @ way), np.finfo(np.float64).tiny)
    off = np.abs(points - points[first] - shares[:, None] * way)
    within_rounding = off <= _ROUNDING * np.abs(points).max(axis=0)
    return [first, last] if within_rounding.all() else None


def model_of(params: ModelParams) -> Model:
    """The model of these numbers, as far as judgements need it."""

    def output(of: OutputParams) -> Output:
        return Output(*(frozen(np.array(row)) for row in (of.c0, of.c1, of.d0, of.d1)))

    seen = {
        name: output(getattr(params, name))
        for name in ("encoder", "position", "velocity", "recorded_velocity", "recorded_travel")
    }
    impulse = None if params.recorded_impulse is None else output(params.recorded_impulse)
    return Model(
        name=params.name,
        rate_hz=params.rate_hz,
        delay_periods=params.delay_periods,
        states=tuple(StateVariable(name, "", "") for name in params.states),
        a0=frozen(np.array(params.a0)),
        a1=frozen(np.array(params.a1)),
        b0=frozen(np.array(params.b0)),
        b1=frozen(np.array(params.b1)),
        inputs=InputColumns(params.command, params.torque, len(params.b0[0])),
        outputs=Outputs(
            **seen,
            recorded_impulse=impulse,
            motor_force=seen["velocity"],  # not asked by any judgement
            estimate=seen["velocity"],
        ),
        contacts=params.contacts,
    )


def cached_levels(ceiling_ns_per_m: float, active_damping_ns_per_m: float) -> tuple[float, ...]:
    """At most LEVELS levels of active damping from 0 to the ceiling, with that of `damping on`."""
    even = np.linspace(0.0, ceiling_ns_per_m, LEVELS - 1).tolist()
    return tuple(sorted({*even, min(active_damping_ns_per_m, ceiling_ns_per_m)}))
