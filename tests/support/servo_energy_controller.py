"""Damping and a lower stiffness end a leak of energy, in time and only then.

The balance is that of the simulated motor: work on the device + change of stored energy - credited
damping x int v^2 dt - energy added by changes.
"""

import math
from itertools import product

from hapticd.core.params import SafetyParams
from hapticd.mailbox.layout import Value
from support.leaking import CREDITED_NS_PER_M, DEVICE_NS_PER_M, Hand, LeakFlight, T, wander
from support.models import device_params, servo_params

BALANCE_J = 5e-3
SMOOTHED_HZ = 31.8
CEILING = 10.0
HANDS = {
    "bare": Hand(push_n=1.0, wander_n=0.3),
    "mass": Hand(mass_kg=0.05, push_n=1.0, wander_n=0.3),
    "grip": Hand(0.02, 100.0, 0.1, push_n=1.0, wander_n=0.3),
    "heavy": Hand(mass_kg=0.3, push_n=2.0, wander_n=0.5),
}
CASES = list(product((0.0, SMOOTHED_HZ), (0.125, 0.5, 1.125), HANDS))


def flight(on=True, hand=HANDS["bare"], delay=0.125, lag_hz=0.0, damps=True, **device):
    """With the controller, or without and without the faults."""
    known = {"physical_damping_ns_per_m": CREDITED_NS_PER_M, "force_smoothing_hz": lag_hz}
    safety = SafetyParams(limit_cycle_faults=on, energy_controller=on)
    params = servo_params(device=device_params(**known | device), safety=safety)
    return LeakFlight(params, hand, delay, lag_hz, damps)


def passive_limit(delay, lag_hz):
    """Return the stiffness [N/m] up to which the device's true damping is passive at low
    frequencies.
    """
    return DEVICE_NS_PER_M / (T * (0.5 + delay) + (1.0 / (math.tau * lag_hz) if lag_hz else 0.0))


def wall(stiffness):
    return {Value.WALL_STIFFNESS: stiffness, Value.WALL_POSITION: 0.0, Value.WALL_SIDE: 1.0}


def against_a_wall(on, seed, lag_hz, delay, hand, ticks=1200, **others):
    """A hand that leans on a wall at five times its limit."""
    found = flight(on, HANDS[hand], delay, lag_hz, **others)
    found.begun(wall(5.0 * passive_limit(delay, lag_hz)))
    found.pushed(wander(HANDS[hand], ticks, seed))
    return found
