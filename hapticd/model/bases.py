"""Three bases for the judgement whether environments are safe.

    theorem     without friction, for every input and every passive hand: the sampled loop is stable
                (`loop`), K >= 0, and the passivity margin (`theorem`) is positive at all
                frequencies (`rational`)
    predicted   with Coulomb friction linearised at a stated perturbation (`predict`), stability
                included. A much larger motion is damped less
    measured    within limits that a bench measured on the axes K, B and M. The set is taken as
                their hull, sum |q| / limit <= 1. For a rigid device the safe set is convex (Re Z is
                affine in K, B, M) and contains these limits

The theorem caches everything that does not depend on the environment, for each level, delay and
pair of filters: the open loop (`theorem.open_loop`, most of the work), its lift, the condition as a
rational function, and the map of a tick. Twenty points then take 1 to 2 ms, mostly for eigenvalues.

At most LEVELS levels of active damping are cached. They are evenly spaced up to the limit of the
circuit, and include the level of `damping on`.

Limitations: `theorem` and `predicted` assume a constant delay; they do not cover a delay that
changes from tick to tick.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.environment import Point
from hapticd.model.blueprint import InputColumns, StateVariable
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import Filters, Tick, radii, tick_of
from hapticd.model.model import Model, Output, Outputs, frozen
from hapticd.model.params import MeasuredLevel, MeasuredParams, ModelParams, OutputParams
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

__all__ = [
    "Basis",
    "Conditions",
    "Measured",
    "Predicted",
    "Reading",
    "Theorem",
    "cached_levels",
    "model_of",
]

LEVELS = 16
_KEPT = 4 * LEVELS  # cached lifts, circles and ticks: levels, some delays, filters
_SLACK = 1e-9  # N s/m: a margin equal to the required one is enough
_ROUNDING = 1e-12  # of the largest K, B or M: distance from a line
_BETWEEN = 1e-4  # N s/m by which a margin tested only at some angles may be too large


class Conditions(NamedTuple):
    """The conditions under which a set of points is judged."""

    active_damping_ns_per_m: float  # level of active damping
    filters: Filters
    delay_periods: float
    spare_ns_per_m: float  # required margin


class Reading(NamedTuple):
    """The safety of a point; None where the basis does not provide the number."""

    margin_ns_per_m: float | None
    worst_hz: float | None  # frequency of the smallest margin
    radius: float | None  # spectral radius of a tick


class Theorem:
    """Stable, and passive for every input and every passive hand, without friction."""

    name = "theorem"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.rate_hz: float | None = model.rate_hz
        # the device with a delay; the same object for the same delay
        self.late: Callable[[float], Model] = lru_cache(LEVELS)(self._delayed)
        # the margin of an unstable loop comes from its impedance alone
        self.reading: Callable[[Point, Conditions], Reading] = lru_cache(_KEPT)(self._look)
        opened: Callable[[float], OpenLoop] = partial(open_loop, model)
        self._opened = lru_cache(LEVELS + 8)(opened)
        self._lifted: Callable[[float, Filters, float], LiftedSystem] = lru_cache(_KEPT)(self._lift)
        self._everywhere: Callable[[Conditions], Rational | None] = lru_cache(_KEPT)(self._draw)
        self._ticks: Callable[[float, Filters, float], Tick] = lru_cache(_KEPT)(self._tick)

    def prepare(self, at: Conditions) -> None:
        """Compute and cache the results for these conditions."""
        self._everywhere(at)
        self._ticks(at.active_damping_ns_per_m, at.filters, at.delay_periods)

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """Return whether each of `points` (N, 3) is safe, with the required margin.

        Points between two safe points of a convex set are safe: they lie outside all circles, and
        are as stable as the two ends.
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
        """Return a cheaper necessary condition of `safe`: on a connected set it decides as soon as
        one point is safe.

        It tests a few angles and leaves out stability. An eigenvalue crosses |z| = 1 only where
        -1/C = G, which is inside a circle. A connected set outside the circles is therefore stable
        as a whole, or not at all.
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
    """Passive and stable, with friction linearised at a perturbation."""

    name = "predicted"

    def __init__(self, theorem: Theorem, perturbation: Perturbation) -> None:
        self.rate_hz = theorem.rate_hz
        self._theorem = theorem
        self._perturbation = perturbation

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """Return whether each point is safe, as `Theorem.safe` does."""
        return self._enough(self._predict(points, at), at)

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """Return the condition without stability, which needs a separate map for every friction."""
        return self._enough(self._predict(points, at, stability=False), at)

    def reading(self, point: Point, at: Conditions) -> Reading:
        """Return the safety of a point. The radius includes the linearised friction, except where
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
    """Inside the measured limits of the highest level that does not exceed the active damping."""

    def __init__(self, measured: MeasuredParams) -> None:
        self.name = f"measured {measured.file}"
        self.rate_hz: float | None = None
        self._measured = measured

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """Return whether each point is safe, as `Theorem.safe` does. This basis has no margin in N
        s/m, so a required margin above 0 makes every point unsafe.
        """
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
        """Return a reading without numbers: limits give no distance to the edge."""
        return Reading(None, None, None)

    def _level(self, active_damping_ns_per_m: float) -> MeasuredLevel | None:
        below = [
            one
            for one in self._measured.levels
            if one.active_damping_ns_per_m <= active_damping_ns_per_m * (1.0 + 1e-3) + 1e-6
        ]
        return below[-1] if below else None


# `rate_hz` of a basis: rate of the ticks to which its radius applies; None: it has no radius
Basis = Theorem | Predicted | Measured


def line_ends(points: Floats) -> list[int] | None:
    """Return the indices of the two of `points` (N, 3) between which all others lie. None if the
    points are not on one line, or if there are at most two.
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
    """Return the model with these parameters, as far as judgements need it."""

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
            motor_force=seen["velocity"],  # not used by any judgement
            estimate=seen["velocity"],
        ),
        contacts=params.contacts,
    )


def cached_levels(ceiling_ns_per_m: float, active_damping_ns_per_m: float) -> tuple[float, ...]:
    """Return at most LEVELS levels of active damping from 0 to the limit, with that of `damping
    on`.
    """
    even = np.linspace(0.0, ceiling_ns_per_m, LEVELS - 1).tolist()
    return tuple(sorted({*even, min(active_damping_ns_per_m, ceiling_ns_per_m)}))
