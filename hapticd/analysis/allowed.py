"""What a device withstands: whether displays are safe, by how much, and how far each of K, B and M
may go.

Three answers to whether an environment of a display (`displays`) is safe:

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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.displays import AXES, Display, Point
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.loop import Filters, Tick, radii, tick_of
from hapticd.analysis.predict import Prediction, predict
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
from hapticd.params import MeasuredLevel, MeasuredParams, ModelParams, OutputParams
from hapticd.plant.blueprint import StateVariable
from hapticd.plant.model import InputColumns, Model, Output, Outputs, frozen

LEVELS = 16
_KEPT = 4 * LEVELS  # of lifts, circles and ticks: levels, some delays, filters
_GRID = 40  # distances at which an axis is looked at, on either side
_FINER = 9  # values between the last that holds and the first that does not, three times
_INSIDE = 1e-3  # of an interval: as far inside of its ends as may be needed to be sure
NONE = np.zeros(0)
_SLACK = 1e-9  # N s/m: a margin equal to what is asked for is enough
_BETWEEN = 1e-4  # N s/m by which the worst frequency may lie between two that are looked at


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

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """What `safe` says, or where that is much cheaper: whether those of a connected set are
        safe as soon as one of them is.
        """
        ...

    def reading(self, point: Point, at: Conditions) -> Reading:
        """How safe one point is."""
        ...


class Theorem:
    """Stable, and passive for every input and hand without friction."""

    name = "theorem"

    def __init__(self, model: Model) -> None:
        self.model = model
        self._late: Callable[[float], Model] = lru_cache(LEVELS)(self._delayed)
        self._opened: Callable[[float], Opened] = lru_cache(LEVELS + 8)(self._open)
        self._lifted: Callable[[float, Filters, float], Lift] = lru_cache(_KEPT)(self._lift)
        self._circles: Callable[[Conditions], Circles] = lru_cache(_KEPT)(self._draw)
        self._read: Callable[[Point, Conditions], Reading] = lru_cache(_KEPT)(self._look)
        self._ticks: Callable[[float, Filters, float], Tick] = lru_cache(_KEPT)(self._tick)

    def prepare(self, at: Conditions) -> None:
        """Compute what is kept for these conditions."""
        self._circles(at)
        self._ticks(at.added_ns_per_m, at.filters, at.delay_periods)

    def safe(self, points: Floats, at: Conditions) -> Flags:
        """As `Basis`."""
        hopeful = self.hopeful(points, at)
        if hopeful.any():
            tick = self._ticks(at.added_ns_per_m, at.filters, at.delay_periods)
            hopeful[hopeful] = radii(tick, points[hopeful]) < 1.0
        return hopeful

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """Without stability: an eigenvalue that crosses |z| = 1 does so where -1/C = G, inside a
        circle, so a connected set outside the circles is stable as a whole or not at all.
        """
        return np.asarray((points[:, 0] >= 0.0) & within(self._circles(at), points))

    def reading(self, point: Point, at: Conditions) -> Reading:
        """As `Basis`. The margin of an unstable loop is that of its impedance alone."""
        return self._read(point, at)

    def _look(self, point: Point, at: Conditions) -> Reading:
        lifted = self._lifted(at.added_ns_per_m, at.filters, at.delay_periods)
        tick = self._ticks(at.added_ns_per_m, at.filters, at.delay_periods)
        kbm = np.array([point])
        found = lifted_worst(lifted, kbm[0], self.model.rate_hz)
        return Reading(found.margin_ns_per_m, found.worst_hz, float(radii(tick, kbm)[0]))

    def late(self, delay_periods: float) -> Model:
        """The device with that delay, the same object each time."""
        return self._late(delay_periods)

    def _delayed(self, delay_periods: float) -> Model:
        return replace(self.model, delay_periods=delay_periods)

    def _open(self, level: float) -> Opened:
        return opened(self.model, level)

    def _lift(self, level: float, filters: Filters, delay_periods: float) -> Lift:
        return lift(self.late(delay_periods), level, filters, self._opened(level))

    def _draw(self, at: Conditions) -> Circles:
        lifted = self._lifted(at.added_ns_per_m, at.filters, at.delay_periods)
        return circles(lifted, at.spare_ns_per_m + _BETWEEN)

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
        return self._enough(self._predict(points, at), at)

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """Without stability, for which every friction takes a map of its own."""
        return self._enough(self._predict(points, at, stability=False), at)

    def reading(self, point: Point, at: Conditions) -> Reading:
        """As `Basis`; the radius is that with the linearised friction, without it where Re Z
        decided.
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
            at.added_ns_per_m,
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

    def hopeful(self, points: Floats, at: Conditions) -> Flags:
        """As `safe`."""
        return self.safe(points, at)

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
    """Displays judged by one basis, with one margin asked for, at one delay or at two: more delay
    makes a negative virtual mass easier, so the longest alone is not the worst.
    """

    def __init__(
        self,
        basis: Basis,
        delay_periods: float,
        spare_ns_per_m: float,
        least_delay_periods: float | None = None,
    ) -> None:
        self.basis = basis
        self.delay_periods = delay_periods
        self.spare_ns_per_m = spare_ns_per_m
        self.least_delay_periods = least_delay_periods
        least = delay_periods if least_delay_periods is None else least_delay_periods
        self._delays = list(dict.fromkeys((delay_periods, least)))

    def conditions(self, display: Display) -> list[Conditions]:
        """Those of one display, by delay."""
        return [
            Conditions(display.added_ns_per_m, display.filters, delay, self.spare_ns_per_m)
            for delay in self._delays
        ]

    def safe(self, displays: Sequence[Display]) -> list[bool]:
        """Whether each is safe, in free space and in contact."""
        found = [True] * len(displays)
        groups: dict[Conditions, list[tuple[int, Point]]] = {}
        for place, display in enumerate(displays):
            for at in self.conditions(display):
                rows = groups.setdefault(at, [])
                rows.extend((place, point) for point in display.points())
        for at, rows in groups.items():
            flags = self.basis.safe(np.array([point for _, point in rows]), at)
            for (place, _), flag in zip(rows, flags.tolist(), strict=True):
                found[place] = found[place] and flag
        return found

    def all_safe(self, path: Sequence[Display]) -> bool:
        """Whether a way is safe; one without points is not known to be."""
        return bool(path) and all(self.safe(path))

    def reading(self, display: Display) -> Reading:
        """How safe it is in free space."""
        return self._read(display.free, display)

    def in_contact(self, display: Display) -> Reading | None:
        """How safe it is in its wall; None without one."""
        point = display.contact
        return None if point is None else self._read(point, display)

    def _read(self, point: Point, display: Display) -> Reading:
        found = [self.basis.reading(point, at) for at in self.conditions(display)]
        known = [one for one in found if one.margin_ns_per_m is not None]
        return min(known, key=lambda one: one.margin_ns_per_m or 0.0) if known else found[0]

    def worse(self, display: Display) -> Reading:
        """The reading of free space or contact, whichever has less margin."""
        free = self.reading(display)
        contact = self.in_contact(display)
        if contact is None or contact.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return contact if contact.margin_ns_per_m < free.margin_ns_per_m else free

    def least_level(self, display: Display, levels: Sequence[float]) -> float | None:
        """The least of `levels` (rising) at which it is safe; None for none."""
        return next(
            (level for level in levels if self.safe([display._replace(added_ns_per_m=level)])[0]),
            None,
        )

    def allowed(
        self, display: Display, lowest: Sequence[float], highest: Sequence[float]
    ) -> dict[str, list[float] | None]:
        """How far each of K, B, M may go with the others as they are, within `lowest`..`highest`:
        the interval round its value if that is safe, else the nearest that is, None for none.

        Ends are safe themselves, and lie within a thousandth of a step of the grid.
        """
        points = [np.array(point) for point in display.points()]
        cases = list(product(points, self.conditions(display)))

        def safe(values: list[Floats], sure: bool) -> list[Flags]:
            test = self.basis.safe if sure else self.basis.hopeful
            flags = np.concatenate([np.ones(one.size, np.bool_) for one in values])
            for point, at in cases:
                moved = [_moved(point, axis, one, display) for axis, one in enumerate(values)]
                flags &= test(np.concatenate(moved), at)
            return np.split(flags, np.cumsum([one.size for one in values])[:-1])

        ranges = [(max(lowest[0], 0.0), highest[0]), *zip(lowest[1:], highest[1:], strict=True)]
        found = intervals(safe, ranges, display.free)
        return dict(zip(AXES, found, strict=True))


