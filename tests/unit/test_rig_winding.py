"""`rig motor --winding`: force per ampere, ohm and back-EMF of rigs that the step does not know."""

import numpy as np
import pytest
from support.models import device_params
from support.rig_winding import rests

from hapticd.core.params import to_plain
from hapticd.rig.steps.winding import analyse

DEVICE = to_plain(device_params())


def moved(volt=1.65):
    speed = 0.05 * np.sin(np.linspace(0.0, 60.0, 250))
    return np.stack([speed, volt * speed - 0.02], axis=1)


def test_offsets_of_the_sensors_do_not_matter():
    values = {one.name: one.value for one in analyse(rests(), moved(), DEVICE).values}
    assert values["motor.force_n_per_a"] == pytest.approx(1.65)
    assert values["motor.winding_ohm"] == pytest.approx(1.6)
    assert values["back-EMF"] == pytest.approx(1.65)


@pytest.mark.parametrize("channel", [1, 2])
def test_a_channel_that_says_nothing_is_refused_by_name(channel):
    dead = rests()
    dead[:, channel] = 0.0
    result = analyse(dead, moved(), DEVICE)
    assert not result.settled
    assert not result.changes
    assert ("current", "voltage")[channel - 1] in result.findings[0].what


def test_a_current_of_the_wrong_sign_is_refused():
    result = analyse(rests(-1.65, 1.6), moved(), DEVICE)
    assert not result.settled
    assert "current" in result.findings[0].what


def test_scales_that_contradict_each_other_are_named():
    result = analyse(rests(), moved(2.0), DEVICE)
    assert any(one.verdict == "warning" and "voltage" in one.remedy for one in result.findings)


def test_a_handle_that_nobody_moved_is_refused():
    result = analyse(rests(), moved() * 0.01, DEVICE)
    assert not result.settled
