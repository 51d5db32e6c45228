"""Spectra against direct sums, against octave, and against the statistics that they promise."""

import dataclasses
import json
import re

import numpy as np
import pytest
from support.octave.run import GOLDEN, record, spa_by_octave

from hapticd.core.errors import AnalysisError
from hapticd.signal import covariances
from hapticd.signal import covariances as kernel_module
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import SpectralStream, corrected
from hapticd.signal.spectra import spa as estimate

RATE_HZ = 4000.0


def direct(force, velocity, lag, frequency_hz, detrend=True):
    """Phi_u, Phi_y, Phi_yu by the sums of the definition."""
    n = force.size
    place = np.arange(force.size)
    if detrend:
        force, velocity = (
            x - np.polyval(np.polyfit(place, x, 1), place) for x in (force, velocity)
        )

    def covariance(late, early, t):
        return late[t:] @ early[: n - t] / n if t >= 0 else covariance(early, late, -t)

    t = np.arange(-lag, lag + 1)
    turn = np.exp(-2j * np.pi * np.outer(frequency_hz, t) / RATE_HZ) * (
        0.5 * (1.0 + np.cos(np.pi * t / lag))
    )
    pairs = ((velocity, velocity), (force, force), (force, velocity))
    return [turn @ np.array([covariance(late, early, step) for step in t]) for late, early in pairs]


def worst(found, expected):
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


@pytest.mark.parametrize(
    ("n_samples", "lag"), [(513, 512), (1000, 64), (4096, 64), (5001, 37), (40_000, 256)]
)
@pytest.mark.parametrize("detrend", [True, False])
def test_spectra_equal_the_direct_sums(n_samples, lag, detrend):
    force, velocity = record(n_samples, lag)
    found = estimate(force, velocity, RATE_HZ, lag, detrend=detrend)
    expected = direct(force, velocity, lag, found.frequency_hz, detrend)
    for mine, other in zip((found.velocity, found.force, found.cross), expected, strict=True):
        assert worst(mine, other) < 1e-12


def test_any_frequency_equals_the_direct_sums():
    force, velocity = record(3000, 1)
    frequency_hz = np.array([0.0, 0.3, 17.77, 500.0, 1999.0, 2000.0])
    found = estimate(force, velocity, RATE_HZ, 50, frequency_hz)
    for mine, other in zip(
        (found.velocity, found.force, found.cross),
        direct(force, velocity, 50, frequency_hz),
        strict=True,
    ):
        assert worst(mine, other) < 1e-12


def test_default_grid_is_that_of_the_window():
    found = estimate(*record(9000, 2), RATE_HZ)
    assert found.lag == 2048
    assert found.frequency_hz[[0, 1, -1]] == pytest.approx([0.0, RATE_HZ / 4096, 2000.0])
    assert (found.lowest_hz, found.bandwidth_hz) == pytest.approx((1.953125, 4000 / 1536))


def test_plain_kernels_equal_the_compiled_ones(monkeypatch):
    force, velocity = record(50_000, 3)
    assert kernel_module.kernels() is not kernel_module, "numba is part of the test environment"
    compiled = estimate(force, velocity, RATE_HZ, 128)
    monkeypatch.setattr(covariances, "kernels", lambda: kernel_module)
    plain = estimate(force, velocity, RATE_HZ, 128)
    for name in ("velocity", "force", "cross"):
        assert worst(getattr(compiled, name), getattr(plain, name)) < 1e-13


def test_without_numba_the_plain_kernels_are_used(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "hapticd.signal.compiled", None)
    monkeypatch.delattr("hapticd.signal.compiled", raising=False)
    assert kernel_module.kernels.__wrapped__() is kernel_module


def test_stream_may_be_asked_before_its_end():
    force, velocity = record(6000, 4)
    stream = SpectralStream(RATE_HZ, 64)
    stream.add(force[:2500], velocity[:2500])
    early = stream.spectra()
    stream.add(force[2500:], velocity[2500:])
    assert worst(early.cross, estimate(force[:2500], velocity[:2500], RATE_HZ, 64).cross) < 1e-12
    assert worst(stream.spectra().cross, estimate(force, velocity, RATE_HZ, 64).cross) < 1e-12
    assert stream.n_samples == 6000


