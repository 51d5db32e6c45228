"""Coulomb friction as the damper that dissipates the same power in a random motion: statistical
linearisation.

For a Gaussian velocity of standard deviation s the force -Fc sign(v) has the gain sqrt(2/pi) Fc / s
(Booton 1953); the remainder, (1 - 2/pi) Fc^2, is noise. s depends on the device: with a
perturbation of one-sided density S

    b s(b) = sqrt(2/pi) Fc,     s(b)^2 = integral of S |Y / (1 + b Y)|^2 df

so friction counts for more the less the device moves, and a limit holds at a given perturbation.
Only Fc^2 / S matters. If two bodies have friction, each in turn gets its damper, until both are
consistent.

A loop that is active without friction has a second solution: it moves so fast that friction no
longer holds it, and runs away. The calm solution counts only if bursts of up to three times its
motion would die out; a 90 s trial contains such bursts.

Limitations: a perturbation that hardly moves the device, because the velocity is then far from
Gaussian.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats, Integers
from hapticd.model.loop import Loop

__all__ = ["BURSTS", "GAIN", "Linearised", "Perturbation", "linearise", "recorded_impedance"]

GAIN = float(np.sqrt(2.0 / np.pi))
BURSTS = (1.2, 1.5, 2.0, 2.5, 3.0)
# N s/m; a body that sticks stays at the maximum, one that runs away ends at the minimum
_LEAST = 1e-4
_MOST = 1e4
_ROUNDS_OF_ONE = 40  # each halves the error of a free mass
_BEND = 16.0 / 3.0 - 1.5 * np.pi  # p'(1) = -1/3
_OPPOSITE = 1e-12  # (1 + cos theta) / 2 where Z + b passes through 0
_ROUNDS = 8  # between two bodies


@dataclass(frozen=True, slots=True)
class Perturbation:
    """White force of one-sided density `psd_n2_per_hz` up to `band_hz`; the default is that of the
    calibrated device.
    """

    psd_n2_per_hz: float = 2.5e-5
    band_hz: float = 1700.0


@dataclass(frozen=True, eq=False)
class Linearised:
    """Impedance with friction linearised in N environments."""

    impedance: Complexes  # (N, F) complex128 at the port, N s/m
    friction: Floats  # (ports, N) equivalent dampers of friction, N s/m
    velocity_sd: Floats  # (N,) of the port, m/s; nan without perturbation
    calm: Flags  # (N,) whether a burst of motion dies out


def linearise(
    loop: Loop, points: Floats, coulomb_n: Floats, start: Floats, perturbation: Perturbation | None
) -> Linearised:
    """Return the impedance of `loop` under the environments `points` (N, 3) with friction
    `coulomb_n` (ports,) at that perturbation.

    `start` (ports,): dampers that the loop's model already has on its bodies; they are removed
    where friction is less. Without a perturbation friction is omitted, and the standard deviation
    of the velocity is nan.
    """
    y = port_admittance(loop, points)
    weight = (
        np.zeros(loop.frequency_hz.size)
        if perturbation is None
        else density_weights(loop.frequency_hz, perturbation)
    )
    level = np.repeat(start[:, None], len(points), axis=1)
    rubbing = (
        []
        if perturbation is None
        else [port for port, force in enumerate(coulomb_n) if force > 0.0]
    )
    # each body in turn is given the damper that fits while the others keep theirs
    for _ in range(_ROUNDS if len(rubbing) > 1 else 1):
        for port in rubbing:
            alone = _alone(y, level, start, port)
            level[port] = fitting_damper(alone, GAIN * coulomb_n[port], weight)
    seen = add_port_dampers(y, level - start[:, None])[0, 0]
    power = (seen.real**2 + seen.imag**2) @ weight
    sd = np.sqrt(power) if perturbation is not None else np.full(len(points), np.nan)
    # a burst dies out if friction weakened by it leaves less motion than the burst
    calm = np.ones(len(points), np.bool_)
    for port in rubbing:
        moving = CoupledFrictionPorts(loop.frequency_hz, _alone(y, level, start, port), weight)
        for burst in BURSTS:
            calm &= (level[port] / burst) * moving.sd(level[port] / burst) < GAIN * coulomb_n[port]
    return Linearised(1.0 / seen, level, sd, calm)


def recorded_impedance(loop: Loop, points: Floats, impedance: Complexes) -> Complexes:
    """Return `impedance` (N, F) of `linearise` as the board records it: exact as in `loop` if no
    damper changed.
    """
    kbm = np.column_stack((np.ones(len(points)), points))
    return np.asarray(impedance * product(kbm, loop.admittance[0, 0]) / product(kbm, loop.recorded))


def impedance_each(
    loop: Loop, line: Integers, points: Floats, dampers: Floats, recorded: bool
) -> Complexes:
    """Return Z (N,) of environments `points` (N, 3), each at its own `line` (N,) of `loop`, with
    `dampers` (ports, N) added to its ports; `recorded` as in `recorded_impedance`.
    """
    kbm = np.column_stack((np.ones(len(points)), points)).T
    common = (kbm * loop.common[:, line]).sum(axis=0)
    y = (kbm * loop.admittance[..., line]).sum(axis=2)
    z = 1.0 / add_port_dampers((y / common)[..., None], dampers)[0, 0, :, 0]
    return np.asarray(z * y[0, 0] / (kbm * loop.recorded[:, line]).sum(axis=0) if recorded else z)


def port_admittance(loop: Loop, points: Floats) -> Complexes:
    """Return the admittance Y_ab (ports, ports, N, F) of the closed loop, with free ports."""
    kbm = np.column_stack((np.ones(len(points)), points))
    common = 1.0 / product(kbm, loop.common)
    return np.stack(
        [np.stack([product(kbm, pair) * common for pair in row]) for row in loop.admittance]
    )


def product(weights: Floats, basis: Complexes) -> Complexes:
    """Multiply real (N, 4) by complex (4, F), as two real products."""
    return np.asarray(weights @ basis.real + 1j * (weights @ basis.imag))


def add_port_dampers(y: Complexes, dampers: Floats, skip: int = -1) -> Complexes:
    """Return `y` (ports, ports, N, F) with `dampers` (ports, N) on its ports, all but port
    `skip`.
    """
    for port, level in enumerate(dampers):
        if port != skip and level.any():
            b = level[:, None]
            y = y - y[:, port, None] * y[port] * (b / (1.0 + b * y[port, port]))
    return y


@dataclass(frozen=True, eq=False)
class SingleFrictionPort:
    """A port i to which a damper is added; the other dampers do not change."""

    drive: Floats  # (N, F) |Y_i0|^2, from the probe's force
    real: Floats  # (N, F) of Y_ii, m/(N s)
    imag: Floats  # (N, F) of Y_ii, m/(N s)
    start: float  # its present damper, N s/m

    def sd(self, damper: Floats, weight: Floats) -> Floats:
        """Standard deviation (N,) [m/s] of the port's velocity with a damper (N,) [N s/m] on it."""
        extra = (damper - self.start)[:, None]
        power = (self.drive / ((1.0 + extra * self.real) ** 2 + (extra * self.imag) ** 2)) @ weight
        return np.asarray(np.sqrt(power))


