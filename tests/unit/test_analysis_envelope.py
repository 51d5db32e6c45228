"""The envelope is the extreme of the passive trials; owners, uncertainty, and what is refused."""

import dataclasses
import re

import numpy as np
import pytest
from support.envelopes import EnvelopeTrial, envelope, of_trial
from support.spectral_trials import exact_trial, mass_damper

from hapticd.core.errors import AnalysisError
from hapticd.signal.findings import Finding
from hapticd.signal.impedance import impedance
from hapticd.signal.verdict import LOST_EDGE, judge


def trial(name, z, coherence=0.99, estimator="h_force"):
    spectra = exact_trial(z, coherence)
    return EnvelopeTrial(name, impedance(spectra, estimator), judge(spectra, channels=False))


SOFT = trial("soft", mass_damper(0.008, 1.0))
FIRM = trial("firm", mass_damper(0.004, 6.0), 0.9)
ACTIVE = trial("active", lambda f: mass_damper(0.02, 0.0)(f) - 9.0)


def test_envelope_is_the_extreme_of_the_passive_trials():
    found = envelope([SOFT, ACTIVE, FIRM])
    f = SOFT.impedance.frequency_hz
    sizes = np.abs([SOFT.impedance.impedance_ns_per_m, FIRM.impedance.impedance_ns_per_m])
    assert found.trials == ("soft", "firm")
    assert found.upper.value == pytest.approx(sizes.max(axis=0))
    assert found.lower.value == pytest.approx(sizes.min(axis=0))
    crossing = np.sqrt(35.0 / (0.008**2 - 0.004**2)) / (2 * np.pi)
    assert found.owner(found.upper)[10] == "firm"
    assert np.array_equal(found.upper.owner == 0, f > crossing)
    assert found.phase_upper.value == pytest.approx(
        np.maximum(SOFT.impedance.phase_deg, FIRM.impedance.phase_deg)
    )


def test_uncertainty_is_that_of_the_owner():
    found = envelope([SOFT, FIRM])
    expected = np.where(
        found.upper.owner == 0, SOFT.impedance.relative_sd, FIRM.impedance.relative_sd
    )
    assert found.upper.sd == pytest.approx(expected)
    phase = np.where(
        found.phase_lower.owner == 0, SOFT.impedance.relative_sd, FIRM.impedance.relative_sd
    )
    assert found.phase_lower.sd == pytest.approx(np.degrees(phase))


def test_order_of_trials_changes_names_alone():
    one = envelope([SOFT, FIRM])
    other = envelope([FIRM, SOFT])
    assert one.upper.value == pytest.approx(other.upper.value)
    assert one.owner(one.upper) == other.owner(other.upper)


def test_envelope_may_grow_trial_by_trial():
    grown = of_trial(SOFT).merged(of_trial(FIRM))
    assert grown.upper.value == pytest.approx(envelope([SOFT, FIRM]).upper.value)
    assert of_trial(SOFT).width_db() == pytest.approx(0.0)


def test_admittance_envelope_is_the_inverse_turned_over():
    found = envelope([SOFT, FIRM])
    inverse = found.admittance()
    assert inverse.kind == "admittance"
    assert inverse.upper.value == pytest.approx(1.0 / found.lower.value)
    assert inverse.owner(inverse.upper) == found.owner(found.lower)
    assert inverse.phase_upper.value == pytest.approx(-found.phase_lower.value)
    assert inverse.width_db() == pytest.approx(found.width_db())
    assert inverse.admittance().upper.value == pytest.approx(found.upper.value)


def test_plain_rule_accepts_what_is_undecided():
    thin = trial("thin", mass_damper(0.008, 0.05), 0.9)
    assert thin.verdict.answer == "undecided"
    assert thin.verdict.passes
    assert thin.verdict.answer != "passive"
    assert not dataclasses.replace(thin.verdict, stability="unstable").passes


def test_plain_rule_accepts_no_trial_that_lost_an_edge_of_its_band():
    """What was not looked at did not pass."""
    thin = trial("thin", mass_damper(0.008, 0.05), 0.9)
    lost = Finding(LOST_EDGE, "the edge at 2.00 Hz is lost under a drift")
    assert not dataclasses.replace(thin.verdict, findings=(lost,)).passes


def test_values_that_are_not_known_own_nothing():
    holed = FIRM.impedance.impedance_ns_per_m.copy()
    holed[5] = np.nan
    unknown = dataclasses.replace(FIRM.impedance, impedance_ns_per_m=holed)
    found = of_trial(SOFT).merged(of_trial(FIRM._replace(impedance=unknown)))
    assert found.upper.owner[5] == 0
    assert found.upper.owner[6] == 1


@pytest.mark.parametrize(
    ("trials", "message"),
    [
        (
            [SOFT, trial("other", mass_damper(), estimator="spa")],
            "at the probe by 'spa' beside others at the probe by 'h_force'",
        ),
        (
            [SOFT, FIRM._replace(impedance=FIRM.impedance.without_mass(0.003))],
            "a trial at the device by",
        ),
    ],
)
def test_unlike_trials_are_refused(trials, message):
    with pytest.raises(AnalysisError, match=re.escape(message)):
        envelope(trials)


def test_unlike_frequencies_are_refused():
    shifted = dataclasses.replace(FIRM.impedance, frequency_hz=FIRM.impedance.frequency_hz + 0.1)
    with pytest.raises(AnalysisError, match="unlike frequencies: estimate all with one window"):
        of_trial(SOFT).merged(of_trial(FIRM._replace(impedance=shifted)))
    with pytest.raises(AnalysisError, match="an admittance envelope cannot be widened"):
        of_trial(SOFT).admittance().merged(of_trial(FIRM))
