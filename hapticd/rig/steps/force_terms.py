"""Forces on a perturbed handle as means for the balance of forces, and the clock of the samples.

Means over intervals of the velocity give v' exactly, as a mean weighted by the triangle of two
intervals. The probe's torque is held, and the smoothed staircase of commands has a double integral
in closed form. phi is the mean normalised friction: the sign of the velocity, and, where forces do
not exceed Fc, their value. Velocity is linear within an interval, so the moment of a reversal is
known.

The board reports the times of the encoder latch. The intervals of the probe end at multiples of 250
us of the same clock plus a constant (`Clock`). The encoder's displacement and the integral of the
velocity agree only for the right constant, to about 0.1 us. The same equation gives the ratio
between both, the corner of a high-pass in the velocity channel, and how much further the encoder
moves at high frequencies (a compliant transmission).

Limitations: a velocity so noisy that phi is random (more than about 2 % of the motion), or a handle
that hardly moves within CLOCK_HZ, so that the constant cannot be determined.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.experiment import SAMPLE_US, PerturbationRun
from hapticd.rig.result import jackknife, lines

H_S = 1.0 / PROBE_RATE_HZ
BLOCK = PROBE_RATE_HZ  # samples: lines 1 Hz apart
EDGE = 20  # samples left out at both ends
CLOCK_HZ = (5.0, 40.0)
CLOCK_BLOCK_S = 1.0
CLOCK_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Clock:
    """Relation of the probe's samples to the board's time."""

    phase_us: float  # board's time at which the interval of index 0 began
    gain: float  # displacement of the encoder over the integral of the velocity
    high_pass_rad_s: float  # corner of the velocity channel
    yield_s2: float  # extra displacement of the encoder, over the square of the frequency [rad/s]


@dataclass(frozen=True, slots=True)
class Handle:
    """The moving masses, and the path of a command to them."""

    mass_kg: float
    viscous_ns_per_m: float
    coulomb_n: float
    gain: float  # of the motor: force by command, both in N
    lag_us: float  # D + s
    spread_us2: float  # s^2; below 0 if noise dominates
    skew_us: float  # delay of the velocity behind the torque
    high_pass_rad_s: float = 0.0  # corner of the torque channel
    slider_kg: float = 0.0  # mass on a spring, in addition to mass_kg; 0: all is rigid
    slider_rad_s: float = 0.0  # its natural frequency while the rest is held
    slider_ratio: float = 0.0  # of its critical damping
    droop: float = 0.0  # of the velocity channel, relative to one that interpolates for its skew

    @property
    def whole_kg(self) -> float:
        """Total moving mass."""
        return self.mass_kg + self.slider_kg


class Terms(NamedTuple):
    """Means (n,) of one run, weighted by the triangles of two intervals."""

    acceleration: Floats
    slider: Floats  # acceleration of the mass on the spring
    velocity: Floats
    friction: Floats  # phi
    command: Floats  # F
    torque: Floats
    pull_n: Floats  # (blocks,) f0


def commanded(run: PerturbationRun, clock: Clock, lag_us: float, spread_us2: float) -> Floats:
    """Return F (N - 1,): the staircase of commands after its delay and smoothing."""
    if spread_us2 < 0.0:  # odd continuation, so that the fit has no edge at 0
        return 2.0 * commanded(run, clock, lag_us, 0.0) - commanded(run, clock, lag_us, -spread_us2)
    smooth_us = float(np.sqrt(spread_us2))
    edge_us = run.board_us + (lag_us - smooth_us)
    grid_us = clock.phase_us + SAMPLE_US * (run.first_index + np.arange(run.torque_n.size + 1))
    twice = _integral(edge_us / US_PER_S, run.force_n, smooth_us / US_PER_S, grid_us / US_PER_S)
    return np.asarray(np.diff(twice, 2) / H_S**2)


def _integral(edge_s: Floats, value: Floats, smooth_s: float, at_s: Floats) -> Floats:
    """Return the double integral at `at_s` of the smoothed staircase of `value` (n,) from `edge_s`
    (n,).
    """
    length = np.diff(edge_s, append=2.0 * edge_s[-1] - edge_s[-2])
    tail = np.exp(-length / smooth_s) if smooth_s > 0.0 else np.zeros(length.size)
    away = _away(value, tail)
    faded = smooth_s * (1.0 - tail)
    once = np.concatenate(([0.0], np.cumsum(value * length + away * faded)))[:-1]
    step = once * length + 0.5 * value * length**2 + away * smooth_s * (length - faded)
    twice = np.concatenate(([0.0], np.cumsum(step)))[:-1]
    k = np.clip(np.searchsorted(edge_s, at_s, side="right") - 1, 0, value.size - 1)
    since = np.maximum(at_s - edge_s[k], 0.0)
    fading = np.exp(-since / smooth_s) if smooth_s > 0.0 else np.zeros(since.size)
    return np.asarray(
        twice[k]
        + once[k] * since
        + 0.5 * value[k] * since**2
        + away[k] * smooth_s * (since - smooth_s * (1.0 - fading))
    )


def _away(value: Floats, tail: Floats) -> Floats:
    """Return the difference (n,) of the smoothed force from each value when that begins."""
    force = float(value[0])
    found = []
    for share, target in zip(tail.tolist(), value.tolist(), strict=True):
        found.append(force - target)
        force = target + found[-1] * share
    return np.array(found)


def shifted(values: Floats, later_us: float, slopes: int = 0) -> Floats:
    """Return `values` (n,) as they were `later_us` later, or their derivative per us."""
    jw = 2j * np.pi * np.fft.rfftfreq(values.size, H_S) / US_PER_S
    turned = np.fft.rfft(values) * np.exp(jw * later_us) * jw**slopes
    return np.asarray(np.fft.irfft(turned, values.size))


def drooped(values: Floats, handle: Handle) -> Floats:
    """Return `values` (n,) with the droop of a channel delayed by interpolation."""
    late = min(max(handle.skew_us / SAMPLE_US, 0.0), 1.0)
    f = np.fft.rfftfreq(values.size)
    lost = handle.droop * late * (1.0 - late) * (1.0 - np.cos(2.0 * np.pi * f))
    return np.asarray(np.fft.irfft((1.0 - lost) * np.fft.rfft(values), values.size))


def friction(push_n: Floats, velocity: Floats, handle: Handle) -> Floats:
    """Return phi (n,): the mean sign of friction in each interval, with the force `push_n` and the
    mean velocity `velocity`.
    """
    mass = handle.mass_kg
    level = max(handle.coulomb_n, 1e-9)
    driven = push_n - handle.viscous_ns_per_m * velocity
    phi = np.sign(velocity)
    start = velocity.copy()
    for _ in range(3):
        slope = (driven - level * phi) / mass
        start[1:] = 0.5 * (velocity[1:] + velocity[:-1]) + 0.25 * H_S * (slope[:-1] - slope[1:])
        before = np.sign(start)
        braked = (driven - level * before) / mass
        stops = start * braked < 0.0
        until = np.ones(start.size)
        until[stops] = np.minimum(1.0, -start[stops] / (braked[stops] * H_S))
        until[before == 0.0] = 0.0
        phi = until * before + (1.0 - until) * np.clip(driven / level, -1.0, 1.0)
    return np.asarray(phi)


def terms(run: PerturbationRun, clock: Clock, handle: Handle) -> Terms:
    """Return the terms of the balance that depend on `handle`."""
    drift = (run.position_m[-1] - run.position_m[0]) / (run.board_us[-1] - run.board_us[0])
    velocity = undo_high_pass(run.velocity_m_per_s, clock.high_pass_rad_s)
    velocity = velocity - velocity.mean() + drift * US_PER_S / clock.gain
    torque = undo_high_pass(run.torque_n, handle.high_pass_rad_s)
    torque = drooped(shifted(torque, -handle.skew_us), handle)
    command = commanded(run, clock, handle.lag_us, handle.spread_us2)
    acceleration = np.diff(velocity) / H_S
    slider = base_excited_response(acceleration, handle.slider_rad_s, handle.slider_ratio)
    push = torque + _widened(handle.gain * command - handle.slider_kg * slider)
    phi = np.zeros(velocity.size)
    pull = 0.0
    for _ in range(2):
        phi = friction(push - pull, velocity, handle)
        rest = push - handle.viscous_ns_per_m * velocity - handle.coulomb_n * phi
        pull = float(rest[EDGE:-EDGE].mean())
    blocks = rest[: rest.size // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    velocity, phi, torque = (0.5 * (one[1:] + one[:-1]) for one in (velocity, phi, torque))
    return Terms(acceleration, slider, velocity, phi, command, torque, blocks)


def _widened(means: Floats) -> Floats:
    """Return interval means (n + 1,) from those under triangles (n,)."""
    return np.concatenate((means[:1], 0.5 * (means[1:] + means[:-1]), means[-1:]))


def base_excited_response(acceleration: Floats, rate_rad_s: float, ratio: float) -> Floats:
    """Return the acceleration (n,) of a mass on a spring and a damper whose base moves with
    `acceleration` (n,); zeros for a rate of 0.
    """
    if rate_rad_s <= 0.0:
        return np.zeros(acceleration.size)
    s = 2j * np.pi * np.fft.rfftfreq(acceleration.size, H_S)
    tied = 2.0 * ratio * rate_rad_s * s + rate_rad_s**2
    found = np.fft.irfft(np.fft.rfft(acceleration) * tied / (s**2 + tied), acceleration.size)
    return np.asarray(found)


# --- clock ----------------------------------------------------------------------------------------
def clocked(run: PerturbationRun) -> Clock:
    """Return the position of the probe's intervals in the board's time."""
    late_us = run.board_us - SAMPLE_US * (run.last_index + 1.0)
    # an interval that had arrived was over, the next one was not
    phase_us = 0.5 * (float(late_us.max()) - SAMPLE_US + float(late_us.min()))
    found = Clock(phase_us, 1.0, 0.0, 0.0)
    for _ in range(CLOCK_ROUNDS):
        found = _phase(run, found.phase_us, found.high_pass_rad_s)
    return found


def undo_high_pass(values: Floats, corner_rad_s: float) -> Floats:
    """Return `values` (n,) without their mean, before a high-pass of that corner."""
    own = values - values.mean()
    return np.asarray(own + corner_rad_s * (np.cumsum(own) - 0.5 * own) * H_S)


def _phase(run: PerturbationRun, phase_us: float, corner_rad_s: float) -> Clock:
    """Refine the clock from a guess of its phase and of the channel's high-pass."""
    v = undo_high_pass(run.velocity_m_per_s, corner_rad_s)
    at = (run.board_us - phase_us) / SAMPLE_US - run.first_index
    inside = (at >= 1.0) & (at < v.size - 2.0)
    seen = _way_m(v, at[inside])
    speed = np.interp(at[inside] - 0.5, np.arange(v.size), v)
    rate_hz = US_PER_S / run.period_us
    lost = np.cumsum(seen - seen.mean()) / rate_hz
    bent = np.zeros(seen.size)
    bent[1:-1] = -np.diff(seen, 2) * rate_hz**2
    columns = (seen, speed, lost, bent, run.position_m[inside])
    block = round(CLOCK_BLOCK_S * rate_hz)
    parts = [lines(one[1:-1], block, rate_hz, CLOCK_HZ) for one in columns]
    gain, shift, corner, further = jackknife(np.dstack(parts[:-1]), parts[-1]).values.tolist()
    phase_us -= US_PER_S * shift / gain
    return Clock(phase_us, gain, corner_rad_s + corner / gain, further / gain)


def _way_m(v: Floats, at: Floats) -> Floats:
    """Return the integral (k,) of the interval means `v` (n,) at the times `at` (k,) in intervals,
    by the parabola through each interval and its neighbours.
    """
    way_m = np.concatenate(([0.0], np.cumsum(v))) * H_S
    whole = np.floor(at).astype(np.int64)
    part = at - whole
    bend = 0.25 * part * (1.0 - part) * (v[whole + 1] - v[whole - 1]) * H_S
    return np.asarray(way_m[whole] + part * v[whole] * H_S - bend)
