"""Figures of envelopes: edges as impedance and as admittance, predictions, owners."""

import numpy as np
import pytest

from hapticd.settings.scene import load_scene
from hapticd.zwidth.outcomes import Conditions, Outcome, kept_frequencies
from hapticd.zwidth.report.envelope import envelope_figure, weightiest
from hapticd.zwidth.report.style import PARTS

pytest.importorskip("matplotlib")


def test_weightiest_part_has_a_sign():
    f = np.array([5.0, 5.0, 5.0, 5.0, 50.0, 50.0])
    owners = np.array(
        [[0, 0, 0], [100, 0.1, 0], [0, 2, 0], [0, -2, 0.001], [0, 0.1, 0.01], [0, 0.1, -0.01]],
        float,
    )
    assert weightiest(f, owners).tolist() == [-1, 0, 1, 3, 2, 4]
    assert [name for name, _ in PARTS] == ["K", "B > 0", "M > 0", "B < 0", "M < 0"]


def drawn(axis, label):
    """(x, y) of the line of that label."""
    line = next(one for one in axis.lines if one.get_label() == label)
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


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
        envelope_figure(Conditions(scene, 90.0, scene.noise), found, inverse=inverse)
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


def outcome(environment, passes=True, answer="passive", scale=1.0):
    """A trial with Z = scale (1 + j w m)."""
    z = scale * (1.0 + 2j * np.pi * kept_frequencies() * 0.001)
    numbers = np.column_stack((z.real, z.imag)), np.full(z.size, 0.001)
    return Outcome(environment, 0.0, answer, passes, 0.5, 0.4, 0.6, 10.0, 20.0, 0.01, 1.0, *numbers)
