"""A limit cycle or a hum between 2 and 12 Hz is named. A narrow resonance of the device, friction,
quantisation and noise of the probe are not.
"""

from functools import cache

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.model.effects import Coulomb, Masses, ProbeMass, Viscous
from hapticd.model.model import Model
from hapticd.model.scene import Excitation, Scene
from hapticd.signal.findings import Finding
from hapticd.signal.resolved import low_line
from hapticd.signal.spectra import spa
from hapticd.zwidth.engine.batch import simulate
from support.measured_scenes import MOTOR, scene

RATE_HZ = 4000.0
NOISE = Excitation("noise")


def display(viscous: float, *effects, mass_kg: float = 0.008) -> Scene:
    parts = (
        Masses(rotor_kg=mass_kg - 0.003),
        MOTOR,
        ProbeMass(mass_kg=0.003),
        Viscous(rotor_ns_per_m=viscous),
    )
    return scene((*parts, *effects), seconds=90.0)


HEAVY = display(0.12, mass_kg=0.023)
DRY = display(0.3, Coulomb(rotor_n=0.03), mass_kg=0.023)


@cache
def trial_records(device: Scene | Model, stiffness: float, seeds: int, seconds: float = 90.0):
    """Forces and velocities of trials with noise of their own."""
    found = simulate(
        device, [[stiffness, 0.0, 0.0]] * seeds, seconds, 1, excitation=NOISE, start=(0.0, 0.0),
        own_torque=True, keep="records",
    )  # fmt: skip
    return [tuple(np.asarray(one, np.float64) for one in found.record(k)) for k in range(seeds)]


def named(force: Floats, velocity: Floats) -> tuple[Finding, ...]:
    return low_line(force, velocity, spa(force, velocity))


def with_line(velocity: Floats, line_hz: float, share: float, width_hz: float = 0.0) -> Floats:
    """A line of which `share` of the power is; its phase wanders if it has a width."""
    steps = np.random.default_rng(1).standard_normal(velocity.size)
    phase = np.cumsum(steps) * np.sqrt(2.0 * np.pi * width_hz / RATE_HZ)
    line = np.sin(2.0 * np.pi * line_hz * np.arange(velocity.size) / RATE_HZ + phase)
    return velocity + velocity.std() * np.sqrt(2.0 * share / (1.0 - share)) * line
