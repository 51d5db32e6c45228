"""A lightly damped spring that `spa` reads low is named; what is resolved is left in peace."""

import re

import numpy as np
import pytest
from support.spectral_trials import LAG, RATE_HZ, mass_damper

from hapticd.signal.covariances import Covariances
from hapticd.signal.findings import leakage_findings, shrinkage
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import Spectra, spa, spectra

BAND = (2.0, 500.0)
N = 360_000
CIRCLE = 1 << 18  # samples of the closed form: 65 s, in which every device here has come to rest


def expected(device, n_samples=N, lag=LAG) -> Spectra:
    """What spa gives on average for `device` under white force: closed form, covariances times
    window and times 1 - t/N.
    """
    f = np.fft.rfftfreq(CIRCLE, 1.0 / RATE_HZ)
    y = 1.0 / device(np.maximum(f, 1e-6))
    velocity, cross = (np.fft.irfft(part, CIRCLE) for part in (np.abs(y) ** 2, y.conj()))
    lags = np.arange(lag + 1)
    ends = 1.0 - lags / n_samples
    white = np.where(lags == 0, 1.0, 0.0)
    return spectra(
        Covariances(
            ends * velocity[: lag + 1],
            white,
            ends * cross[: lag + 1],
            ends * cross[-lags],
            n_samples,
        ),
        RATE_HZ,
    )


def low(trial: Spectra, device, frequency_hz=2.93, estimator="spa") -> float:
    at = int(np.argmin(np.abs(trial.frequency_hz - frequency_hz)))
    f = trial.frequency_hz[at]
    return 1.0 - float(np.abs(impedance(trial, estimator).impedance_ns_per_m[at] / device(f)))


@pytest.mark.parametrize(("stiffness", "damping"), [(500.0, 0.3), (1000.0, 1.0), (1000.0, 0.3)])
def test_lightly_damped_spring_is_named(stiffness, damping):
    device = mass_damper(0.008, damping, stiffness)
    trial = expected(device)
    truth = low(trial, device)
    assert truth > 0.06
    found = leakage_findings(trial, BAND)
    message = found[0].message
    assert [one.code for one in found] == ["leakage"]
    assert not found[0].voids
    said = re.match(
        r"leakage: \|Z\| reads about (\S+) % low at 2\.93 Hz and the phase is pulled \S+ deg"
        r" towards 0, from 2\.93 to \S+ Hz more "
        r"than 5 %: a window of 2048 samples does not resolve so lightly damped a motion; take a"
        r" longer window \(--lag\), h_force, "
        r"a multisine, or begin the band higher$",
        message,
    )
    assert said
    assert float(said[1]) / 100.0 == pytest.approx(truth, rel=0.35)


@pytest.mark.parametrize(("stiffness", "damping"), [(0.0, 1.0), (100.0, 3.0), (1000.0, 40.0)])
def test_damped_device_is_resolved(stiffness, damping):
    device = mass_damper(0.008, damping, stiffness)
    trial = expected(device)
    assert low(trial, device) < 0.05
    assert leakage_findings(trial, BAND) == ()


@pytest.mark.parametrize("remedy", ["longer window and record", "h_force", "higher band"])
def test_each_remedy_cures_it(remedy):
    device = mass_damper(0.008, 1.0, 1000.0)
    if remedy == "h_force":
        trial = expected(device)
        band = BAND
        estimator = "h_force"
    elif remedy == "higher band":
        trial = expected(device)
        band = (5.0, 500.0)
        estimator = "spa"
    else:
        trial = expected(device, n_samples=4 * N, lag=4 * LAG)
        band = BAND
        estimator = "spa"
    assert abs(low(trial, device, max(2.93, band[0]), estimator)) < 0.05
    assert leakage_findings(trial, band, estimator) == ()


def test_phase_that_is_pulled_to_0_is_measured():
    """K = 100 N/m, b = 1 N s/m: the phase at 3 Hz comes out nearly a degree nearer to 0, as its
    factor says.
    """
    device = mass_damper(0.008, 1.0, 100.0)
    trial = expected(device)
    truth = np.degrees(
        np.angle(impedance(trial).impedance_ns_per_m[3] / device(trial.frequency_hz[3]))
    )
    assert truth > 0.5
    assert np.degrees(np.angle(shrinkage(trial)[3])) == pytest.approx(truth, rel=0.35)


def test_record_of_such_a_spring_is_named_as_well():
    """The same from samples: 90 s of noise, the device in steady state before and after."""
    device = mass_damper(0.008, 0.3, 1000.0)
    random = np.random.default_rng(2)
    force = 0.2 * random.standard_normal(N + 40_000)
    f = np.maximum(np.fft.rfftfreq(force.size, 1.0 / RATE_HZ), 1e-3)
    velocity = np.fft.irfft(np.fft.rfft(force) / device(f), force.size)
    trial = spa(force[20_000:-20_000], velocity[20_000:-20_000])
    assert low(trial, device) > 0.06
    assert [one.code for one in leakage_findings(trial, BAND)] == ["leakage"]


def test_nothing_is_said_of_spectra_that_do_not_hold_the_covariances():
    force = np.random.default_rng(1).standard_normal(40_000)
    trial = spa(force, force, frequency_hz=np.array([3.0, 5.0, 100.0]))
    assert np.array_equal(shrinkage(trial), np.ones(3))
    assert leakage_findings(trial, BAND) == ()
