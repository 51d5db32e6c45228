"""Motor figures of the paper, and copper."""

import pytest
from plant_devices import alpha

from hapticd.plant.winding import copper_ohm, crowbar_nms_per_rad, lever_of_crowbar_m


def test_crowbar_figures_of_the_paper():
    """Eq. 3: 1.7e-4 Nms/rad; its 3.7e-5 Ns/m would need a lever of 2.14 m, and 10 mm gives 1.70 Ns/m."""
    crowbar = crowbar_nms_per_rad(0.016492422502470644, 1.6)
    assert crowbar == pytest.approx(1.7e-4, rel=1e-12)
    assert lever_of_crowbar_m(1.7e-4, 3.7e-5) == pytest.approx(2.1435, abs=1e-4)
    assert crowbar / 0.01**2 == pytest.approx(1.70, rel=1e-12)


def test_forty_kelvin_are_sixteen_percent():
    assert copper_ohm(1.6, 20.0, 60.0) / 1.6 == pytest.approx(1.1572)
    assert copper_ohm(1.6, 20.0, 20.0) == 1.6


def test_hot_is_weaker_cold_is_stronger():
    figures = [alpha(1.74, 1.6 * 0.00393 * kelvin, 1.649242) for kelvin in (-10, 0, 10, 20, 40)]
    assert figures == pytest.approx([1.0419, 1.0, 0.9613, 0.9256, 0.8614], abs=1e-4)
