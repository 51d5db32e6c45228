"""Trials of the directed search: flown or found in the store, and what each teaches.

Each trial has noise of its own (seed, seed + 1, ..), as in a laboratory: with one noise for all, what is chance would be learnt
as if it were the device. The same search therefore makes the same trials, and goes on where it was interrupted.
"""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.surrogate import Observation
from hapticd.measure.outcomes import Conditions, Hear, Outcome, fly, kept, kept_frequencies, key_of, restored
from hapticd.measure.scenes import SATURATED
from hapticd.measure.store import TrialStore, fingerprint
from hapticd.plant.compose import compose

POOR = 0.2  # relative standard deviation, the median over the band, of a spectrum that teaches nothing
DIGITS = 6  # of an environment: what is asked is what is stored


def learnt_at(conditions: Conditions) -> Floats:
    """Frequencies (F,) of what a trial teaches."""
    f = kept_frequencies()
    return f[(f >= conditions.band_hz[0]) & (f <= conditions.band_hz[1])]


def rounded(wanted: Floats) -> Floats:
    """Environments (n, 3) as they can be written down."""
    return np.array([[float(f"{value:.{DIGITS}g}") for value in point] for point in wanted])


def make(
    conditions: Conditions, damping_ns_per_m: float, wanted: Floats, done: int, store: TrialStore, pool: Executor, hear: Hear
) -> list[Outcome]:
    """Outcomes of `wanted` (n, 3) after `done` trials, from the store or by trials on `pool`; `hear` gets the new ones."""
    source = conditions.excitation
    each = [replace(conditions, excitation=replace(source, seed=source.seed + done + place)) for place in range(len(wanted))]
    points = [(float(k), float(b), float(m)) for k, b, m in wanted]
    keys = [key_of(fingerprint(one), damping_ns_per_m, point) for one, point in zip(each, points, strict=True)]
    missing = [place for place, key in enumerate(keys) if key not in store.known]
    tasks = [pool.submit(fly, each[place], damping_ns_per_m, wanted[place : place + 1]) for place in missing]
    new = [task.result()[0] for task in tasks]
    store.add((keys[place], kept(outcome)) for place, outcome in zip(missing, new, strict=True))
    if new:
        hear(new)
    return [restored(store.known[key]) for key in keys]


def observed(conditions: Conditions, outcome: Outcome) -> Observation | None:
    """What a trial teaches; None where the loop was not stable, or moved by something else than the perturbation."""
    limit_n = compose(conditions.scene).force_limit_n or np.inf
    escaped = outcome.max_force_n >= SATURATED * limit_n or (not outcome.passes and outcome.margin_ns_per_m > 0.0)
    if not outcome.z.size or escaped:
        return None
    inside = np.isin(kept_frequencies(), learnt_at(conditions))
    relative = outcome.relative_sd[inside]
    if not np.median(relative) < POOR:
        return None
    sd = np.hypot(*outcome.z[inside].T) * np.minimum(relative, 10.0)
    return Observation(np.asarray(outcome.environment), outcome.z[inside, 0], sd)
