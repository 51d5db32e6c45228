"""A batch of trials of one scene: `simulate`, its result, and the execution of its tasks.

A batch is cut into tasks of some groups of lanes each, which run on threads of this process or on
any executor. A task plays its groups one after the other from start to end (`run_chunk`). A batch
uses the cores of its process, or fewer with `at_most`: a pool that runs many tasks at once gives
each its share. A result holds sums, spectra or records, and never a NaN.

Random numbers of a single trial depend on its K, B and M, or on its position in the batch if each
has a torque record of its own. A trial simulated alone, again, or among others is therefore the
same.

Seeds and records must not depend on the task of a trial (results would then depend on the number of
cores).
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace
from functools import partial
from hashlib import blake2b
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Floats, Values
from hapticd.core.environment import Environment
from hapticd.core.errors import ConfigError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.compose import compose
from hapticd.model.loop import Filters
from hapticd.model.model import Model
from hapticd.model.scene import DampingStep, Excitation, Scene
from hapticd.signal.spectra import DEFAULT_LAG as LAG
from hapticd.signal.spectra import Spectra, grid_frequencies
from hapticd.zwidth.engine.contact import AtContact, ContactDamping
from hapticd.zwidth.engine.job import (
    Group,
    Heating,
    Inputs,
    Job,
    Prepared,
    level_at,
    played,
    prepared,
    shared_torque,
)
from hapticd.zwidth.engine.parts import LawPart
from hapticd.zwidth.engine.records import Records, Sums, force_spectrum, spectral

__all__ = ["BatchResult", "simulate"]


@dataclass(frozen=True, eq=False)
class BatchResult:
    """n trials of `ticks` servo ticks at 4 kHz. The caller owns the arrays.

    A trial whose speed passed 1,000 m/s (rms over a tick), or was not a number, has diverged: its
    sums and records end before that tick, at `samples`, and the rest of its row of a record is 0.
    """

    params: Values  # (n, 3): stiffness N/m, damping Ns/m, mass kg
    sigma_v_m_per_s: Values  # (n,) rms of the recorded velocity
    max_force_n: Values  # (n,) largest command
    work_j: Values  # (n,) work of the perturbation on the device
    # (n,) minimum of that work at the end of a tick: below 0 the device has delivered energy
    min_energy_j: Values
    samples: npt.NDArray[np.int64]  # (n,) valid samples
    rate_hz: float  # of the records
    seconds: float  # length of a trial that does not diverge
    # (n,) share of its ticks in which the amplifier was at a limit, where it has limits
    limited: Values | None = None
    winding_c: Values | None = None  # (n,) temperature at the end, where the winding heats up
    # (F,) or (n, F) [N^2], with keep="spectra", at k 4000/4096 Hz; as `signal.spectra.spa`
    force_spectrum: Floats | None = None
    velocity_spectrum: Floats | None = None  # (n, F) [(m/s)^2]
    cross_spectrum: Complexes | None = None  # (n, F) [N m/s]
    section_rms_m_per_s: Values | None = None  # (n, sections) of 2,048 samples
    # (samples,) if all trials share it, otherwise (n, samples): interval means
    torque_n: Values | None = None
    velocity_m_per_s: Values | None = None  # (n, samples), interval means
    position_m: Values | None = None  # (n, ticks) at the input of the law
    force_n: Values | None = None  # (n, ticks) commanded

    @property
    def diverged(self) -> npt.NDArray[np.bool_]:
        """(n,)"""
        return self.samples < round(self.seconds * self.rate_hz)

    @property
    def diverged_at_s(self) -> Values:
        """(n,) time of divergence [s], infinite for a trial that ran to its end."""
        return np.where(self.diverged, self.samples / self.rate_hz, np.inf)

    def record(self, trial: int) -> tuple[Values, Values]:
        """Return (torque, velocity) of one trial up to its end. ValueError if not kept."""
        if self.torque_n is None or self.velocity_m_per_s is None:
            raise ValueError("only sums were kept; simulate with keep='records'")
        end = int(self.samples[trial])
        torque = self.torque_n if self.torque_n.ndim == 1 else self.torque_n[trial]
        return torque[:end], self.velocity_m_per_s[trial, :end]

    def traces(self, trial: int) -> tuple[Floats, Floats]:
        """Return (position, command) float64 of one trial at each tick up to its end. ValueError if
        they were not kept.
        """
        if self.position_m is None or self.force_n is None:
            raise ValueError("no ticks were kept; simulate with keep='ticks'")
        end = int(self.samples[trial]) * self.force_n.shape[1] // round(self.seconds * self.rate_hz)
        return np.asarray(self.position_m[trial, :end], np.float64), np.asarray(
            self.force_n[trial, :end], np.float64
        )

    def spectra(self, trial: int) -> Spectra:
        """Return the spectra of one trial, as `spa` gives them for its record. ValueError if they
        were not kept, or it diverged.
        """
        if (
            self.force_spectrum is None
            or self.velocity_spectrum is None
            or self.cross_spectrum is None
        ):
            raise ValueError("spectra were not kept; simulate with keep='spectra'")
        if self.diverged[trial]:
            raise ValueError(
                f"trial {trial} diverged after {self.diverged_at_s[trial]:.3g} s: it has no spectra"
            )
        force = np.asarray(
            self.force_spectrum if self.force_spectrum.ndim == 1 else self.force_spectrum[trial]
        )
        return Spectra(
            grid_frequencies(self.rate_hz, LAG),
            self.velocity_spectrum[trial],
            force,
            self.cross_spectrum[trial],
            self.rate_hz,
            int(self.samples[trial]),
            LAG,
        )


SHARED = ("rate_hz", "seconds")  # fields that are the same for all parts of a batch


def joined(parts: list[BatchResult]) -> BatchResult:
    """Join the parts of a batch, in order."""

    def together(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        if name in SHARED or values[0] is None or len(values) == 1:
            return values[0]
        return np.concatenate(values)

    return BatchResult(**{item.name: together(item.name) for item in fields(BatchResult)})


# a context variable: each task of a pool has its own grant, whichever thread it runs on
_granted: ContextVar[int | None] = ContextVar("granted", default=None)


def workers() -> int:
    """Return the number of cores that a batch started here may use."""
    free = len(os.sched_getaffinity(0))
    return min(free, _granted.get() or free)


@contextmanager
def at_most(cores: int) -> Iterator[None]:
    """Limit batches started inside, on this thread, to this number of cores."""
    before = _granted.set(cores)
    try:
        yield
    finally:
        _granted.reset(before)


TICKS_MAX = 1e12
SEEDS = 1 << 63
REMOTE_GROUPS = 4  # groups of lanes in a task of another executor, whose transfer costs more
# values of a scene that a model lacks: a trial of the paper (Weir, Colgate and Peshkin 2008)
OF_A_MODEL = Scene("", "", "", (), excitation=Excitation("noise"), seconds=90.0)


def simulate(
    scene: Scene | Model,
    params: npt.ArrayLike,
    seconds: float | None = None,
    seed: int | None = None,
    *,
    active_damping: float | Sequence[tuple[float, float]] | None = None,
    environment: Environment | None = None,
    filters: Filters | None = None,
    excitation: Excitation | npt.ArrayLike | None = None,
    start: tuple[float, float] | None = None,
    substeps: int = 1,
    dtype: str = "f64",
    keep: str = "summary",
    own_torque: bool = False,
    parts: tuple[LawPart, ...] = (),
    contact: ContactDamping | None = None,
    executor: Executor | None = None,
    chunk: int | None = None,
) -> BatchResult:
    """Simulate n trials of `scene`, a scene or a composed model, that differ in the rendered
    environment.

    params       (n, 3) stiffness [N/m], damping [Ns/m], mass [kg]
    seconds      length of a trial
    seed         of all random numbers
    active_damping  active damping [Ns/m], or steps (time s, level)
    environment  filters, wall and soft ends of the law; its K, B, M are not used
    filters      of velocity and acceleration in place of those; None for raw differences
    excitation   of the probe, or forces [N] at 4 kHz that repeat: (samples,), with own_torque (n,
                 samples)
    start        position [m] and velocity [m/s] of all bodies
    substeps     per 4 kHz sample; only friction, ends, cogging and limits of the amplifier need
                 them, without those there is one
    dtype        "f64" | "f32"
    keep         "summary" | "spectra" as `signal.spectra` | "records" at 4 kHz |
                 "ticks": also position and force of every tick
    own_torque   a record of its own for every trial instead of a shared one, with noise of the
                 probe by its position; otherwise by its K, B and M
    parts        of the law, such as another estimator of the velocity (`zwidth.engine.parts`)
    contact      active damping that follows the wall, in place of `active_damping`
    executor     any of concurrent.futures; None = threads here
    chunk        trials per task

    If records or ticks are kept, 16 trials are simulated at once (f32; 8 in f64), otherwise 64
    (32).

    None means the value of the scene; for a model: 90 s, seed 1, no damping, the paper's filters,
    noise of 2.5e-5 N^2/Hz up to 1.7 kHz, at rest at 0. The same call gives the same bytes for any
    executor and chunk. A trial gives the same bytes whatever is simulated with it, unless each has
    a torque of its own. ConfigError for arguments out of range, a rate that does not divide 4 kHz,
    or without numba.
    """
    trials = _checked(params)
    job = _job(
        scene,
        seconds,
        seed,
        active_damping,
        environment,
        filters,
        excitation,
        start,
        substeps=substeps,
        dtype=dtype,
        keep=keep,
        own_torque=own_torque,
        parts=parts,
        contact=contact,
        some=bool(trials.any()),
    )
    if chunk is not None and chunk < 1:
        raise ConfigError(f"{chunk} trials in a task: must be 1 or more, or None")
    made = prepared(job)  # compiles once, before any thread waits for it
    size = chunk or made.shape.lanes * (1 if executor is None else REMOTE_GROUPS)
    size = size if contact is None else 1  # a level is that of a whole group of lanes
    firsts = range(0, len(trials), size)
    groups = [trials[first : first + size] for first in firsts]
    own = range(len(trials)) if own_torque else [_number(trial) for trial in trials]
    numbered = [own[first : first + size] for first in firsts]
    if executor is not None:
        found = list(executor.map(partial(run_chunk, job), groups, numbered))
    else:
        with ThreadPoolExecutor(max_workers=min(len(groups), workers())) as threads:
            found = list(threads.map(partial(run_chunk, job), groups, numbered))
    result = joined(found)
    if keep == "spectra" and result.force_spectrum is None:
        return replace(result, force_spectrum=force_spectrum(job, made))
    if keep in ("summary", "spectra") or result.torque_n is not None:
        return result
    return replace(result, torque_n=played(shared_torque(job), job.samples, made.scalar))


def _job(
    scene: Scene | Model,
    seconds: float | None,
    seed: int | None,
    active_damping: float | Sequence[tuple[float, float]] | None,
    environment: Environment | None,
    filters: Filters | None,
    excitation: Excitation | npt.ArrayLike | None,
    start: tuple[float, float] | None,
    *,
    keep: str,
    some: bool,
    **rest: Any,
) -> Job:
    """Return the shared part of all trials; `some` of them have K, B or M."""
    given = scene if isinstance(scene, Scene) else OF_A_MODEL
    model = compose(scene) if isinstance(scene, Scene) else scene
    length_s = given.seconds if seconds is None else seconds
    if not 0.5 <= length_s * model.rate_hz <= TICKS_MAX:
        raise ConfigError(
            f"a trial of {length_s:g} s: must be one tick of {1.0 / model.rate_hz:g} s or more,"
            f" {TICKS_MAX:g} at most"
        )
    if keep == "spectra" and length_s * PROBE_RATE_HZ < LAG + 1:
        raise ConfigError(
            f"spectra of {length_s:g} s: more than the window of {LAG} samples,"
            f" {LAG / PROBE_RATE_HZ:g} s, are needed"
        )
    number = given.excitation.seed if seed is None else seed
    if not 0 <= number < SEEDS:
        raise ConfigError(f"seed {number}: must lie in 0..{SEEDS - 1}")
    probe = given.excitation if excitation is None else excitation
    rendered = environment or given.environment
    position_m, velocity_m_per_s = start or (given.start_position_m, given.start_velocity_m_per_s)
    return Job(
        model=model,
        environment=rendered,
        filters=filters or (rendered.velocity_filter, rendered.acceleration_filter),
        active_damping=given.active_damping if active_damping is None else _steps(active_damping),
        excitation=probe if isinstance(probe, Excitation) else np.asarray(probe, dtype=np.float64),
        ticks=round(length_s * model.rate_hz),
        seed=number,
        keep=keep,
        # walls and ends also need the law
        renders=bool(
            some or keep == "ticks" or rendered.wall.side or rendered.workspace.stiffness_n_per_m
        ),
        start_position_m=position_m,
        start_velocity_m_per_s=velocity_m_per_s,
        **rest,
    )


def _steps(damping: float | Sequence[tuple[float, float]]) -> tuple[DampingStep, ...]:
    steps = [(0.0, damping)] if isinstance(damping, int | float) else [(0.0, 0.0), *damping]
    if not np.isfinite(steps).all():
        raise ConfigError(f"damping steps {steps}: finite times [s] and levels [N s/m] are needed")
    return tuple(
        DampingStep(at_s, level) for at_s, level in sorted(steps, key=lambda step: step[0])
    )


def _checked(params: npt.ArrayLike) -> Floats:
    trials = np.ascontiguousarray(params, dtype=np.float64)
    if trials.ndim != 2 or trials.shape[1] != 3 or not len(trials):
        raise ConfigError(
            f"params of shape {trials.shape}: must be (n, 3), stiffness N/m, damping Ns/m and mass"
            " kg of n >= 1 trials"
        )
    if not np.isfinite(trials).all():
        raise ConfigError("params contain a value that is not finite")
    return trials


def _number(trial: Floats) -> int:
    """Return the 32-bit number that seeds the random numbers of a trial with this K, B, M (3,)."""
    same_zero = trial + 0.0  # -0 N/m is 0 N/m
    return int.from_bytes(blake2b(same_zero.tobytes(), digest_size=4).digest(), "little")


def run_chunk(job: Job, params: Floats, numbers: Sequence[int]) -> BatchResult:
    """Run trials of these K, B, M (n, 3), each with the number that seeds its own noise."""
    made = prepared(job)
    lanes = made.shape.lanes
    return joined(
        [
            _run_group(job, made, params[start : start + lanes], numbers[start : start + lanes])
            for start in range(0, len(params), lanes)
        ]
    )


def _run_group(job: Job, made: Prepared, params: Floats, numbers: Sequence[int]) -> BatchResult:
    group = Group(job, made, params)
    inputs = Inputs(job, made, numbers)
    records = (spectral if job.keep == "spectra" else Records)(job, made, numbers)
    heating = None if made.model.winding is None else Heating(group, made.model.winding.heating)
    follower = None if job.contact is None else AtContact(group, job, job.contact)
    level_ns_per_m = None
    for start, end in inputs.legs():
        if follower is None and (wanted := level_at(job, start)) != level_ns_per_m:
            level_ns_per_m = wanted
            (heating or group).damp(level_ns_per_m)
        group.play(
            inputs.torque(start, end),
            inputs.noise(start, end),
            records.block(start),
            end - start,
            records.kept,
        )
        records.store(start, end, group.rows["ALIVE"])
        if follower is not None:
            follower.follow()
        if heating is not None:
            heating.warm((end - start) / job.model.rate_hz, (end - start) * made.shape.samples)
        if not group.rows["ALIVE"][: group.count].any():
            break
    return _result(job, params, group, heating, records, inputs)


def _result(
    job: Job,
    params: Floats,
    group: Group,
    heating: Heating | None,
    records: Records | Sums,
    inputs: Inputs,
) -> BatchResult:
    n = group.count
    sums = {name: values[:n] for name, values in group.tallied().items()}
    shape = group.made.shape
    samples = (sums["TICKS"] * shape.samples).astype(np.int64)
    counted = np.maximum(samples, 1)
    return BatchResult(
        params=params,
        sigma_v_m_per_s=np.sqrt(sums["SPEED2"] / counted),
        max_force_n=group.rows["FORCE"][:n].astype(np.float64),
        work_j=sums["WORK"] / PROBE_RATE_HZ,
        min_energy_j=sums["LOWEST"] / PROBE_RATE_HZ,
        samples=samples,
        rate_hz=float(PROBE_RATE_HZ),
        seconds=job.ticks / job.model.rate_hz,
        limited=None if shape.drive is None else sums["LIMITED"] * shape.samples / counted,
        winding_c=None if heating is None else heating.temperature_c[:n],
        **records.finished(samples, inputs),
    )
