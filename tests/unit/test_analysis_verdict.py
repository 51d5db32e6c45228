"""The verdict: its three answers, its conditions, and what it refuses."""

import dataclasses
import re

import numpy as np
import pytest
from scipy import stats
from support.spectral_trials import exact_trial, mass_damper, record, with_phase_margin

from hapticd.core.errors import AnalysisError
from hapticd.core.units import percent
from hapticd.signal.findings import Finding, energy, examine
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import Judged, judge, sidak, student_quantile

NU = 2 * 360_000 / 1536 - 2
LINE_HZ = 4000.0 / 4096


def pushed(level, low_hz=150.0, high_hz=250.0, damping=1.0):
    """Mass and damper whose real part is `level` between two frequencies."""
    return lambda f: (
        mass_damper(0.008, 0.0)(f) + np.where((f > low_hz) & (f < high_hz), level, damping)
    )


def test_positive_resistance_is_passive():
    found = judge(exact_trial(mass_damper(), 0.99))
    assert found.answer == "passive"
    assert found.within_90_deg
    assert found.margin_ns_per_m.value == pytest.approx(0.99)
    assert found.margin_ns_per_m.lower > 0.0


def test_negative_resistance_is_not_passive():
    found = judge(exact_trial(pushed(-0.5), 0.99))
    assert found.answer == "not_passive"
    assert not found.within_90_deg
    assert 150.0 < found.margin_ns_per_m.frequency_hz < 250.0
    assert found.margin_ns_per_m.upper < 0.0
    assert found.margin_deg.upper < 0.0


@pytest.mark.parametrize("level", [-0.02, 0.02])
def test_margin_within_its_noise_is_undecided(level):
    found = judge(exact_trial(pushed(level), 0.97))
    assert found.answer == "undecided"
    assert found.within_90_deg == (level > 0)
    assert found.margin_ns_per_m.lower < 0.0 < found.margin_ns_per_m.upper


def test_intervals_are_students_at_sidaks_level():
    found = judge(exact_trial(mass_damper(0.0, 2.0), 0.9))
    t = stats.t.ppf(0.95 ** (1 / found.n_frequencies), NU)
    half = t * np.sqrt((1 - 0.9) / (0.9 * NU))
    assert found.n_frequencies == 511, "510 lines, of which 500 Hz is one, and 2 Hz"
    assert found.margin_ns_per_m.value == pytest.approx(1.8), (
        "the paper's estimator shrinks by the coherence"
    )
    assert found.margin_ns_per_m.lower == pytest.approx(1.8 * (1 - half))
    assert found.margin_ns_per_m.upper == pytest.approx(1.8 * (1 + half))
    assert found.margin_deg.value == pytest.approx(90.0)
    assert found.margin_deg.lower == pytest.approx(90.0 - np.degrees(np.arcsin(half)))
    assert judge(
        exact_trial(mass_damper(0.0, 2.0), 0.9), estimator="h_force"
    ).margin_ns_per_m.value == pytest.approx(2.0)


@pytest.mark.parametrize("degrees", [-3.0, -1.0, 0.5, 1.0, 3.0, 10.0])
@pytest.mark.parametrize("coherence", [0.5, 0.95])
def test_both_margins_give_one_answer(degrees, coherence):
    band_hz = (
        3.0 * LINE_HZ,
        500.0,
    )  # from line to line: with a pole at 0 Hz these are no covariances inside a window
    found = judge(
        exact_trial(with_phase_margin(degrees), coherence), band_hz=band_hz, channels=False
    )
    by_angle = (
        "passive"
        if found.margin_deg.lower > 0
        else "not_passive"
        if found.margin_deg.upper < 0
        else "undecided"
    )
    assert found.answer == by_angle
    assert found.margin_deg.value == pytest.approx(degrees, abs=1e-6)


@pytest.mark.parametrize(("confidence", "statements"), [(0.95, 1), (0.95, 510), (0.99, 40)])
def test_sidak_level_holds_for_all_together(confidence, statements):
    assert sidak(confidence, statements) ** statements == pytest.approx(confidence)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0])
def test_impossible_confidence_is_refused(confidence):
    with pytest.raises(AnalysisError, match=r"must lie between 0 and 1; 0.95 is usual"):
        judge(exact_trial(mass_damper(), 0.9), confidence=confidence)


