"""Many simulated trials at once, each reduced to an outcome: the verdict, its margins, and Z at
about 120 frequencies.

Trials are simulated and transformed together (`keep="spectra"`). Records are made only for trials
whose verdict needs them. Sums replace the parts that `examine` takes from a record: energy from the
work of each tick, an escape from the rms velocity of every second.

The engine computes in float32. Margins agree with float64 to 1.3e-6 of |Z| (median 4e-7) without
rounding of signals. With counted positions and commands, or stiction, they agree to 2e-5 in the
median and 3e-4 at most, because states that differ by 1e-10 m fall on other counts and the motions
diverge. Judging float32 states in float64 changes nothing; `dtype="f64"` does.

A task is sent as parameters and returns 5 kB per trial, so it may run in a thread or in another
process. The same task gives the same outcome anywhere. `passes` is the paper's rule: all phases of
the whole band within +-90 degrees, the loop stable, the command below its limit. `answer` is the
verdict with its intervals. A trial that diverged has no spectra.

A procedure is a generator that yields batches (trials under one set of conditions), is sent their
outcomes, yields more, and returns its result. `run_all` runs any number of procedures together. A
trial's key is the hash of its dependencies, so a trial in the store is never simulated again,
whichever procedure requests it. Each task is stored when it finishes; tasks that have not started
are cancelled when the caller stops.

Random numbers must depend on the parts of a trial's key, not on its position in its task. A map
that is continued, or cut into other tasks, would otherwise change.
"""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from itertools import pairwise
from math import inf, isnan, nan
from typing import Any, TypeVar

import numpy as np

from hapticd import __version__
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.units import DEFAULT_BAND_HZ
from hapticd.model.predict import coulomb
from hapticd.model.scene import Excitation, Scene
from hapticd.signal.assess import Assessment, Criteria, LoopModel, MeasuredTrial, assess
from hapticd.signal.findings import Energy, Record, escape_findings
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import DEFAULT_LAG, Spectra
from hapticd.signal.verdict import NEAR_HZ, Judged
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.engine.shape import LANES
from hapticd.zwidth.executors import pool_of
from hapticd.zwidth.passive_set import Envelope
from hapticd.zwidth.sources import NOISE, SATURATED, Display, display, frequencies
from hapticd.zwidth.store import TrialStore, fingerprint
from hapticd.zwidth.watch import SATURATED_SHARE

__all__ = [
    "Conditions",
    "Outcome",
    "Point",
    "TrialBatch",
    "judged",
    "kept_frequencies",
    "outcomes_of",
    "points_of",
    "run_trials",
]

TOGETHER = LANES["f32"]  # trials that the engine runs at once
GROUPS = 4  # groups per task: trials that need their records are simulated together
TASKS = 8  # of a batch, before its tasks grow
FREQUENCIES = 120
KEPT_BAND_HZ = (2.0, 1000.0)
FORMAT = 2  # of an outcome; part of its key

Point = tuple[float, float, float]  # K [N/m], B [N s/m], M [kg]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Conditions:
    """The common conditions of many trials: all but K, B, M and the active damping."""

    scene: Scene
    seconds: float = 90.0  # of one trial; section 2.2 of the paper
    excitation: Excitation = NOISE
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ
    confidence: float = 0.95
    substeps: int = 4  # per 4 kHz sample
    dtype: str = "f32"  # of the engine: f32 or f64
    below_window: bool = False  # the band may begin below 1/(M T), with smoothed values

    @property
    def display(self) -> Display:
        """The device, prepared, with its predictions under these conditions."""
        return display(self.scene, self.excitation)

    @property
    def criteria(self) -> Criteria:
        """The criteria of its verdicts."""
        return Criteria(self.band_hz, self.confidence, below_window=self.below_window)

    def perturbed(self, amplitude: float = 1.0, more_seed: int = 0) -> "Conditions":
        """Return the conditions with the force multiplied by `amplitude`, and other noise."""
        source = self.excitation
        changed = replace(
            source, psd_n2_per_hz=source.psd_n2_per_hz * amplitude**2, seed=source.seed + more_seed
        )
        return replace(self, excitation=changed)


