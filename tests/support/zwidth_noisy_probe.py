"""The noise of the probe's amplifier belongs to the trial, independent of the executor.

The device is linear and narrow: some verdicts need the record, which is then simulated again.
"""

import numpy as np

from hapticd.model.effects import Masses, ProbeMass, SensorNoise, Viscous
from hapticd.model.scene import Excitation
from hapticd.zwidth.outcomes import Conditions
from support.measured_scenes import MOTOR, scene

SECONDS = 20.0
NOISE = Excitation("noise", seed=5)
PARTS = (Masses(rotor_kg=0.005), MOTOR, ProbeMass(mass_kg=0.003), Viscous(rotor_ns_per_m=0.3))
NOISY = scene((*PARTS, SensorNoise(velocity_m_per_s=1e-3)), seconds=SECONDS)
GIVEN = Conditions(NOISY, SECONDS, NOISE)
POINTS = np.zeros((8, 3))
POINTS[:, 0] = np.linspace(0.0, 590.0, 8)
