"""`rig probe`: closed forms on made-up motions, and the simulated board with other gains and signs
than its device file's.
"""

import math

import numpy as np

from hapticd.model.params import TouchParams
from hapticd.rig.excitation import LINES_HZ, Recording, sines
from hapticd.rig.steps.probe import (
    AttachedMass,
)

N = 2.0 / 32767
FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5}
FRICTION = TouchParams(coulomb_n=0.03, static_n=0.03)
MASS = AttachedMass(0.02)


def motion(mass_kg, seed, gain=N, velocity_gain=N, delay=0.7, n_per_m=math.inf):
    """Return 4 s of a mass with viscous and Coulomb friction under about the played force, as both
    streams record it. The motion is given, and the force follows from it. 3 g of it turn with the
    probe, behind a transmission of `n_per_m`.
    """
    random = np.random.default_rng(seed)
    at = np.arange(16_000.0)
    ticks = np.arange(0.0, at[-1], 4.0)
    omega = 2.0 * np.pi * LINES_HZ
    force = np.fft.rfft(sines(90.0 * mass_kg))[10:31] / 2000.0
    size = force / (-mass_kg * omega**2 + 0.8j * omega)

    def wave(amplitude, samples):
        turns = np.exp(1j * np.outer(samples[samples < 4000.0] / 4000.0, omega))
        return np.resize((turns @ amplitude).real, samples.size)

    turned = size * (1.0 - (mass_kg - 0.003) * omega**2 / n_per_m)
    speed = wave(1j * omega * turned, at)
    needed = wave(-(omega**2) * ((mass_kg - 0.003) * size + 0.003 * turned), at)
    needed += 0.4 * speed + 0.04 * np.sign(speed)
    torque = np.round(needed / gain + 7.0 + random.standard_normal(at.size))
    late = 0.2 * np.roll(speed, 1) + 0.8 * speed  # as in `both_channels`
    velocity = np.round(late / velocity_gain - 3.0 + 2.0 * random.standard_normal(at.size))
    found = wave(size * np.exp(1j * omega * delay / 4000.0), ticks) + 3e-7 * random.standard_normal(
        ticks.size
    )
    return Recording(at, torque, velocity, ticks, found, np.ones(ticks.size, np.uint8))


def told(result):
    return {one.name: one for one in result.values}
