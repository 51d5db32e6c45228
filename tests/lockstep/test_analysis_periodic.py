"""Periods of a multisine: exact where the device is linear, and an interval that holds with
noise and with friction.
"""

import numpy as np
import pytest
from scipy.stats import t as student
from support.analysis_periodic import (
    DEVICE,
    PERIOD,
    RATE_HZ,
    answered,
    covered,
    forces,
    inside,
)
from support.spectral_trials import mass_damper

from hapticd.core.errors import AnalysisError
from hapticd.model.predict import predicted_impedance
from hapticd.signal.assess import periodic
from hapticd.signal.channels import channel_findings
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import judge, student_quantile

# --- linear ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("realisations", "periods"), [(1, 2), (2, 1), (3, 2)])
def test_linear_device_is_measured_to_rounding(realisations, periods):
    force = forces(realisations, periods)
    found = periodic(force, answered(force), RATE_HZ)
    use = inside(found)
    truth = DEVICE(np.maximum(found.frequency_hz, 1e-3))
    for estimator in ("spa", "h_force"):
        assert np.allclose(
            impedance(found, estimator).impedance_ns_per_m[use], truth[use], rtol=1e-10
        )
    assert found.coherence[use].min() > 1.0 - 1e-12


def test_densities_are_those_of_the_signals():
    force = forces(4, 1)
    velocity = answered(force)
    found = periodic(force, velocity, RATE_HZ)
    for power, signal in ((found.force, force), (found.velocity, velocity)):
        variance = (2.0 * power.sum() - power[-1]) / PERIOD
        assert variance == pytest.approx(np.mean(signal**2), rel=1e-9)


def test_grid_is_that_of_the_paper_s_window():
    force = forces(2, 1)
    found = periodic(force, answered(force), RATE_HZ)
    window = spa(force.ravel(), answered(force).ravel())
    assert np.array_equal(found.frequency_hz, window.frequency_hz)
    assert found.lowest_hz == pytest.approx(0.9765625)


def test_harmonics_that_were_not_excited_are_not_known():
    force = forces(3, 1)
    found = periodic(force, answered(force, noise_m_per_s=1e-3), RATE_HZ)
    assert found.coherence[found.frequency_hz > 1701.0].max() == 0.0
    assert (
        judge(found, band_hz=(2.0, 1900.0), estimator="h_force", channels=False).answer
        == "undecided"
    )


def test_spring_without_window_is_no_high_pass():
    """A window would have smoothed it, which `channels` takes out; here there is nothing to
    take out.
    """
    force = forces(4, 2)
    spring = mass_damper(0.008, 1.0, 100.0)
    assert channel_findings(periodic(force, answered(force, spring, 1e-5), RATE_HZ)) == ()


# --- chance ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 5, 6, 7, 10, 16, 17])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.975, 0.9999])
def test_quantiles_of_few_degrees_of_freedom_are_exact(probability, freedom):
    assert student_quantile(probability, freedom) == pytest.approx(
        student.ppf(probability, freedom), rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize("freedom", [0, -1, 4.5])
def test_broken_degrees_of_freedom_are_refused(freedom):
    with pytest.raises(
        AnalysisError,
        match=f"{freedom:g} degrees of freedom: below 18 a whole number is needed; average more",
    ):
        student_quantile(0.95, freedom)


@pytest.mark.parametrize(("realisations", "periods"), [(4, 2), (8, 1), (1, 6)])
def test_interval_covers_sensor_noise(realisations, periods):
    """95 % at each frequency: 40 trials of 510 frequencies."""
    force = forces(realisations, periods)
    found = [periodic(force, answered(force, DEVICE, 5e-3, seed), RATE_HZ) for seed in range(40)]
    truth = DEVICE(np.maximum(found[0].frequency_hz, 1e-3))
    assert 0.94 < np.mean([covered(one, truth) for one in found]) < 0.96


def test_damped_device_is_passive_and_a_driven_one_is_not():
    force = forces(6, 2)
    for damping, answer in ((1.0, "passive"), (-0.5, "not_passive")):
        velocity = answered(force, mass_damper(0.008, damping), 1e-4)
        assert (
            judge(periodic(force, velocity, RATE_HZ), estimator="h_force", channels=False).answer
            == answer
        )


def rms_error(spectra, estimator, model, point, band_hz):
    use = inside(spectra, band_hz)
    ratio = impedance(spectra, estimator).impedance_ns_per_m[use] / predicted_impedance(
        model, point, spectra.frequency_hz[use]
    )
    return float(np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2)))


# --- refused --------------------------------------------------------------------------------------


def test_records_without_periods_are_refused():
    force = forces(2, 2)
    velocity = answered(force)
    with pytest.raises(
        AnalysisError,
        match=(
            r"force \(2, 4096\) and velocity \(2, 4096\): both must be \(realisations, periods, sam"
        ),
    ):
        periodic(force[0], velocity[0], RATE_HZ)
    with pytest.raises(AnalysisError, match="samples even"):
        periodic(force[..., 1:], velocity[..., 1:], RATE_HZ)
    with pytest.raises(AnalysisError, match="not finite; drop or repair"):
        periodic(np.where(force > 0.5, np.nan, force), velocity, RATE_HZ)


def test_force_that_does_not_repeat_is_refused():
    """A sample lost in the second period."""
    force = forces(2, 2)
    velocity = answered(force)
    force[1, 1] = np.roll(force[1, 1], 1)
    with pytest.raises(
        AnalysisError,
        match=(
            r"the force does not repeat from period to period \(\d+ % of it changes\): samples were"
        ),
    ):
        periodic(force, velocity, RATE_HZ)
    with pytest.raises(AnalysisError, match="the force does not repeat"):
        periodic(0.0 * force, velocity, RATE_HZ)


def test_single_average_has_no_verdict():
    force = forces(1, 1)
    with pytest.raises(
        AnalysisError,
        match=(
            r"record of 1\.02 s: too short for a verdict with a period of 4096 samples; record"
            r" 2\.05 s"
        ),
    ):
        judge(periodic(force, answered(force), RATE_HZ))
    several = forces(4, 1)
    with pytest.raises(
        AnalysisError,
        match=r"band from 0\.5 Hz: the period of 4096 samples contains nothing below 0\.977 Hz",
    ):
        judge(periodic(several, answered(several), RATE_HZ), band_hz=(0.5, 500.0))
