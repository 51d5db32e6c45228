"""The fits of `probe`: what a known mass adds to the torque, and one signal in both channels.

Mass. The balance of forces on a shaken handle, without and with a known mass, says what a count of
the probe's torque is, with neither the device's mass nor its motor known.

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
velocity channel; one signal into both the difference of the torque channel. Both
are taken out, of V' before its sign is taken too: 0.1 Hz at 10 Hz shift the reversals by as much as
a slow reversal takes. The scale of V' falls with the square of the frequency as the transmission
gives; what it is at 0 Hz is its gain.

Limitations: sticking for a good part of the time (the residuals show it), and a mass behind
something soft of its own.

Signal. What the probe's two channels do to one and the same signal: skew and high-pass mismatch. A
signal that goes into both inputs comes out of them with the ratio of the channels' own responses,
H_v / H_t, whatever the signal is. Its phase is

    phi(f) = 2 pi f d + a / f,     d the skew, a = (f_v - f_t) of first-order corners at f >> both

and next orders, f^3 of interpolation and anti-aliasing, 1/f^3 of corners that are not far below,
are fitted besides. d > 0: the velocity is that of d later than the force of the same sample
(`zwidth trial live` takes it out). A mismatch turns a spring into a damper: Z = K/jw is turned by
-phi, so that at f_min, the lowest frequency that is judged, it seems to have the damping

    -K sin(phi - 2 pi f d) / (2 pi f_min)

The phases are fitted by least squares with the signal's power as weight (noise of the channels is
white) between BAND_HZ. A Hann window takes nearly half of the record away, which widens the
interval.

Limitations: a signal without content near f_min (the interval of the mismatch says so), or inputs
that are coupled otherwise than by the signal.
"""

from dataclasses import dataclass
from math import copysign, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.estimate import Fit, least_squares
from hapticd.rig.excitation import LINES_HZ, Lines, Recording, amplitudes, lines
from hapticd.rig.experiment import SAMPLE_US
from hapticd.rig.result import Change, Finding, StepResult, Value, checked

__all__ = ["ReferenceSpring"]

UNEVEN = 2.0  # of a variance: what a fit leaves is rather of its model, and not alike at all lines
PART_SD = 0.3  # of a share that is anything between 0 and 1
OMEGA = 2.0 * pi * LINES_HZ
SIGNAL_S = 30.0
BAND_HZ = (0.8, 200.0)
HANN_SPREAD = 35.0 / 18.0  # of the variance of what is fitted under it: mean w^4 / (mean w^2)^2
SIGNAL_COUNTS = 20.0  # rms in the band, of a signal that says something
SIGNAL_COHERENT = 0.5  # share of the velocity channel's power that is the torque channel's
MOST_SKEW = 0.1  # of a sample: 9 degrees at 1 kHz
MOST_DAMPING_NS_PER_M = 0.05


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


def fit_velocity_channel(bare: Lines) -> Channel:
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


def fit_added_mass(
    bare: Recording, loaded: Recording, of_velocity: Channel, turned: Floats
) -> Added:
    """Fit both recordings; `turned` (l,) is the phase of the velocity channel against the torque
    channel.
    """
    bare_torque, bare_inner, bare_own = _parts(bare, of_velocity, turned)
    loaded_torque, loaded_inner, loaded_own = _parts(loaded, of_velocity, turned)
    inner = np.concatenate((bare_inner, loaded_inner))
    # inner, then acceleration, velocity, friction and position of each recording
    columns = np.zeros((len(inner), 9), np.complex128)
    columns[:, 0] = inner
    columns[: len(LINES_HZ), 1:5] = bare_own
    columns[len(LINES_HZ) :, 5:] = loaded_own
    torque = np.concatenate((bare_torque, loaded_torque))
    known = np.concatenate([columns.real, columns.imag])
    seen = np.concatenate([torque.real, torque.imag])
    free = least_squares(known, seen, inflate=UNEVEN)
    fit = least_squares(*_within_mass(known, seen, free), inflate=UNEVEN)
    of = np.zeros(9)
    of[1] = -1.0
    of[5] = 1.0
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


def _parts(
    found: Recording, of_velocity: Channel, turned: Floats
) -> tuple[Complexes, Complexes, Complexes]:
    """Lines of one recording, on the encoder's clock: of the torque (l,) in counts, of the
    acceleration (l,) of the probe's end beyond the encoder's [m/s^2], and of the encoder's own
    acceleration, velocity, friction and position (l, 4).
    """
    seen = lines(found)
    probe = seen.velocity * np.exp(-1j * of_velocity.phase) / of_velocity.counts
    torque = seen.torque * np.exp(-1j * (of_velocity.phase - turned))
    speed = 1j * OMEGA * seen.position_m
    acceleration = 1j * OMEGA * speed
    signs = np.sign(_without_high_pass(found, of_velocity))
    (friction,) = amplitudes(found.number, signs[None, :])
    friction = friction * np.exp(-1j * of_velocity.turn_per_hz * LINES_HZ)
    own = np.stack([acceleration, speed, friction, seen.position_m], axis=1)
    return torque, 1j * OMEGA * probe - acceleration, own


