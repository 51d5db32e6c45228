"""Spectra against direct sums, against octave, and against the statistics that they promise."""

import pytest
from support.octave.run import record, spa_by_octave
from support.programs import octave_with_signal
from test_analysis_spectra import RATE_HZ, compare_with_octave


@pytest.mark.parametrize(("n_samples", "lag"), [(5000, 100), (20_000, 1024)])
def test_octave_agrees_live(n_samples, lag):
    octave_with_signal()
    force, velocity = record(n_samples, n_samples)
    columns = spa_by_octave(force, velocity, lag, RATE_HZ)
    compare_with_octave(force, velocity, lag, RATE_HZ, columns)