@dataclass(frozen=True, eq=False)
class Outcome:
    """One trial; `z` (F, 2) real and imaginary part [N s/m] and `relative_sd` (F,) at
    `frequency_hz`, empty if it diverged; nan and inf at an edge that was not judged.
    `first_judged_hz`, `last_judged_hz`: nan if it diverged.
    """

    environment: Point
    active_damping_ns_per_m: float  # active damping
    answer: str  # passive, not_passive or undecided
    passes: bool  # by the paper's rule
    margin_ns_per_m: float  # minimum of Re Z
    margin_lower: float  # N s/m
    margin_upper: float  # N s/m
    margin_deg: float  # minimum of 90 degrees - |phase|
    worst_hz: float  # of the minimum Re Z
    velocity_sd: float  # m/s
    max_force_n: float  # largest command
    z: Floats
    relative_sd: Floats
    first_judged_hz: float = nan
    last_judged_hz: float = nan
    band_hz: tuple[float, float] | None = None  # requested

    @property
    def frequency_hz(self) -> Floats:
        """The frequencies (F,) of `z` [Hz]."""
        return kept_frequencies(self.band_hz)


OnOutcomes = Callable[[list[Outcome]], None]
Procedure = Generator[Sequence["TrialBatch"], list[Outcome], T]
OnBatch = Callable[[int, "TrialBatch", list[Outcome]], None]


@lru_cache
def kept_frequencies(band_hz: tuple[float, float] | None = None) -> Floats:
    """Return frequencies (F,) at which Z of a trial is stored: lines of the window evenly in ln f,
    and the edges of the judged band.
    """
    return np.union1d(frequencies(KEPT_BAND_HZ, FREQUENCIES), band_hz or ())


def run_trials(
    conditions: Conditions, active_damping_ns_per_m: float, points: Floats
) -> list[Outcome]:
    """Simulate and judge trials of `points` (n, 3): K [N/m], B [N s/m], M [kg]. Those whose verdict
    needs the record are simulated again, with the same noise, and judged on it.

    ConfigError as `simulate`, AnalysisError as `judge`.
    """
    found = _simulated(conditions, active_damping_ns_per_m, points, "spectra")
    linear = not coulomb(conditions.display.model).any()
    model = LoopModel(linear=linear, servo_rate_hz=conditions.scene.rate_hz)
    assessed = {
        trial: assess(_measured(found, trial), conditions.criteria, model)
        for trial in np.flatnonzero(~found.diverged).tolist()
    }
    unsure = [trial for trial, one in assessed.items() if one.needs_record]
    for first in range(0, len(unsure), TOGETHER):
        some = unsure[first : first + TOGETHER]
        again = np.asarray(found.params[some], np.float64)
        records = _simulated(conditions, active_damping_ns_per_m, again, "records")
        shared = _shared_transform(records)
        for place, trial in enumerate(some):
            assessed[trial] = assessed[trial].with_samples(*records.record(place), shared)
    limit_n = conditions.display.force_limit_n
    return [
        _outcome(conditions, active_damping_ns_per_m, limit_n, found, trial, assessed.get(trial))
        for trial in range(len(points))
    ]


def _simulated(
    conditions: Conditions,
    active_damping_ns_per_m: float,
    points: Floats,
    keep: str,
) -> BatchResult:
    return simulate(
        conditions.scene,
        points,
        conditions.seconds,
        conditions.excitation.seed,
        active_damping=active_damping_ns_per_m,
        environment=conditions.scene.free_of_walls,
        excitation=conditions.excitation,
        start=(0.0, 0.0),
        substeps=conditions.substeps,
        dtype=conditions.dtype,
        keep=keep,
    )


def _shared_transform(records: BatchResult) -> Complexes | None:
    """Return the transform of the force (N/2 + 1,), if all trials share it."""
    force = records.torque_n
    return None if force is None or force.ndim > 1 else np.fft.rfft(np.asarray(force, np.float64))


