"""Periods of a multisine: exact where the device is linear, and an interval that holds with
noise and with friction.
"""

import re

import numpy as np
import pytest
from support.analysis_devices import display, rigid
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
from test_analysis_periodic import rms_error

from hapticd.model.effects import AntiAlias, Encoder
from hapticd.model.excitation import torque_record
from hapticd.model.scene import Excitation
from hapticd.signal.assess import periodic, periodic_findings
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import judge
from hapticd.zwidth.engine.batch import simulate


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


@pytest.mark.parametrize(
    ("effects", "most"),
    [((), 4e-6), ((AntiAlias(corner_hz=1800.0),), 4e-6), ((Encoder(quantum_m=0.5e-6),), 8e-4)],
)
def test_two_seconds_of_multisine_know_a_loop_better_than_90_s_of_noise(effects, most):
    """K = 100 N/m, B = 1 N s/m: one period after one that settles, against the paper's trial,
    which leaves 2e-3.
    """
    model = rigid(viscous=1.0, extra=effects)
    point = (100.0, 1.0, 0.0)
    slow = simulate(
        model,
        [point],
        90.0,
        keep="records",
        excitation=torque_record(Excitation("noise"), 360_000, 1),
    )
    assert (
        rms_error(
            periodic(*simulated(model, point, 1, 1), RATE_HZ), "h_force", model, point, (3.0, 499.0)
        )
        < most
    )
    assert rms_error(spa(*slow.record(0)), "spa", model, point, (3.0, 200.0)) > 1.5e-3
