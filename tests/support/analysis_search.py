"""The directed search on oracles with a known boundary: the number of trials, with and without
noise and a prior.
"""

import numpy as np
from scipy import signal

from hapticd.zwidth.acquisition import doubtful_share, first_trials, next_trials, predicted_passive
from hapticd.zwidth.surrogate import Box, Observation

T = 1e-3
MASS = 0.008
DAMPING = 2.0
W = 2.0 * np.pi * np.geomspace(1.0, 499.0, 300)
BOX = Box((0.0, -2.2, -0.009), (1450.0, 3.6, 0.015))
INSIDE = (300.0, 0.3, 0.001)


def directed_search(oracle, begin, inside, budget, doubt=0.0):
    """Query `oracle`, one environment at a time, at most `budget` times, or until `doubtful_share`
    is below `doubt`.
    """
    first = first_trials(begin.box, inside)
    search = begin.with_trials(first, [oracle(environment) for environment in first])
    while len(search.trials) + len(search.unstable) < budget and doubtful_share(search) >= doubt:
        wanted = next_trials(search)
        search = search.with_trials(wanted, [oracle(wanted[0])])
    return search


def basis():
    """dZ/d(K, B, M) of a rigid device at 1 kHz, held force, one tick late, Butterworth filters
    of 100 and 72 Hz.
    """
    back = np.exp(-1j * W * T)
    slope = (1.0 - back) / T
    low = [
        np.polyval(b[::-1], back) / np.polyval(a[::-1], back)
        for b, a in (signal.butter(2, corner, fs=1000.0) for corner in (100.0, 72.0))
    ]
    hold = back * (1.0 - back) / (1j * W * T) / (1j * W)
    return np.stack([hold, hold * slope * low[0], hold * slope**2 * low[1]])


BASIS = basis()


def bent(points):
    """Return the non-affine term of the second oracle: up to 0.55 of the 2 N s/m."""
    k, b, m = np.atleast_2d(points).T
    return 0.35 * np.sin(k / 250.0) + 0.2 * np.tanh(b) * np.cos(400.0 * m)


class Oracle:
    """Re Z of the device; `bend` 0 is affine, 1 is not; `noise` relative to |Z|."""

    def __init__(self, bend=0.0, noise=0.0, seed=1):
        self.bend = bend
        self.noise = noise
        self.asked = 0
        self.random = np.random.default_rng(seed)

    def exact(self, points):
        return DAMPING + self.bend * bent(points)[:, None] + np.atleast_2d(points) @ BASIS.real

    def passive(self, points):
        return np.concatenate(
            [self.exact(part).min(axis=1) >= 0.0 for part in np.array_split(points, 20)]
        )

    def __call__(self, environment):
        self.asked += 1
        sd = self.noise * np.abs(DAMPING + 1j * W * MASS + environment @ BASIS)
        return Observation(
            environment, self.exact(environment)[0] + sd * self.random.standard_normal(W.size), sd
        )


SAMPLES = BOX.to_environment(np.random.default_rng(7).random((30_000, 3)))


def error(search, oracle):
    """Volume of the symmetric difference over the volume of the passive set."""
    truth = oracle.passive(SAMPLES)
    return np.mean(predicted_passive(search, SAMPLES) != truth) / truth.mean()
