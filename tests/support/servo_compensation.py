"""The compensation follows the resistance of the winding from below, for any sensor, current and
board. The test integrates the winding itself, by its differential equation only.
"""

from dataclasses import replace
from math import expm1

from hapticd.servo.compensation import compensated
from hapticd.servo.plan import (
    COMPENSATES,
    NO_TEMPERATURE,
    initial_plan,
)
from support.flight import HEALTHY
from support.models import device_params, servo_params
from support.winding_table import TABLE

CEILING = 10.0  # N s/m
ABLE = HEALTHY | COMPENSATES
COUNT_OHM = 0.8 / 32767
COUNT_A = 10.0 / 32767


def params(**changes):
    table = replace(TABLE, **changes)
    return servo_params(device=device_params(resistance=table))


def copper(celsius: float) -> float:
    return 1.6 * (1.0 + 0.00393 * (celsius - 20.0))


class Warm:
    """A winding and its updates, without the ticks between them."""

    def __init__(self, servo, ohm_k_per_w=8.0, tau_s=10.0, ambient_c=20.0):
        self.servo = servo
        self.plan = initial_plan(servo)
        self.celsius = ambient_c
        self.numbers = (ohm_k_per_w, tau_s, ambient_c)
        self.tick = 0
        self.least = 1e9  # least uncompensated ohm
        self.nearest = 1e9  # loop gain

    def look(self, ampere, sensor_c=None, host=ABLE, arrival=0, held_n=0.0, status=1):
        """Update once from the sensor (None: honest; not connected: 130 degC), with that current
        since the last update.
        """
        due = self.plan.winding.due_tick
        r_th, tau_s, ambient_c = self.numbers
        elapsed_s = (due - self.tick) * 1e-3
        heat = r_th * copper(self.celsius) * ampere**2
        self.celsius += (ambient_c + heat - self.celsius) * -expm1(-elapsed_s / tau_s)
        self.tick = due
        if host & NO_TEMPERATURE:
            sensor_c = 130.0
        count = round(100.0 * (self.celsius if sensor_c is None else sensor_c))
        sample = (0, status, count, arrival, host, 0, 0.125, round(ampere / COUNT_A), 0)
        self.plan = compensated(self.plan, sample, held_n, due, self.servo)
        left = copper(self.celsius) - 1.5 - self.plan.winding.dac_count * COUNT_OHM
        self.least = min(self.least, left)
        self.nearest = min(self.nearest, CEILING * left / 1.65**2)
        return left
