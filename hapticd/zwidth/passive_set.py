"""The passive set in the space of K, B and M, and the Z-width envelope over frequency.

Limits (`axis_limit`, `PassiveSet.limits`). A headline such as "K up to 600 N/m" can mean two
things, which differ by a factor. The axis limit scans one parameter from 0 to its first failure
with the others 0 (`axis_limit`). The set limit is the maximum over the whole set
(`PassiveSet.limits`). Both are always reported together.

Volume (`PassiveSet.volume`). It is that of the grid's cells. Each cell counts by the share of it
where the margin, linear between corners, is not negative.

Boundary (`boundary`, for the directed search). If only yes and no are known, rays from inside the
set find its boundary in the unit box. Their directions are spread evenly on the sphere (Fibonacci
spiral: Swinbank and Purser 2006). Each ray is bisected between its start, which is inside, and the
end of the box.

Limitations: a grid that does not reach beyond the set, because its limits are then those of the
grid (`PassiveSet.open_ends` lists them); a set that a ray leaves twice, of which one exit is found.

Envelope (`Envelope`). The paper draws the Z-width as the largest and smallest passive |Z| and phase
at every frequency. "The Z-width envelope is iteratively updated as successive trials are performed"
(Weir, Colgate and Peshkin 2008, section 2). Every point keeps the trial that set it and the
uncertainty of that trial, so each feature can be traced to a trial. Trials that are not passive do
not widen the envelope. The uncertainty is that of the owner alone. The largest of many noisy values
exceeds the true maximum by about one of its standard deviations. Confirm an owner with a second
trial before quoting it.

Admittance (`Envelope.admittance`). Its envelope has maximum and minimum exchanged: 1/|Z|, minus the
phase.

Trials on other frequencies, at another port or with another estimator are refused.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, Integers, bisect
from hapticd.core.errors import AnalysisError

__all__ = [
    "AXES",
    "Edge",
    "Envelope",
    "PassiveSet",
    "ascending",
    "axis_limit",
    "grid",
]

AXES = ("K", "B", "M")
_SPLIT = 4  # parts of a cell's edge when its share is counted
N_RAYS = 400  # of `boundary`
N_SAMPLES = 3000  # random points for the middle and the volume
_HALVINGS = 12  # bisections of a ray: to 1/4096 of it
_EDGE = 0.999  # of the way to the end of the box


@dataclass(frozen=True, slots=True)
class Limits:
    """Smallest and largest passive values along each axis."""

    stiffness: tuple[float, float]  # (minimum, maximum), N/m
    virtual_damping: tuple[float, float]  # (minimum, maximum), N s/m
    mass: tuple[float, float]  # (minimum, maximum), kg


@dataclass(frozen=True, eq=False)
class PassiveSet:
    """Margins on a grid of environments; a negative margin or nan is not passive."""

    axes: tuple[Floats, Floats, Floats]  # ascending K N/m, B N s/m, M kg
    margin: Floats  # (nK, nB, nM) minimum Re Z, N s/m

    @property
    def passive(self) -> Flags:
        """Which points of the grid are passive, (nK, nB, nM)."""
        return np.asarray(self.margin >= 0.0)

    @classmethod
    def of(
        cls, axes: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike], margin: npt.ArrayLike
    ) -> Self:
        """Return the set from margins in the order of `grid`. AnalysisError unless the axes ascend
        and the sizes match.
        """
        lists = tuple(np.asarray(axis, np.float64) for axis in axes)
        shape = tuple(axis.size for axis in lists)
        values = np.asarray(margin, np.float64)
        ascending(lists)
        if values.size != np.prod(shape):
            raise AnalysisError(
                f"{values.size} margins for a grid of {' x '.join(map(str, shape))} environments"
            )
        return cls((lists[0], lists[1], lists[2]), values.reshape(shape))

    def limits(self) -> Limits:
        """Return the extremes over the whole set. AnalysisError for an empty one."""
        if not self.passive.any():
            raise AnalysisError("no environment of the grid is passive: there are no limits")
        kept = [
            axis[np.any(self.passive, axis=tuple(i for i in range(3) if i != place))]
            for place, axis in enumerate(self.axes)
        ]
        return Limits(*((float(values[0]), float(values[-1])) for values in kept))

    def open_ends(self) -> tuple[str, ...]:
        """Return the ends of the grid that are passive, such as "K max", where the set may extend
        further. K = 0 is not included, because K < 0 is active.
        """
        ends = []
        for place, (name, axis) in enumerate(zip(AXES, self.axes, strict=True)):
            for word, index in (("min", 0), ("max", -1)):
                if name == "K" and word == "min" and axis[0] == 0.0:
                    continue
                if np.take(self.passive, index, axis=place).any():
                    ends.append(f"{name} {word}")
        return tuple(ends)

    def volume(self) -> float:
        """Return the volume of the set [N/m N s/m kg]."""
        cell = np.prod(np.meshgrid(*(np.diff(axis) for axis in self.axes), indexing="ij"), axis=0)
        return float((cell * _shares(self.margin)).sum())


def ascending(axes: tuple[Floats, ...]) -> None:
    """Raise AnalysisError unless each of `axes` has at least two ascending values."""
    if any(axis.ndim != 1 or axis.size < 2 or not np.all(np.diff(axis) > 0.0) for axis in axes):
        raise AnalysisError("a grid needs at least two ascending values on each of its three axes")


def grid(axes: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]) -> Floats:
    """Return all environments (N, 3) of a grid, M changing fastest."""
    return np.stack(
        np.meshgrid(*(np.asarray(axis, np.float64) for axis in axes), indexing="ij"), axis=-1
    ).reshape(-1, 3)


def axis_limit(
    decide: Callable[[Floats], Flags],
    axis: int,
    reach: float,
    base: tuple[float, float, float] = (0.0, 0.0, 0.0),
    steps: int = 60,
) -> float:
    """Return the first failure from `base` along `axis` (0 K, 1 B, 2 M) towards base + `reach`,
    refined to reach / steps^3.

    `decide` takes environments (N, 3) and returns (N,) whether each is passive. The limit is nan if
    `base` itself fails, and base + reach if no environment fails.
    """
    low = 0.0
    high = 1.0
    for _ in range(3):
        at = np.linspace(low, high, steps + 1)
        points = np.tile(np.asarray(base, np.float64), (at.size, 1))
        points[:, axis] += reach * at
        failed = np.flatnonzero(~decide(points))
        if not failed.size:
            return base[axis] + reach
        if failed[0] == 0:
            return float("nan")
        low = float(at[failed[0] - 1])
        high = float(at[failed[0]])
    return base[axis] + reach * low


def _shares(margin: Floats) -> Floats:
    """Return the share (nK-1, nB-1, nM-1) of each cell where the trilinear margin is not negative.

    A corner that is nan (not passive, without a number) counts as minus the median of all
    magnitudes.
    """
    known = np.abs(margin[np.isfinite(margin)])
    corners = np.nan_to_num(margin, nan=-float(np.median(known)) if known.size else -1.0)
    at = (np.arange(_SPLIT) + 0.5) / _SPLIT
    total = np.zeros(tuple(n - 1 for n in corners.shape))
    for x, y, z in grid((at, at, at)):
        total += _between(_between(_between(corners, 0, x), 1, y), 2, z) >= 0.0
    return total / _SPLIT**3


def _between(values: Floats, axis: int, share: float) -> Floats:
    first = np.take(values, range(values.shape[axis] - 1), axis)
    second = np.take(values, range(1, values.shape[axis]), axis)
    return np.asarray(first + share * (second - first))


def boundary(holds: Callable[[Floats], Flags], middle: Floats) -> tuple[Floats, Flags]:
    """Return where rays from `middle` (3,) leave the set `holds`, (N_RAYS, 3) in the unit box, and
    which of them reach the end of the box inside the set.
    """
    rays = directions()
    with np.errstate(divide="ignore"):
        to_end = np.where(
            rays > 0.0, (1.0 - middle) / rays, np.where(rays < 0.0, -middle / rays, np.inf)
        ).min(axis=1)
    high = _EDGE * to_end
    ends = holds(middle + rays * high[:, None])
    low = np.where(ends, high, 0.0)
    low, high = bisect(lambda share: holds(middle + rays * share[:, None]), low, high, _HALVINGS)
    return middle + rays * (0.5 * (low + high))[:, None], ends


def directions() -> Floats:
    """Unit vectors (N_RAYS, 3), spread evenly."""
    at = np.arange(N_RAYS) + 0.5
    # equal areas downwards, the golden angle around
    down = np.arccos(1.0 - 2.0 * at / N_RAYS)
    around = np.pi * (1.0 + np.sqrt(5.0)) * at
    return np.column_stack(
        (np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down))
    )


def samples() -> Floats:
    """Return random points (N_SAMPLES, 3) of the unit box, always the same."""
    return np.random.default_rng(1).random((N_SAMPLES, 3))


def distance(one: Floats, other: Floats) -> Floats:
    """Return the distance from each of `one` (N, 3) to the nearest of `other` (n, 3)."""
    return np.asarray(np.sqrt(((one[:, None] - other) ** 2).sum(axis=2)).min(axis=1))


# --- envelope -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Edge:
    """One edge of the envelope."""

    value: Floats  # (F,) in the unit of the envelope's kind, or degrees
    sd: Floats  # (F,) standard deviation of the owner's estimate: of the logarithm, or degrees
    owner: Integers  # (F,) places in the envelope's `trials`


@dataclass(frozen=True, eq=False)
class Envelope:
    """Upper and lower edges of |Z| or |Y| over `frequency_hz` (F,), and of their phase.

    `trials` are the names of the trials in the order of adding; owners are indices into them.
    """

    frequency_hz: Floats
    upper: Edge  # N s/m or m/(N s)
    lower: Edge  # N s/m or m/(N s)
    phase_upper: Edge  # deg
    phase_lower: Edge  # deg
    trials: tuple[str, ...]
    port: str  # where force and velocity were measured
    estimator: str
    kind: str = "impedance"  # "impedance" or "admittance"

    def width_db(self) -> Floats:
        """Return 20 log10 of upper over lower edge (F,)."""
        return np.asarray(20.0 * np.log10(self.upper.value / self.lower.value))

    def owner(self, edge: Edge) -> list[str]:
        """Return the names of the trials that own the points of `edge`."""
        return [self.trials[index] for index in edge.owner]

    @classmethod
    def of_one(
        cls,
        name: str,
        frequency_hz: Floats,
        z: Complexes,
        relative_sd: Floats,
        port: str,
        estimator: str,
    ) -> Self:
        """Return the envelope of one Z (F,) [N s/m] at `frequency_hz` (F,). `relative_sd` (F,) is
        the standard deviation of ln|Z| and of the phase in radians.
        """
        owner = np.zeros(frequency_hz.size, np.int64)
        size = Edge(np.abs(z), relative_sd, owner)
        phase = Edge(np.degrees(np.angle(z)), np.degrees(relative_sd), owner)
        return cls(frequency_hz, size, size, phase, phase, (name,), port, estimator)

    @classmethod
    def predicted(cls, frequency_hz: Floats, z: Complexes) -> Self:
        """Return the envelope of predicted Z (N, F) [N s/m], without uncertainty; owners: indices
        (N,).
        """
        size = np.abs(z)
        angle = np.degrees(np.angle(z))
        none = np.zeros(frequency_hz.size)

        def edge(values: Floats, which: Integers) -> Edge:
            return Edge(np.take_along_axis(values, which[None], 0)[0], none, which)

        return cls(
            frequency_hz,
            edge(size, size.argmax(0)), edge(size, size.argmin(0)),
            edge(angle, angle.argmax(0)), edge(angle, angle.argmin(0)),
            tuple(str(place) for place in range(len(z))), "probe", "spa",
        )  # fmt: skip

    def merged(self, new: "Envelope") -> "Envelope":
        """Return the envelope of the trials of both. AnalysisError if frequencies, ports or
        estimators differ.
        """
        if self.kind != "impedance":
            raise AnalysisError(
                "an admittance envelope cannot be widened; widen the impedance envelope and take"
                " its admittance"
            )
        _alike(self, new)
        before = len(self.trials)
        return replace(
            self,
            upper=_outer(self.upper, new.upper, before, 1.0),
            lower=_outer(self.lower, new.lower, before, -1.0),
            phase_upper=_outer(self.phase_upper, new.phase_upper, before, 1.0),
            phase_lower=_outer(self.phase_lower, new.phase_lower, before, -1.0),
            trials=(*self.trials, *new.trials),
        )

    def admittance(self) -> "Envelope":
        """Return the envelope of Y = 1/Z; for an admittance envelope, that of Z."""
        kind = "admittance" if self.kind == "impedance" else "impedance"
        turned = [replace(edge, value=1.0 / edge.value) for edge in (self.lower, self.upper)]
        phases = [replace(edge, value=-edge.value) for edge in (self.phase_lower, self.phase_upper)]
        return replace(
            self,
            upper=turned[0],
            lower=turned[1],
            phase_upper=phases[0],
            phase_lower=phases[1],
            kind=kind,
        )


def _outer(old: Edge, new: Edge, before: int, sense: float) -> Edge:
    beyond = ~(sense * new.value <= sense * old.value) & np.isfinite(new.value)
    return Edge(
        np.where(beyond, new.value, old.value),
        np.where(beyond, new.sd, old.sd),
        np.where(beyond, new.owner + before, old.owner),
    )


def _alike(found: Envelope, new: Envelope) -> None:
    if not np.array_equal(found.frequency_hz, new.frequency_hz):
        raise AnalysisError(
            "trials on unlike frequencies: estimate all with one window and one list of frequencies"
        )
    if (found.port, found.estimator) != (new.port, new.estimator):
        raise AnalysisError(
            f"a trial at the {new.port} by {new.estimator!r} beside others at the {found.port} by"
            f" {found.estimator!r}: choose one"
        )
