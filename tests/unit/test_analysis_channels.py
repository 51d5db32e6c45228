"""Skew and high-pass of the channels are found and measured; what is physics is left in peace."""

import re

import numpy as np
import pytest
from support.spectral_trials import exact_trial, mass_damper, record

from hapticd.signal.channels import MODES_SKEW_S, channel_findings, high_pass, skew
from hapticd.signal.spectra import corrected, spa
from hapticd.signal.verdict import judge

RATE_HZ = 4000.0
SECONDS = 20
N = int(SECONDS * RATE_HZ)


def codes(findings):
    return [one.code for one in findings]


def turned(impedance, skew_s=0.0, high_pass_hz=0.0):
    """Impedance as channels with these faults show it."""
    return lambda f: (
        impedance(f) / (np.exp(2j * np.pi * f * skew_s) * (1j * f / (high_pass_hz + 1j * f)))
    )


@pytest.mark.parametrize("skew_us", [-125.0, -40.0, 40.0, 125.0])
@pytest.mark.parametrize(("damping", "stiffness"), [(1.0, 0.0), (3.0, 500.0)])
def test_skew_is_found_and_measured(skew_us, damping, stiffness):
    shown = spa(*record(turned(mass_damper(0.008, damping, stiffness), skew_us * 1e-6), 4, N))
    found = channel_findings(shown)
    assert codes(found) == ["channel_skew"]
    assert 1e6 * skew(shown).value == pytest.approx(skew_us, abs=4.0)
    assert ("after" if skew_us > 0 else "before") + " the force" in found[0].message
    assert judge(shown).answer == "undecided"


def test_half_a_sample_makes_a_passive_device_look_active():
    shown = spa(*record(turned(mass_damper(0.008, 4.0), -125e-6), 5, N))
    assert judge(shown, channels=False).answer == "not_passive"
    repaired = corrected(shown, skew_s=-125e-6)
    assert judge(repaired).answer == "passive"


def coupled(bridge_ns_per_m):
    """Probe and motor on a stiff transmission: |Z| goes through a maximum and a minimum."""

    def impedance(f):
        s = 2j * np.pi * f
        slider = 0.0025 * s + 0.15
        bridge = bridge_ns_per_m + 4e4 / s
        return 0.0055 * s + 0.85 + slider * bridge / (slider + bridge)

    return impedance


def test_two_bodies_are_not_taken_for_skew():
    shown = exact_trial(coupled(2.0), 0.98)
    assert abs(skew(shown).value) < 15e-6
    assert channel_findings(shown) == ()


@pytest.mark.parametrize("bridge_ns_per_m", [0.5, 1.0, 2.0])
def test_mode_of_the_papers_display_does_no_more_skew_than_its_interval_holds(bridge_ns_per_m):
    found = skew(exact_trial(coupled(bridge_ns_per_m), 0.98))
    assert abs(found.value) + 1.96 * found.sd <= MODES_SKEW_S


def test_mode_that_is_damped_more_does_more_skew_than_that():
    """A limit of the fit, which the module states."""
    found = skew(exact_trial(coupled(4.0), 0.98))
    assert 15e-6 < found.value < 27e-6


def test_device_that_is_no_mass_says_nothing_about_skew():
    shown = exact_trial(lambda f: 2.0 + 1e5 / (2j * np.pi * f), 0.98)
    assert np.isnan(skew(shown).value)
    assert channel_findings(shown) == ()


@pytest.mark.parametrize("stiffness", [100.0, 500.0])
def test_high_pass_is_found_over_a_spring(stiffness):
    shown = exact_trial(turned(mass_damper(0.008, 1.0, stiffness), high_pass_hz=0.5), 0.995)
    assert high_pass(shown).value == pytest.approx(0.5, rel=0.1)
    found = channel_findings(shown)
    assert codes(found) == ["high_pass_mismatch"]
    assert re.match(
        r"high-pass mismatch: the velocity channel looks AC-coupled at 0\.5\d* Hz", found[0].message
    )
    assert judge(shown).answer == "undecided"


def test_delayed_force_is_not_taken_for_a_high_pass():
    """A lag of 5 ms over a spring adds a constant to Re Z, a high-pass 1/f^2."""

    def late(f):
        return mass_damper(0.008, 1.0)(f) + 100.0 * np.exp(-2j * np.pi * f * 5e-3) / (
            2j * np.pi * f
        )

    shown = exact_trial(late, 0.995)
    assert abs(high_pass(shown).value) < 0.05
    assert channel_findings(shown) == ()


def test_without_a_spring_nothing_is_said_about_a_high_pass():
    assert np.isnan(high_pass(exact_trial(turned(mass_damper(), high_pass_hz=0.5), 0.995)).value)
