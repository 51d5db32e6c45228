"""Perturbations of a free handle, and their permitted amplitude: noise, or sines.

Noise contains all frequencies from LOW_HZ up. It falls off above CORNER_HZ, so that the handle
moves rather than trembles, and it is faded in and out. A short soft try measures how far the handle
moves. The loud part is scaled to keep it within TRAVEL_SHARE of its half travel.

Sines repeat one second of whole Hz from 10 to 30 Hz. Their force rises with frequency, so that a
mass moves equally fast at each (Schroeder's phases, 1970, keep the peak low). Their amplitude grows
until the handle moves far enough to be measured. B = M = 0, and K is so weak that it only keeps the
handle from drifting off, as the smallest slope would cause.

Encoder and probe share the clock of one board. Sample n of the probe ends at n * 250 us plus a
constant, which follows from the ticks that brought the samples (`Recording.place`). Lines are
fitted to the received samples (weighted least squares with a Hann window), so samples may be
missing and ticks may jitter.

Limitations: a handle whose motion is nonlinear in the force (static friction that the try does not
overcome, or friction above the probe's force), or one that drifts into a stop.
"""

from collections.abc import Mapping
from math import pi
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.client import Client
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.experiment import Streams, collect, perturbation_run, perturbing, record

# --- noise ----------------------------------------------------------------------------------------
CENTRE = Environment(20.0, 0.3)  # weak: it keeps the handle in the middle
LOW_HZ = 5.0
CORNER_HZ = 60.0
MOST_HZ = 1500.0
FADE_S = 0.1
TRY_S = 2.0
TRY_SHARE = 0.3  # of the probe's force
LOUDEST_SHARE = 0.8
TRAVEL_SHARE = 0.3  # of the half travel that the loud part may take

# --- sines ----------------------------------------------------------------------------------------
LINES_HZ = np.arange(10.0, 31.0)
PERIOD_S = 1.0
WEAK = Environment(5.0, 0.0)
WEAK_S = 1.0
SETTLE_S = 0.75
SEARCH_S = 1.0
SINES_S = 4.0
QUIET_S = 0.1  # until the waveform has ended and another one may be loaded
FIRST_SHARE = 0.05  # of the probe's force
MOST_SHARE = 0.95
ENOUGH_M = 3e-3  # rms: friction then takes only a small part of the force
MOST_STRONGER = 2.0  # from one try to the next
LEAST_STRONGER = 1.2
REACH_M = 12e-3  # from where the handle was let go, or from x = 0 if that is nearer


class Recording(NamedTuple):
    """Received samples (n,) of the probe, and the ticks (m,) of the same time."""

    number: Floats  # (n,) of the sample
    torque: Floats  # (n,) counts
    velocity: Floats  # (n,) counts
    place: Floats  # (m,) when the encoder was latched, in samples of the probe
    position_m: Floats  # (m,)
    state: npt.NDArray[np.uint8]  # (m,) of the servo


class Lines(NamedTuple):
    """Amplitudes (l,) of cosines of LINES_HZ over the probe's own time."""

    torque: Complexes  # counts
    velocity: Complexes  # counts
    position_m: Complexes


