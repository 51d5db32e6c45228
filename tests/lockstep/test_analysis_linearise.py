"""Friction linearised: energy balance, scaling, dampers on ports, narrow resonances."""

import numpy as np
import pytest
from support.analysis_devices import display

from hapticd.model.linearise import (
    CoupledFrictionPorts,
    Perturbation,
    SingleFrictionPort,
    add_port_dampers,
    density_weights,
    port_admittance,
)
from hapticd.model.loop import close_loop
from hapticd.model.predict import predict, with_equivalent_damping

F = np.array([0.5, 2.0, 10.0, 47.0, 120.0, 333.0, 499.0, 700.0, 1500.0])
WHITE = Perturbation(2.5e-5, 1700.0)


def test_only_friction_squared_over_density_counts():
    point = [[60.0, 1.0, 0.002]]
    one = predict(display(coulomb=0.02), point, perturbation=Perturbation(1e-5, 1700.0))
    other = predict(display(coulomb=0.06), point, perturbation=Perturbation(9e-5, 1700.0))
    assert one.friction_ns_per_m == pytest.approx(other.friction_ns_per_m)
    assert one.margin_ns_per_m == pytest.approx(other.margin_ns_per_m)


def test_friction_on_the_slider_is_felt_at_the_probe():
    point = [[50.0, 2.0, 0.0]]
    on_rotor = predict(display(), point, perturbation=WHITE)
    on_slider = predict(display(coulomb=0.0, slider_coulomb=0.0293), point, perturbation=WHITE)
    split = predict(
        display(coulomb=0.0293 / 2, slider_coulomb=0.0293 / 2), point, perturbation=WHITE
    )
    for other in (on_slider, split):
        assert other.margin_ns_per_m == pytest.approx(on_rotor.margin_ns_per_m, rel=0.1)
        assert other.velocity_sd == pytest.approx(on_rotor.velocity_sd, rel=0.05)
    assert split.friction_ns_per_m == pytest.approx(on_rotor.friction_ns_per_m, rel=0.06)


def test_hung_dampers_equal_dampers_in_the_device():
    """Without a law the admittance with dampers hung on its ports is exactly that of the device
    that has them.
    """
    both = display(coulomb=0.01, slider_coulomb=0.01)
    levels = (0.7, 1.3)
    nothing = np.zeros((1, 3))
    afterwards = add_port_dampers(
        port_admittance(close_loop(both, F), nothing), np.array(levels)[:, None]
    )
    inside = port_admittance(close_loop(with_equivalent_damping(both, levels), F), nothing)
    assert afterwards == pytest.approx(inside, rel=1e-9)


def test_without_perturbation_there_is_no_friction():
    found = predict(display(), [[50.0, 2.0, 0.0]])
    assert found.friction_ns_per_m[0] == 0.0
    assert np.isnan(found.velocity_sd[0])
    assert found.perturbation is None
    assert found.margin_ns_per_m == pytest.approx(
        predict(display(coulomb=0.0), [[50.0, 2.0, 0.0]], perturbation=WHITE).margin_ns_per_m
    )


def test_deviation_of_a_narrow_resonance_is_that_of_its_closed_form():
    """White force on mass, spring and damper: variance S / (4 m b), whatever the grid; a sum of
    lines is 70 % off.
    """
    f = np.arange(1.0, 200.0, 2.0)
    for stiffness in np.linspace(60.0, 70.0, 11):
        y = 1.0 / (0.3 + 2j * np.pi * f * 0.008 + stiffness / (2j * np.pi * f))[None]
        alone = SingleFrictionPort(np.abs(y) ** 2, y.real, y.imag, 0.3)
        weight = density_weights(f, Perturbation(2.5e-5, 1e9))
        for damper in (0.3, 0.1, 0.01):
            found = CoupledFrictionPorts(f, alone, weight).sd(np.array([damper]))[0]
            assert found == pytest.approx(np.sqrt(2.5e-5 / (4.0 * 0.008 * damper)), rel=0.05)
