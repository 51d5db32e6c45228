"""What a model predicts for the directed search: Re Z as the prediction has it, and headroom
against escape.
"""

import numpy as np
import pytest

from hapticd.model.compose import compose
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import spectral_radius
from hapticd.model.predict import predict, predicted_impedance, with_equivalent_damping
from hapticd.settings.scene import load_scene
from hapticd.zwidth.acquisition import ModelPrior
from hapticd.zwidth.surrogate import Box

F = np.array([2.9296875, 8.7890625, 40.0390625, 90.8203125, 250.0, 499.0234375])
BOX = Box((0.0, 0.0, -0.02), (1500.0, 9.0, 0.03))
POINTS = BOX.to_environment(np.random.default_rng(2).random((300, 3)))
WEIR = load_scene("fig4")
THEORY = load_scene("theory")


def prior_of(scene, damping):
    return ModelPrior(compose(scene), BOX, F, damping, scene.environment.filters, Perturbation())


@pytest.mark.parametrize("damping", [0.0, 1.74])
def test_resistance_is_that_of_the_prediction(damping):
    near = BOX.to_environment(0.25 * np.random.default_rng(3).random((12, 3)) + [0.0, 0.0, 0.35])
    found = prior_of(WEIR, damping).resistance(near)
    for point, row in zip(near, found, strict=True):
        z = predicted_impedance(
            compose(WEIR), point, F, damping, WEIR.environment.filters, Perturbation()
        )
        assert np.allclose(row, z.real, atol=0.01 * np.abs(z).max())


def test_headroom_is_the_friction_that_the_loop_can_lose():
    """Left with the share 1/3 - headroom of its friction, the loop is at the edge of stability:
    spectral radius 1.
    """
    model = compose(WEIR)
    chosen = WEIR.environment.filters
    friction = predict(compose(WEIR), POINTS, 1.74, perturbation=Perturbation())
    found = prior_of(WEIR, 1.74).headroom(POINTS)
    share = 1.0 / 3.0 - found
    between = np.flatnonzero((share > 0.02) & (share < 0.9))
    assert len(between) > 8
    for place in between:
        edge = [
            spectral_radius(
                with_equivalent_damping(model, (factor * friction.friction_ns_per_m[place],)),
                POINTS[place],
                1.74,
                chosen,
            )[0]
            for factor in (share[place] - 0.15, share[place] + 0.15)
        ]
        assert edge[0] > 1.0 > edge[1]


def test_headroom_falls_on_the_way_across_the_boundary():
    """Damped, K = M = 0: passive up to about 8 N s/m; deep inside, where nothing escapes, it is
    not followed.
    """
    outwards = np.column_stack((np.zeros(12), np.linspace(6.0, 9.0, 12), np.zeros(12)))
    assert (np.diff(prior_of(WEIR, 1.74).headroom(outwards)) <= 0.0).all()


def test_without_friction_headroom_says_stable_or_not():
    """A rigid display without friction: nothing to lose, so the loop is stable with all
    headroom or with none.
    """
    model = compose(THEORY)
    points = POINTS[POINTS[:, 0] > 50.0]
    found = prior_of(THEORY, 0.0).headroom(points)
    radius = spectral_radius(model, points, 0.0, THEORY.environment.filters)
    clear = np.abs(radius - 1.0) > 5e-3
    assert set(np.sign(found[clear])) == {-1.0, 1.0}
    assert np.mean((found > 0.0) == (radius < 1.0)) > 0.95
    assert np.abs(found[clear]).min() == pytest.approx(1.0)


def test_the_same_points_are_not_computed_twice(monkeypatch):
    known = prior_of(WEIR, 0.0)
    first = known.resistance(POINTS)
    monkeypatch.setattr(known, "_linearised", lambda _: pytest.fail("computed again"))
    known.headroom(POINTS.copy())
    assert known.resistance(POINTS) is first
