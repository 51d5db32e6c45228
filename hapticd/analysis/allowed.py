"""What a device withstands: whether displays are safe, by how much, and how far each of K, B and M
may go.

A display is what is rendered and damped at once: K, B, M with a wall, two filters, and a level of
active damping. It is two environments (`points`), (K, B, M) in free space and (K + K_wall,
B + B_wall, M) in the wall; both have to hold. Three answers to whether one does:

    theorem     without friction, for every input and every hand: the sampled loop is stable
                (`loop`), K >= 0, and the device has damping to spare (`theorem`)
    predicted   with Coulomb friction as it is at a stated perturbation (`predict`), stability
                included. A motion much larger than that is damped less
    measured    inside what a bench measured: between the limits of K, B and M on their axes, with
                the set taken as their hull, sum |q| / limit <= 1. For a rigid device the set is
                convex (Re Z is affine in K, B, M), and limits on its axes are in it

For the theorem everything that no environment changes is kept for each level, delay and pair of
filters: what the device is without a law (`theorem.opened`, most of the work), its lift, its
circles, its tick. Twenty points then cost half a millisecond, nearly all of it eigenvalues.

What is kept of levels is at most LEVELS, evenly up to the ceiling of the circuit, with the level
that `damping on` means.

What would break it: a delay that changes from tick to tick, or a hand that makes and breaks
contact with the wall in step with its motion: each side is judged for itself, and neither is
covered.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.loop import Filters, Tick, radii, tick_of
from hapticd.analysis.predict import predict
from hapticd.analysis.theorem import (
    Circles,
    Lift,
    Opened,
    circles,
    lift,
    lifted_worst,
    opened,
    within,
)
from hapticd.params import (
    FilterParams,
    MeasuredLevel,
    MeasuredParams,
    ModelParams,
    OutputParams,
    WallParams,
)
from hapticd.plant.blueprint import StateVariable
from hapticd.plant.model import InputColumns, Model, Output, Outputs, frozen

LEVELS = 16
_KEPT = 4 * LEVELS  # of lifts, circles and ticks: levels, some delays, filters
_GRID = 40  # distances at which an axis is looked at, on either side
_FINER = 9  # values between the last that holds and the first that does not, three times
_SLACK = 1e-9  # N s/m: a margin equal to what is asked for is enough

Point = tuple[float, float, float]
AXES = ("K", "B", "M")


class Display(NamedTuple):
    """What is rendered and damped at one time."""

    stiffness_n_per_m: float
    damping_ns_per_m: float  # virtual damping B
    mass_kg: float
    wall: WallParams
    filters: tuple[FilterParams, FilterParams]  # of velocity and acceleration
    added_ns_per_m: float  # level of active damping

    @property
    def free(self) -> Point:
        """K, B, M outside the wall."""
        return self.stiffness_n_per_m, self.damping_ns_per_m, self.mass_kg

    @property
    def contact(self) -> Point | None:
        """K, B, M in the wall; None without one."""
        if self.wall.side == 0:
            return None
        return (
            self.stiffness_n_per_m + self.wall.stiffness_n_per_m,
            self.damping_ns_per_m + self.wall.damping_ns_per_m,
            self.mass_kg,
        )

    def points(self) -> list[Point]:
        """All environments that it is."""
        return [self.free] if self.contact is None else [self.free, self.contact]

    def with_free(self, free: Point) -> "Display":
        """The display with another K, B, M."""
        stiffness, damping, mass = (float(value) for value in free)
        return self._replace(stiffness_n_per_m=stiffness, damping_ns_per_m=damping, mass_kg=mass)

    def scaled(self, share: float) -> "Display":
        """The display with all its forces times `share`, as the gain of an enable has it."""
        wall = replace(
            self.wall,
            stiffness_n_per_m=share * self.wall.stiffness_n_per_m,
            damping_ns_per_m=share * self.wall.damping_ns_per_m,
        )
        stiffness, damping, mass = self.free
        return self.with_free((share * stiffness, share * damping, share * mass))._replace(
            wall=wall
        )


class Conditions(NamedTuple):
    """What one judgement of points holds for."""

    added_ns_per_m: float  # level of active damping
    filters: Filters
    delay_periods: float
    spare_ns_per_m: float  # margin that has to be left


class Reading(NamedTuple):
    """How safe a point is; None where the basis does not say."""

    margin_ns_per_m: float | None  # damping to spare
    worst_hz: float | None  # where it is least
    radius: float | None  # spectral radius of a tick


class Basis(Protocol):
    """How it is known whether points are safe."""

    name: str

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """Whether each of `points` (N, 3) is safe, with the margin asked for."""
        ...

    def reading(self, point: Point, at: Conditions) -> Reading:
        """How safe one point is."""
        ...


class Theorem:
    """Stable, and passive for every input and hand without friction."""

    name = "theorem"

    def __init__(self, model: Model) -> None:
        self.model = model
        self._opened: Callable[[float], Opened] = lru_cache(LEVELS + 4)(self._open)
        self._lifted: Callable[[float, Filters, float], Lift] = lru_cache(_KEPT)(self._lift)
        self._circles: Callable[[Conditions], Circles] = lru_cache(_KEPT)(self._draw)
        self._ticks: Callable[[float, Filters, float], Tick] = lru_cache(_KEPT)(self._tick)

    def prepare(self, at: Conditions) -> None:
        """Compute what is kept for these conditions."""
        self._circles(at)
        self._ticks(at.added_ns_per_m, at.filters, at.delay_periods)

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """As `Basis`."""
        hopeful = (points[:, 0] >= 0.0) & within(self._circles(at), points)
        if hopeful.any():
            tick = self._ticks(at.added_ns_per_m, at.filters, at.delay_periods)
            hopeful[hopeful] = radii(tick, points[hopeful]) < 1.0
        return hopeful

    def reading(self, point: Point, at: Conditions) -> Reading:
        """As `Basis`. The margin of an unstable loop is that of its impedance alone."""
        lifted = self._lifted(at.added_ns_per_m, at.filters, at.delay_periods)
        tick = self._ticks(at.added_ns_per_m, at.filters, at.delay_periods)
        kbm = np.array([point])
        found = lifted_worst(lifted, kbm[0], self.model.rate_hz)
        return Reading(found.margin_ns_per_m, found.worst_hz, float(radii(tick, kbm)[0]))

    def late(self, delay_periods: float) -> Model:
        """The device with that delay."""
        return replace(self.model, delay_periods=delay_periods)

    def _open(self, level: float) -> Opened:
        return opened(self.model, level)

    def _lift(self, level: float, filters: Filters, delay_periods: float) -> Lift:
        return lift(self.late(delay_periods), level, filters, self._opened(level))

    def _draw(self, at: Conditions) -> Circles:
        lifted = self._lifted(at.added_ns_per_m, at.filters, at.delay_periods)
        return circles(lifted, at.spare_ns_per_m - _SLACK)

    def _tick(self, level: float, filters: Filters, delay_periods: float) -> Tick:
        return tick_of(self.late(delay_periods), level, filters)


class Predicted:
    """Passive and stable with friction as it is at a perturbation."""

    name = "predicted"

    def __init__(self, theorem: Theorem, perturbation: Perturbation) -> None:
        self._theorem = theorem
        self._perturbation = perturbation

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """As `Basis`."""
        found = predict(
            self._theorem.late(at.delay_periods),
            points,
            at.added_ns_per_m,
            at.filters,
            self._perturbation,
        )
        return found.passive & (found.margin_ns_per_m >= at.spare_ns_per_m - _SLACK)

    def reading(self, point: Point, at: Conditions) -> Reading:
        """As `Basis`; the radius is that with the linearised friction, without where it was not
        needed.
        """
        found = predict(
            self._theorem.late(at.delay_periods),
            np.array([point]),
            at.added_ns_per_m,
            at.filters,
            self._perturbation,
            allow_negative_stiffness=True,
        )
        radius = float(found.spectral_radius[0])
        bare = self._theorem.reading(point, at).radius
        return Reading(
            float(found.margin_ns_per_m[0]),
            float(found.worst_hz[0]),
            bare if np.isnan(radius) else radius,
        )


class Measured:
    """Inside the limits that a bench measured, at the level of damping then or more."""

    def __init__(self, measured: MeasuredParams) -> None:
        self.name = f"measured {measured.file}"
        self._measured = measured

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """As `Basis`. A margin in N s/m is not known: none may be asked for."""
        level = self._level(at.added_ns_per_m)
        corners = tuple(one.frequency_hz for one in at.filters if one is not None)
        if level is None or at.spare_ns_per_m > 0.0 or corners != self._measured.corners_hz:
            return np.zeros(len(points), np.bool_)
        high = (level.stiffness_n_per_m, level.damping_high_ns_per_m, level.mass_high_kg)
        low = (0.0, level.damping_low_ns_per_m, level.mass_low_kg)
        ends = np.where(points >= 0.0, high, low)
        shares = np.divide(points, ends, out=np.full(points.shape, np.inf), where=ends != 0.0)
        shares[points == 0.0] = 0.0
        return np.asarray(shares.sum(axis=1) <= 1.0)

    def reading(self, point: Point, at: Conditions) -> Reading:
        """As `Basis`: limits say nothing of how far inside a point is."""
        return Reading(None, None, None)

    def _level(self, added_ns_per_m: float) -> MeasuredLevel | None:
        below = [
            one
            for one in self._measured.levels
            if one.damping_ns_per_m <= added_ns_per_m * (1.0 + 1e-3) + 1e-6
        ]
        return below[-1] if below else None


def model_of(params: ModelParams) -> Model:
    """The model of these numbers, as far as judgements need it."""

    def output(of: OutputParams) -> Output:
        return Output("", *(frozen(np.array(row)) for row in (of.c0, of.c1, of.d0, of.d1)))

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


def cached_levels(ceiling_ns_per_m: float, added_ns_per_m: float) -> tuple[float, ...]:
    """At most LEVELS levels of active damping from 0 to the ceiling, with that of `damping on`."""
    even = np.linspace(0.0, ceiling_ns_per_m, LEVELS - 1).tolist()
    return tuple(sorted({*even, min(added_ns_per_m, ceiling_ns_per_m)}))


class Judgement:
    """Displays judged by one basis, at one delay, with one margin asked for."""

    def __init__(self, basis: Basis, delay_periods: float, spare_ns_per_m: float) -> None:
        self.basis = basis
        self.delay_periods = delay_periods
        self.spare_ns_per_m = spare_ns_per_m

    def conditions(self, display: Display) -> Conditions:
        """Those of one display."""
        return Conditions(
            display.added_ns_per_m, display.filters, self.delay_periods, self.spare_ns_per_m
        )

    def safe(self, displays: Sequence[Display]) -> list[bool]:
        """Whether each is safe, in free space and in contact."""
        found = [True] * len(displays)
        groups: dict[Conditions, list[tuple[int, Point]]] = {}
        for place, display in enumerate(displays):
            rows = groups.setdefault(self.conditions(display), [])
            rows.extend((place, point) for point in display.points())
        for at, rows in groups.items():
            flags = self.basis.safe(np.array([point for _, point in rows]), at)
            for (place, _), flag in zip(rows, flags.tolist(), strict=True):
                found[place] = found[place] and flag
        return found

    def reading(self, display: Display) -> Reading:
        """How safe it is in free space."""
        return self.basis.reading(display.free, self.conditions(display))

    def in_contact(self, display: Display) -> Reading | None:
        """How safe it is in its wall; None without one."""
        point = display.contact
        return None if point is None else self.basis.reading(point, self.conditions(display))

    def allowed(
        self, display: Display, lowest: Sequence[float], highest: Sequence[float]
    ) -> dict[str, list[float] | None]:
        """How far each of K, B, M may go with the others as they are, within `lowest`..`highest`:
        the interval round its value if that is safe, else the nearest that is, None for none.
        """
        at = self.conditions(display)
        points = display.points()
        found: dict[str, list[float] | None] = {}
        for axis, name in enumerate(AXES):

            def safe(values: Floats, axis: int = axis) -> Flags:
                flags = np.ones(len(values), np.bool_)
                for point in points:
                    moved = np.tile(np.array(point), (len(values), 1))
                    moved[:, axis] += values - display.free[axis]
                    flags &= self.basis.safe(moved, at)
                return flags

            low = max(lowest[axis], 0.0) if name == "K" else lowest[axis]
            found[name] = interval(safe, low, highest[axis], display.free[axis])
        return found

    def least_level(self, display: Display, levels: Sequence[float]) -> float | None:
        """The least of `levels` at which it is safe; None for none."""
        flags = self.safe([display._replace(added_ns_per_m=level) for level in levels])
        return next((level for level, flag in zip(levels, flags, strict=True) if flag), None)


def interval(
    safe: Callable[[Floats], Flags], low: float, high: float, at: float
) -> list[float] | None:
    """The connected interval round `at` in which `safe` holds, or the nearest one, within
    `low`..`high`; its ends hold themselves, and lie within a thousandth of a step of the grid.
    """
    distances = (high - low) * np.concatenate(([0.0], np.geomspace(1e-6, 1.0, _GRID)))
    values = np.unique(np.clip(np.concatenate((at - distances, at + distances, [0.0])), low, high))
    flags = safe(values)
    if not flags.any():
        return None
    held = np.flatnonzero(flags)
    nearest = int(held[np.argmin(np.abs(values[held] - at))])
    first = nearest
    while first > 0 and flags[first - 1]:
        first -= 1
    last = nearest
    while last + 1 < len(values) and flags[last + 1]:
        last += 1
    start = _edge(safe, values[first], values[first - 1]) if first > 0 else values[first]
    end = _edge(safe, values[last], values[last + 1]) if last + 1 < len(values) else values[last]
    return [float(start), float(end)]


def _edge(safe: Callable[[Floats], Flags], inside: float, outside: float) -> float:
    """The last value that holds on the way from `inside`, which does, to `outside`."""
    for _ in range(3):
        values = np.linspace(inside, outside, _FINER + 2)
        flags = safe(values[1:-1])
        count = _FINER if flags.all() else int(np.argmin(flags))
        inside = values[count]
        outside = values[count + 1]
    return float(inside)
