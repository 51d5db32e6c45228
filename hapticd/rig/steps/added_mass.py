"""The balance of forces on a shaken handle, without and with a known mass: what a count of the
probe's torque is, with neither the device's mass nor its motor known.

The encoder slides at one end of a transmission that gives a little, the probe turns at the other;
at 30 Hz a handle of 25 g moves some percent further than the probe. Forces inside the device cancel
in the sum over both, so at every line, with g newtons in a count,

    g T = (m + M) A + r (A' - A) + b V + c S + k X

A, V and X are acceleration, velocity and position of the encoder's end, A' the acceleration of the
probe's end (its own velocity channel), r what moves with it, S the lines of sign(V'): Coulomb
friction is no noise but a known signal. M is 0 and the mass. Both recordings are solved together,
for m, m + M and r, and b, c and k of each; the difference is the mass over g, and its sign g's.

As a transmission that gives next to nothing tells nothing of r, r is taken to be some part of m.

The channels turn the phase. V' against the encoder's velocity shows a delay and a high-pass of the
velocity channel; one signal into both (`common_signal`) the difference of the torque channel. Both
are taken out, of V' before its sign is taken too: 0.1 Hz at 10 Hz shift the reversals by as much as
a slow reversal takes. The scale of V' falls with the square of the frequency as the transmission
gives; what it is at 0 Hz is its gain.

What would break it: sticking for a good part of the time (the residuals show it), and a mass behind
something soft of its own.
"""

from math import copysign, pi, sqrt
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.rig.estimate import Fit, least_squares
from hapticd.rig.excitation import LINES_HZ, Lines, Recording, amplitudes, lines

UNEVEN = 2.0  # of a variance: what a fit leaves is rather of its model, and not alike at all lines
PART_SD = 0.3  # of a share that is anything between 0 and 1
OMEGA = 2.0 * pi * LINES_HZ


class Channel(NamedTuple):
    """The velocity channel against the encoder."""

    counts: float  # per m/s, with its sign
    relative_half: float  # of its 95 % interval
    turn_per_hz: float  # radians: a delay
    corner_hz: float  # of a first-order high-pass

    @property
    def phase(self) -> Floats:
        """By which it turns the lines (l,), in radians."""
        return self.turn_per_hz * LINES_HZ + self.corner_hz / LINES_HZ


class Added(NamedTuple):
    """What the fit of both recordings says."""

    counts: float  # that the torque channel shows for what the mass adds, per m/s^2
    half: float  # of its 95 % interval
    left: float  # share of the torque's lines that is not explained


def channel(bare: Lines) -> Channel:
    """The velocity channel, from lines of the handle without the mass."""
    speed = 1j * OMEGA * bare.position_m
    ratio = bare.velocity / speed
    sign = copysign(1.0, float(ratio.real.sum()))
    columns = np.stack([LINES_HZ, 1.0 / LINES_HZ], axis=1)
    turn, corner = np.linalg.lstsq(columns, np.angle(sign * ratio), rcond=None)[0]
    # what the transmission gives grows with w^2
    known = np.stack([np.abs(speed), np.abs(speed) * OMEGA**2], axis=1)
    fit = least_squares(known, np.abs(bare.velocity), inflate=UNEVEN)
    counts = float(fit.values[0])
    return Channel(sign * counts, float(fit.halves[0]) / counts, float(turn), float(corner))


def added(bare: Recording, loaded: Recording, of_velocity: Channel, turned: Floats) -> Added:
    """Fit both recordings; `turned` (l,) is the phase of the velocity channel against the torque
    channel.
    """
    parts = [_parts(one, of_velocity, turned) for one in (bare, loaded)]
    inner = np.concatenate([one.inner for one in parts])
    # inner, then acceleration, velocity, friction and position of each recording
    columns = np.zeros((len(inner), 9), np.complex128)
    columns[:, 0] = inner
    columns[: len(LINES_HZ), 1:5] = parts[0].own
    columns[len(LINES_HZ) :, 5:] = parts[1].own
    torque = np.concatenate([one.torque for one in parts])
    known = np.concatenate([columns.real, columns.imag])
    seen = np.concatenate([torque.real, torque.imag])
    free = least_squares(known, seen, inflate=UNEVEN)
    fit = least_squares(*_within_mass(known, seen, free), inflate=UNEVEN)
    of = np.zeros(9)
    of[1], of[5] = -1.0, 1.0
    left = float(np.linalg.norm(fit.residuals) / np.linalg.norm(seen))
    return Added(float(of @ fit.values), fit.half(of), left)


def _within_mass(known: Floats, seen: Floats, free: Fit) -> tuple[Floats, Floats]:
    """`known` and `seen` with a row more: what moves with the probe is a part of what moves, half
    of it give or take PART_SD. A transmission that does not give tells nothing of it.
    """
    deviation = sqrt(UNEVEN * float(free.residuals @ free.residuals) / free.freedom)
    row = np.zeros(known.shape[1])
    row[:2] = 1.0, -0.5
    weight = deviation / (PART_SD * abs(float(free.values[1])))
    return np.vstack([known, weight * row]), np.append(seen, 0.0)


class _Parts(NamedTuple):
    """Lines (l,) of one recording, on the encoder's clock."""

    torque: Complexes  # counts
    inner: Complexes  # m/s^2, of the probe's end beyond the encoder's
    own: Complexes  # (l, 4) acceleration, velocity, friction and position


def _parts(found: Recording, of_velocity: Channel, turned: Floats) -> _Parts:
    seen = lines(found)
    probe = seen.velocity * np.exp(-1j * of_velocity.phase) / of_velocity.counts
    torque = seen.torque * np.exp(-1j * (of_velocity.phase - turned))
    speed = 1j * OMEGA * seen.position_m
    acceleration = 1j * OMEGA * speed
    signs = np.sign(_without_high_pass(found, of_velocity))
    (friction,) = amplitudes(found.number, signs[None, :])
    friction = friction * np.exp(-1j * of_velocity.turn_per_hz * LINES_HZ)
    own = np.stack([acceleration, speed, friction, seen.position_m], axis=1)
    return _Parts(torque, 1j * OMEGA * probe - acceleration, own)


def _without_high_pass(found: Recording, of_velocity: Channel) -> Floats:
    """The velocity (n,), in counts of the right sign, with what the high-pass took."""
    counts = copysign(1.0, of_velocity.counts) * (found.velocity - found.velocity.mean())
    way = np.cumsum(counts) / PROBE_RATE_HZ
    number = np.arange(len(way))
    way -= np.polyval(np.polyfit(number, way, 1), number)
    return np.asarray(counts + 2.0 * pi * of_velocity.corner_hz * way)
