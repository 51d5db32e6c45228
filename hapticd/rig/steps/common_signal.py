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
from math import cos, pi, sin

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.estimate import Fit, least_squares
from hapticd.rig.result import Change, Finding, Value, checked

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
    """phi(f) in radians: f, f^3, 1/f and 1/f^3 times the coefficients of a fit."""

    fit: Fit

    def at(self, f: Floats) -> Floats:
        """phi (n,) at `f` (n,) in Hz."""
        found: Floats = _columns(f) @ self.fit.values
        return found

    @property
    def skew(self) -> Value:
        """By how much later the velocity is sampled [us]."""
        # the zero crossing of a line is where it is: what its interpolation adds is in f^3
        to_us = US_PER_S / (2.0 * pi)
        skew, half = to_us * float(self.fit.values[0]), to_us * float(self.fit.halves[0])
        return Value.around(SKEW, skew, "us", half)

    def mismatch(self, judged: Judged) -> Value:
        """Damping that unequal high-passes feign on the spring of `judged`."""
        low = judged.lowest_hz
        of = np.array([0.0, 0.0, 1.0 / low, low**-3.0])
        angle = float(of @ self.fit.values)
        per_radian = judged.stiffness_n_per_m / (2.0 * pi * low)
        half = per_radian * cos(angle) * self.fit.half(of)
        return Value.around("high-pass mismatch", -per_radian * sin(angle), "N s/m", half)


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
    if counts.min() < LEAST_COUNTS or shared < LEAST_COHERENT:
        what = (
            f"one signal gives {counts[0]:.3g} counts rms in the torque channel, {counts[1]:.3g} in"
            f" the velocity channel, {100 * shared:.3g} % of it common"
        )
        remedy = "feed one signal with content from 1 to 200 Hz, as strong as a trial's, into both"
        return Finding(what, "refused", remedy)
    angles = np.angle(cross * np.sign(cross.sum().real))
    fit = least_squares(_columns(f[inside]), angles, np.abs(t), inflate=UNEVEN * HANN_SPREAD)
    return Phase(fit._replace(freedom=len(angles) / HANN_SPREAD - len(fit.values)))


def change(skew: Value) -> Change:
    """`skew` into the device file."""
    return Change("probe_velocity", "skew_us", skew.rounded)


def findings(skew: Value, mismatch: Value, judged: Judged) -> list[Finding]:
    """What is to be thought of both."""
    share = skew.value / PERIOD_US
    late = f"the velocity is sampled {skew.value:.3g} us after the force, {share:.2g} of a sample"
    together = "sample both together; until then live trials take it out, as the device file says"
    what = (
        f"unequal high-passes look like {mismatch.value:.3g} N s/m on a spring of"
        f" {judged.stiffness_n_per_m:g} N/m at {judged.lowest_hz:g} Hz"
    )
    most = max(abs(mismatch.low), abs(mismatch.high))
    remedy = "couple both channels directly or with equal corners, or judge from a higher frequency"
    return [
        checked(late, abs(share) <= MOST_SKEW, together),
        checked(what, most <= MOST_DAMPING_NS_PER_M, remedy),
    ]
