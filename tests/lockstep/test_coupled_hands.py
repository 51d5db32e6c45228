"""Every environment called passive and stable stays stable in 1,000 random passive hands (Colgate
and Hogan 1988).

Not pair by pair: 1,701 environments in 1,000 hands are a minute of eigenvalues (made once,
ADR-0017). Instead, as `model.coupled` says, a circle at each angle that no hand leaves (all
1,000 are tried, by the exact pulse transfer of device and hand), and which no called environment's
-1/C enters (all are tried). Eigenvalues then check that this is so: of environments at the edge in
all hands, and of random pairs, inside and outside. And it can fail: 5 % outside a hand shakes the
display.
"""

import re

import numpy as np
import pytest
from support.analysis_devices import rigid
from support.coupled_hands import LEVEL, hands

from examples.weir2008.paper import MAIN
from examples.weir2008.run import conditions
from hapticd.core.errors import AnalysisError
from hapticd.model.coupled import Hand, coupled_stable, held_by
from hapticd.model.loop import responses
from hapticd.model.theorem import lifted_system


def test_random_hands_are_of_many_kinds():
    size = [abs(hand.impedance(np.array([20j * np.pi]))[0]) for hand in hands()]
    assert max(size) / min(size[place] for place in range(1000) if size[place] > 0.0) > 1e9
    assert sum(not hand.damping_ns_per_m.any() for hand in hands()) > 20
    assert sum(not hand.stiffness_n_per_m.sum(axis=0).any() for hand in hands()) > 50
    assert sum(bool(hand.loose.any()) for hand in hands()) > 300
    assert max(hand.mass_kg.size for hand in hands()) >= 9


@LEVEL
def test_held_device_has_both_impedances(level):
    """1/Y of the composed model, states and all, is the device's 1/Y and Z_h."""
    model = conditions(MAIN).display.model
    f = np.geomspace(0.1, 3000.0, 40)
    alone = 1.0 / responses(model, f, level).velocity[0, 1]
    for hand in hands()[:100]:
        together = 1.0 / responses(held_by(model, hand), f, level).velocity[0, 1]
        parts = alone, hand.impedance(2j * np.pi * f)
        assert (
            np.max(np.abs(together - parts[0] - parts[1]) / (np.abs(parts[0]) + np.abs(parts[1])))
            < 1e-6
        )


def test_nothing_is_withstood_without_damping():
    assert not coupled_stable(lifted_system(rigid(viscous=0.0)), [[10.0, 0.0, 0.0]])[0]
    assert coupled_stable(lifted_system(rigid(viscous=0.0)), [[0.0, 0.0, 0.0]])[0]


@pytest.mark.parametrize(
    ("mass", "damping", "stiffness", "why"),
    [
        ([-0.1], [[1.0]], [[1.0]], "mass matrix has the eigenvalue -0.1 is"),
        ([0.1], [[-1.0]], [[1.0]], "damping matrix has the eigenvalue -1 is"),
        (
            [0.1, 0.1],
            np.eye(2),
            [[1.0, 2.0], [2.0, 1.0]],
            "stiffness matrix has the eigenvalue -1 is",
        ),
        ([0.1, 0.1], np.eye(2), [[1.0, 0.5], [0.0, 1.0]], "not passive; it takes symmetric, >= 0"),
        (
            [0.1, 0.0],
            np.diag([1.0, 0.0]),
            np.eye(2),
            "without mass and without damper; give it one of them",
        ),
    ],
)
def test_active_hand_is_refused(mass, damping, stiffness, why):
    with pytest.raises(AnalysisError, match=re.escape(why)):
        Hand(np.array(mass), np.array(damping), np.array(stiffness))
