"""Numbers for a display against closed forms, and conditions under which two may be compared."""

import dataclasses

import numpy as np
import pytest
from support.analysis_devices import display
from support.envelopes import EnvelopeTrial, envelope
from test_analysis_compare import SOFT

from hapticd.model.linearise import Perturbation
from hapticd.model.predict import predict, predicted_impedance
from hapticd.zwidth.compare import (
    EnvelopeConditions,
    check_alike,
    normalised,
    stiffness_damping_area,
)
from hapticd.zwidth.passive_set import PassiveSet, grid


def measured(scale):
    """Envelope and set of so many displays, each perturbed alike, as the prediction sees them."""
    model = display(scale=scale)
    push = Perturbation(scale**2 * 2.5e-5, 1700.0)
    f = np.geomspace(2.0, 500.0, 60)
    edges = []
    for point in ((0, 0, 0), (60, 1, 0), (0, 2, 0), (0, 0, -0.005)):
        z = predicted_impedance(model, scale * np.array(point), f, perturbation=push)
        exact = dataclasses.replace(
            SOFT.impedance,
            frequency_hz=f,
            impedance_ns_per_m=z,
            sd_ns_per_m=np.zeros(60),
            coherence=np.ones(60),
            noise=z.real,
            noise_sd=z.real,
        )
        edges.append(EnvelopeTrial(str(point), exact, SOFT.verdict))
    axes = tuple(
        scale * axis
        for axis in (np.linspace(0, 300, 13), np.linspace(-1, 5, 13), np.linspace(-0.01, 0.01, 9))
    )
    found = PassiveSet.of(axes, predict(model, grid(axes), perturbation=push).decided_margin)
    conditions = EnvelopeConditions(
        f"{scale:g} displays",
        scale * 0.008,
        probe_mass_kg=scale * 0.003,
        perturbation_psd_n2_per_hz=push.psd_n2_per_hz,
    )
    return conditions, envelope(edges), found


def test_two_displays_bolted_together_are_no_better_display():
    """The paper's paradox: K, B and M double, so does every stiffness-damping plot; per mass
    nothing has changed.
    """
    (one, single, small), (two, double, large) = measured(1.0), measured(2.0)
    for mine, other in zip(
        dataclasses.astuple(small.limits()), dataclasses.astuple(large.limits()), strict=True
    ):
        assert other == pytest.approx(tuple(2.0 * value for value in mine))
    assert double.upper.value == pytest.approx(2.0 * single.upper.value, rel=1e-6)
    assert double.lower.value == pytest.approx(2.0 * single.lower.value, rel=1e-6)
    assert stiffness_damping_area(large) == pytest.approx(
        4.0 * stiffness_damping_area(small), rel=1e-3
    )
    assert large.volume() == pytest.approx(8.0 * small.volume(), rel=0.01)
    assert double.width_db() == pytest.approx(single.width_db(), abs=1e-5)
    assert check_alike([one, two]) == ()
    a = normalised(single, one.mass_kg)
    b = normalised(double, two.mass_kg)
    assert b.upper.value == pytest.approx(a.upper.value, rel=1e-6)
    assert b.lower.value == pytest.approx(a.lower.value, rel=1e-6)
