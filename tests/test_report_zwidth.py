"""Figures of trials and envelopes: what is drawn is what was measured, as impedance and as
admittance.
"""

import numpy as np
import pytest

from hapticd.analysis.passive_set import PassiveSet
from hapticd.plant.scene import Excitation
from hapticd.report.envelope import envelope_figure
from hapticd.report.passive_set import slice_masses, slices
from hapticd.report.style import OFF, ON, PARTS, PREDICTED, of_levels, of_mean, tint
from hapticd.report.trial import trial_figure
from hapticd.settings.scene import load_scene
from hapticd.zwidth.map import LevelMap, MapResult
from hapticd.zwidth.outcomes import Conditions, Outcome, fly, kept_frequencies
from hapticd.zwidth.scenes import noise
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import Recorded
from hapticd.zwidth.trial import Layout, TrialParams, judged, multisine_like, plan_trial, run_trial

pytest.importorskip("matplotlib")


def drawn(axis, label):
    """(x, y) of the line of that label."""
    line = next(one for one in axis.lines if one.get_label() == label)
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def band(axis):
    """Lower and upper edge of the band over its frequencies: {f: (low, high)}."""
    corners = axis.collections[0].get_paths()[0].vertices
    return {
        f: (corners[corners[:, 0] == f, 1].min(), corners[corners[:, 0] == f, 1].max())
        for f in np.unique(corners[:, 0])
    }


@pytest.fixture(scope="module")
def result():
    force = np.random.default_rng(1).normal(0.0, 0.2, 80_000)
    velocity = force / 3.0 + np.random.default_rng(2).normal(0.0, 0.02, force.size)
    return judged(
        plan_trial(TrialParams(Trial(seconds=20.0))),
        Recorded(force, velocity, 4000.0, "made", False),
    )


