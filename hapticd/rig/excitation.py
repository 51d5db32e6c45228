"""Noise that shakes a free handle by the probe, and how loud it may be.

The noise has all frequencies from LOW_HZ up; above CORNER_HZ it falls off, so that the handle moves
rather than trembles. It begins and ends softly. A short soft try says how far the handle goes, and
the loud part is as much louder as keeps it within TRAVEL_SHARE of its half travel.

What would break it: a handle whose motion is no linear matter of the force (static friction that
the try does not overcome; then the probe's own limit is what is left).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.rig.played import play

CENTRE = Environment(20.0, 0.3)  # weak: it keeps the handle in the middle
LOW_HZ = 5.0
CORNER_HZ = 60.0
MOST_HZ = 1500.0
FADE_S = 0.1
TRY_S = 2.0
TRY_SHARE = 0.3  # of the probe's force
MOST_SHARE = 0.8
TRAVEL_SHARE = 0.3  # of the half travel that the loud part may take


def noise(seconds: float, most_n: float, number: int) -> Floats:
    """Force [N at 4 kHz] (n,) up to `most_n`, from LOW_HZ up, falling off above CORNER_HZ; another
    one for each `number`.
    """
    samples = round(PROBE_RATE_HZ * seconds)
    f = np.fft.rfftfreq(samples, 1.0 / PROBE_RATE_HZ)
    random = np.random.Generator(np.random.Philox(key=number))
    real, imaginary = random.standard_normal((2, f.size))
    shape = ((f >= LOW_HZ) & (f <= MOST_HZ)) / (1.0 + f / CORNER_HZ)
    force = np.fft.irfft(shape * (real + 1j * imaginary), samples)
    place = np.arange(samples)
    fade = np.minimum(place, samples - 1 - place) / (FADE_S * PROBE_RATE_HZ)
    force *= np.minimum(1.0, fade)
    return np.asarray(force * (most_n / np.abs(force).max()))


def loudest_n(bench: Client, servo: Mapping[str, Any]) -> float:
    """Greatest force of the loud part, for which the handle keeps well inside its travel."""
    probe_n = float(servo["device"]["probe_limit_n"])
    tried = play(bench, noise(TRY_S, TRY_SHARE * probe_n, 0), CENTRE)
    ends = servo["environment"]["workspace"]
    room_m = 0.5 * (float(ends["upper_m"]) - float(ends["lower_m"]))
    went_m = 0.5 * float(np.ptp(tried.position_m))
    most = MOST_SHARE / TRY_SHARE
    stronger = min(most, TRAVEL_SHARE * room_m / went_m) if went_m > 0.0 else most
    return TRY_SHARE * probe_n * stronger