def _outcome(
    conditions: Conditions,
    damping: float,
    limit_n: float,
    found: BatchResult,
    trial: int,
    assessed: Assessment | None,
) -> Outcome:
    k, b, m = (float(value) for value in found.params[trial])
    most = float(found.max_force_n[trial])
    sd = float(found.sigma_v_m_per_s[trial])
    if assessed is None:
        nothing = np.empty(0)
        ran_away = ("not_passive", False, *(nan,) * 5, sd, most, nothing, nothing)
        return Outcome((k, b, m), damping, *ran_away, band_hz=conditions.band_hz)
    verdict = assessed.verdict
    limited = found.limited is not None and found.limited[trial] > SATURATED_SHARE
    # a K < 0 is active below every band
    doubtful = most >= SATURATED * limit_n or limited or k < 0.0
    z = _kept_impedance(assessed.spectra, conditions.band_hz)
    return Outcome(
        environment=(k, b, m),
        active_damping_ns_per_m=damping,
        answer="undecided" if doubtful and verdict.answer == "passive" else verdict.answer,
        passes=verdict.passes and not doubtful,
        margin_ns_per_m=verdict.margin_ns_per_m.value,
        margin_lower=verdict.margin_ns_per_m.lower,
        margin_upper=verdict.margin_ns_per_m.upper,
        margin_deg=verdict.margin_deg.value,
        worst_hz=verdict.margin_ns_per_m.frequency_hz,
        velocity_sd=sd,
        max_force_n=most,
        z=z[:, :2],
        relative_sd=z[:, 2],
        first_judged_hz=verdict.first_judged_hz,
        last_judged_hz=verdict.last_judged_hz,
        band_hz=conditions.band_hz,
    )


def _kept_impedance(spectra: Spectra, band_hz: tuple[float, float]) -> Floats:
    """Return (F, 3) real and imaginary part of Z and its relative deviation at `kept_frequencies`;
    nan and inf at a missing edge.
    """
    f = kept_frequencies(band_hz)
    found = np.tile((nan, nan, inf), (f.size, 1))
    at = np.minimum(np.searchsorted(spectra.frequency_hz, f), spectra.frequency_hz.size - 1)
    known = spectra.frequency_hz[at] == f
    found[known] = _rows(spectra.part(at[known]))
    ends = spectra.band(band_hz).part(np.array([0, -1]))
    for edge, hz, row in zip(band_hz, ends.frequency_hz, _rows(ends), strict=True):
        if abs(hz - edge) < NEAR_HZ:
            found[f == edge] = row
    return found


def _rows(spectra: Spectra) -> Floats:
    z = impedance(spectra)
    return np.column_stack((z.impedance_ns_per_m.real, z.impedance_ns_per_m.imag, z.relative_sd))