def test_admittance_is_the_inverse_with_units_and_the_same_relative_interval(result):
    z, y = (trial_figure(result, admittance=inverse) for inverse in (False, True))
    assert [axis.get_ylabel() for axis in z.axes] == [
        "|Z| (N s/m)",
        "phase of Z (degrees)",
        "coherence",
    ]
    assert [axis.get_ylabel() for axis in y.axes] == [
        "|Y| (m/(N s) = s/kg)",
        "phase of Y (degrees)",
        "coherence",
    ]
    (f, size), (_, inverse) = (drawn(figure.axes[0], "measured") for figure in (z, y))
    assert np.allclose(size * inverse, 1.0)
    (_, phase), (_, turned) = (drawn(figure.axes[1], "measured") for figure in (z, y))
    assert np.allclose(phase, -turned)
    of_z = band(z.axes[0])
    of_y = band(y.axes[0])
    at = f[f.size // 2]
    assert of_z[at][0] * of_y[at][1] == pytest.approx(1.0)
    assert of_z[at][1] * of_y[at][0] == pytest.approx(1.0)
    assert of_z[at][0] < size[f.size // 2] < of_z[at][1]
    assert "20 s of noise" in z.get_suptitle()


def test_worst_point_lies_on_the_drawn_phase(result):
    for inverse, sign in ((False, 1.0), (True, -1.0)):
        figure = trial_figure(result, admittance=inverse)
        label = f"worst: margin {result.verdict.margin_deg.value:.2g} degrees"
        x, y = drawn(figure.axes[1], label)
        at = int(np.argmin(np.abs(result.measured.frequency_hz - x[0])))
        assert y[0] == pytest.approx(sign * result.measured.phase_deg[at])


def test_multisine_is_drawn_where_it_was_excited_and_by_its_few_realisations():
    scene = load_scene("fig7")
    trial = Trial((50.0, 2.0, 0.0), excitation=multisine_like(Excitation("noise"), 500.0))
    found = run_trial(
        plan_trial(TrialParams(trial, scene, estimator="h_force", multisine=Layout(3, 1))),
        engine_source(scene),
    )
    figure = trial_figure(found)
    f, size = drawn(figure.axes[0], "measured")
    assert f[-1] == 500.0
    at = int(np.searchsorted(f, 100.0))
    low, high = band(figure.axes[0])[f[at]]
    coherence = found.measured.coherence[found.measured.frequency_hz == f[at]][0]
    few = 2.776445 * np.sqrt((1.0 / coherence - 1.0) / 4.0)  # t of 4 degrees of freedom at 97.5 %
    assert np.log(high / size[at]) == pytest.approx(few, rel=1e-4)
    assert np.log(size[at] / low) == pytest.approx(few, rel=1e-4)
    assert "multisine: 3 realisations of 1 periods" in figure.get_suptitle()


def outcome(environment, passes=True, answer="passive", scale=1.0):
    """A trial with Z = scale (1 + j w m)."""
    z = scale * (1.0 + 2j * np.pi * kept_frequencies() * 0.001)
    numbers = np.column_stack((z.real, z.imag)), np.full(z.size, 0.001)
    return Outcome(environment, 0.0, answer, passes, 0.5, 0.4, 0.6, 10.0, 20.0, 0.01, 1.0, *numbers)


def test_envelope_as_admittance_exchanges_its_edges():
    scene = load_scene("theory")
    found = [
        (
            0.0,
            [
                outcome((0.0, 0.0, 0.01)),
                outcome((0.0, 1.0, 0.0), scale=3.0),
                outcome((9.0, 9.0, 0.0), passes=False, scale=9.0),
            ],
        )
    ]
    z, y = (
        envelope_figure(Conditions(scene, 90.0, noise(scene)), found, inverse=inverse)
        for inverse in (False, True)
    )
    assert [axis.get_ylabel() for axis in y.axes] == [
        "|Y| at the probe (m/(N s) = s/kg)",
        "",
        "phase of Y (degrees)",
    ]
    edges = [
        [np.asarray(line.get_ydata()) for line in figure.axes[0].lines[:2]] for figure in (z, y)
    ]
    assert np.allclose(edges[0][0] * edges[1][1], 1.0)
    assert np.allclose(edges[0][1] * edges[1][0], 1.0)
    assert np.allclose(edges[0][0] / edges[0][1], 3.0)
    assert "as admittance" in y.get_suptitle()
    assert "as admittance" not in z.get_suptitle()


def test_envelope_draws_what_is_predicted_of_the_same_trials():
    """Affine device: the prediction of one trial is its impedance."""
    scene = load_scene("theory")
    figure = envelope_figure(
        Conditions(scene, 90.0, noise(scene)),
        [(0.0, fly(Conditions(scene, 20.0), 0.0, np.zeros((1, 3))))],
    )
    measured = figure.axes[0].lines[0]
    predicted = figure.axes[0].lines[2]
    inside = measured.get_xdata() < 300.0
    expected = np.interp(measured.get_xdata(), predicted.get_xdata(), predicted.get_ydata())
    assert np.allclose(measured.get_ydata()[inside], expected[inside], rtol=0.05)
    assert (measured.get_color(), predicted.get_color()) == (OFF["color"], PREDICTED["color"])


def test_escaped_trial_shows_its_record_and_no_impedance():
    force = np.random.default_rng(1).normal(0.0, 0.2, 80_000)
    record = Recorded(force, 0.1 * force, 4000.0, "made", False, ended="escape: it ran away")
    figure = trial_figure(judged(plan_trial(TrialParams(Trial(seconds=20.0))), record))
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "force of the probe (N)",
        "velocity (m/s)",
    ]
    assert "ESCAPED, so there is no impedance to draw: it ran away" in figure.get_suptitle()
    assert figure.axes[0].lines[0].get_ydata().size == force.size


def test_slices_of_a_map_hold_the_mass_nearest_to_zero():
    for masses in (
        np.linspace(-0.03, 0.02, 11),
        np.linspace(-0.002, 0.06, 32),
        np.array([-0.03, -0.01]),
    ):
        margin = np.ones((2, 3, masses.size))
        found = PassiveSet((np.array([0.0, 1.0]), np.arange(3.0), masses), margin)
        shown = slices(
            MapResult(None, (LevelMap(0.0, found, np.zeros(margin.size, bool), (), None, 0),), 0)
        )
        assert int(np.argmin(np.abs(masses))) in shown
        assert len(shown) in (2, 3, 6)
        assert (np.diff(shown) > 0).all()


def test_slices_of_a_search_go_through_its_trials():
    tried = np.array([-0.009, 0.001, 0.0011, 0.0012, 0.004])
    assert slice_masses(tried, np.array([-0.01, -0.005, 0.0, 0.005]), 0.0005) == pytest.approx(
        [-0.009, -0.0025, 0.001]
    )


# --- one language ---------------------------------------------------------------------------------


def test_added_damping_is_blue_and_none_is_dashed():
    for levels, expected in (((0.0, 1.74), (OFF, ON)), ((1.74, 0.0), (ON, OFF)), ((3.5,), (ON,))):
        assert of_levels(levels) == list(expected)
    assert of_levels((0.0, 0.87, 1.74, 3.5))[2] == ON
    colours = [look["color"] for look in of_levels((0.0, 0.87, 1.74, 3.5))]
    assert len(set(colours)) == 4
    assert not set(colours) & {colour for _, colour in PARTS}


def test_interval_of_few_seeds_is_by_students_t():
    """t of 97.5 %: 12.7062 with one degree of freedom, 4.30265 with two, 2.36462 with seven."""
    assert of_mean(1) == 0.0
    assert of_mean(2) * np.sqrt(2.0) == pytest.approx(12.7062, rel=1e-4)
    assert of_mean(3) * np.sqrt(3.0) == pytest.approx(4.30265, rel=1e-4)
    assert of_mean(8) * np.sqrt(8.0) == pytest.approx(2.36462, rel=1e-4)


def test_tint_is_opaque_and_light():
    assert tint("#000000", 0.5) == "#808080"
    assert tint("#0072B2", 0.0) == "#ffffff"
