"""`hapticd zwidth predict`: what theory says of one environment, and where its parts differ."""

import numpy as np
import pytest
from test_cli_zwidth_predict import DIFFERING, said, told

from hapticd.model.coupled import Hand, held_by
from hapticd.model.loop import spectral_radius
from hapticd.settings.scene import load_scene
from hapticd.zwidth.sources import display


def test_theorem_and_prediction_may_differ(capsys):
    """Friction carries it at a trial's amplitude; without, a hand shakes it. Its eigenvalues
    say so.
    """
    found = told(DIFFERING, capsys)
    assert found["prediction"]["passive"]
    assert found["theorem"]["margin_ns_per_m"] < 0.0
    assert not found["theorem"]["passive"]
    assert not found["withstands_every_hand"]
    hand = Hand(
        *(
            np.array(found["hand"][name])
            for name in ("mass_kg", "damping_ns_per_m", "stiffness_n_per_m")
        )
    )
    fig4 = display(load_scene("fig4"))
    radius = spectral_radius(
        held_by(fig4.model, hand), np.array([[800.0, 1.0, 0.02]]), 1.74, fig4.filters
    )[0]
    assert radius == pytest.approx(found["hand"]["spectral_radius"])
    assert radius > 1.001
    assert "the theorem differs" in said(DIFFERING, capsys)