def _without_high_pass(found: Recording, of_velocity: Channel) -> Floats:
    """The velocity (n,), in counts of the right sign, with what the high-pass took."""
    counts = copysign(1.0, of_velocity.counts) * (found.velocity - found.velocity.mean())
    way = np.cumsum(counts) / PROBE_RATE_HZ
    number = np.arange(len(way))
    way -= np.polyval(np.polyfit(number, way, 1), number)
    return np.asarray(counts + 2.0 * pi * of_velocity.corner_hz * way)


@dataclass(frozen=True)
class ReferenceSpring:
    """What the mismatch is to be thought of: a spring at the lowest frequency that is judged."""

    lowest_hz: float = 2.0
    stiffness_n_per_m: float = 600.0


@dataclass(frozen=True)
class Phase:
    """phi(f) in radians: f, f^3, 1/f and 1/f^3 times the coefficients of a fit."""

    fit: Fit

    def at(self, f: Floats) -> Floats:
        """phi (n,) at `f` (n,) in Hz."""
        return np.asarray(_columns(f) @ self.fit.values)

    @property
    def skew(self) -> Value:
        """By how much later the velocity is sampled [us]."""
        # the zero crossing of a line is where it is: what its interpolation adds is in f^3
        to_us = US_PER_S / (2.0 * pi)
        skew = to_us * float(self.fit.values[0])
        return Value.around("probe skew", skew, "us", to_us * float(self.fit.halves[0]))

    def mismatch(self, judged: ReferenceSpring) -> Value:
        """Damping that unequal high-passes feign on the spring of `judged`."""
        low = judged.lowest_hz
        of = np.array([0.0, 0.0, 1.0 / low, low**-3.0])
        angle = float(of @ self.fit.values)
        per_radian = judged.stiffness_n_per_m / (2.0 * pi * low)
        half = per_radian * cos(angle) * self.fit.half(of)
        return Value.around("high-pass mismatch", -per_radian * sin(angle), "N s/m", half)

    def result(self, judged: ReferenceSpring) -> StepResult:
        """Both, and what is to be thought of them; the skew goes into the device file."""
        skew = self.skew
        mismatch = self.mismatch(judged)
        share = skew.value / SAMPLE_US
        most = max(abs(mismatch.low), abs(mismatch.high))
        findings = [
            checked(
                f"the velocity is sampled {skew.value:.3g} us after the force, {share:.2g} of a"
                " sample",
                abs(share) <= MOST_SKEW,
                "sample both together; until then, live trials correct for it by the device file",
            ),
            checked(
                f"unequal high-passes look like {mismatch.value:.3g} N s/m on a spring of"
                f" {judged.stiffness_n_per_m:g} N/m at {judged.lowest_hz:g} Hz",
                most <= MOST_DAMPING_NS_PER_M,
                "couple both channels directly or with equal corners, or judge from a higher"
                " frequency",
            ),
        ]
        change = Change("probe_velocity", "skew_us", skew.rounded)
        return StepResult("probe", [skew, mismatch], findings, [change])


def _columns(f: Floats) -> Floats:
    return np.stack([f, f**3, 1.0 / f, 1.0 / f**3], axis=1)


def phase(torque: Floats, velocity: Floats) -> Phase | Finding:
    """The phase between the counts (n,) of both channels under one signal; why there is none."""
    window = np.hanning(len(torque))
    f = np.arange(len(window) // 2 + 1) * PROBE_RATE_HZ / len(window)
    inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    t, v = (np.fft.rfft((one - one.mean()) * window)[inside] for one in (torque, velocity))
    powers = np.array([(np.abs(one) ** 2).sum() for one in (t, v)])
    # rms of what a window of mean square 3/8 lets through
    counts = np.sqrt(powers * 2.0 / 0.375) / len(torque)
    cross = v * t.conj()
    shared = abs(cross.sum()) ** 2 / (powers.prod() + 1e-300)
    if counts.min() < SIGNAL_COUNTS or shared < SIGNAL_COHERENT:
        return Finding(
            f"one signal gives {counts[0]:.3g} counts rms in the torque channel, {counts[1]:.3g} in"
            f" the velocity channel, {100 * shared:.3g} % of it common",
            "refused",
            "feed one signal with content from 1 to 200 Hz, as strong as a trial's, into both",
        )
    angles = np.angle(cross * np.sign(cross.sum().real))
    fit = least_squares(_columns(f[inside]), angles, np.abs(t), inflate=UNEVEN * HANN_SPREAD)
    return Phase(fit._replace(freedom=len(angles) / HANN_SPREAD - len(fit.values)))
