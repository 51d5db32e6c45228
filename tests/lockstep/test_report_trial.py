"""Figures of trials: what is drawn is what was measured, as impedance and as admittance."""

import numpy as np
import pytest

from hapticd.model.scene import Excitation
from hapticd.settings.scene import load_scene
from hapticd.signal.assess import Criteria
from hapticd.zwidth.report.trial import trial_figure
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import EndReason, TrialEnd, TrialRecord
from hapticd.zwidth.trial import (
    MultisineLayout,
    TrialParams,
    impedance_csv,
    judged,
    multisine_like,
    plan_trial,
    run_trial,
)

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
        TrialRecord(force, velocity, 4000.0, "made", False),
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


def test_interval_is_said_to_be_of_the_random_error_alone(result):
    """The calibrations' uncertainty is not in it, as in the column of impedance.csv."""
    (legend,) = trial_figure(result).legends
    assert "95 % interval of the random error" in [one.get_text() for one in legend.get_texts()]
    assert "random_error_sd_ns_per_m" in impedance_csv(result.measured).splitlines()[0]


def test_multisine_is_drawn_where_it_was_excited_and_by_its_few_realisations():
    scene = load_scene("fig7")
    trial = Trial((50.0, 2.0, 0.0), excitation=multisine_like(Excitation("noise"), 500.0))
    found = run_trial(
        plan_trial(
            TrialParams(
                trial, scene, Criteria(estimator="h_force"), multisine=MultisineLayout(3, 1)
            )
        ),
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


@pytest.mark.filterwarnings("error")
def test_trial_in_which_nothing_moved_shows_its_record_and_no_impedance():
    nothing = np.zeros(80_000)
    record = TrialRecord(nothing, nothing, 4000.0, "made", False)
    result = judged(plan_trial(TrialParams(Trial(seconds=20.0))), record)
    figure = trial_figure(result)
    assert "no impedance to draw: force and velocity have nothing in common" in (
        figure.get_suptitle().replace("\n", " ")
    )
    assert len(figure.axes) == 2
    assert "perturb the device while it records" in str(result.verdict)


def test_escaped_trial_shows_its_record_and_no_impedance():
    force = np.random.default_rng(1).normal(0.0, 0.2, 80_000)
    ended = TrialEnd(EndReason.ESCAPE, "it ran away")
    record = TrialRecord(force, 0.1 * force, 4000.0, "made", False, ended=ended)
    figure = trial_figure(judged(plan_trial(TrialParams(Trial(seconds=20.0))), record))
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "force of the probe (N)",
        "velocity (m/s)",
    ]
    assert "ESCAPED, so there is no impedance to draw: it ran away" in figure.get_suptitle()
    assert figure.axes[0].lines[0].get_ydata().size == force.size
