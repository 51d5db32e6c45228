"""A shaken handle with friction, rigid or with a mass on a spring, in steps of 15.6 us: an
independent reference for `force_balance`. It uses only the record format of the product.
"""

from dataclasses import dataclass
from math import pi

import numba
import numpy as np

from hapticd.rig.experiment import PerturbationRun

PER_SAMPLE = 16
PER_TICK = 4 * PER_SAMPLE
STEP_S = 250e-6 / PER_SAMPLE
ENCODER_M = 0.5e-6
VELOCITY_M_PER_S = 6.1e-5  # of a count


@dataclass(frozen=True)
class Truth:
    mass_kg: float = 0.008
    viscous_ns_per_m: float = 0.35
    coulomb_n: float = 0.04
    delay_steps: int = 20  # of 15.6 us
    smoothing_s: float = 0.0
    viscous_more: float = 0.0  # share by which viscous friction is greater towards positive x
    coulomb_more: float = 0.0  # the same of Coulomb friction
    noise_m_per_s: float = 5e-5
    slider_kg: float = 0.0  # of that mass, with the encoder, on a spring; motor, probe and friction
    resonance_hz: float = 800.0  # are at the rest of it
    resonance_ratio: float = 0.05  # of critical damping
    late_samples: float = 0.0  # by which the velocity channel interpolates

    @property
    def coupling(self) -> tuple[float, float]:
        """Spring [N/m] and damper [N s/m]."""
        reduced_kg = self.slider_kg * (1.0 - self.slider_kg / self.mass_kg)
        rate = 2.0 * pi * self.resonance_hz
        return reduced_kg * rate**2, 2.0 * self.resonance_ratio * reduced_kg * rate

    @property
    def lag_us(self) -> float:
        return 1e6 * (self.delay_steps * STEP_S + self.smoothing_s)


@numba.njit(cache=False)
def _moved(torque, stiffness, damping, numbers, delay_steps):
    mass, viscous, coulomb, smoothing_s, viscous_more, coulomb_more, slider, spring, damper = (
        numbers
    )
    mass -= slider
    samples = torque.size
    ticks = samples // 4
    position = np.zeros(ticks)
    command = np.zeros(ticks)
    way = np.zeros(samples + 1)
    x = 0.0
    v = 0.0
    slid = 0.0
    sliding = 0.0
    force = 0.0
    keep = np.exp(-STEP_S / smoothing_s) if smoothing_s > 0.0 else 0.0
    mean = smoothing_s / STEP_S * (1.0 - keep)  # mean of the decaying part over a step
    for n in range(samples * PER_SAMPLE):
        if n % PER_TICK == 0:
            k = n // PER_TICK
            position[k] = np.round((slid if slider > 0.0 else x) / ENCODER_M) * ENCODER_M
            rate = 1000.0 * (position[k] - position[k - 1]) if k else 0.0
            command[k] = -stiffness * position[k] - damping * rate
        late = n - delay_steps
        target = command[late // PER_TICK] if late >= 0 else 0.0
        acting = target + mean * (force - target)
        force = target + keep * (force - target)
        one_way = 1.0 if v > 0.0 else -1.0
        drag = viscous * (1.0 + viscous_more * one_way)
        apart = slid - x + 0.5 * STEP_S * (sliding - v)  # in the middle of the step
        tied = spring * apart + damper * (sliding - v)
        free = v + STEP_S / mass * (torque[n // PER_SAMPLE] + acting - drag * v + tied)
        low = -coulomb * (1.0 + coulomb_more)
        high = coulomb * (1.0 - coulomb_more)
        rub = min(max(-free * mass / STEP_S, low), high)
        new = free + STEP_S / mass * rub
        x += 0.5 * STEP_S * (v + new)
        v = new
        if slider > 0.0:
            slid += STEP_S * sliding - 0.5 * STEP_S**2 / slider * tied
            sliding -= STEP_S / slider * tied
        if (n + 1) % PER_SAMPLE == 0:
            way[(n + 1) // PER_SAMPLE] = x
    return position, command, way


def shaken(truth: Truth, torque_n, stiffness: float, damping: float, seed: int) -> PerturbationRun:
    """Return the record of the handle under `torque_n` (n,) and a spring with a damper."""
    numbers = (
        truth.mass_kg,
        truth.viscous_ns_per_m,
        truth.coulomb_n,
        truth.smoothing_s,
        truth.viscous_more,
        truth.coulomb_more,
        truth.slider_kg,
        *truth.coupling,
    )
    position, command, way = _moved(torque_n, stiffness, damping, numbers, truth.delay_steps)
    random = np.random.default_rng(seed)
    seen = np.diff(way) / 250e-6
    seen += truth.late_samples * (np.append(0.0, seen[:-1]) - seen)
    seen += truth.noise_m_per_s * random.standard_normal(torque_n.size)
    ticks = np.arange(position.size)
    return PerturbationRun(
        1000.0 * ticks,
        position,
        command,
        np.full(position.size, -1.0),
        4.0 * ticks - 1.0,
        0.0,
        torque_n,
        np.round(seen / VELOCITY_M_PER_S) * VELOCITY_M_PER_S,
    )