def noise(seconds: float, most_n: float, number: int) -> Floats:
    """Return a force [N at 4 kHz] (n,) up to `most_n`, from LOW_HZ up, falling off above CORNER_HZ.
    Each `number` gives another realisation.
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
    """Return the maximum force of the loud part that keeps the handle well inside its travel."""
    try_n = TRY_SHARE * float(servo["device"]["probe_limit_n"])
    tried = perturbation_run(bench, noise(TRY_S, try_n, 0), CENTRE)
    ends = servo["environment"]["workspace"]
    room_m = 0.5 * (float(ends["upper_m"]) - float(ends["lower_m"]))
    went_m = 0.5 * float(np.ptp(tried.position_m))
    most = LOUDEST_SHARE / TRY_SHARE
    return try_n * (min(most, TRAVEL_SHARE * room_m / went_m) if went_m > 0.0 else most)


def sines(peak_n: float) -> Floats:
    """Return one period (n,) of the perturbation [N] whose maximum force is `peak_n`."""
    phases = -pi * np.arange(LINES_HZ.size) * np.arange(1, LINES_HZ.size + 1) / LINES_HZ.size
    turns = np.outer(np.arange(round(PERIOD_S * PROBE_RATE_HZ)) / PROBE_RATE_HZ, LINES_HZ)
    force = np.cos(2.0 * pi * turns + phases) @ LINES_HZ
    return np.asarray(force * (peak_n / np.abs(force).max()))


def sine_run(bench: Client) -> Recording:
    """Shake the handle with sines of sufficient amplitude, and record it. AnalysisError as for
    `experiment.record`.
    """
    most_n = bench.hello().servo.device.probe_limit_n
    share = FIRST_SHARE
    with perturbing(bench, WEAK, WEAK_S, REACH_M) as watch:
        while True:
            bench.perturb_load(sines(share * most_n))
            bench.perturb_start(loop=True)
            record(bench, SETTLE_S, watch)
            went_m = rms(lines(recording(record(bench, SEARCH_S, watch))).position_m)
            if went_m >= ENOUGH_M or share >= MOST_SHARE:
                return recording(record(bench, SINES_S, watch))
            # friction takes a constant part of a weak force: motion grows faster than force
            stronger = min(MOST_STRONGER, ENOUGH_M / max(went_m, 1e-9))
            share = min(MOST_SHARE, max(LEAST_STRONGER, stronger) * share)
            bench.perturb_stop()
            collect(bench, QUIET_S)


def recording(found: Streams) -> Recording:
    """Return both streams on the probe's time. AnalysisError if they do not belong together."""
    ticks, samples, _ = found
    latched = ticks["board_us"] * (PROBE_RATE_HZ / US_PER_S)
    # the last sample that each tick brought ends within one sample before it was latched
    last = np.flatnonzero(np.diff(samples["time_ns"], append=samples["time_ns"][-1] + 1))
    at_ns, of_sample, of_tick = np.intersect1d(
        samples["time_ns"][last], ticks["time_ns"], return_indices=True
    )
    if not len(at_ns):
        raise AnalysisError("probe and servo streams do not belong together; repeat the step")
    return Recording(
        samples["index"].astype(np.float64),
        samples["torque"].astype(np.float64),
        samples["velocity"].astype(np.float64),
        latched + np.median(samples["index"][last][of_sample] - latched[of_tick]),
        ticks["position_m"].astype(np.float64),
        ticks["state"].astype(np.uint8),
    )


def lines(found: Recording) -> Lines:
    """Return the lines of a recording of whole seconds."""
    torque, velocity = amplitudes(found.number, np.stack([found.torque, found.velocity]))
    (position_m,) = amplitudes(found.place, found.position_m[None, :])
    return Lines(torque, velocity, position_m)


def amplitudes(at: Floats, values: Floats) -> Complexes:
    """Return amplitudes (k, l) of cosines of LINES_HZ in `values` (k, n) at probe samples `at`
    (n,). Mean and trend are removed.
    """
    since = at - at[0]
    window = np.sin(pi * (since + 0.5) / (since[-1] + 1.0)) ** 2
    turns = 2.0 * pi / PROBE_RATE_HZ * np.outer(at, LINES_HZ)
    trend = np.stack([np.ones_like(at), since / since[-1]], axis=1)
    weighted = np.hstack([np.cos(turns), np.sin(turns), trend]) * window[:, None]
    found = np.linalg.lstsq(weighted.T @ weighted, weighted.T @ (values * window).T, rcond=None)[0]
    size = len(LINES_HZ)
    return np.asarray((found[:size] - 1j * found[size : 2 * size]).T)


def rms(amplitude: Complexes) -> float:
    """Return the rms value of all lines together."""
    return float(np.sqrt(np.sum(np.abs(amplitude) ** 2) / 2.0))
