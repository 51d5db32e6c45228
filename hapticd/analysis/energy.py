"""The definition itself: energy that has flowed into the device at the port, never less than minus
what it held at the start.

E(t) = integral of F v. With interval means of both channels sum(F_k v_k) T is the exact work of a
force held over each interval; no trend is removed, because the energy of a trial is that of its
true force and velocity. Starting at rest a passive device keeps E >= 0. A trial whose noise drives
mostly frequencies where the device dissipates stays far above 0 although it is active at others:
the spectral verdict is the sharper one, this is the unconditional one.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats


@dataclass(frozen=True, slots=True)
class Energy:
    """Energy integral of a record [J]: its minimum with the time of it [s], and its value at
    the end.
    """

    minimum_j: float
    minimum_s: float
    end_j: float


def energy(force_n: Floats, velocity_m_per_s: Floats, rate_hz: float) -> Energy:
    """Energy integral of force and velocity (N,), N >= 1, sampled at `rate_hz`."""
    flowed = np.cumsum(force_n * velocity_m_per_s) / rate_hz
    lowest = int(np.argmin(flowed))
    if flowed[lowest] >= 0.0:
        return Energy(0.0, 0.0, float(flowed[-1]))
    return Energy(float(flowed[lowest]), (lowest + 1) / rate_hz, float(flowed[-1]))
