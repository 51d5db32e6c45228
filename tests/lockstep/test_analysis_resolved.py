"""A resonance is no instability, however narrow; a limit cycle is one. What decides is the record,
not the window.

Devices are the rigid display of theory with a probe: 8 g, sampled at 1 kHz without delay, passive
up to K = 2 b / T.
"""

import numpy as np
import pytest
from support.analysis_resolved import (
    NOISE,
    T,
    display,
    least_resistance,
    outcomes,
)

from hapticd.core.arrays import Floats
from hapticd.core.units import DEFAULT_BAND_HZ as BAND
from hapticd.model.scene import Excitation, Scene
from hapticd.signal.resolved import resolved, unresolved
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import Verdict, judge
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import TrialRecord
from hapticd.zwidth.trial import TrialParams, judged, plan_trial
from hapticd.zwidth.watch import TrialMonitor, Watch


def recorded_of(
    device: Scene, stiffness: float, seed: int, source: Excitation = NOISE
) -> tuple[Floats, Floats]:
    """Force and velocity of a trial of 90 s at 4 kHz."""
    found = simulate(
        device,
        [[stiffness, 0.0, 0.0]],
        90.0,
        seed,
        excitation=source,
        start=(0.0, 0.0),
        keep="records",
    )
    force, velocity = (np.asarray(channel, np.float64) for channel in found.record(0))
    return force, velocity


def verdict(device: Scene, stiffness: float, seed: int, source: Excitation = NOISE) -> Verdict:
    """Of a trial whose record was kept."""
    plan = plan_trial(TrialParams(Trial((stiffness, 0.0, 0.0), seconds=90.0), device))
    channels = recorded_of(device, stiffness, seed, source)
    return judged(plan, TrialRecord(*channels, 4000.0, "engine", True)).verdict


def codes(found: Verdict) -> list[str]:
    return [one.code for one in found.findings]


@pytest.mark.parametrize("viscous", [0.12, 0.3, 1.0])
@pytest.mark.parametrize("share", [0.5, 0.83, 0.97])
def test_display_inside_its_limit_is_passive_by_its_true_margin(viscous, share):
    device = display(viscous)
    stiffness = share * 2.0 * viscous / T
    (found,) = outcomes(device, [stiffness])
    assert found.answer == "passive"
    assert found.passes
    assert found.margin_lower <= least_resistance(device, stiffness) <= found.margin_upper
    assert found.margin_upper - found.margin_lower < 0.01 * viscous


@pytest.mark.parametrize("stiffness", [100.0, 300.0, 600.0])
def test_resonance_of_the_device_is_no_line(stiffness):
    found = verdict(display(1.0, mass_kg=0.023), stiffness, 1)
    assert found.answer == "passive"
    assert not {"line", "oscillation", "unresolved"} & set(codes(found))


def test_verdict_says_how_and_where_it_was_judged_again():
    found = verdict(display(0.12), 200.0, 1)
    assert "stable, spectral radius 0.998" in str(found)
    assert "leakage: |Z| reads about" in str(found)
    assert (
        "motion narrower than the window of 2048 samples: judged again by the record's own"
        " frequencies, 0.011 Hz apart, by local polynomials 5.9 Hz wide from 1.95 to 500 Hz"
        in str(found)
    )


def test_escape_by_the_seconds_is_none_where_the_perturbation_drives_it():
    """Its resonance rings for 4 s, so it swells and fades with the noise; beyond the limit the
    same device runs away.
    """
    device = display(0.12)
    inside, beyond = (verdict(device, stiffness, 1) for stiffness in (232.8, 242.4))
    assert "swells" in codes(inside)
    assert "swells and fades" in str(inside)
    assert (inside.answer, inside.stability) == ("passive", "stable")
    assert (beyond.answer, beyond.stability) == ("not_passive", "unstable")


def test_without_a_record_a_line_that_is_partly_explained_is_left_open():
    device = display(0.12)
    found = simulate(
        device, [[216.0, 0.0, 0.0]], 90.0, 1, excitation=NOISE, start=(0.0, 0.0), keep="records"
    )
    seen = judge(spa(*found.record(0)), channels=False)
    assert (seen.answer, seen.stability) == ("undecided", "unknown")
    assert "narrower than the window of 2048 samples: a resonance or a limit cycle" in str(seen)


def test_images_of_the_force_explain_what_the_sampled_law_answers():
    """The law samples at 1 kHz: what the force does at f + 1 kHz moves the device at f. With it
    the interval is far narrower.
    """
    device = display(1.0)
    stiffness = 1800.0
    found = simulate(
        device, [[stiffness, 0.0, 0.0]], 90.0, 1, excitation=NOISE, start=(0.0, 0.0), keep="records"
    )
    whole = spa(*found.record(0))
    needed = unresolved(whole, BAND, linear=True)
    blind, aware = (
        judge(
            resolved(*found.record(0), whole, needed, BAND, rate_hz),
            channels=False,
        ).margin_ns_per_m
        for rate_hz in (None, 1.0 / T)
    )
    assert aware.upper - aware.lower < 0.05 * (blind.upper - blind.lower)
    assert aware.lower <= least_resistance(device, stiffness) <= aware.upper
    assert blind.lower <= least_resistance(device, stiffness) <= blind.upper


def test_a_trial_is_not_ended_by_a_verdict_that_its_record_would_change():
    """Of this passive display the window says "not passive" after 20 s."""
    force, velocity = recorded_of(display(0.3), 450.0, 1)
    sentinel = TrialMonitor(Watch(until_decided=True), 4000.0)
    assert sentinel.see(force, velocity) is None


def test_a_result_shows_the_impedance_that_its_verdict_was_found_by():
    device = display(1.0)
    plan = plan_trial(TrialParams(Trial((1950.0, 0.0, 0.0), seconds=90.0), device))
    found = judged(plan, TrialRecord(*recorded_of(device, 1950.0, 2), 4000.0, "engine", True))
    assert any(finding.code == "resolved" for finding in found.verdict.findings)
    margin = found.verdict.margin_ns_per_m
    at = found.measured.frequency_hz == margin.frequency_hz
    assert found.measured.impedance_ns_per_m.real[at] == pytest.approx(margin.value, rel=1e-12)
