"""One bad sample of the encoder moves nothing in a homing: neither its push nor what it finds."""

import numpy as np
import pytest
from support.models import COUNT_M
from test_servo_homing_glitch import homed

from hapticd.model.params import InjectionParams
from hapticd.servo.safety import State

SEEN_N = 0.05  # of 0.5 N: what a sample that waits for the next one leaves


@pytest.fixture(scope="module")
def undisturbed():
    ticks, origin = homed()
    assert ticks["homed"][-1]
    return ticks, origin


@pytest.mark.parametrize("glitch_m", [4e-3, -1.2e-2])
@pytest.mark.parametrize("tick", [40, 300, 560, 700, 1000, 1500, 2300, 2700])
def test_one_bad_sample_changes_neither_push_nor_origin(undisturbed, tick, glitch_m):
    jump = InjectionParams("encoder_jump", tick=tick, value=glitch_m / COUNT_M)
    ticks, origin = homed(jump)
    usual, found = undisturbed
    assert ticks["homed"][-1]
    assert not ticks["fault"].any()
    assert abs(origin - found) <= 4
    both = (ticks["state"] == State.HOMING) & (usual["state"] == State.HOMING)
    assert np.abs(ticks["force_n"] - usual["force_n"])[both].max() < SEEN_N


@pytest.mark.parametrize("lost", [1, 3])
@pytest.mark.parametrize("tick", [300, 700, 1500, 2700])
def test_nor_does_one_behind_lost_frames(undisturbed, tick, lost):
    jump = InjectionParams("encoder_jump", tick=tick, value=4e-3 / COUNT_M)
    ticks, origin = homed(InjectionParams("drop_in", tick=tick - lost, count=lost), jump)
    usual, found = undisturbed
    assert ticks["homed"][-1]
    assert not ticks["fault"].any()
    assert abs(origin - found) <= 4
    assert np.abs(ticks["force_n"] - usual["force_n"])[tick - 10 : tick + 20].max() < SEEN_N


def test_homing_goes_on_though_every_other_frame_is_lost():
    """Every sample then comes behind a lost one."""
    lost = (InjectionParams("drop_in", tick=tick) for tick in range(41, 2600, 2))
    ticks, _ = homed(*lost)
    assert ticks["homed"][-1]