def _measured(found: BatchResult, trial: int) -> MeasuredTrial:
    """Return the spectra of a trial, with the summary of its samples from sums."""
    assert found.section_rms_m_per_s is not None
    rms = found.section_rms_m_per_s[trial]
    pairs = np.sqrt(np.mean(rms[: rms.size // 2 * 2].reshape(-1, 2) ** 2, axis=1))
    spectra = found.spectra(trial)
    record = Record(
        spectra.n_samples / spectra.rate_hz,
        Energy(float(found.min_energy_j[trial]), nan, float(found.work_j[trial])),
        float(found.sigma_v_m_per_s[trial]),
        escape_findings(pairs, 2 * DEFAULT_LAG / found.rate_hz),
    )
    return MeasuredTrial(spectra, record=record)


def restored(line: Mapping[str, Any]) -> Outcome:
    """Return an outcome from a store; null becomes nan."""
    values: dict[str, Any] = {name: nan if value is None else value for name, value in line.items()}
    values["environment"] = tuple(values["environment"])
    values["z"] = np.asarray(values["z"], np.float64).reshape(-1, 2)
    values["relative_sd"] = np.array(
        [inf if value is None else value for value in values["relative_sd"]], np.float64
    )
    values["band_hz"] = tuple(line["band_hz"]) if line.get("band_hz") else None
    return Outcome(**values)


def judged(outcomes: Iterable[Outcome]) -> Judged:
    """Return the range of frequencies judged in every trial that did not run away."""
    ends = [
        (one.first_judged_hz, one.last_judged_hz)
        for one in outcomes
        if not isnan(one.first_judged_hz)
    ]
    if not ends:
        return Judged()
    return Judged(max(first for first, _ in ends), min(last for _, last in ends))


def envelope_of(outcomes: list[Outcome]) -> Envelope:
    """Return the envelope over the trials that pass, each point with its owner. AnalysisError if
    none passes.
    """
    each = [_envelope(outcome) for outcome in outcomes if outcome.passes]
    if not each:
        raise AnalysisError(
            "no trial passed: there is no envelope; begin with K = B = M = 0 and a longer trial"
        )
    return reduce(Envelope.merged, each)


def _envelope(outcome: Outcome) -> Envelope:
    k, b, m = outcome.environment
    return Envelope.of_one(
        f"K {k:.4g} N/m, B {b:.3g} N s/m, M {1e3 * m:.3g} g",
        outcome.frequency_hz,
        outcome.z[:, 0] + 1j * outcome.z[:, 1],
        outcome.relative_sd,
        "probe",
        "spa",
    )


@dataclass(frozen=True, eq=False)
class TrialBatch:
    """Trials under one set of conditions."""

    conditions: Conditions
    active_damping_ns_per_m: float
    points: tuple[Point, ...]

    @cached_property
    def keys(self) -> dict[Point, str]:
        """The key of each point in a store."""
        shared = FORMAT, __version__, fingerprint(self.conditions), self.active_damping_ns_per_m
        return {point: fingerprint((*shared, point))[:32] for point in self.points}

    def known(self, store: TrialStore) -> list[Outcome]:
        """Return its outcomes in the store."""
        return [restored(store.known[key]) for key in self.keys.values() if key in store.known]

    def tasks(self, store: TrialStore) -> list[Floats]:
        """Return the points (n, 3) missing from the store, in groups of the engine's batch size, or
        of several times that size if there are many tasks. The last tasks are small, so that no
        core waits long for another.
        """
        missing = [point for point, key in self.keys.items() if key not in store.known]
        size = TOGETHER * min(max(1, len(missing) // (TASKS * TOGETHER)), GROUPS)
        long = max(0, len(missing) - TASKS * TOGETHER) // size * size
        firsts = [*range(0, long, size), *range(long, len(missing), TOGETHER)]
        return [np.array(missing[here:there]) for here, there in pairwise([*firsts, len(missing)])]


def points_of(rows: Floats) -> tuple[Point, ...]:
    """Return environments (N, 3) as keys."""
    return tuple((float(k), float(b), float(m)) for k, b, m in rows)


def run_all(
    procedures: Sequence[Procedure[T]], store: TrialStore, executor: Executor | None,
    on_batch: OnBatch = lambda place, batch, new: None,
) -> list[T]:  # fmt: skip
    """Return the results of the procedures, whose trials run on `executor` or on threads of this
    process. `on_batch` receives the index of a procedure, its batch, and the new outcomes of each
    task.

    Each procedure waits for one request at a time; the others keep the cores busy. If `on_batch`
    raises, the remaining tasks are cancelled.
    """
    asked: dict[int, Sequence[TrialBatch]] = {}
    results: dict[int, T] = {}
    waiting: dict[Future[list[Outcome]], tuple[int, TrialBatch]] = {}

    def goes_on(place: int) -> None:
        """Run a procedure until it ends, or waits for missing trials."""
        while not any(owner == place for owner, _ in waiting.values()):
            found: Any = (
                [outcome for batch in asked[place] for outcome in batch.known(store)]
                if place in asked
                else None
            )
            try:
                asked[place] = procedures[place].send(found)
            except StopIteration as end:
                results[place] = end.value
                return
            for batch in asked[place]:
                shared = (batch.conditions, batch.active_damping_ns_per_m)
                waiting.update(
                    (pool.submit(run_trials, *shared, task), (place, batch))
                    for task in batch.tasks(store)
                )

    with pool_of(executor) as pool:
        try:
            for place in range(len(procedures)):
                goes_on(place)
            while waiting:
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    outcomes = future.result()
                    place, batch = waiting.pop(future)
                    store.add((batch.keys[one.environment], vars(one)) for one in outcomes)
                    on_batch(place, batch, outcomes)
                    goes_on(place)
        finally:
            for future in waiting:
                future.cancel()
    return [results[place] for place in range(len(procedures))]


def outcomes_of(batch: TrialBatch, store: TrialStore) -> list[Outcome]:
    """Return the outcomes of one batch; missing trials run on threads of this process."""

    def asking() -> Procedure[list[Outcome]]:
        return (yield [batch])

    return run_all([asking()], store, None)[0]
