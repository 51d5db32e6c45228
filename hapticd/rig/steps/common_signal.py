"""What the probe's two channels do to one and the same signal: skew and high-pass mismatch.

A signal that goes into both inputs comes out of them with the ratio of the channels' own responses,
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

What would break it: a signal without content near f_min (the interval of the mismatch says so), or
inputs that are coupled otherwise than by the signal.
"""

from dataclasses import dataclass
from math import cos, pi, sin, sqrt

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.result import UPPER_END, Change, Finding, Value, rounded
from hapticd.signal.verdict import student_quantile

__all__ = ["Judged"]

SECONDS = 30.0
BAND_HZ = (0.8, 200.0)
PERIOD_US = US_PER_S / PROBE_RATE_HZ
HANN_SPREAD = 35.0 / 18.0  # of the variance of what is fitted under it: mean w^4 / (mean w^2)^2
UNEVEN = 2.0  # of a variance: what a fit leaves is rather of its model, and not alike at all lines
LEAST_COUNTS = 20.0  # rms in the band, of a signal that says something
LEAST_COHERENT = 0.5  # share of the velocity channel's power that is the torque channel's
MOST_SKEW = 0.1  # of a sample: 9 degrees at 1 kHz
MOST_DAMPING_NS_PER_M = 0.05
SKEW = "probe skew"


@dataclass(frozen=True)
class Judged:
    """What the mismatch is to be thought of: a spring at the lowest frequency that is judged."""

    lowest_hz: float = 2.0
    stiffness_n_per_m: float = 600.0


@dataclass(frozen=True)
class Phase:
    """phi(f) in radians: `weights` (4,) of f, f^3, 1/f and 1/f^3, with their covariance (4, 4)."""

    weights: Floats
    covariance: Floats
    freedom: float

    def at(self, f: Floats) -> Floats:
        """phi (n,) at `f` (n,) in Hz."""
        found: Floats = _columns(f) @ self.weights
        return found

    def half(self, of: Floats) -> float:
        """Half of the 95 % interval of the sum of `of` (4,) times the weights."""
        return student_quantile(UPPER_END, self.freedom) * sqrt(float(of @ self.covariance @ of))


def _columns(f: Floats) -> Floats:
    return np.stack([f, f**3, 1.0 / f, 1.0 / f**3], axis=1)


def phase(torque: Floats, velocity: Floats) -> Phase | Finding:
    """The phase between the counts (n,) of both channels under one signal; why there is none."""
    window = np.hanning(len(torque))
    f = np.arange(len(window) // 2 + 1) * PROBE_RATE_HZ / len(window)
    inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    t, v = (np.fft.rfft((one - one.mean()) * window)[inside] for one in (torque, velocity))
    f = f[inside]
    power = np.asarray(np.abs(t) ** 2, np.float64)
    # rms of what a window of mean square 3/8 lets through
    counts = np.sqrt(np.array([power.sum(), (np.abs(v) ** 2).sum()]) * 2.0 / 0.375) / len(torque)
    cross = v * t.conj()
    shared = abs(cross.sum()) ** 2 / (power.sum() * (np.abs(v) ** 2).sum() + 1e-300)
    if counts.min() < LEAST_COUNTS or shared < LEAST_COHERENT:
        what = (
            f"one signal gives {counts[0]:.3g} counts rms in the torque channel, {counts[1]:.3g} in"
            f" the velocity channel, {100 * shared:.3g} % of it common"
        )
        remedy = "feed one signal with content from 1 to 200 Hz, as strong as a trial's, into both"
        return Finding(what, "refused", remedy)
    turned = cross * np.sign(cross.sum().real)
    return _fitted(f, np.asarray(np.angle(turned), np.float64), power)


def _fitted(f: Floats, angles: Floats, weight: Floats) -> Phase:
    # a column each over its size at the ends, or the normal equations have no digits left
    scale = np.array([BAND_HZ[1], BAND_HZ[1] ** 3, 1.0 / BAND_HZ[0], BAND_HZ[0] ** -3.0])
    columns = _columns(f) / scale * np.sqrt(weight)[:, None]
    inverse = np.linalg.pinv(columns.T @ columns)
    weights = inverse @ (columns.T @ (angles * np.sqrt(weight)))
    left = angles * np.sqrt(weight) - columns @ weights
    freedom = len(f) / HANN_SPREAD - len(scale)
    spread = UNEVEN * float(left @ left) / (len(f) - len(scale))
    covariance = inverse * spread * HANN_SPREAD / np.outer(scale, scale)
    return Phase(weights / scale, covariance, freedom)


def values(found: Phase, judged: Judged) -> list[Value]:
    """Skew and mismatch."""
    to_us = US_PER_S / (2.0 * pi)
    skew = to_us * float(found.weights[0])
    skew_half = to_us * found.half(np.array([1.0, 0.0, 0.0, 0.0]))
    low = judged.lowest_hz
    of = np.array([0.0, 0.0, 1.0 / low, low**-3.0])
    angle = float(of @ found.weights)
    per_radian = judged.stiffness_n_per_m / (2.0 * pi * low)
    damping = -per_radian * sin(angle)
    half = per_radian * cos(angle) * found.half(of)
    # the zero crossing of a line is where it is: what its interpolation adds to a delay is in f^3
    return [
        Value(SKEW, skew, "us", skew - skew_half, skew + skew_half),
        Value("high-pass mismatch", damping, "N s/m", damping - half, damping + half),
    ]


def change(skew: Value) -> Change:
    """`skew` into the device file."""
    return Change("probe_velocity", "skew_us", rounded(skew.value, skew.low, skew.high))


def findings(skew: Value, mismatch: Value, judged: Judged) -> list[Finding]:
    """What is to be thought of both."""
    share = skew.value / PERIOD_US
    what = f"the velocity is sampled {skew.value:.3g} us after the force, {share:.2g} of a sample"
    said = [Finding(what, "ok")]
    if abs(share) > MOST_SKEW:
        remedy = "sample both together; until then live trials take it out, as the device file says"
        said = [Finding(what, "warning", remedy)]
    what = (
        f"unequal high-passes look like {mismatch.value:.3g} N s/m on a spring of"
        f" {judged.stiffness_n_per_m:g} N/m at {judged.lowest_hz:g} Hz"
    )
    most = max(abs(mismatch.low), abs(mismatch.high))
    if most <= MOST_DAMPING_NS_PER_M:
        return [*said, Finding(what, "ok")]
    remedy = "couple both channels directly or with equal corners, or judge from a higher frequency"
    return [*said, Finding(what, "warning", remedy)]