@pytest.mark.parametrize("degrees_of_freedom", [18.0, 50.0, 467.0])
@pytest.mark.parametrize("probability", [0.05, 0.5, 0.975, 0.9999])
def test_student_quantile_equals_scipy(probability, degrees_of_freedom):
    expected = stats.t.ppf(probability, degrees_of_freedom)
    assert student_quantile(probability, degrees_of_freedom) == pytest.approx(
        expected, rel=1e-4, abs=1e-12
    )


def test_unstable_loop_is_not_passive_whatever_its_resistance():
    found = judge(exact_trial(mass_damper(), 0.99), spectral_radius=1.0001)
    assert found.margin_ns_per_m.lower > 0.0
    assert (found.answer, found.stability) == ("not_passive", "unstable")
    assert judge(exact_trial(mass_damper(), 0.99), spectral_radius=0.9).stability == "stable"
    assert judge(exact_trial(mass_damper(), 0.99)).stability == "unknown"


def test_findings_that_void_leave_it_undecided():
    seen = examine(*record(mass_damper(), 1, 40_000), 4000.0)
    void = dataclasses.replace(
        seen, findings=(Finding("saturation", "torque saturated", voids=True),)
    )
    assert judge(exact_trial(mass_damper(), 0.99), seen).answer == "passive"
    found = judge(exact_trial(mass_damper(), 0.99), void)
    assert found.answer == "undecided"
    assert "torque saturated" in str(found)


def test_verdict_is_never_without_its_conditions():
    force, velocity = record(mass_damper(), 2)
    said = str(judge(spa(force, velocity), examine(force, velocity, 4000.0)))
    assert re.match(
        r"passive in band \[2, 500\] Hz at 95 % confidence; stable as far as seen; margin .* N s/m,"
        r" .* deg; the recorded channels read Re Z .* high at \S+ Hz; perturbation 2\.4",
        said,
    )
    assert re.search(r"velocity \S+ mm/s rms over 90 s at the probe$", said)
    assert "stability unknown" in str(judge(spa(force, velocity)))
    assert "stable, spectral radius 0.98;" in str(judge(spa(force, velocity), spectral_radius=0.98))
    assert str(judge(spa(force, velocity), spectral_radius=1.01)).startswith(
        "not passive in band [2, 500] Hz"
    )


def test_amplitude_is_that_of_the_trial():
    force, velocity = record(mass_damper(), 3, force_n=0.3)
    found = judge(spa(force, velocity))
    assert found.amplitude.force_psd_n2_per_hz == pytest.approx(2 * 0.3**2 / 4000.0, rel=0.02)
    assert found.amplitude.velocity_sd_m_per_s == pytest.approx(velocity.std(), rel=0.01)


def test_mass_of_the_probe_turns_the_phase_and_not_the_verdict():
    trial = exact_trial(mass_damper(0.008, 1.0), 0.99)
    at_probe = judge(trial)
    behind = judge(trial, behind_mass_kg=0.003)
    assert (at_probe.port, behind.port) == ("probe", "device")
    assert behind.answer == at_probe.answer
    assert behind.margin_ns_per_m == at_probe.margin_ns_per_m
    assert behind.margin_deg.value > at_probe.margin_deg.value


def test_seconds_needed_are_those_that_decide():
    trial = exact_trial(pushed(0.05), 0.97)
    found = judge(trial, channels=False)
    assert found.answer == "undecided"
    assert found.seconds == 90.0
    longer = dataclasses.replace(trial, n_samples=int(found.seconds_needed * 4000 * 1.01))
    shorter = dataclasses.replace(trial, n_samples=int(found.seconds_needed * 4000 * 0.98))
    assert judge(longer, channels=False).answer == "passive"
    assert judge(shorter, channels=False).answer == "undecided"


def test_low_coherence_decides_nothing():
    found = judge(exact_trial(mass_damper(), 0.005))
    assert found.answer == "undecided"
    assert [one.code for one in found.findings] == ["low_coherence"]


def test_frequency_without_power_leaves_it_undecided():
    trial = exact_trial(mass_damper(), 0.99)
    dead = trial.cross.copy()
    dead[100] = 0.0
    found = judge(dataclasses.replace(trial, cross=dead), channels=False)
    assert found.answer == "undecided"
    assert found.margin_ns_per_m.lower == -np.inf


