"""Until signs are verified a device has a tenth of its force and a box, and every push is watched.

The board behind is the simulated one: its truth may differ from what the device file says.
"""

import numpy as np
import pytest
from support.models import COUNT_N, servo_params
from test_servo_commissioning import FAR, pushed, unverified

from hapticd.mailbox.layout import Value

LIMIT_N = 0.8  # a tenth of the device's 8 N


def test_force_is_a_tenth_of_the_devices_at_most():
    """A spring whose push is 2 N: the handle gets 0.8 N."""
    wall = {Value.WALL_STIFFNESS: 100.0, Value.WALL_POSITION: -0.02, Value.WALL_SIDE: 1.0}
    found = pushed(unverified(), wall, lower_stop_m=-0.001)
    assert np.abs(found["force_n"]).max() == pytest.approx(LIMIT_N, abs=COUNT_N)
    free = pushed(servo_params(), wall, lower_stop_m=-0.001)
    assert np.abs(free["force_n"]).max() > 1.8


def test_a_push_against_a_stop_and_a_perturbation_are_no_fault():
    """A held handle does no work; without K, B and M nothing pushes at all."""
    held = pushed(unverified(), FAR, lower_stop_m=-0.001, ticks=3000)
    assert not held["fault"].any()
    free = pushed(unverified(), {}, ticks=3000)
    assert not free["fault"].any()
