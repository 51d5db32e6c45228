"""Spectra against direct sums, against octave, and against the statistics that they promise."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.octave.run import record, spa_by_octave
from support.programs import octave_with_signal
from test_analysis_spectra import RATE_HZ, compare_with_octave, worst

from hapticd.signal.spectra import SpectralStream
from hapticd.signal.spectra import spa as estimate


@pytest.mark.parametrize(("n_samples", "lag"), [(5000, 100), (20_000, 1024)])
def test_octave_agrees_live(n_samples, lag):
    octave_with_signal()
    force, velocity = record(n_samples, n_samples)
    columns = spa_by_octave(force, velocity, lag, RATE_HZ)
    compare_with_octave(force, velocity, lag, RATE_HZ, columns)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(0, 700), min_size=1, max_size=30), st.integers(2, 90))
def test_stream_equals_the_whole_record(blocks, lag):
    n_samples = sum(blocks) + lag + 1
    force, velocity = record(n_samples, lag)
    stream = SpectralStream(RATE_HZ, lag)
    start = 0
    for size in (*blocks, lag + 1):
        stream.add(force[start : start + size], velocity[start : start + size])
        start += size
    found = stream.spectra()
    expected = estimate(force, velocity, RATE_HZ, lag)
    for name in ("velocity", "force", "cross"):
        assert worst(getattr(found, name), getattr(expected, name)) < 1e-10
