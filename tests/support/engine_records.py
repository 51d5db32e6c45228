"""Spectra kept in place of records equal those that `spa` computes from the records, for any
distribution of the batch.
"""

import numpy as np

from hapticd.signal.spectra import spa
from hapticd.zwidth.engine.batch import simulate
from support.devices import COUNTS, DRY, LIMIT, STAR, device

WEIR = device(*STAR, DRY, COUNTS, LIMIT)
RNG = np.random.default_rng(1)
PARAMS = np.column_stack(
    [RNG.uniform(0, 100, 70), RNG.uniform(0, 2, 70), RNG.uniform(-0.002, 0.01, 70)]
)
KEPT = ("force_spectrum", "velocity_spectrum", "cross_spectrum", "section_rms_m_per_s")


def both(model, *arguments, **options):
    return (simulate(model, *arguments, **options, keep=keep) for keep in ("spectra", "records"))


def assert_alike(spectra, records, trials, tolerance):
    for trial in trials:
        found = spectra.spectra(trial)
        exact = spa(*records.record(trial))
        for name in ("force", "velocity", "cross"):
            one = getattr(found, name)
            other = getattr(exact, name)
            assert np.abs(one - other).max() < tolerance * np.abs(other).max(), name
        assert (found.n_samples, found.lag, found.rate_hz) == (
            exact.n_samples,
            exact.lag,
            exact.rate_hz,
        )
