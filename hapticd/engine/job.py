"""What a task of a batch carries: a device, an environment and how to simulate them. Values that
pickle, no records.

Everything that a task needs and that is costly to make (reduced model, shape, kernel, torque
record) is made where it runs and kept there (`prepared`, `shared_torque`), so that a task travels
as parameters and seeds only.

One group of lanes from start to end: state array, blocks of ticks, what each block left,
divergence.

The kernel tallies in its own precision within a block; blocks add up in double. A lane that
diverged is parked: its state is zeroed after the block, and its sums have stopped at that tick (see
`tick`).

A winding that warms up: the kernel's coefficients follow the temperature of every lane.

    T' = (R(T) (F / K)^2 R_th - (T - T_ambient)) / tau        integrated exactly over each refresh,
                                                              its heat held

The heat is the mean over the refresh of the motor force squared (summed by the kernel). Temperature
moves with tau, tens of seconds, so coefficients are refreshed every 0.1 s. They are exact maps on a
grid of temperatures and interpolated between its nodes; at 0.5 K the neglected curvature is below
1e-6 of a coefficient.

What drives a group, leg by leg: torque and noise, and where legs end.

A leg is a run of ticks with one damping level, inside one period of the torque record, no longer
than a block (and, where a winding heats up, than its refresh; where spectra are kept, inside one
section).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from math import exp, lcm
from types import ModuleType
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Flags, Values, aligned
from hapticd.analysis.spectra import DEFAULT_LAG as LAG
from hapticd.engine.kernels import kernel
from hapticd.engine.numbers import Filters, law_numbers, plant_numbers
from hapticd.engine.shape import Shape, reduced, shape_of
from hapticd.engine.source import LAW_STATE, SCALARS
from hapticd.errors import ConfigError
from hapticd.params import EnvironmentParams
from hapticd.plant.effects import copper_ohm
from hapticd.plant.excitation import Stream, held_noise, torque_record
from hapticd.plant.model import Array, Model, Winding
from hapticd.plant.scene import DampingStep, Excitation
from hapticd.units import PROBE_RATE_HZ

CACHED = 4  # jobs, records: a few are compared, the rest would only fill memory
KEEPS = ("summary", "spectra", "records", "ticks")


@dataclass(frozen=True, eq=False)
class Job:
    """See `batch.simulate` for what each means."""

    model: Model
    environment: EnvironmentParams
    filters: Filters
    damping: tuple[DampingStep, ...]
    excitation: Excitation | Array
    ticks: int
    seed: int
    substeps: int
    dtype: str
    keep: str
    own_torque: bool
    renders: bool  # some trial has an environment
    start_position_m: float
    start_velocity_m_per_s: float

    @property
    def samples(self) -> int:
        """At 4 kHz, of a trial."""
        return round(self.ticks * PROBE_RATE_HZ / self.model.rate_hz)


@dataclass(frozen=True, eq=False)
class Prepared:
    """A job where it runs: `model` in the engine's coordinates, `coordinates` from the model's
    states to those.
    """

    model: Model
    coordinates: Array
    shape: Shape
    kernel: ModuleType
    scalar: type[np.floating[Any]]
    _numbers: dict[float, dict[str, float]] = field(default_factory=dict)

    def numbers(self, level_ns_per_m: float) -> dict[str, float]:
        """Coefficients at that damping level, made once."""
        if level_ns_per_m not in self._numbers:
            self._numbers[level_ns_per_m] = plant_numbers(self.model, self.shape, level_ns_per_m)
        return self._numbers[level_ns_per_m]


@lru_cache(maxsize=CACHED)
def prepared(job: Job) -> Prepared:
    """The kernel and what feeds it, made once per job. ConfigError as `shape_of` and `kernel`."""
    damped = any(step.level_ns_per_m != 0.0 for step in job.damping)
    model, coordinates = reduced(job.model, damped)
    shape = shape_of(model, job.environment, damped, job.substeps, job.dtype)
    if job.keep not in KEEPS:
        raise ConfigError(f"keep {job.keep!r}: use one of {', '.join(KEEPS)}")
    shape = replace(
        shape, renders=job.renders, own_torque=job.own_torque, ticks=job.keep == "ticks"
    )
    return Prepared(model, coordinates, shape, kernel(shape), SCALARS[shape.dtype])


def shared_torque(job: Job) -> Array:
    """The record that all trials get, or one period of it."""
    if isinstance(job.excitation, np.ndarray):
        return _rounded(job.excitation, job.model.torque_quantum_n)
    return drawn(job.excitation, job.samples, job.seed, job.model.torque_quantum_n)


@lru_cache(maxsize=CACHED)
def drawn(excitation: Excitation, samples: int, seed: int, quantum_n: float | None) -> Array:
    """The same for all jobs that ask for it."""
    return _rounded(torque_record(excitation, samples, seed, Stream.SHARED), quantum_n)


def played(record: Array, samples: int, scalar: type[np.floating[Any]]) -> Values:
    """A shared record, or its period, as the kernel plays it from the first sample to the last."""
    return np.resize(record.astype(scalar), samples)


def own_torque(job: Job, trial: int) -> Array:
    """The record of one trial."""
    if isinstance(job.excitation, np.ndarray):
        return _rounded(job.excitation[trial], job.model.torque_quantum_n)
    return _rounded(
        torque_record(job.excitation, job.samples, job.seed, Stream.TORQUE + trial),
        job.model.torque_quantum_n,
    )


def estimate_noise(job: Job) -> Array:
    """Noise of the velocity estimate, shared by all trials; one zero if there is none."""
    noise = job.model.noise
    if noise is None or not noise.estimate_psd:
        return np.zeros(1)
    return held_noise(job.samples, noise.estimate_psd, job.seed, Stream.ESTIMATE)


def _rounded(force_n: Array, quantum_n: float | None) -> Array:
    return force_n if quantum_n is None else np.floor(force_n / quantum_n + 0.5) * quantum_n


class Group:
    """`rows[name]` is a view of a row of the state array."""

    def __init__(self, job: Job, made: Prepared, params: Array) -> None:
        lanes = made.shape.lanes
        names = made.kernel.ROWS
        self.made, self.count = made, len(params)
        self.state = aligned(len(names) * lanes, made.scalar)
        self.rows = {
            name: self.state[place * lanes : (place + 1) * lanes]
            for place, name in enumerate(names)
        }
        self.v2, self.work, self.lowest, self.samples = (np.zeros(lanes) for _ in range(4))
        self.coefficients = np.zeros(max(1, len(made.kernel.COEFFICIENTS)), made.scalar)
        self.set(law_numbers(job.environment, job.filters, job.model.rate_hz))
        for column, name in enumerate("KBM" if job.renders else ""):
            self.rows[name][: self.count] = params[:, column]
        self.rows["ALIVE"][:] = 1.0
        self._start(job)

    def damp(self, level_ns_per_m: float) -> None:
        """Coefficients for this damping level from now on."""
        self.set(self.made.numbers(level_ns_per_m))

    def set(self, numbers: dict[str, Any]) -> None:
        """Fill the coefficients that the kernel has; where they are rows, with one value for
        all lanes or one each.
        """
        for name in numbers.keys() & self.rows.keys():
            self.rows[name][:] = numbers[name]
        for place, name in enumerate(self.made.kernel.COEFFICIENTS):
            if name in numbers:
                self.coefficients[place] = numbers[name]

    def play(self, torque: Values, noise: Values, out: Values, ticks: int, keep: bool) -> None:
        """`ticks` on, tallied; `out` gets all of them if asked."""
        self.made.kernel.run(self.state, self.coefficients, torque, noise, out, ticks, int(keep))
        rows = self.rows
        self.lowest = np.minimum(self.lowest, self.work + rows["LOWEST"])
        self.v2 += rows["SPEED2"]
        self.work += rows["WORK"]
        self.samples += rows["TICKS"] * self.made.shape.samples
        for name in ("SPEED2", "WORK", "LOWEST", "TICKS"):
            rows[name][:] = 0.0
        if not rows["ALIVE"].all():
            self._park(rows["ALIVE"] == 0.0)

    def _park(self, lanes: Flags) -> None:
        moving = [
            name for name in self.rows if name[0] == "X" or name == "U" or name.startswith("WAIT")
        ]
        law = [*LAW_STATE, "K", "B", "M"] if self.made.shape.renders else []
        for name in [*moving, *law]:
            self.rows[name][lanes] = 0.0

    def _start(self, job: Job) -> None:
        """All bodies together at the start position and velocity, the law at rest there."""
        bodies = {"position": job.start_position_m, "velocity": job.start_velocity_m_per_s}
        states = [
            state.name.rpartition("_")[2] if state.name in BODIES else ""
            for state in job.model.states
        ]
        start = self.made.coordinates @ np.array([bodies.get(kind, 0.0) for kind in states])
        for index, value in enumerate(start):
            self.rows[f"X{index}"][:] = value
        if not job.renders:
            return
        quantum = job.model.encoder_quantum_m
        seen = (
            job.start_position_m
            if quantum is None
            else np.floor(job.start_position_m / quantum + 0.5) * quantum
        )
        self.rows["L0"][:] = seen


BODIES = {
    f"{body}_{kind}" for body in ("rotor", "slider", "hand") for kind in ("position", "velocity")
}


REFRESH_S = 0.1
GRID_K = 0.5


class Heating:
    """The windings of a group."""

    def __init__(self, group: Group, winding: Winding) -> None:
        self._group = group
        self._winding = winding
        self.temperature_c: Array = np.full(group.made.shape.lanes, winding.start_c)
        self._level_ns_per_m = 0.0
        self._nodes: dict[tuple[int, float], dict[str, float]] = {}

    def damp(self, level_ns_per_m: float) -> None:
        """Coefficients for this level and the present temperatures."""
        self._level_ns_per_m = level_ns_per_m
        lower = np.floor(self.temperature_c / GRID_K).astype(int)
        part = self.temperature_c / GRID_K - lower
        ends = [[self._node(int(index) + step) for index in lower] for step in (0, 1)]
        low, high = (
            {name: np.array([node[name] for node in end]) for name in end[0]} for end in ends
        )
        self._group.set({name: low[name] + part * (high[name] - low[name]) for name in low})

    def warm(self, seconds: float, samples: int) -> None:
        """After `seconds` in which the kernel summed the motor force squared over `samples`."""
        winding = self._winding
        heat = self._group.rows["HEAT"]
        ohm = np.array([self._ohm(float(celsius)) for celsius in self.temperature_c])
        power_w = ohm * heat / (samples * self._group.made.model.torque_constant_n_per_a**2)
        end_c = winding.ambient_c + winding.thermal_resistance_k_per_w * power_w
        self.temperature_c = end_c + (self.temperature_c - end_c) * exp(
            -seconds / winding.time_constant_s
        )
        heat[:] = 0.0
        self.damp(self._level_ns_per_m)

    def _ohm(self, celsius: float) -> float:
        return copper_ohm(self._winding.resistance_ohm, self._winding.reference_c, celsius)

    def _node(self, index: int) -> dict[str, float]:
        key = index, self._level_ns_per_m
        if key not in self._nodes:
            made = self._group.made
            residual_ohm = self._ohm(index * GRID_K) - self._winding.compensated_ohm
            numbers = plant_numbers(
                made.model.at_residual(residual_ohm), made.shape, self._level_ns_per_m
            )
            self._nodes[key] = {
                name: value for name, value in numbers.items() if name in self._group.rows
            }
        return self._nodes[key]


BLOCK_TICKS = 8192


class Inputs:
    """Torque and noise in the kernel's layout. A record that is shorter than the trial repeats."""

    def __init__(self, job: Job, made: Prepared, count: int, first: int) -> None:
        self._samples = made.shape.samples
        self._lanes = made.shape.lanes if job.own_torque else 1
        self._torque = _own(job, made, count, first) if job.own_torque else _shared(job, made)
        self._noise = estimate_noise(job).astype(made.scalar)
        self._borders = _borders(job, made, len(self._torque) // self._samples)

    def legs(self) -> Iterator[tuple[int, int]]:
        """(first tick, tick after the last) of every leg."""
        return pairwise(self._borders)

    def torque(self, start: int, end: int) -> Values:
        """For the ticks of a leg, flat."""
        begin = start * self._samples % len(self._torque)
        return self._torque[begin : begin + (end - start) * self._samples].reshape(-1)

    def noise(self, start: int, end: int) -> Values:
        """For the ticks of a leg; one zero if there is none."""
        return (
            self._noise
            if len(self._noise) == 1
            else self._noise[start * self._samples : end * self._samples]
        )

    def rows(self, count: int, total: int) -> Values:
        """The records of the trials, (count, total)."""
        return np.resize(self._torque, (total, self._lanes)).T[:count].copy()


def level_at(job: Job, tick: int) -> float:
    """Damping level [Ns/m] that acts from `tick` on, as its DAC gives it."""
    asked = [
        step.level_ns_per_m for step in job.damping if round(step.at_s * job.model.rate_hz) <= tick
    ]
    level = asked[-1]
    quantum = job.model.damping_quantum_ns_per_m
    return level if quantum is None else float(np.floor(level / quantum + 0.5) * quantum)


@lru_cache(maxsize=2)
def _shared(job: Job, made: Prepared) -> Values:
    """(period, 1)"""
    return _repeated(shared_torque(job).astype(made.scalar)[:, None], job, made)


def _own(job: Job, made: Prepared, count: int, first: int) -> Values:
    """(period, lanes)"""
    rows = [own_torque(job, first + lane).astype(made.scalar) for lane in range(count)]
    record = np.zeros((len(rows[0]), made.shape.lanes), made.scalar)
    for lane, row in enumerate(rows):
        record[:, lane] = row
    return _repeated(record, job, made)


def _repeated(record: Values, job: Job, made: Prepared) -> Values:
    period = _period(len(record), made.shape.samples, job.samples)
    return record if len(record) == period else np.resize(record, (period, record.shape[1]))


def _period(length: int, samples: int, total: int) -> int:
    """Samples after which the record repeats: whole ticks, and at least a block unless the
    trial is shorter.
    """
    whole = lcm(length, samples)
    return min(total, whole * -(-BLOCK_TICKS * samples // whole))


def _borders(job: Job, made: Prepared, period: int) -> list[int]:
    steps = [BLOCK_TICKS, period]
    if job.keep == "spectra" and not LAG % made.shape.samples:
        steps.append(LAG // made.shape.samples)
    if made.model.winding is not None:
        steps.append(max(1, round(REFRESH_S * job.model.rate_hz)))
    ticks = {tick for step in steps for tick in range(0, job.ticks, step)}
    ticks |= {round(step.at_s * job.model.rate_hz) for step in job.damping}
    return sorted({tick for tick in ticks if 0 <= tick < job.ticks} | {job.ticks})
