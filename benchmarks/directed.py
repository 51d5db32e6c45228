"""Trials that the directed search needs for 2 % of the passive set's volume, on an affine and on a bent device without noise.

The device: 8 g, 2 N s/m, 1 kHz, force held, one tick late, Butterworth filters of 100 and 72 Hz; the bent one has a damping
that the environment changes by up to 0.55 N s/m. A grid of yes and no needs 290,000 and 180,000 trials.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.figures import Figure, compared, refused
from hapticd.analysis.loop import derivatives, held
from hapticd.analysis.search import Search, first_trials, next_trials, predicted_passive
from hapticd.analysis.surrogate import Box, Observation

TARGETS = {"search_nonaffine": "<= 60", "search_affine": "<= 10"}
BEND = {"search_nonaffine": 1.0, "search_affine": 0.0}
BOX, INSIDE = Box((0.0, -2.2, -0.009), (1450.0, 3.6, 0.015)), (300.0, 0.3, 0.001)
RATE_HZ, DELAY, DAMPING, ENOUGH, BUDGET, SAMPLES = 1000.0, 1.0, 2.0, 0.02, 70, 40_000
F = np.geomspace(1.0, 499.0, 400)


def measure() -> Iterator[Figure]:
    """Trials until the volume that is held wrongly is 2 % of the true one."""
    for name, target in TARGETS.items():
        needed = _trials(BEND[name])
        if needed is None:
            yield refused(name, target, f"not within 2 % after {BUDGET} trials")
        else:
            yield compared(name, target, float(needed), "trials")


def _trials(bend: float) -> int | None:
    search, samples = Search(BOX), BOX.to_environment(np.random.default_rng(7).random((SAMPLES, 3)))
    truth = np.concatenate([_resistance(part, bend).min(axis=1) >= 0.0 for part in np.array_split(samples, 20)])
    while len(search.trials) < BUDGET:
        started = search.surrogate is not None
        environment = next_trials(search)[0] if started else first_trials(BOX, INSIDE)[len(search.trials)]
        seen = _resistance(environment[None], bend)[0]
        search = search.with_trial(environment, Observation(environment, seen, np.zeros(F.size)))
        if search.surrogate and np.mean(predicted_passive(search, samples) != truth) <= ENOUGH * truth.mean():
            return len(search.trials)
    return None


def _resistance(environments: np.ndarray, bend: float) -> np.ndarray:
    turn = np.exp(2j * np.pi * F / RATE_HZ)
    law = np.stack((np.ones(F.size), *derivatives(turn, RATE_HZ)))
    felt = (law * held(F, RATE_HZ, DELAY) / (2j * np.pi * F)).real
    k, b, m = environments.T
    bent = 0.35 * np.sin(k / 250.0) + 0.2 * np.tanh(b) * np.cos(400.0 * m)
    return DAMPING + bend * bent[:, None] + environments @ felt
