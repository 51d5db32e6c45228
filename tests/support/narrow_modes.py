"""Devices with one narrow mode, and the theorem for them from a closed form on a dense grid.

A rotor with probe and motor, a slider with the encoder, and a spring and a damper between them.
With the rotor held the command moves nothing, so e = 0, h = H0 and q = T(s)/s, where T is the
slider's motion per rotor motion. The condition of `theorem` then needs no matrix.
"""

from typing import NamedTuple

import numpy as np

from hapticd.model.loop import PAPER_FILTERS, derivatives
from support.analysis_narrow import flexible

PERIOD_S = 1e-3
HARMONICS = np.arange(-25, 26)
FIRST, SECOND = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 1), (0, 2), (0, 2), (1, 2), (1, 2)]).T
EVEN = np.concatenate((np.geomspace(2e-3, 0.05, 150)[:-1], np.linspace(0.05, np.pi, 3000)))  # wT


class Narrow(NamedTuple):
    """Two masses with a mode of the free device at `mode_hz`."""

    rotor_kg: float
    slider_kg: float
    mode_hz: float
    ratio: float  # of critical damping
    viscous_ns_per_m: float  # on the rotor
    delay_periods: float

    @property
    def reduced_kg(self):
        """Mass of the mode."""
        return self.rotor_kg * self.slider_kg / (self.rotor_kg + self.slider_kg)

    @property
    def spring(self):
        """Stiffness [N/m] and damping [N s/m] between the masses."""
        rate = 2.0 * np.pi * self.mode_hz
        return self.reduced_kg * rate**2, 2.0 * self.ratio * self.reduced_kg * rate

    def model(self):
        """As the package composes it."""
        return flexible(
            self.rotor_kg, self.slider_kg, *self.spring, self.viscous_ns_per_m, self.delay_periods
        )


def drawn(seed, viscous=(0.1, 2.0)):
    """A device with a mode of 20 to 400 Hz and a ratio of 0.0005 to 0.1."""
    random = np.random.default_rng((32, seed))

    def size(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    return Narrow(
        size(1e-3, 1e-2),
        size(1e-3, 1e-2),
        size(20.0, 400.0),
        size(5e-4, 0.1),
        size(*viscous),
        random.uniform(0.0, 1.0),
    )


def directions(seed, count):
    """Directions (count, 3) in K, B, M; axes, planes and between."""
    random = np.random.default_rng((33, seed))
    found = random.uniform((0.0, 0.0, -0.002), (600.0, 2.0, 0.004), (count, 3))
    found *= random.integers(0, 2, (count, 3))
    found[~found.any(axis=1)] = (600.0, 0.0, 0.0)
    return found


def dense_angles(device):
    """Angles wT (A,), far denser about the mode of the held device than it is wide."""
    k, c = device.spring
    rate = np.sqrt(k / device.slider_kg) * PERIOD_S
    width = 0.5 * c / device.slider_kg * PERIOD_S
    away = width * np.geomspace(0.02, 1e4, 500)
    found = np.abs(np.concatenate((EVEN, rate - away, rate + away)))
    folded = np.abs(np.remainder(found + np.pi, 2.0 * np.pi) - np.pi)
    return np.unique(folded[folded > 2e-3])


class ClosedForm:
    """The condition |1 + C g|^2 >= R^2 |C|^2 at dense angles.

    R^2 is that of the theorem, sum |h|^2/r sum |q|^2/r / 4, which is valid for time-varying hands
    too. `constant`: the smaller (sum |hq|/r)^2 / 4 of time-invariant hands. These reach every point
    of that circle, so beyond it some hand destabilises the device.
    """

    def __init__(self, device, constant=False):
        angles = dense_angles(device)
        phase = angles[:, None] + 2.0 * np.pi * HARMONICS
        s = 1j * phase / PERIOD_S
        k, c = device.spring
        carried = (c * s + k) / (device.slider_kg * s**2 + c * s + k)
        resistance = device.viscous_ns_per_m + (device.slider_kg * s * carried).real
        held = (1.0 - np.exp(-1j * angles[:, None])) / (1j * phase)
        held = held * np.exp(-1j * phase * device.delay_periods)
        seen = carried / s
        a = (np.abs(held) ** 2 / resistance).sum(axis=1)
        # beyond HARMONICS the slider does not move
        a += (1.0 - (np.abs(held) ** 2).sum(axis=1)) / (device.viscous_ns_per_m + c)
        b = (np.abs(seen) ** 2 / resistance).sum(axis=1)
        centre = 0.5 * (held * seen / resistance).sum(axis=1)
        square = (np.abs(held * seen) / resistance).sum(axis=1) ** 2 if constant else a * b
        turn = np.exp(1j * angles)
        law = np.stack((np.ones_like(turn), *derivatives(turn, 1000.0, PAPER_FILTERS)))
        products = (law[FIRST] * law[SECOND].conj()).real
        self.terms = np.vstack(  # of K, B, M and of their products, (9, A)
            (2.0 * (law * centre).real, products * (np.abs(centre) ** 2 - 0.25 * square))
        )

    def holds(self, points):
        """Return True (N,) where the condition, a quadratic form in K, B, M, is met at
        all angles.
        """
        points = np.asarray(points)
        products = points[:, FIRST] * points[:, SECOND]
        return (np.hstack((points, products)) @ self.terms).min(axis=1) >= -1.0


def edge(holds, direction):
    """Return the factor of `direction` up to which `holds` is true, to 1e-9; inf if there is no
    limit.
    """
    shares = np.geomspace(1e-3, 10.0, 140)
    flags = holds(shares[:, None] * direction)
    if flags.all():
        return np.inf
    first = int(np.argmin(flags))
    if first == 0:
        return 0.0
    low, high = shares[first - 1], shares[first]
    while high - low > 1e-9 * high:
        middle = np.linspace(low, high, 18)[1:-1]
        flags = holds(middle[:, None] * direction)
        last = 16 if flags.all() else int(np.argmin(flags))
        edges = np.concatenate(([low], middle, [high]))
        low, high = edges[last], edges[last + 1]
    return float(low)