def _moved(point: Floats, axis: int, values: Floats, display: Display) -> Floats:
    """The point (N, 3) with one of the display's K, B, M at other values (N,)."""
    moved = np.tile(point, (len(values), 1))
    moved[:, axis] += values - display.free[axis]
    return moved


Asked = Callable[[list[Floats], bool], list[Flags]]  # values of several axes; for sure, or not yet


def intervals(
    safe: Asked, ranges: Sequence[tuple[float, float]], at: Sequence[float]
) -> list[list[float] | None]:
    """For each axis the connected interval round its value `at` in which `safe` holds, or the
    nearest one, inside its range. All axes are asked together.

    `safe` may first hope, where that is cheaper; ends and middle of what is found are then made
    sure of, and a run that fails there is left for the next.
    """
    grids = [_grid(low, high, one) for (low, high), one in zip(ranges, at, strict=True)]
    hopes = safe(grids, False)
    found: list[list[float] | None] = [None] * len(grids)
    open_axes = list(range(len(grids)))
    while open_axes:
        runs = {axis: _run(grids[axis], hopes[axis], at[axis]) for axis in open_axes}
        open_axes = [axis for axis in open_axes if runs[axis] is not None]
        if not open_axes:
            break
        ends = _refined(safe, grids, {axis: runs[axis] for axis in open_axes})
        checks = [_checks(*ends[axis]) if axis in ends else NONE for axis in range(len(grids))]
        sure = safe(checks, True)
        for axis in open_axes:
            found[axis] = _sure(checks[axis], sure[axis])
            first, last = runs[axis] or (0, 0)
            hopes[axis][first : last + 1] = False
        open_axes = [axis for axis in open_axes if found[axis] is None]
    return found