def test_stream_forgets_an_offset_ten_thousand_times_the_signal():
    force, velocity = record(20_000, 5)
    stream = SpectralStream(RATE_HZ, 64)
    stream.add(force, velocity + 1e4)
    assert worst(stream.spectra().cross, estimate(force, velocity, RATE_HZ, 64).cross) < 1e-6


def test_golden_file_of_octave():
    golden = json.loads(GOLDEN.read_text())
    compare_with_octave(
        golden["force"],
        golden["velocity"],
        golden["lag"],
        golden["rate_hz"],
        np.array(golden["columns"]).T,
    )


def compare_with_octave(force, velocity, lag, rate_hz, columns):
    frequency_hz, phi_u, phi_y, real, imag, gain, noise, sd = columns.T
    found = estimate(force, velocity, rate_hz, lag)
    z = impedance(found)
    assert found.frequency_hz == pytest.approx(frequency_hz)
    assert worst(found.velocity, phi_u) < 1e-11
    assert worst(found.force, phi_y) < 1e-11
    assert worst(found.cross, real + 1j * imag) < 1e-11
    assert np.abs(z.impedance_ns_per_m) == pytest.approx(gain, rel=1e-9)
    assert z.noise == pytest.approx(noise, rel=1e-8, abs=1e-10 * noise.max())
    assert z.sd_ns_per_m == pytest.approx(sd, rel=1e-8)


def test_missing_octave_names_the_remedy(monkeypatch):
    monkeypatch.setattr("support.octave.run.shutil.which", lambda name: None)
    with pytest.raises(
        RuntimeError, match=r"octave with octave-signal is needed .* `make deps` installs both"
    ):
        spa_by_octave(*record(100, 1), 10, RATE_HZ)


def test_standard_deviations_are_those_of_ljung():
    found = estimate(*record(30_000, 6), RATE_HZ, 64)
    z = impedance(found)
    n = 30_000
    c = 0.75 * 64
    window = 0.5 * (1.0 + np.cos(np.pi * np.arange(-64, 65) / 64))
    assert np.sum(window**2) == pytest.approx(c)
    g2 = np.abs(found.cross) ** 2 / (found.velocity * found.force)
    assert z.coherence == pytest.approx(g2)
    assert z.noise == pytest.approx(found.force - np.abs(found.cross) ** 2 / found.velocity)
    assert z.sd_ns_per_m == pytest.approx(np.sqrt(c / n * z.noise / found.velocity))
    assert z.relative_sd == pytest.approx(np.sqrt(c / (2 * n) * (1 - g2) / g2))
    assert z.noise_sd[1:-1] == pytest.approx(np.sqrt(c / n) * z.noise[1:-1])
    assert z.noise_sd[[0, -1]] == pytest.approx(np.sqrt(2 * c / n) * z.noise[[0, -1]])


def test_white_noise_has_a_flat_spectrum_of_its_variance():
    random = np.random.default_rng(7)
    force = 3.0 * random.standard_normal(400_000)
    found = estimate(force, random.standard_normal(400_000), RATE_HZ, 32)
    assert found.force == pytest.approx(9.0, rel=0.05)


def test_noisy_velocity_shrinks_spa_and_not_h_force():
    random = np.random.default_rng(8)
    velocity = random.standard_normal(400_000)
    force = 2.0 * velocity
    found = estimate(force, velocity + random.standard_normal(400_000), RATE_HZ, 32)
    inside = slice(1, -1)
    assert np.abs(impedance(found, "spa").impedance_ns_per_m[inside]) == pytest.approx(
        1.0, rel=0.05
    )
    assert np.abs(impedance(found, "h_force").impedance_ns_per_m[inside]) == pytest.approx(
        2.0, rel=0.05
    )
    assert np.angle(impedance(found, "spa").impedance_ns_per_m) == pytest.approx(
        np.angle(impedance(found, "h_force").impedance_ns_per_m)
    )


def test_h_force_reports_the_noise_of_the_velocity():
    random = np.random.default_rng(9)
    velocity = random.standard_normal(400_000)
    found = estimate(velocity, velocity + 0.5 * random.standard_normal(400_000), RATE_HZ, 32)
    assert impedance(found, "h_force").noise[1:-1] == pytest.approx(0.25, rel=0.1)