class CoupledFrictionPorts:
    """The same port with more motion and less friction, whose resonance may be narrower than the
    grid.

    A sum over lines would hit or miss the peak, and the edge of a set would be jagged. Between two
    lines Z + b runs straight from a to a', and the integral of 1/|Z + b|^2 is theta / (|a| |a'| sin
    theta) of the distance, theta the angle between them: p(q) / q with q = cos(theta / 2), p to 0.4
    %.
    """

    def __init__(self, frequency_hz: Floats, alone: SingleFrictionPort, weight: Floats) -> None:
        own = alone.real + 1j * alone.imag
        size = alone.real**2 + alone.imag**2
        self._z = 1.0 / own
        self._start = alone.start
        share = alone.drive / size
        density = np.minimum(weight[1:], weight[:-1]) > 0.0
        per_hz = float(np.max(weight / np.gradient(frequency_hz)))
        self._share = (
            0.5 * (share[:, 1:] + share[:, :-1]) * (per_hz * density * np.diff(frequency_hz))
        )

    def sd(self, damper: Floats) -> Floats:
        """Standard deviation (N,) [m/s] of the port's velocity with a damper (N,) [N s/m] on it."""
        real = self._z.real + (damper - self._start)[:, None]
        imag = self._z.imag
        size = np.sqrt(real**2 + imag**2)
        both = size[:, 1:] * size[:, :-1]
        along = real[:, 1:] * real[:, :-1] + imag[:, 1:] * imag[:, :-1]
        q = np.sqrt(np.maximum(0.5 + 0.5 * along / both, _OPPOSITE))
        return np.asarray(np.sqrt((self._share * _straight(q) / (q * both)).sum(axis=1)))


def _straight(q: Floats) -> Floats:
    """Return arccos(q) / sqrt(1 - q^2) for q in 0..1 to 0.4 %, from both ends' values and
    slopes.
    """
    return 0.5 * np.pi + q * (-1.0 + q * (_BEND + q * (2.0 - 0.5 * np.pi - _BEND)))


def fitting_damper(alone: SingleFrictionPort, gain_n: float, weight: Floats) -> Floats:
    """Find b (N,) with b s(b) = `gain_n`.

    The iteration b <- g / s(b) starts at rest and only falls, so it ends at the strongest damper
    that fits. That is the calm solution, if a loop that is active without friction has several. If
    there is none, b falls below the value at which the loop begins to oscillate, and Re Z < 0 there
    shows it.
    """
    b = np.full(len(alone.drive), _MOST)
    # never upwards: the upper bound is the damper of the last round
    for _ in range(_ROUNDS_OF_ONE):
        b = np.clip(gain_n / alone.sd(b, weight), _LEAST, b)
    return b


def _alone(y: Complexes, level: Floats, start: Floats, port: int) -> SingleFrictionPort:
    """`port` of `y` with the dampers of the others changed from `start` to `level`."""
    others = add_port_dampers(y, level - start[:, None], skip=port)
    through = others[port, 0]
    own = others[port, port]
    return SingleFrictionPort(
        through.real**2 + through.imag**2, own.real, own.imag, float(start[port])
    )


def density_weights(frequency_hz: Floats, perturbation: Perturbation) -> Floats:
    """Return weights (F,) of the integral of S |Y|^2 over the perturbation's band (trapezoids)."""
    inside = frequency_hz <= perturbation.band_hz
    return np.asarray(np.where(inside, perturbation.psd_n2_per_hz * np.gradient(frequency_hz), 0.0))