def _checks(start: float, end: float) -> Floats:
    """Where an interval is made sure of: at its middle, and at each end or a little inside, for at
    the edge itself rounding decides.
    """
    return start + (end - start) * np.array([0.0, _INSIDE, 0.5, 1.0 - _INSIDE, 1.0])


def _sure(values: Floats, flags: Flags) -> list[float] | None:
    """What is sure of an interval that was looked at in five places; None if nothing is."""
    first, near, middle, far, last = flags.tolist()
    if not (middle and (first or near) and (far or last)):
        return None
    return [float(values[0] if first else values[1]), float(values[4] if last else values[3])]


def _grid(low: float, high: float, at: float) -> Floats:
    distances = (high - low) * np.concatenate(([0.0], np.geomspace(1e-6, 1.0, _GRID)))
    values = np.concatenate((at - distances, at + distances, [0.0]))
    return np.asarray(np.unique(np.clip(values, low, high)))


def _run(values: Floats, flags: Flags, at: float) -> tuple[int, int] | None:
    """First and last place of the run of true flags that is nearest to `at`."""
    held = np.flatnonzero(flags)
    if not held.size:
        return None
    nearest = int(held[np.argmin(np.abs(values[held] - at))])
    false = np.flatnonzero(~flags)
    first = int(false[false < nearest].max(initial=-1)) + 1
    last = int(false[false > nearest].min(initial=len(values))) - 1
    return first, last


def _refined(
    safe: Asked, grids: list[Floats], runs: Mapping[int, tuple[int, int] | None]
) -> dict[int, list[float]]:
    """Both ends of each run, nearer to where it stops."""
    inside = {}
    outside = {}
    for axis, run in runs.items():
        if run is not None:
            first, last = run
            values = grids[axis]
            inside[axis] = [values[first], values[last]]
            outside[axis] = [values[max(first - 1, 0)], values[min(last + 1, len(values) - 1)]]
    for _ in range(3):
        between = {
            axis: np.linspace(inside[axis], outside[axis], _FINER + 2)[1:-1] for axis in inside
        }
        asked = [between[axis].T.ravel() if axis in between else NONE for axis in range(len(grids))]
        flags = safe(asked, False)
        for axis in inside:
            for end in (0, 1):
                held = flags[axis][end * _FINER : (end + 1) * _FINER]
                count = _FINER if held.all() else int(np.argmin(held))
                steps = [inside[axis][end], *between[axis][:, end], outside[axis][end]]
                inside[axis][end] = steps[count]
                outside[axis][end] = steps[count + 1]
    return {axis: [float(end) for end in ends] for axis, ends in inside.items()}
