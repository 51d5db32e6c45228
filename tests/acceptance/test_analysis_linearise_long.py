"""Friction linearised: energy balance, scaling, dampers on ports, narrow resonances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.analysis_devices import display, rigid
from test_analysis_linearise import WHITE

from hapticd.model.linearise import (
    GAIN,
)
from hapticd.model.predict import predict


@given(st.floats(0.005, 0.06), st.floats(0.1, 3.0), st.floats(0.002, 0.02))
@settings(max_examples=20, deadline=None)
def test_friction_of_a_free_mass_follows_its_energy_balance(coulomb, viscous, mass):
    """White force on a mass: variance S / (4 m (b + bc)), so bc = g sqrt(4 m (b + bc) / S); the
    band ends at 1700 Hz.
    """
    found = predict(rigid(mass, viscous, coulomb=coulomb), [[0, 0, 0]], perturbation=WHITE)
    level = found.friction_ns_per_m[0]
    sd = found.velocity_sd[0]
    assert level * sd == pytest.approx(GAIN * coulomb, rel=1e-6)
    corner = (viscous + level) / (2 * np.pi * mass)
    assert sd == pytest.approx(
        np.sqrt(2.5e-5 / (4 * mass * (viscous + level)) * 2 / np.pi * np.arctan(1700 / corner)),
        rel=0.02,
    )


def test_edge_of_what_bursts_bear_has_no_teeth():
    """Largest K over B at one M rises, then falls: bursts see a narrow resonance between the
    lines too.
    """
    damping = np.linspace(0.0, 4.0, 41)
    stiffness = np.linspace(0.0, 400.0, 401)
    points = np.array([(k, b, -0.0024) for b in damping for k in stiffness])
    passive = predict(display(), points, perturbation=WHITE).passive.reshape(41, 401)
    edge = passive.sum(axis=1)
    assert np.array_equal(passive, np.arange(401) < edge[:, None])
    top = np.argmax(edge)
    assert (np.diff(edge[: top + 1]) >= 0).all()
    assert (np.diff(edge[top:]) <= 0).all()
