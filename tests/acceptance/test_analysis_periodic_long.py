"""Periods of a multisine: exact where the device is linear, and an interval that holds with
noise and with friction.
"""

import re

import numpy as np
import pytest
from support.analysis_devices import display
from support.analysis_periodic import (
    BAND,
    DEVICE,
    RATE_HZ,
    answered,
    covered,
    forces,
    simulated,
)
from support.spectral_trials import mass_damper

from hapticd.signal.assess import periodic, periodic_findings
from hapticd.signal.impedance import impedance
from hapticd.signal.verdict import judge


@pytest.fixture(scope="module")
def rubbing():
    """A display with Coulomb friction under 240 realisations of 2 periods."""
    return simulated(display(), (100.0, 1.0, 0.01), 240, 2)


def test_interval_covers_coulomb_friction(rubbing):
    """Truth: the mean over 160 realisations. 10 trials of 8 others hold it in 95 % of the
    frequencies, its own doubt included.
    """
    truth = impedance(
        periodic(*(signal[:160] for signal in rubbing), RATE_HZ), "h_force"
    ).impedance_ns_per_m
    trials = [
        periodic(*(signal[first : first + 8] for signal in rubbing), RATE_HZ)
        for first in range(160, 240, 8)
    ]
    assert 0.92 < np.mean([covered(one, truth) for one in trials]) < 0.97


def test_one_realisation_covers_no_friction_and_says_so(rubbing):
    truth = impedance(
        periodic(*(signal[:160] for signal in rubbing), RATE_HZ), "h_force"
    ).impedance_ns_per_m
    alone = periodic(*(signal[200:201] for signal in rubbing), RATE_HZ)
    freedom = alone.degrees_of_freedom - 2.0
    assert freedom == 2.0
    assert np.mean(covered(alone, truth)) < 0.3
    (found,) = periodic_findings(alone, BAND)
    assert found.voids
    assert (
        found.message
        == "one realisation: the interval covers noise alone, and nothing tells distortion from the"
        " device; ask for several realisations"
    )
    assert alone.covers.startswith(
        "noise alone, from the scatter of 2 periods; nonlinear distortion such as friction's is not"
    )


def test_distortion_is_told_from_noise(rubbing):
    several = periodic(*(signal[:8] for signal in rubbing), RATE_HZ)
    noise, total = several.scatter(BAND)
    assert noise < 0.01 < 0.05 < total
    (found,) = periodic_findings(several, BAND)
    assert re.match(
        r"nonlinear distortion: realisations scatter by \S+ %, periods of one by \S+ %; more"
        r" realisations make the interval",
        found.message,
    )
    assert (
        several.covers
        == "noise and nonlinear distortion at this perturbation, from the scatter of 8 realisations"
        " of 2 periods"
    )
    single = periodic(*(signal[:8, :1] for signal in rubbing), RATE_HZ)
    (found,) = periodic_findings(single, BAND)
    assert re.match(
        r"noise or nonlinear distortion: realisations scatter by \S+ %; more of them .*two periods"
        r" of each",
        found.message,
    )
    force = forces(8, 2)
    calm = periodic(force, answered(force, DEVICE, 5e-3), RATE_HZ)
    assert not list(periodic_findings(calm, BAND))


def test_lossless_device_is_decided_in_one_of_twenty():
    """Re Z = 0 everywhere: a verdict against the truth, either way, in at most 5 % of trials at
    95 %.
    """
    force = forces(6, 1)
    lossless = mass_damper(0.008, 0.0)
    answers = [
        judge(
            periodic(force, answered(force, lossless, 5e-3, seed), RATE_HZ),
            estimator="h_force",
            channels=False,
        ).answer
        for seed in range(300)
    ]
    assert answers.count("not_passive") <= 0.05 * 300 + 2.0 * (0.05 * 0.95 * 300) ** 0.5
    assert answers.count("passive") == 0
