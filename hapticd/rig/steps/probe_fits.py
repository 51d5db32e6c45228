"""Fits of `probe`: the torque added by a known mass, and one signal in both channels.

Mass. The balance of forces on a shaken handle, without and with a known mass, gives newtons per
count of the probe's torque, without knowledge of the device's mass or motor.

The encoder is at one end of a slightly compliant transmission, the probe at the other. At 30 Hz a
handle of 25 g moves a few percent further than the probe. Forces inside the device cancel in the
sum over both, so at every line, with g newtons in a count,

    g T = (m + M) A + r (A' - A) + b V + c S + k X

A, V and X are acceleration, velocity and position of the encoder's end, A' the acceleration of the
probe's end (its own velocity channel), r the mass that moves with it, S the lines of sign(V'):
Coulomb friction is a known signal, not noise. M is 0 and the mass. Both recordings are solved
together, for m, m + M and r, and b, c and k of each. The difference is the mass over g, and its
sign that of g.

A nearly rigid transmission gives no information on r, so r is assumed to be a part of m.

The channels shift the phase. V' against the encoder's velocity shows a delay and a high-pass of the
velocity channel; one signal into both shows the difference of the torque channel. Both are removed,
also from V' before its sign is taken: 0.1 Hz at 10 Hz shifts the reversals by as much as a slow
reversal takes. The scale of V' falls with the square of the frequency because of the compliance;
its value at 0 Hz is the gain.

Limitations: sticking for a large part of the time (it appears in the residuals), and a mass behind
a soft part of its own.

Signal. Skew and high-pass mismatch of the probe's two channels. A signal into both inputs appears
at the outputs with the ratio of the channels' responses, H_v / H_t, for any signal. Its phase is

    phi(f) = 2 pi f d + a / f,     d the skew, a = (f_v - f_t) of first-order corners at f >> both

and the next orders, f^3 of interpolation and anti-aliasing, 1/f^3 of corners that are not far
below, are also fitted. d > 0: the velocity is that of d later than the force of the same sample
(`zwidth trial live` corrects it). A mismatch turns a spring into a damper: Z = K/jw is rotated by
-phi. So at f_min, the lowest frequency judged, it appears to have the damping

    -K sin(phi - 2 pi f d) / (2 pi f_min)

The phases are fitted by least squares with the signal's power as weight (noise of the channels is
white) between BAND_HZ. A Hann window discards nearly half of the record, which widens the interval.

Limitations: a signal without content near f_min (the interval of the mismatch shows it), or inputs
that are coupled in another way than by the signal.
"""

from dataclasses import dataclass
from math import copysign, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.excitation import LINES_HZ, Lines, Recording, amplitudes, lines
from hapticd.rig.experiment import SAMPLE_US
from hapticd.rig.result import Change, Finding, Fit, StepResult, Value, checked, least_squares

__all__ = ["ReferenceSpring"]

UNEVEN = 2.0  # of a variance: residuals are mainly model errors, and differ between lines
PART_SD = 0.3  # of an unknown share between 0 and 1
OMEGA = 2.0 * pi * LINES_HZ
SIGNAL_S = 30.0
BAND_HZ = (0.8, 200.0)
HANN_SPREAD = 35.0 / 18.0  # of the variance of a fit under the window: mean w^4 / (mean w^2)^2
SIGNAL_COUNTS = 20.0  # rms in the band, of a usable signal
SIGNAL_COHERENT = 0.5  # coherent share of the velocity channel's power
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
        """Phase by which it shifts the lines (l,), in radians."""
        return self.turn_per_hz * LINES_HZ + self.corner_hz / LINES_HZ


class Added(NamedTuple):
    """Result of the fit of both recordings."""

    counts: float  # torque counts of the added mass, per m/s^2
    half: float  # of its 95 % interval
    left: float  # unexplained share of the torque's lines


def fit_velocity_channel(bare: Lines) -> Channel:
    """Fit the velocity channel, from lines of the handle without the mass."""
    speed = 1j * OMEGA * bare.position_m
    ratio = bare.velocity / speed
    sign = copysign(1.0, float(ratio.real.sum()))
    columns = np.stack([LINES_HZ, 1.0 / LINES_HZ], axis=1)
    turn, corner = np.linalg.lstsq(columns, np.angle(sign * ratio), rcond=None)[0]
    # the compliance grows with w^2
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
    """Append a row to `known` and `seen`: the mass that moves with the probe is half of the moving
    mass, within PART_SD. A rigid transmission gives no other information on it.
    """
    deviation = sqrt(UNEVEN * float(free.residuals @ free.residuals) / free.freedom)
    row = np.zeros(known.shape[1])
    row[:2] = 1.0, -0.5
    weight = deviation / (PART_SD * abs(float(free.values[1])))
    return np.vstack([known, weight * row]), np.append(seen, 0.0)


def _parts(
    found: Recording, of_velocity: Channel, turned: Floats
) -> tuple[Complexes, Complexes, Complexes]:
    """Return lines of one recording, on the encoder's clock: of the torque (l,) in counts, of the
    acceleration (l,) of the probe's end relative to the encoder's [m/s^2], and of the encoder's own
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
    """Return the velocity (n,), in counts of the right sign, with the high-pass undone."""
    counts = copysign(1.0, of_velocity.counts) * (found.velocity - found.velocity.mean())
    way = np.cumsum(counts) / PROBE_RATE_HZ
    number = np.arange(len(way))
    way -= np.polyval(np.polyfit(number, way, 1), number)
    return np.asarray(counts + 2.0 * pi * of_velocity.corner_hz * way)


@dataclass(frozen=True)
class ReferenceSpring:
    """A spring, at the lowest frequency judged, for the assessment of the mismatch."""

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
        """Delay of the velocity's sampling [us]."""
        # the zero crossing of a line is exact: the effect of its interpolation is in f^3
        to_us = US_PER_S / (2.0 * pi)
        skew = to_us * float(self.fit.values[0])
        return Value.around("probe skew", skew, "us", to_us * float(self.fit.halves[0]))

    def mismatch(self, judged: ReferenceSpring) -> Value:
        """Return the damping that unequal high-passes imitate on the spring of `judged`."""
        low = judged.lowest_hz
        of = np.array([0.0, 0.0, 1.0 / low, low**-3.0])
        angle = float(of @ self.fit.values)
        per_radian = judged.stiffness_n_per_m / (2.0 * pi * low)
        half = per_radian * cos(angle) * self.fit.half(of)
        return Value.around("high-pass mismatch", -per_radian * sin(angle), "N s/m", half)

    def result(self, judged: ReferenceSpring) -> StepResult:
        """Return skew and mismatch with their findings; the skew is written to the device file."""
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
    """Return the phase between the counts (n,) of both channels under one signal, or why there is
    none.
    """
    window = np.hanning(len(torque))
    f = np.arange(len(window) // 2 + 1) * PROBE_RATE_HZ / len(window)
    inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    t, v = (np.fft.rfft((one - one.mean()) * window)[inside] for one in (torque, velocity))
    powers = np.array([(np.abs(one) ** 2).sum() for one in (t, v)])
    # rms that a window of mean square 3/8 passes
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
