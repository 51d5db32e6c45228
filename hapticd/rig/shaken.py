"""The handle while the perturbation shakes it: what is played, what comes of it, line by line.

Played is one second of sines of whole Hz from 10 to 30 Hz, over and over, their force rising with
the frequency so that a mass moves equally fast at each (Schroeder's phases, 1970, keep the peak
low). Its strength grows until the handle moves far enough to be measured. B = M = 0, and K is so
weak that it only keeps the handle from wandering off, as the smallest slope would make it.

Encoder and probe have clocks of one board: sample n of the probe ends at n * 250 us, to within a
constant, which the ticks that brought the samples tell (`Recording.place`). Lines are fitted to
what came (weighted least squares with a Hann window), so samples may be missing and ticks jitter.

What would break it: friction above the probe's force (the handle does not move, which is said), or
a motion that is no steady one: the handle drifting into a stop.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from math import pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.client.lease import ClientLease
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.push import ready
from hapticd.rig.records import collect
from hapticd.rig.streams import Travel, inside, measuring, streams

LINES_HZ = np.arange(10.0, 31.0)
PERIOD_S = 1.0
CENTRE_N_PER_M = 5.0
CENTRE_S = 1.0
SETTLE_S = 0.75
SEARCH_S = 1.0
SHAKE_S = 4.0
QUIET_S = 0.1  # until what played has ended, and another waveform may be loaded
FIRST_SHARE = 0.05  # of the probe's force
MOST_SHARE = 0.95
ENOUGH_M = 3e-3  # rms: friction then takes little of the force
MOST_STRONGER = 2.0  # from one try to the next
LEAST_STRONGER = 1.2
MOST_TRAVEL_M = 12e-3  # from where the handle was let go, or from x = 0 if that is nearer
SAMPLES_PER_US = PROBE_RATE_HZ / US_PER_S


class Recording(NamedTuple):
    """What came of the probe's samples (n,) and of the ticks beside them (m,)."""

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


class Watch(NamedTuple):
    """What a recording under force is kept by: the lease, and where the handle may go."""

    lease: ClientLease
    travel: Travel


def record(bench: Client, seconds: float, watch: Watch | None = None) -> Recording:
    """Both streams for `seconds`; without `watch` nothing acts. Errors as those of `streams`, and
    AnalysisError where force ends or the handle wanders off.
    """
    if watch is None:
        found = streams(bench, seconds, lambda ticks: None)
    else:
        travel = watch.travel
        found = streams(bench, seconds, lambda ticks: inside(bench, ticks, travel), watch.lease)
    return recording(found.samples, found.ticks)


def recording(samples: Records, ticks: Records) -> Recording:
    """Records of the topics `probe` and `servo.raw`, on the probe's time."""
    latched = ticks["board_us"] * SAMPLES_PER_US
    # the last sample that each tick brought ends within one sample before it was latched
    last = np.flatnonzero(np.diff(samples["time_ns"], append=samples["time_ns"][-1] + 1))
    at_ns, of_sample, of_tick = np.intersect1d(
        samples["time_ns"][last], ticks["time_ns"], return_indices=True
    )
    if not len(at_ns):
        raise AnalysisError("probe and servo streams do not belong together; repeat the step")
    shift = np.median(samples["index"][last][of_sample] - latched[of_tick])
    return Recording(
        samples["index"].astype(np.float64),
        samples["torque"].astype(np.float64),
        samples["velocity"].astype(np.float64),
        latched + shift,
        ticks["position_m"].astype(np.float64),
        ticks["state"].astype(np.uint8),
    )


def waveform(peak_n: float) -> Floats:
    """One period (n,) of the perturbation [N] whose largest force is `peak_n`."""
    phases = -pi * np.arange(LINES_HZ.size) * np.arange(1, LINES_HZ.size + 1) / LINES_HZ.size
    turns = np.outer(np.arange(round(PERIOD_S * PROBE_RATE_HZ)) / PROBE_RATE_HZ, LINES_HZ)
    force = np.cos(2.0 * pi * turns + phases) @ LINES_HZ
    found: Floats = force * (peak_n / np.abs(force).max())
    return found


def lines(found: Recording) -> Lines:
    """The lines of a recording of whole seconds."""
    torque, velocity = amplitudes(found.number, np.stack([found.torque, found.velocity]))
    (position_m,) = amplitudes(found.place, found.position_m[None, :])
    return Lines(torque, velocity, position_m)


def amplitudes(at: Floats, values: Floats) -> Complexes:
    """Amplitudes (k, l) of cosines of LINES_HZ in `values` (k, n) at the samples `at` (n,) of the
    probe; mean and trend are taken out.
    """
    since = at - at[0]
    window = np.sin(pi * (since + 0.5) / (since[-1] + 1.0)) ** 2
    turns = 2.0 * pi / PROBE_RATE_HZ * np.outer(at, LINES_HZ)
    columns = np.hstack(
        [np.cos(turns), np.sin(turns), np.stack([np.ones_like(at), since / since[-1]], axis=1)]
    )
    weighted = columns * window[:, None]
    found = np.linalg.lstsq(weighted.T @ weighted, weighted.T @ (values * window).T, rcond=None)[0]
    size = len(LINES_HZ)
    result: Complexes = (found[:size] - 1j * found[size : 2 * size]).T
    return result


@contextmanager
def shaking(bench: Client) -> Iterator[Watch]:
    """Enabled for a perturbation. However it is left, nothing plays and the device is disabled."""
    with measuring(bench) as lease, ready(bench):
        bench.set(K=CENTRE_N_PER_M, ramp_s=CENTRE_S)
        at_m = float(collect(bench, CENTRE_S).records["position_m"][-1])
        ends_m = Travel(min(0.0, at_m) - MOST_TRAVEL_M, max(0.0, at_m) + MOST_TRAVEL_M)
        yield Watch(lease, ends_m)
        bench.perturb_stop()


def shaken(bench: Client) -> Recording:
    """Shake the handle as strongly as it takes, and record it. AnalysisError as of `record`."""
    most_n = float(bench.hello().servo["device"]["probe_limit_n"])
    with shaking(bench) as watch:
        share = FIRST_SHARE
        while True:
            _play(bench, waveform(share * most_n))
            record(bench, SETTLE_S, watch)
            went_m = rms(lines(record(bench, SEARCH_S, watch)).position_m)
            if went_m >= ENOUGH_M or share >= MOST_SHARE:
                return record(bench, SHAKE_S, watch)
            # friction takes its part of a weak force alone: motion grows faster than force
            stronger = min(MOST_STRONGER, ENOUGH_M / max(went_m, 1e-9))
            share = min(MOST_SHARE, max(LEAST_STRONGER, stronger) * share)
            bench.perturb_stop()
            collect(bench, QUIET_S)


def _play(bench: Client, force_n: Floats) -> None:
    bench.perturb_load(force_n)
    bench.perturb_start(loop=True)


def rms(amplitude: Complexes) -> float:
    """Of all lines together."""
    return float(np.sqrt(np.sum(np.abs(amplitude) ** 2) / 2.0))
