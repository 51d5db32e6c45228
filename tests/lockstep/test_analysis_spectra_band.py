"""A band is looked at from edge to edge, whatever lines the window has, and a verdict says from
where to where."""

import dataclasses

import numpy as np
import pytest
from support.spectral_trials import exact_trial, mass_damper, record, with_phase_margin

from hapticd.core.errors import AnalysisError
from hapticd.signal.assess import periodic
from hapticd.signal.covariances import Covariances
from hapticd.signal.spectra import SpectralStream, corrected, spa, spectra
from hapticd.signal.verdict import coherence_inside, half_width, judge

CHANNELS = ("velocity", "force", "cross")


def disagreement(found, wanted):
    """The largest relative one of velocity, force and cross spectrum."""
    pairs = [(getattr(found, name), getattr(wanted, name)) for name in CHANNELS]
    return max(np.abs(one - other).max() / np.abs(other).max() for one, other in pairs)


@pytest.mark.parametrize(
    ("rate_hz", "lag"), [(4000.0, 2048), (1000.0, 333), (7777.0, 512), (44_100.0, 4097)]
)
@pytest.mark.parametrize("places", [(2.048, 400.3), (1.5, 32.0), (0.01, 332.99), (7.25, 7.75)])
def test_edges_are_those_of_the_windowed_sum_of_covariances(rate_hz, lag, places):
    force, velocity = record(mass_damper(0.008, 1.0, 50.0), 3, 30_000)
    low, high = (min(place, lag - 0.3) * 0.5 * rate_hz / lag for place in places)
    found = spa(force, velocity, rate_hz, lag).band((low, high))
    assert (found.frequency_hz[0], found.frequency_hz[-1]) == (low, pytest.approx(high, rel=1e-12))
    assert (np.diff(found.frequency_hz) > 0.0).all()
    assert disagreement(found, spa(force, velocity, rate_hz, lag, found.frequency_hz)) < 1e-12


def geometric(ratio, angle, lag):
    """sum over t = 0..M of (ratio e^(-i angle))^t, in closed form."""
    q = ratio * np.exp(-1j * angle)
    return (1.0 - q ** (lag + 1)) / (1.0 - q)


def windowed(forward, backward, angle, lag):
    """The same on both sides of 0, under the lag window: three shifted sums, for 2 W = 1 +
    cos(pi t / M).
    """

    def both(at):
        return geometric(forward, at, lag) + geometric(backward, -at, lag) - 1.0

    return 0.5 * both(angle) + 0.25 * (both(angle - np.pi / lag) + both(angle + np.pi / lag))


def test_edges_have_the_closed_form_of_geometric_covariances():
    lag = 512
    rate_hz = 2000.0
    decays = np.arange(513)
    given = Covariances(0.97**decays, 0.9**decays, 0.95**decays, 0.8**decays, 100_000)
    found = spectra(given, rate_hz).band((4.4, 611.1))
    angle = 2.0 * np.pi * found.frequency_hz / rate_hz
    np.testing.assert_allclose(found.velocity, windowed(0.97, 0.97, angle, lag).real, rtol=1e-12)
    np.testing.assert_allclose(found.force, windowed(0.9, 0.9, angle, lag).real, rtol=1e-12)
    np.testing.assert_allclose(found.cross, windowed(0.95, 0.8, angle, lag), rtol=1e-12)


def test_a_line_is_not_interpolated():
    trial = exact_trial(mass_damper(), 0.99)
    line_hz = trial.frequency_hz[1]
    found = trial.band((3.0 * line_hz * (1.0 + 1e-12), 500.0))
    assert np.array_equal(found.cross, trial.cross[3:513])
    assert trial.band((4.0 * line_hz, 4.0 * line_hz)).frequency_hz.tolist() == [4.0 * line_hz]
    assert trial.band((4.3 * line_hz, 4.3 * line_hz)).frequency_hz.tolist() == [4.3 * line_hz]


def test_a_corrected_channel_is_interpolated_as_it_was_recorded():
    force, velocity = record(mass_damper(0.008, 1.0, 50.0), 4, 30_000)
    faults = {"skew_s": 60e-6, "high_pass_hz": 0.5}
    found = corrected(spa(force, velocity), **faults).band((2.2, 499.3))
    wanted = corrected(spa(force, velocity, frequency_hz=found.frequency_hz), **faults)
    assert disagreement(found, wanted) < 1e-12


def test_a_stream_is_judged_at_the_edges_of_a_trial():
    force, velocity = record(mass_damper(0.008, 1.0, 50.0), 5, 60_000)
    stream = SpectralStream()
    for first in range(0, force.size, 700):
        stream.add(force[first : first + 700], velocity[first : first + 700])
    found = stream.spectra().band((2.0, 333.3))
    wanted = spa(force, velocity).band((2.0, 333.3))
    assert np.array_equal(found.frequency_hz, wanted.frequency_hz)
    assert disagreement(found, wanted) < 1e-9


def test_a_band_without_lines_is_judged_at_its_edges():
    force, velocity = record(mass_damper(0.008, 1.0, 50.0), 6, 60_000)
    found = judge(spa(force, velocity), band_hz=(2.0, 2.5), channels=False)
    assert (found.first_judged_hz, found.last_judged_hz, found.n_frequencies) == (2.0, 2.5, 2)


