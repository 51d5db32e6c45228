"""Figures of envelopes: edges as impedance and as admittance, predictions, owners."""

import numpy as np

from hapticd.settings.scene import load_scene
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.report.envelope import envelope_figure
from hapticd.zwidth.report.style import OFF, PREDICTED


def test_envelope_draws_what_is_predicted_of_the_same_trials():
    """Affine device: the prediction of one trial is its impedance."""
    scene = load_scene("theory")
    figure = envelope_figure(
        Conditions(scene, 90.0, scene.noise),
        [(0.0, run_trials(Conditions(scene, 20.0), 0.0, np.zeros((1, 3))))],
    )
    measured = figure.axes[0].lines[0]
    predicted = figure.axes[0].lines[2]
    inside = measured.get_xdata() < 300.0
    expected = np.interp(measured.get_xdata(), predicted.get_xdata(), predicted.get_ydata())
    assert np.allclose(measured.get_ydata()[inside], expected[inside], rtol=0.05)
    assert (measured.get_color(), predicted.get_color()) == (OFF["color"], PREDICTED["color"])
