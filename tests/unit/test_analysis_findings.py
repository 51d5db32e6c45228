"""What can be wrong with a trial is found and named; what is right is left in peace."""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.spectral_trials import exact_trial, mass_damper, record

from hapticd.core.errors import AnalysisError
from hapticd.signal.findings import (
    ESCAPE_RATIO,
    coherence_findings,
    escape_findings,
    examine,
    outgrows_walk,
)
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import judge

RATE_HZ = 4000.0
SECONDS = 20
N = int(SECONDS * RATE_HZ)


def trial(seed=1, impedance=None):
    return record(impedance or mass_damper(0.008, 1.0, 50.0), seed, N)


def codes(findings):
    return [one.code for one in findings]


def test_calm_record_has_no_finding():
    force, velocity = trial()
    found = examine(force, velocity, RATE_HZ)
    assert found.findings == ()
    assert found.seconds == SECONDS
    assert found.velocity_sd_m_per_s == pytest.approx(velocity.std(), rel=1e-3)
    assert found.energy.end_j > 0.0


def test_clipped_channel_is_saturated():
    force, velocity = trial()
    found = examine(np.clip(force, -0.5, 0.5), velocity, RATE_HZ).findings
    assert codes(found) == ["saturation"]
    assert re.match(
        r"torque saturated at 0\.5 N in \S+ % of the samples; lower the perturbation",
        found[0].message,
    )
    assert found[0].voids


@pytest.mark.parametrize("periods", [1, 16])
def test_periodic_force_is_not_taken_for_saturated(periods):
    """A sine meets its largest value every period, a multisine once in 4096 samples."""
    time = np.arange(N)
    sine = np.sin(2 * np.pi * 100.0 * time / RATE_HZ)
    multisine = np.tile(np.random.default_rng(6).standard_normal(4096), N // 4096 + 1)[:N]
    for force in (sine, multisine):
        assert "saturation" not in codes(examine(periods * force, trial()[1], RATE_HZ).findings)


def test_limit_of_the_channel_finds_a_single_sample():
    force, velocity = trial()
    assert examine(force, velocity, RATE_HZ, velocity_limit_m_per_s=2.0).findings == ()
    velocity[100] = 2.0
    found = examine(force, velocity, RATE_HZ, velocity_limit_m_per_s=2.0).findings
    assert found[0].message.startswith("velocity saturated at 2 m/s")


def test_escape_is_found_with_its_time():
    force, velocity = trial()
    velocity[int(12.5 * RATE_HZ) :] *= 50.0
    found = [one for one in examine(force, velocity, RATE_HZ).findings if one.code == "escape"]
    assert found[0].message.startswith("escape at 12 s: the velocity grew from 0.0")
    assert found[0].unstable
    assert judge(spa(force, velocity), examine(force, velocity, RATE_HZ)).answer == "not_passive"


def test_limit_cycle_is_an_oscillation():
    force, velocity = trial()
    cycle = 0.05 * np.sin(2 * np.pi * 41.3 * np.arange(N) / RATE_HZ)
    found = coherence_findings(spa(force, velocity + cycle), (2.0, 500.0))
    message = next(one.message for one in found if one.code == "oscillation")
    assert re.match(
        r"oscillation at 41(\.\d)? Hz: \S+ % of the velocity's power is a line that the"
        r" perturbation does not",
        message,
    )
    assert judge(spa(force, velocity + cycle)).stability == "unstable"


def test_resonance_under_noise_is_no_oscillation():
    force, velocity = record(mass_damper(0.008, 0.2, 100.0), 2, N, noise_m_per_s=5e-3)
    assert "oscillation" not in codes(coherence_findings(spa(force, velocity), (2.0, 500.0)))


@pytest.mark.parametrize(
    "drift", [lambda v: v + 0.03, lambda v: v + np.linspace(-0.02, 0.02, v.size)]
)
def test_offset_and_trend_are_drift(drift):
    force, velocity = trial()
    found = examine(force, drift(velocity), RATE_HZ).findings
    assert codes(found) == ["drift"]
    assert re.match(
        r"velocity drift: offset \S+ m/s, trend \S+ m/s over the record, noise \S+ m/s; zero the"
        r" sensor",
        found[0].message,
    )


def test_perturbation_that_changes_is_drift():
    force, velocity = trial()
    force[N // 2 :] *= 1.5
    found = examine(force, velocity, RATE_HZ).findings
    assert re.match(
        r"perturbation drift: \S+ rms in the first half, \S+ in the second; the trial mixes",
        found[0].message,
    )


def test_low_coherence_is_named_with_its_range():
    force, velocity = record(mass_damper(0.008, 1.0), 3, N, noise_m_per_s=0.1)
    found = coherence_findings(spa(force, velocity), (2.0, 500.0))
    assert codes(found) == ["low_coherence"]
    assert re.match(
        r"low coherence: below 0\.5 at \d+ % of the frequencies, from \S+ to 500 Hz; perturb more"
        r" strongly",
        found[0].message,
    )


def test_low_coherence_says_what_spa_makes_of_the_size():
    """The paper's estimator shrinks |Z| by the coherence; with the force as the input it does
    not.
    """
    noisy = exact_trial(mass_damper(0.008, 1.0), 0.31)
    (by_spa,), (by_force,) = (
        coherence_findings(noisy, (2.0, 500.0), estimator) for estimator in ("spa", "h_force")
    )
    assert re.search(
        r"; \|Z\| by spa reads low there by the coherence, at \S+ Hz to 0\.31 of its value, while",
        by_spa.message,
    )
    assert by_spa.message.endswith("the sign of Re Z stay; h_force does not shrink it")
    assert "|Z|" not in by_force.message
    assert by_spa.message in str(judge(noisy, channels=False))
    assert by_force.message in str(judge(noisy, channels=False, estimator="h_force"))


def test_low_coherence_at_the_lower_edge_is_named():
    """Read as "2 Hz", but 1.95 Hz, the line beside which the band begins."""
    whole, poor = (exact_trial(mass_damper(0.008, 1.0), coherence) for coherence in (0.99, 0.46))
    at_edge = np.where(np.arange(whole.frequency_hz.size) == 2, poor.velocity, whole.velocity)
    (found,) = coherence_findings(replace(whole, velocity=at_edge), (2.0, 500.0))
    assert "from 1.95 to 1.95 Hz" in found.message
    assert "to 0.46 of its value" in found.message
    assert coherence_findings(replace(whole, velocity=at_edge), (5.0, 500.0)) == ()


def test_short_record_is_refused():
    with pytest.raises(
        AnalysisError,
        match=re.escape("record of 1 s: at least 2 s are needed to separate noise from drift"),
    ):
        examine(np.ones(4000), np.ones(4000), RATE_HZ)


def cut(force, velocity, changed):
    """The last quarter and more of the record changed, in ways that happen."""
    last = slice(int(0.6 * N), None)
    force = force.copy()
    velocity = velocity.copy()
    if changed == "dead":
        velocity[last] = velocity[last.start]
    if changed == "silent":
        force[last], velocity[last] = (
            0.0,
            1e-6 * np.random.default_rng(5).standard_normal(N - last.start),
        )
    return force, velocity


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ("dead", r"velocity stood still in 40 % of the record, from 12 s on"),
        ("silent", r"no perturbation in 40 % of the record, from 12 s on"),
    ],
)
def test_part_without_a_signal_is_no_escape_and_leaves_nothing_to_decide(changed, words):
    """A quarter of silence makes all the rest look loud, and counts as if it were knowledge."""
    found = examine(*cut(*trial(), changed), RATE_HZ).findings
    assert not any(one.unstable for one in found)
    (one,) = (one for one in found if one.code == "dropout")
    assert re.search(words, one.message)
    assert one.voids
    assert (
        judge(spa(*cut(*trial(), changed)), examine(*cut(*trial(), changed), RATE_HZ)).answer
        == "undecided"
    )


