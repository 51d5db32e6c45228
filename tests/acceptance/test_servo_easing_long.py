"""An enable or a change of parameters never steps the force further than the device file says."""

import dataclasses
import math

import numpy as np
import pytest
from support.flight import Flight, enabled
from test_servo_easing import ROUNDING_N, SOLID, params_with

from hapticd.mailbox.layout import Command, Value
from hapticd.render.law import constant
from hapticd.servo.safety import State


def before_the_change(flight):
    """A flight that meets the next sample with the parameters that `flight` had last."""
    shadow = Flight(params_with(math.inf))
    settled, *rest = flight.state
    values = {
        place: constant(ramp.value(flight.tick - 1)) for place, ramp in settled.plan.values.items()
    }
    plan = settled.plan._replace(values=values)
    shadow.state = dataclasses.replace(settled, wake_tick=1 << 62, plan=plan), *rest
    shadow.tick = flight.tick
    return shadow


@pytest.mark.parametrize("seed", range(5))
def test_in_motion_only_the_law_itself_steps_further(seed):
    """The force of each tick against that of the parameters before, at the same sample."""
    random = np.random.default_rng(seed)
    step_n = 0.2
    flight = enabled(params_with(step_n), {Value.STIFFNESS: 300.0, **SOLID})
    steps = []
    for n in range(1200):
        shadow = before_the_change(flight)
        encoder = round(20_000 * math.sin(0.05 * n))
        change = {
            Value.STIFFNESS: random.uniform(0.0, 2000.0),
            Value.VIRTUAL_DAMPING: random.uniform(0.0, 20.0),
            Value.MASS: random.uniform(0.0, 0.1),
            Value.WALL_POSITION: random.uniform(-0.02, 0.02),
            Value.RAMP_S: random.choice([0.0, 0.01]),
        }
        if n % 20:
            flight.fly(1, encoder=encoder)
        else:
            flight.do(Command.SET, change, encoder=encoder)
        steps.append(abs(flight.out[8] - shadow.fly(1, encoder=encoder)[8]))
    assert flight.plan.state is State.ENABLED
    assert 0.5 * step_n < max(steps) <= step_n + ROUNDING_N