def test_mass_in_front_is_taken_off():
    z = impedance(estimate(*record(5000, 10), RATE_HZ, 64))
    behind = z.without_mass(0.003)
    assert behind.port == "device"
    assert z.port == "probe"
    assert behind.impedance_ns_per_m.real == pytest.approx(z.impedance_ns_per_m.real)
    assert behind.impedance_ns_per_m.imag == pytest.approx(
        z.impedance_ns_per_m.imag - 2 * np.pi * z.frequency_hz * 0.003
    )


def test_known_skew_and_high_pass_are_corrected():
    found = estimate(*record(5000, 11), RATE_HZ, 64)
    f = found.frequency_hz
    channel = np.exp(2j * np.pi * f * 60e-6) * (1j * f / (5.0 + 1j * f))
    seen = dataclasses.replace(
        found, velocity=found.velocity * np.abs(channel) ** 2, cross=found.cross * channel.conj()
    )
    restored = corrected(seen, skew_s=60e-6, high_pass_hz=5.0)
    assert restored.cross[1:] == pytest.approx(found.cross[1:])
    assert restored.velocity[1:] == pytest.approx(found.velocity[1:])


def test_skew_sign_is_that_of_a_late_velocity():
    random = np.random.default_rng(12)
    force = random.standard_normal(100_000)
    late = estimate(force[:-1], force[1:], RATE_HZ, 32)
    assert corrected(late, skew_s=1 / RATE_HZ).cross == pytest.approx(late.velocity + 0j, abs=0.03)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            (np.zeros(100), np.zeros(99)),
            "force (100,) and velocity (99,): two records of one length are needed",
        ),
        ((np.zeros((2, 50)), np.zeros((2, 50))), "two records of one length"),
        (
            (np.zeros(64), np.zeros(64), 4e3, 64),
            "record of 64 samples: more than the window of 64 are needed",
        ),
        (
            (np.zeros(64), np.zeros(64), 4e3, 1),
            "lag 1: a window of at least 2 samples is needed; the paper's has 2048",
        ),
        (
            (np.full(99, np.nan), np.zeros(99), 4e3, 9),
            "values that are not finite; drop or repair them before the analysis",
        ),
        ((np.zeros(99), np.full(99, np.inf), 4e3, 9, None, False), "values that are not finite"),
        (
            (*record(99, 1), 4e3, 9, [2000.1]),
            "frequencies: a list inside 0..2000 Hz, half the sample rate, is needed",
        ),
        ((*record(99, 1), 4e3, 9, []), "frequencies: a list inside"),
        ((*record(99, 1), 4e3, 9, [-1.0]), "frequencies: a list inside"),
    ],
)
def test_impossible_records_are_refused(arguments, message):
    with pytest.raises(AnalysisError, match=re.escape(message)), np.errstate(invalid="ignore"):
        estimate(*arguments)


def test_empty_stream_has_nothing_to_say():
    with pytest.raises(AnalysisError, match="record of 0 samples"):
        SpectralStream().spectra()
    with pytest.raises(AnalysisError, match="no samples: nothing to correlate"):
        covariances.Sections(8).covariances()


def test_unknown_estimator_is_refused():
    with pytest.raises(AnalysisError, match="estimator 'welch': use 'spa'"):
        impedance(estimate(*record(99, 1), 4e3, 9), "welch")


def test_silent_channel_has_no_impedance():
    found = impedance(estimate(np.ones(200), np.zeros(200), 4e3, 9))
    assert not found.coherence.any()
    assert np.isnan(found.impedance_ns_per_m).all()
    assert np.isinf(found.relative_sd).all()


def test_stream_with_a_huge_offset_is_that_without_it():
    """Detrended covariances do not know an offset; its square must not drown them."""
    force, velocity = np.random.default_rng(9).normal(size=(2, 20_000))
    plain = SpectralStream()
    shifted = SpectralStream()
    for part in np.array_split(np.arange(20_000), 7):
        plain.add(force[part], velocity[part])
        shifted.add(force[part] + 1e9, velocity[part] - 1e9)
    assert np.allclose(shifted.spectra().cross, plain.spectra().cross, atol=1e-5)
    assert shifted.spectra().coherence.max() < 0.9
