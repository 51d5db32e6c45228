"""Perturbation records: level, band and independence of the noise, the multisine, the push."""

import numpy as np
import pytest
from scipy import signal, stats

from hapticd.model.excitation import Stream, torque_record
from hapticd.model.scene import Excitation
from hapticd.zwidth.engine.job import held_noise

NOISE = Excitation("noise", psd_n2_per_hz=2.5e-5, band_hz=1700.0)


def test_noise_has_the_stated_density_and_band():
    record = torque_record(NOISE, 360_000, 1)
    frequency, density = signal.welch(record, 4000, nperseg=4000, scaling="density")
    inside = (frequency > 1.0) & (frequency < 1690.0)
    outside = frequency > 1915.0
    assert density[inside].mean() == pytest.approx(2.5e-5, rel=0.01)
    assert density[inside].std() < 0.2 * 2.5e-5  # 180 averages, overlapped
    assert density[outside].max() < 1e-4 * 2.5e-5
    assert record.std() == pytest.approx(np.sqrt(2.5e-5 * (1700.0 + 0.375 * 204.0)), rel=0.01)
    assert abs(record.mean()) < 1e-15


def test_noise_is_gaussian():
    record = torque_record(NOISE, 360_000, 1)
    assert abs(stats.skew(record)) < 0.02
    assert abs(stats.kurtosis(record)) < 0.03


def test_streams_and_seeds_are_independent():
    records = [
        torque_record(NOISE, 40_000, seed, stream)
        for seed, stream in ((1, 0), (1, Stream.TORQUE), (1, Stream.TORQUE + 1), (2, 0))
    ]
    related = np.corrcoef(records) - np.eye(4)
    assert abs(related).max() < 0.025
    assert torque_record(NOISE, 40_000, 1).tobytes() == records[0].tobytes()


def test_multisine_is_flat_and_has_its_rms():
    record = torque_record(
        Excitation("multisine", force_n=0.2, band_hz=1700.0, period_s=1.024), 0, 3
    )
    spectrum = abs(np.fft.rfft(record))
    assert len(record) == 4096
    assert record.std() == pytest.approx(0.2, rel=1e-12)
    assert np.allclose(spectrum[1:1741], spectrum[1], rtol=1e-9)
    assert spectrum[1741:].max() < 1e-9 * spectrum[1]


def test_push_begins_at_its_time():
    record = torque_record(Excitation("push", force_n=0.5, start_s=0.01), 100, 1)
    assert not record[:40].any()
    assert set(record[40:]) == {0.5}
    assert not torque_record(Excitation("none"), 100, 1).any()


def test_held_noise_has_the_variance_of_its_density():
    assert held_noise(400_000, 1e-6, 1, Stream.ESTIMATE).var() == pytest.approx(
        1e-6 * 4000 / 2, rel=0.01
    )
