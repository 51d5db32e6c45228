"""The stepped sine: an independent measurement of an impedance, one frequency after the other,
without spectral estimation.

At each frequency the probe plays one sine, the first second is left out, and Z is the ratio of the
two channels' Fourier sums over whole seconds. Frequencies are whole hertz, so whole seconds hold
whole periods and nothing leaks. On a linear device it must agree with noise. With Coulomb friction
a sine of the same rms sees a different equivalent damping (4/pi Fc/V instead of sqrt(2/pi)
Fc/sigma). The two then differ, and both are right for their amplitude.

Limitations: a loop that rings for longer than the second that is left out.
"""

from dataclasses import dataclass, replace

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.zwidth.sources import Source, Trial
from hapticd.zwidth.store import EndReason, Progress, Steps, TrialRecord, silent

__all__ = ["ReferenceSines", "may_follow", "stepped_sine"]

FREQUENCIES_HZ = (3.0, 5.0, 8.0, 13.0, 21.0, 34.0, 55.0, 89.0, 144.0, 233.0, 377.0, 480.0)
DWELL_S = 4.0
TRANSIENT_S = 1.0
HARMLESS = (EndReason.ESCAPE, EndReason.SATURATION, EndReason.DECIDED)
FORCE_N = 0.2  # rms, as that of the paper's noise


@dataclass(frozen=True, eq=False)
class ReferenceSines:
    """Z (F,) complex128 [N s/m] at `frequency_hz` (F,); nan where the trial ended early. `force_n`
    is the rms of each sine, `velocity_rms_m_per_s` (F,) that of the motion, all frequencies
    together.
    """

    frequency_hz: Floats
    impedance_ns_per_m: Complexes
    force_n: float
    velocity_rms_m_per_s: Floats


def stepped_sine(
    trial: Trial,
    source: Source,
    tell: Progress = silent,
    frequency_hz: tuple[float, ...] = FREQUENCIES_HZ,
    force_n: float = FORCE_N,
) -> ReferenceSines:
    """Measure Z of the environment of `trial` at whole frequencies, a short trial each."""
    steps = Steps(tell, len(frequency_hz))
    count = len(frequency_hz)
    z = np.full(count, np.nan, np.complex128)
    speed = np.full(count, np.nan)
    for place, f in enumerate(frequency_hz):
        steps.next(f"sine of {f:g} Hz")
        wave = (
            np.sqrt(2.0)
            * force_n
            * np.sin(2.0 * np.pi * f * np.arange(PROBE_RATE_HZ) / PROBE_RATE_HZ)
        )
        recorded = source(replace(trial, waveform_n=wave, seconds=DWELL_S), silent)
        if not recorded.ended:
            force, velocity = _settled(recorded)
            turn = np.exp(-2j * np.pi * f * np.arange(force.size) / recorded.rate_hz)
            z[place] = (force @ turn) / (velocity @ turn)
            speed[place] = np.std(velocity)
        if not may_follow(recorded):
            break
    steps.end()
    return ReferenceSines(np.asarray(frequency_hz, np.float64), z, force_n, speed)


def may_follow(recorded: TrialRecord) -> bool:
    """Whether another trial may follow: not after a disable or a change by another client, nor with
    a hot winding.
    """
    ended = recorded.ended
    return ended is None or ended.reason in HARMLESS


def _settled(recorded: TrialRecord) -> tuple[Floats, Floats]:
    """Force and velocity of the whole seconds at the end, both (n,)."""
    count = round(int(recorded.seconds - TRANSIENT_S) * recorded.rate_hz)
    return recorded.force_n[-count:], recorded.velocity_m_per_s[-count:]
