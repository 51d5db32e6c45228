"""Numbers for a display against closed forms, and conditions under which two may be compared."""

import dataclasses
import re

import numpy as np
import pytest
from support.analysis_devices import rigid
from support.envelopes import EnvelopeTrial, envelope, of_trial
from support.spectral_trials import exact_trial, mass_damper

from hapticd.core.errors import AnalysisError
from hapticd.signal.impedance import impedance
from hapticd.signal.verdict import judge
from hapticd.zwidth.compare import (
    EnvelopeConditions,
    check_alike,
    differences,
    normalised,
    stiffness_at,
    stiffness_damping_area,
    stiffness_rate,
    width_db,
    widths_db,
    zero_mass_bandwidth_hz,
)
from hapticd.zwidth.passive_set import PassiveSet, grid


def trial(name, z, coherence=0.99, estimator="h_force"):
    spectra = exact_trial(z, coherence)
    return EnvelopeTrial(name, impedance(spectra, estimator), judge(spectra, channels=False))


SOFT = trial("soft", mass_damper(0.008, 1.0))
FIRM = trial("firm", mass_damper(0.004, 6.0), 0.9)
AXES = (np.linspace(0, 1000, 21), np.linspace(-2, 6, 17), np.linspace(-0.02, 0.02, 9))


def wedge(points):
    """Passive where K/1000 + |B - 1|/3 + |M|/0.01 <= 0.8."""
    k, b, m = points.T
    return 0.8 - k / 1000 - np.abs(b - 1.0) / 3 - np.abs(m) / 0.01


SET = PassiveSet.of(AXES, wedge(grid(AXES)))


def test_width_is_the_ratio_of_the_edges_in_decibels():
    one = trial("a", lambda f: 2.0 + 0j * f)
    other = trial("b", lambda f: 20.0 + 0j * f)
    found = envelope([one, other])
    assert width_db(found, 5.0, 50.0) == pytest.approx(20.0)
    assert [band.width_db for band in widths_db(found)] == pytest.approx([20.0] * 4)


def test_width_is_a_mean_over_the_logarithm_of_frequency():
    slope = envelope([trial("a", lambda f: 1.0 + 0j * f), trial("b", lambda f: f + 0j)])
    inside = slope.frequency_hz[(slope.frequency_hz >= 10.0) & (slope.frequency_hz <= 1000.0)]
    assert width_db(slope, 10.0, 1000.0) == pytest.approx(
        10.0 * np.log10(inside[0] * inside[-1]), rel=2e-3
    )


def test_width_outside_the_envelope_is_refused():
    with pytest.raises(AnalysisError, match=re.escape("no two frequencies in 3000..4000 Hz")):
        width_db(of_trial(SOFT), 3000.0, 4000.0)


def test_stiffness_damping_area_of_the_wedge():
    """From B = 0 to 3.4 under 800 - 1000 |B - 1| / 3 at M = 0: (467 + 800)/2 + 800 x 2.4 / 2."""
    assert stiffness_damping_area(SET) == pytest.approx((466.7 + 800) / 2 + 960, rel=0.01)


def test_stiffness_at_a_damping_and_its_rate():
    assert stiffness_at(SET, 2.0) == pytest.approx(1000 * (0.8 - 1 / 3), rel=1e-6)
    assert stiffness_rate(SET, 2.0) == pytest.approx(-1000 / 3, rel=1e-6)
    assert stiffness_rate(SET, 0.0) == pytest.approx(1000 / 3, rel=1e-6)
    assert np.isnan(stiffness_at(SET, 5.0))
    with pytest.raises(
        AnalysisError,
        match=re.escape("virtual damping B = 9 N s/m lies outside the grid -2..6"),
    ):
        stiffness_at(SET, 9.0)
    with pytest.raises(
        AnalysisError, match=re.escape("no virtual mass 0.001 kg; the nearest is 0 kg")
    ):
        stiffness_at(SET, 1.0, 0.001)


def test_zero_mass_bandwidth_of_mass_and_damper():
    f = np.geomspace(1.0, 1000.0, 4000)
    assert zero_mass_bandwidth_hz(f, mass_damper(0.008, 1.0)(f)) == pytest.approx(
        1.0 / (2 * np.pi * 0.008), rel=3e-3
    )
    assert zero_mass_bandwidth_hz(f, np.full(f.size, 2.0 + 0j)) == np.inf


def test_normalised_admittance_is_that_of_the_normalised_impedance():
    found = envelope([SOFT, FIRM])
    assert normalised(found.admittance(), 0.008).upper.value == pytest.approx(
        normalised(found, 0.008).admittance().upper.value
    )
    with pytest.raises(
        AnalysisError,
        match=re.escape("mass 0.0 kg: the mass that moves at the port must be positive"),
    ):
        normalised(found, 0.0)


ONE = EnvelopeConditions("A", 0.008, probe_mass_kg=0.003, perturbation_psd_n2_per_hz=2.5e-5)


def test_unlike_conditions_are_refused_and_named():
    other = dataclasses.replace(ONE, device="B", grip="hand", rate_hz=2000.0)
    assert differences(ONE, other) == ("rate_hz", "grip")
    message = (
        "A and B were measured under unlike conditions: rate_hz: 1000.0 and 2000.0; grip: 'free'"
        " and 'hand'; measure them under the same conditions, or compare them anyway with --allow"
        " rate_hz,grip"
    )
    with pytest.raises(AnalysisError, match=re.escape(message)):
        check_alike([ONE, other])
    assert check_alike([ONE, other], allow=("grip", "rate_hz")) == ("rate_hz", "grip")
    with pytest.raises(AnalysisError, match="allow grip"):
        check_alike([ONE, other], allow=("rate_hz",))


def test_conditions_that_scale_with_mass_are_compared_per_mass():
    assert differences(ONE, dataclasses.replace(ONE, device="B", mass_kg=0.016)) == (
        "probe_mass_kg",
        "perturbation_psd_n2_per_hz",
    )
    doubled = EnvelopeConditions("B", 0.016, probe_mass_kg=0.006, perturbation_psd_n2_per_hz=1e-4)
    assert differences(ONE, doubled) == ()
    assert rigid(scale=2.0).mass_kg == pytest.approx(0.016)