@pytest.mark.parametrize(
    ("changes", "arguments", "message"),
    [
        (
            {},
            {"band_hz": (1.9, 500.0)},
            "band from 1.9 Hz: the window of 2048 samples contains nothing below 1.95 Hz",
        ),
        (
            {},
            {"band_hz": (3000.0, 4000.0)},
            "no frequency of the estimate lies in 3000..4000 Hz; widen the band",
        ),
        (
            {"n_samples": 15_000},
            {},
            (
                "record of 3.75 s: too short for a verdict with a window of 2048 samples; record"
                " 3.84 s or more"
            ),
        ),
    ],
)
def test_judgement_without_ground_is_refused(changes, arguments, message):
    with pytest.raises(AnalysisError, match=re.escape(message)):
        judge(dataclasses.replace(exact_trial(mass_damper(), 0.99), **changes), **arguments)


def test_energy_of_a_damper_only_grows():
    velocity = np.sin(np.arange(8000) * 0.01)
    found = energy(2.0 * velocity, velocity, 4000.0)
    assert (found.minimum_j, found.minimum_s) == (0.0, 0.0)
    assert found.end_j == pytest.approx(2.0 * np.sum(velocity**2) / 4000.0)


def test_energy_finds_where_a_spring_was_released():
    velocity = np.r_[-np.ones(1000), np.ones(3000)]
    found = energy(np.ones(4000), velocity, 1000.0)
    assert (found.minimum_j, found.minimum_s, found.end_j) == pytest.approx((-1.0, 1.0, 2.0))


def test_held_force_does_exact_work_on_interval_means():
    """A wall of 1 kN/m sampled at 1 kHz gives away K T^2/2 of energy a turn; instants of the
    velocity would book the opposite.
    """
    time = np.arange(1001) * 1e-3
    x = 1e-3 * np.sin(2 * np.pi * 20.0 * time)
    force = -1000.0 * x[:-1]
    from_user = energy(-force, np.diff(x) * 1e3, 1e3).end_j
    assert from_user == pytest.approx(-0.5 * 1000.0 * np.sum(np.diff(x) ** 2), rel=1e-9)
    assert from_user < -3.9e-3


@pytest.mark.parametrize("high_hz", [2000.1, 5000.0, np.inf])
def test_band_beyond_half_the_sample_rate_is_refused(high_hz):
    """A verdict would name a band in which nothing was looked at."""
    assert judge(exact_trial(mass_damper(), 0.99), band_hz=(2.0, 2000.0)).band_hz == (2.0, 2000.0)
    with pytest.raises(
        AnalysisError, match=r"samples at 4000 Hz contain nothing above 2000 Hz; end there"
    ):
        judge(exact_trial(mass_damper(), 0.99), band_hz=(2.0, high_hz))


def test_radius_that_is_no_number_is_not_stable():
    found = judge(exact_trial(mass_damper(), 0.99), spectral_radius=float("nan"))
    assert (found.stability, found.answer) == ("unstable", "not_passive")


def test_few_frequencies_are_judged_without_looking_for_lines():
    force, velocity = record(mass_damper(0.008, 1.0, 50.0), 1, 80_000)
    found = judge(spa(force, velocity, frequency_hz=np.linspace(2.0, 500.0, 20)), channels=False)
    assert found.n_frequencies == 20
    assert found.stability == "unknown"


def test_sentence_says_how_fine_it_looks():
    """What is narrower is averaged with what is beside it: activity of a light mode may not
    show.
    """
    found = judge(exact_trial(mass_damper(), 0.99))
    assert found.resolution_hz == pytest.approx(4000.0 / 1536.0)
    assert "margin at a resolution of 2.6 Hz" in str(found)


@pytest.mark.parametrize(("at_hz", "share"), [(100.0, 0.002), (500.0, 0.053)])
def test_verdict_says_that_its_margin_is_of_the_recorded_channels(at_hz, share):
    """Force held and velocity averaged over 1/4000 s: 1 / sinc^2 of a damper's Re Z."""

    def impedance(f):
        return 1.0 + 0.5 * np.abs(f - at_hz) / at_hz + 2j * np.pi * f * 0.008

    found = judge(exact_trial(impedance, coherence=0.999))
    assert found.margin_ns_per_m.frequency_hz == pytest.approx(at_hz, abs=1.0)
    assert found.channels == found.judged.channels == "recorded"
    assert found.reads_high == pytest.approx(share, abs=0.0006)
    assert f"the recorded channels read Re Z of a rigid device {percent(found.reads_high)}" in str(
        found
    )


def test_every_range_that_was_judged_says_by_which_channels():
    told = Judged(2.0, 500.0)
    assert str(told) == "judged 2.00 to 500 Hz by the recorded channels"
    assert told.words.endswith(
        "by the recorded channels: Re Z of a rigid device reads 0.2 % high at 100 Hz, 5.3 % at"
        " 500 Hz"
    )
