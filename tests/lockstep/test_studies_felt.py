"""Felt impedance and noise at rest of laws without an impedance: on linear laws they are those of
the theory, and a law plays in CPython as in a kernel.
"""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from hapticd.model.effects import Coulomb, Encoder
from hapticd.model.scene import DampingStep
from hapticd.settings.scene import load_scene
from hapticd.studies import remedies
from hapticd.studies.port_energy import felt, noise_at_rest, played
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.parts import LawPart

ASKED = (300.0, 0.4)
COUNT_M = 1e-6
RATE_HZ = 1000.0
LEVEL_NS_PER_M = 0.87
PARTS = [
    LawPart.foaw(COUNT_M, RATE_HZ),
    LawPart.levant(50.0, RATE_HZ),
    LawPart.observer(),
    LawPart.held_observer(),
    LawPart.tank(1e-5, 0.1, RATE_HZ),
]


def bench():
    """A mass of 8 g with 1 N s/m, dry friction, an encoder and active damping."""
    scene = load_scene("theory")
    more = Coulomb(rotor_n=0.05), Encoder(quantum_m=COUNT_M)
    damped = (DampingStep(0.0, LEVEL_NS_PER_M),)
    return replace(scene, effects=(*scene.effects, *more), active_damping=damped)


def test_felt_impedance_of_a_linear_law_is_that_of_the_theory_without_dry_friction():
    found = felt(bench(), (), ASKED, 0.1)
    expected = remedies.rendered(bench(), ASKED, remedies.felt_law(ASKED, None))
    assert found == pytest.approx(expected, rel=0.01)


def test_felt_impedance_of_a_law_that_diverges_is_no_number():
    assert np.isnan(felt(bench(), (), (1e6, 0.0), 0.1)).all()


def test_noise_of_a_linear_law_is_that_of_the_theory():
    found = noise_at_rest(bench(), (), ASKED)
    law = remedies.felt_law(ASKED, None)
    assert found == pytest.approx(remedies.noise_at_rest(bench(), law), rel=0.05)
    spring = noise_at_rest(bench(), (), (ASKED[0], 0.0))
    assert spring == pytest.approx(ASKED[0] * COUNT_M / sqrt(12.0), rel=0.03)


def test_noise_of_an_observer_of_the_held_force_is_many_times_that_of_the_law():
    """Of a spring, which leaks in every step: a debt is divided by part of a count."""
    spring = (ASKED[0], 0.0)
    quiet, loud = (
        noise_at_rest(bench(), parts, spring) for parts in ((), (LawPart.held_observer(),))
    )
    assert loud > 10.0 * quiet


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.kind)
def test_a_law_plays_as_in_a_kernel(part):
    wave = 0.5 * np.sin(2.0 * pi * 7.0 * np.arange(4000) / 4000.0)
    trial = simulate(bench(), [[*ASKED, 0.0]], 0.5, excitation=wave, keep="ticks", parts=(part,))
    positions, forces = trial.traces(0)
    assert played(bench(), (part,), ASKED, positions).tobytes() == forces.tobytes()
    assert abs(forces).max() > 0.01