def test_escape_in_the_last_part_of_a_second_is_seen():
    force, velocity = trial()
    force = force[: -int(0.3 * RATE_HZ)]
    velocity = velocity[: -int(0.3 * RATE_HZ)]
    velocity[-int(0.6 * RATE_HZ) :] *= 20.0
    whole = velocity[: velocity.size // 4000 * 4000]
    whole[-4000:] = whole[:4000]  # only what is after the last whole second runs away
    assert "escape" in codes(examine(force, velocity, RATE_HZ).findings)


def test_line_too_small_for_a_verdict_is_named_all_the_same():
    """Hum of a sensor, or a limit cycle that the noise hides: the answer stays, with the line
    beside it.
    """
    force, velocity = trial()
    hum = velocity + 0.5 * velocity.std() * np.sin(2 * np.pi * 1203.0 * np.arange(N) / RATE_HZ)
    (found,) = coherence_findings(spa(force, hum), (2.0, 500.0))
    assert found.code == "line"
    assert not found.voids
    assert not found.unstable
    assert re.search(r"line at 1\.2e\+03 Hz: 1\d % of the velocity's power", found.message)
    assert coherence_findings(spa(force, velocity), (2.0, 500.0)) == ()


def ringing(growth_per_s: float, seed: int, seconds: int = 90) -> np.ndarray:
    """Size (n,), second by second, of a motion that noise drives and that grows by that rate."""
    random = np.random.default_rng(seed)
    steps = random.standard_normal((seconds, 2)) @ np.array([1.0, 1j])
    size = 0.0j
    sizes = []
    for step in steps:
        size = size * np.exp(growth_per_s) + step
        sizes.append(abs(size))
    return np.array(sizes)


@pytest.mark.parametrize("ring_s", [5.0, 35.0, 1000.0])
@pytest.mark.parametrize("seed", range(5))
def test_ring_that_noise_drives_does_not_outgrow_a_walk(ring_s, seed):
    assert not outgrows_walk(ringing(-1.0 / ring_s, seed))


@pytest.mark.parametrize("growth_s", [1.0, 5.0, 15.0])
@pytest.mark.parametrize("seed", range(5))
def test_motion_that_grows_by_itself_outgrows_a_walk(growth_s, seed):
    assert outgrows_walk(ringing(1.0 / growth_s, seed))


def test_motion_that_swells_as_a_walk_leaves_it_undecided():
    sizes = ringing(-1e-3, 1)
    assert sizes.max() > ESCAPE_RATIO * np.quantile(sizes, 0.25)
    (found,) = escape_findings(sizes, 1.0)
    assert (found.code, found.unstable, found.voids) == ("swells", False, True)