def test_activity_below_the_first_line_is_found():
    """A device that is active from 1.5 to 2.4 Hz only: a verdict from 2 Hz names it, and so
    does the plain rule.
    """
    trial = exact_trial(mass_damper(), 0.99)
    active = np.where(np.abs(trial.frequency_hz - 1.953125) < 0.1, -3.0, 1.0)
    cross = active * trial.cross.real + 1j * trial.cross.imag
    found = judge(dataclasses.replace(trial, cross=cross), channels=False)
    assert found.answer == "not_passive"
    assert found.margin_ns_per_m.frequency_hz == 2.0
    assert not found.within_90_deg


def test_a_verdict_says_from_where_to_where_it_judged():
    found = judge(exact_trial(mass_damper(), 0.99))
    assert (found.first_judged_hz, found.last_judged_hz) == (2.0, 500.0)
    assert "judged 2.00 to 500 Hz" in str(found)


def test_multisines_are_judged_from_their_first_line_and_say_so():
    random = np.random.default_rng(7)
    force = np.tile(random.standard_normal((4, 1, 4096)), (1, 2, 1))
    trial = periodic(force, 0.7 * force + 1e-3 * random.standard_normal(force.shape), 4000.0)
    found = judge(trial, channels=False, estimator="h_force")
    assert (found.first_judged_hz, found.last_judged_hz, found.n_frequencies) == (
        3 * 4000.0 / 4096,
        500.0,
        510,
    )
    assert "judged 2.93 to 500 Hz" in str(found)
    assert trial.band((2.0, 500.0)).scatter((2.0, 500.0)) == trial.scatter((2.0, 500.0))


def test_chosen_frequencies_are_judged_as_they_are():
    force, velocity = record(mass_damper(0.008, 1.0, 50.0), 1, 80_000)
    found = judge(spa(force, velocity, frequency_hz=np.linspace(1.0, 499.0, 167)), channels=False)
    assert (found.first_judged_hz, found.last_judged_hz) == (4.0, 499.0)


def test_a_band_below_the_window_is_judged_only_where_it_is_asked_for():
    trial = exact_trial(mass_damper(), 0.99)
    first = trial.frequency_hz == trial.frequency_hz[1]
    active = dataclasses.replace(trial, cross=np.where(first, -1.0, 1.0) * trial.cross)
    asked = {"band_hz": (0.9, 500.0), "channels": False}
    assert judge(trial, below_window=True, **asked).within_90_deg
    found = judge(active, below_window=True, **asked)
    assert (found.first_judged_hz, found.within_90_deg) == (0.9, False)
    with pytest.raises(AnalysisError, match="contains nothing below"):
        judge(trial, **asked)


def drifting(seed, lag=256):
    """A free mass without friction, shaken for 90 s: its velocity wanders."""
    return spa(*record(with_phase_margin(0.0), seed, 45_000, noise_m_per_s=5e-3), 4000.0, lag)


def test_the_line_below_stands_for_an_edge_that_lost_its_power_to_a_drift():
    """Side lobes of what is at 0 Hz are negative between lines. A verdict then begins at the line
    below, so that the band has no gap, and says so."""
    replaced = 0
    for seed in range(40):
        trial = drifting(seed)
        asked = trial.band((16.0, 500.0))
        line = trial.frequency_hz[2]
        replaced += asked.frequency_hz[0] == line
        assert asked.frequency_hz[0] in (16.0, line)
        assert asked.velocity[0] >= 0.5 * trial.velocity[2:4].min()
        assert (
            judge(trial, band_hz=(16.0, 500.0), channels=False).first_judged_hz
            == asked.frequency_hz[0]
        )
    assert 10 < replaced < 40


def test_a_band_that_lost_its_edge_is_not_called_passive():
    """Power at 0 Hz takes the edge, which is no line. Where the window says nothing of the line
    below either, nothing is said of the band; what was seen to be active stays so.
    """
    trial = exact_trial(mass_damper(), 0.99)
    drift = dataclasses.replace(
        trial, velocity=np.where(trial.frequency_hz == 0.0, 1e6, 1.0) * trial.velocity
    )
    covered = judge(drift, band_hz=(3.4, 500.0), channels=False)
    assert (covered.first_judged_hz, covered.answer) == (trial.frequency_hz[3], "passive")
    asked = {"band_hz": (1.4, 500.0), "below_window": True, "channels": False}
    found = judge(drift, **asked)
    assert found.first_judged_hz == trial.frequency_hz[2]
    assert found.margin_ns_per_m.lower > 0.0
    assert found.answer == "undecided"
    assert "record longer" in str(found)
    active = dataclasses.replace(drift, cross=-drift.cross)
    assert judge(active, **asked).answer == "not_passive"


def test_the_line_above_stands_for_an_upper_edge_that_lost_its_power():
    trial = exact_trial(mass_damper(), 0.99)
    inside = trial.frequency_hz < 499.5
    steep = dataclasses.replace(trial, velocity=np.where(inside, 1e6, 1.0) * trial.velocity)
    band = steep.band((2.0, 500.1)).frequency_hz
    assert band[-1] == 500.1 or band[-1] == trial.frequency_hz[trial.frequency_hz > 500.1][0]


def test_an_edge_is_not_known_better_than_the_lines_beside_it():
    for seed in range(10):
        trial = drifting(seed)
        edge = trial.band((16.0, 16.0))
        lines = trial.part(slice(2, 4))
        freedom = trial.degrees_of_freedom
        beside = half_width(coherence_inside(trial, lines), freedom, 0.975)
        if edge.frequency_hz.size:
            known = coherence_inside(trial, edge)
            assert (half_width(known, freedom, 0.975) >= beside.max()).all()
