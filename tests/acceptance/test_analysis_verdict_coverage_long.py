"""What a verdict promises, counted over many trials: false alarms, coverage of intervals, power.

Trials of 90 s are scaled down where only N / M matters: the sample rate with the window, or both
with the frequencies.
"""

import numpy as np
import pytest
from support.analysis_devices import rigid
from support.analysis_verdict_coverage import answers
from support.spectral_trials import mass_damper, record, with_phase_margin

from hapticd.model.predict import predicted_impedance
from hapticd.model.scene import Excitation
from hapticd.signal.findings import coherence_findings, examine
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import judge
from hapticd.zwidth.engine.batch import simulate

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("noise_m_per_s", [5e-3, 5e-2])
def test_lossless_device_is_rarely_called_active(noise_m_per_s):
    """The hardest case: Re Z = 0 at every frequency, so every one of them may raise the alarm.
    5 % + 3 standard errors.
    """
    shares, plain = answers(with_phase_margin(0.0), noise_m_per_s, 700)
    assert shares["not_passive"] <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / 700)
    assert shares["passive"] == 0.0
    assert plain == 0.0


@pytest.mark.parametrize("estimator", ["h_force", "spa"])
def test_95_percent_intervals_cover_95_percent(estimator):
    """90 s, 1 kHz, M = 512: the window of 4 kHz and M = 2048. "spa" is counted for the phase
    alone: its |Z| is biased by g2.
    """
    true = mass_damper(0.008, 1.0, 100.0)
    estimates = []
    for seed in range(300):
        trial = spa(*record(true, seed, 90_000, noise_m_per_s=5e-3, rate_hz=1000.0), 1000.0, 512)
        estimates.append(impedance(trial, estimator))
    f = trial.frequency_hz
    for low, high in ((30.0, 100.0), (100.0, 200.0), (200.0, 490.0)):
        band = (f >= low) & (f < high)
        error = np.log([one.impedance_ns_per_m[band] / true(f[band]) for one in estimates])
        half = 1.96 * np.array([one.relative_sd[band] for one in estimates])
        assert 0.93 <= np.mean(np.abs(error.imag) < half) <= 0.97
        if estimator == "h_force":
            assert 0.93 <= np.mean(np.abs(error.real) < half) <= 0.97


def test_active_device_is_never_called_passive():
    def active(f):
        return mass_damper(0.008, 1.0)(f) - 1.02 * ((f > 60.0) & (f < 70.0))

    found = [
        judge(
            spa(*record(active, seed, 90_000, rate_hz=1000.0), 1000.0, 512),
            band_hz=(2.0, 400.0),
            channels=False,
        )
        for seed in range(200)
    ]
    assert sum(one.answer == "passive" for one in found) == 0


def test_margin_of_one_degree_raises_no_alarm():
    """The plain rule calls this passive device active every time."""
    shares, plain = answers(with_phase_margin(1.0), 2e-2, 200)
    assert shares["not_passive"] <= 0.05
    assert plain == 0.0


def test_clear_cases_are_decided():
    assert answers(with_phase_margin(-5.0), 1e-3, 40)[0]["not_passive"] == 1.0
    # at the lowest line of the window the velocity drifts: half as long, a tenth stays undecided
    shares, _ = answers(with_phase_margin(10.0), 1e-3, 40, samples=90_000)
    assert shares["passive"] >= 0.95


@pytest.mark.parametrize("noise_m_per_s", [0.0, 1e-4, 1e-3])
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (100.0, 1.0, 0.0)])
def test_intervals_cover_what_is_predicted_of_the_record(point, noise_m_per_s):
    """24 trials of 90 s of a linear device, its force held, its velocity averaged; down to no
    noise.
    """
    model = rigid(viscous=1.0)
    estimates = []
    found = simulate(
        model,
        np.tile(point, (24, 1)),
        90.0,
        keep="records",
        own_torque=True,
        excitation=Excitation("noise"),
    )
    for trial in range(24):
        force, velocity = (np.asarray(signal, np.float64) for signal in found.record(trial))
        noise = noise_m_per_s * np.random.default_rng(trial).standard_normal(velocity.size)
        estimates.append(impedance(spa(force, velocity + noise), "h_force"))
    f = estimates[0].frequency_hz
    for low, high in ((100.0, 200.0), (200.0, 350.0), (350.0, 500.0)):
        band = (f >= low) & (f <= high)
        truth = predicted_impedance(model, point, f[band])
        error = np.log([one.impedance_ns_per_m[band] / truth for one in estimates])
        half = 1.96 * np.array([one.relative_sd[band] for one in estimates])
        for part in (error.real, error.imag):
            assert np.mean(np.abs(part) < half) >= 0.93


def test_simultaneous_interval_covers_the_true_margin():
    """Least Re Z lies between the limits in at least 95 % of the trials."""

    def true(f):
        return 2j * np.pi * f * 0.008 + 1.0 - 0.7 * np.exp(-(((f - 90.0) / 40.0) ** 2))

    covered = 0
    for seed in range(150):
        trial = spa(*record(true, seed, 90_000, rate_hz=1000.0), 1000.0, 512)
        margin = judge(
            trial, band_hz=(2.0, 400.0), estimator="h_force", channels=False
        ).margin_ns_per_m
        covered += margin.lower <= 0.3 <= margin.upper
    assert covered / 150 >= 0.95


def test_noise_alone_raises_no_finding():
    for seed in range(25):
        force, velocity = record(mass_damper(0.008, 1.0, 50.0), seed, 90_000, rate_hz=1000.0)
        assert examine(force, velocity, 1000.0).findings == ()
        assert coherence_findings(spa(force, velocity, 1000.0, 512), (2.0, 300.0)) == ()
