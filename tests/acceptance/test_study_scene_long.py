"""A scene by itself: ceilings of damping, runs with damping and without, and explicit methods, each
against a closed form.
"""

from math import inf

import numpy as np
import pytest
from support.measured_scenes import MASS_KG, PARTS, VISCOUS_NS_PER_M, scene

from hapticd.model.effects import Amplifier, DampingCircuit, WindingTemperature, copper_ohm
from hapticd.settings.scene import load_scene
from hapticd.studies.scene import ceiling, plan_scene, run_scene


@pytest.mark.slow
def test_hot_scene_tells_its_temperatures() -> None:
    found = run_scene(plan_scene(load_scene("hot"), seconds=6.0))
    for trial in found.trials:
        assert trial.winding_c is not None
        times, celsius = trial.winding_c
        assert (times[0], celsius[0], times[-1]) == (0.0, 20.0, 6.0)
        assert (np.diff(celsius) > 0.0).all()


CIRCUIT = (*PARTS, Amplifier(bandwidth_hz=5000.0), DampingCircuit(bandwidth_hz=1000.0))


def test_ceiling_is_that_of_routh() -> None:
    """(m s + b)(s + wa)(s + wd) + g wa wd: stable while the two inner coefficients beat the two
    outer ones.
    """
    wa = 2.0 * np.pi * 5000.0
    wd = 2.0 * np.pi * 1000.0
    m = MASS_KG
    b = VISCOUS_NS_PER_M
    routh = (m * (wa + wd) + b) * (m * wa * wd + b * (wa + wd)) / (m * wa * wd) - b
    found = ceiling(scene(CIRCUIT, 1.74))
    assert found.device == pytest.approx(routh, rel=1e-6)
    assert found.oscillation_hz == pytest.approx(
        np.sqrt((m * wa * wd + b * (wa + wd)) / m) / (2.0 * np.pi), rel=1e-4
    )
    assert (found.scene, found.loop_gain, found.warmer) == (1.74, 0.0, ())


def test_cold_winding_bounds_damping_by_what_is_over_compensated() -> None:
    """g dR / K^2 = -1 cannot be passed; a slow circuit gets close to it, a hot winding has no
    such bound.
    """
    found = ceiling(
        scene((*CIRCUIT, WindingTemperature(temperature_c=20.0, compensated_c=20.0)), 1.74)
    )
    warmer = {kelvin: top for kelvin, top, _ in found.warmer}
    bounded = {kelvin: level for kelvin, _, level in found.warmer}
    for kelvin in (-40.0, -20.0):
        excess_ohm = copper_ohm(1.6, 20.0, 20.0 + kelvin) - 1.6
        bound = -(1.65**2) / excess_ohm
        assert 0.85 * bound < warmer[kelvin] <= bound
        assert bounded[kelvin] == pytest.approx(0.3 * bound)
    assert warmer[0.0] == bounded[0.0] == found.device == found.bounded
    assert warmer[40.0] == warmer[10.0] == inf


def test_loop_is_stable_between_its_lowest_and_highest_damping() -> None:
    """A spring of 4 kN/m needs more than the device's own 1 N s/m; what is needed does not
    depend on where it comes from.
    """
    needy = scene(CIRCUIT, 1.74, kbm=(4000.0, 0.0, 0.0))
    found = ceiling(needy)
    assert 0.5 < found.lowest < 3.0
    assert found.lowest < found.highest <= found.device * 1.001
    assert ceiling(scene(CIRCUIT, 1.74)).lowest == 0.0
