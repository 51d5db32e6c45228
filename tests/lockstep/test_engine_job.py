"""A winding that heats up under load: its temperature against the closed form, and what it does
to the force.
"""

import numpy as np
import pytest
from support.devices import MOTOR, WARMING, device

from hapticd.core.units import COPPER_PER_K
from hapticd.model.effects import (
    Amplifier,
    DampingCircuit,
    Load,
    Masses,
    WindingTemperature,
    copper_ohm,
)
from hapticd.model.scene import Excitation
from hapticd.zwidth.engine.batch import simulate

PER_N_PER_A = 1.65
WARM = (
    Masses(rotor_kg=0.008), MOTOR, Load(stiffness_n_per_m=2000.0, damping_ns_per_m=20.0),
    Amplifier(bandwidth_hz=2000.0), DampingCircuit(bandwidth_hz=500.0),
    WindingTemperature(temperature_c=20.0, compensated_c=20.0),
    WARMING,
)  # fmt: skip


def holding(stiffness, seconds, level=0.0):
    """A motor that works against a 2 N push with a virtual spring, the device's own spring
    taking the rest.
    """
    push = Excitation("push", force_n=2.0)
    return simulate(
        device(*WARM),
        [[stiffness, 0.0, 0.0], [0.0, 0.0, 0.0]],
        seconds,
        excitation=push,
        active_damping=level,
        keep="ticks",
    )


def closed_form_c(force_n, seconds):
    """T' = (R0 (1 + a (T - T0)) (F/K)^2 R_th - (T - T0)) / tau: an exponential with a slower
    rate as copper warms.
    """
    heat = copper_ohm(1.6, 20.0, 20.0) * (force_n / PER_N_PER_A) ** 2 * 20.0
    slower = 1.0 - COPPER_PER_K * heat
    return 20.0 + heat / slower * (1.0 - np.exp(-slower * seconds / 10.0))


def test_temperature_follows_the_closed_form():
    result = holding(600.0, 20.0)
    force_n = result.force_n[0, -1]
    assert abs(force_n) == pytest.approx(2.0 * 600.0 / 2600.0, rel=1e-3)
    assert result.winding_c[0] == pytest.approx(closed_form_c(force_n, 20.0), abs=0.02)
    assert result.winding_c[1] == pytest.approx(20.0, abs=1e-9)


def test_hot_winding_weakens_the_rendered_spring_by_alpha():
    """At DC the motor gives alpha F_cmd, alpha = 1 / (1 + g dR / K^2): the spring yields more,
    the command grows.
    """
    level = 3.0
    result = holding(2000.0, 30.0, level)
    residual = copper_ohm(1.6, 20.0, float(result.winding_c[0])) - 1.6
    alpha = 1.0 / (1.0 + level * residual / PER_N_PER_A**2)
    assert residual > 0.05
    assert result.force_n[0, -1] == pytest.approx(
        -2000.0 * 2.0 / (2000.0 + 2000.0 * alpha), rel=1e-3
    )
    assert abs(result.force_n[0, -1]) > 1.01 * 1.0
