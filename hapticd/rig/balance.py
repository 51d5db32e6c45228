"""Mass, friction, delay and smoothing from the balance of forces on a perturbed handle.

Every force on it is known: the probe's torque t, and the servo's commands f, which act after a
delay D as a held staircase through a smoothing of time constant s. So at every sample of 4 kHz

    m v' + b v + Fc phi + f0 = t + g F,     F = smoothed staircase of f,  g = gain of the motor

and m, b, Fc, g are linear in it. Means over intervals of the velocity give v' exactly, as a mean
under the triangle of two intervals; the torque is held, and F has a double integral in closed form.
phi is the mean of what friction does: the sign of the velocity, and where forces do not overcome
Fc, as much as they are (within an interval the velocity runs straight, so the moment of a reversal
is known). Everything passes the same window, and the equation is solved by lines of LOW_HZ to
HIGH_HZ. Coulomb and viscous friction differ because v grows with the amplitude and phi does not
(their describing functions), so two amplitudes are played.

Delay and smoothing. To the second order in w the path of a command is 1 - jw L - w^2 (L^2 + q) / 2
with the lag L = D + s and the spread q = s^2. L is known at once. q is told by curvature alone, as
if a mass K q / 2 were missing, so a mass that is not known to MASS_SHARE leaves q in doubt by
2 m MASS_SHARE / K, and D with it: D = L - sqrt(q). What the board's clock says of D is its least.

Clocks. The encoder is latched at times that the board tells, the intervals of the probe end at
multiples of 250 us of the same clock, to within a constant. The encoder's way and the integral of
the velocity agree only for the right constant (`clocked`), to some 0.1 us, the right gain, and the
right corner of a high-pass in the velocity channel. The velocity may come later than the torque (a
skew), and the torque channel may have a high-pass too: two more unknowns of the balance.

Intervals: the equation is linear near its solution, and a sum over blocks of one second. Leaving
out each in turn (jackknife) gives deviations and correlations without presuming white residuals.

Assumptions. Each is a term that should not be there: a mass that changes with the frequency (fitted
along, so that m is what moves slowly), friction that grows with the square of the speed, friction
of speed that differs by direction, a delay that drifts, a steady pull. Added to the equation its
coefficient has Student's t, so the chance of a false alarm is known: SIGNIFICANCE for all of them
together (Bonferroni).

What would break it: a velocity so noisy that phi is chance (more than some 2 % of the motion), and
motion above HIGH_HZ that is no small part of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.verdict import student_quantile
from hapticd.errors import AnalysisError
from hapticd.rig.played import SAMPLE_US, Played
from hapticd.units import PROBE_RATE_HZ, US_PER_S

H_S = 1.0 / PROBE_RATE_HZ
BLOCK = PROBE_RATE_HZ  # samples: lines 1 Hz apart
LEAST_BLOCKS = 8
LOW_HZ = 5.0
HIGH_HZ = 200.0
COUPLED_HZ = 450.0  # up to where a resonance is fitted
RATIO = 0.05  # of critical damping, to begin with
CLOCK_HZ = (5.0, 40.0)
CLOCK_BLOCK_S = 1.0
SMOOTH_LINES = 15  # on each side, of the residuals that weigh the lines
FIRST_ROUNDS = 3
ROUNDS = 10
SETTLED_US = 0.05
STRIDE_US = 300.0  # most that a round changes the lag
SPREADS_US = (0.0, 300.0, 1000.0, 3000.0, 8000.0)  # smoothing to begin with
SMALL_US2 = 1e3  # difference by which the spread is differentiated
SIGNIFICANCE = 0.01
EDGE = 20  # samples left out at both ends
NAMES = (
    "mass_kg",
    "viscous_ns_per_m",
    "coulomb_n",
    "gain",
    "lag_us",
    "spread_us2",
    "skew_us",
    "bend_kg",
    "high_pass_rad_s",
    "slider_kg",
    "slider_rad_s",
    "slider_ratio",
)
RIGID = 9  # of them: the last three are those of a resonance


@dataclass(frozen=True, slots=True)
class Handle:
    """What moves, and the way of a command to it."""

    mass_kg: float
    viscous_ns_per_m: float
    coulomb_n: float
    gain: float  # of the motor: force by command, both in N
    lag_us: float  # D + s
    spread_us2: float  # s^2; below 0 where noise says so
    skew_us: float  # by which the velocity comes later than the torque
    bend_kg: float = 0.0  # what the mass grows by up to HIGH_HZ, with the square of the frequency
    high_pass_rad_s: float = 0.0  # corner of the torque channel
    slider_kg: float = 0.0  # what hangs on a spring, beside mass_kg; 0: everything is rigid
    slider_rad_s: float = 0.0  # its own frequency while the rest is held
    slider_ratio: float = 0.0  # of its critical damping


@dataclass(frozen=True, slots=True)
class Clock:
    """How the probe's samples stand in the board's time."""

    phase_us: float  # board's time at which the interval of index 0 began
    phase_sd_us: float
    gain: float  # encoder's way by the integral of the velocity
    gain_sd: float
    high_pass_rad_s: float  # corner of the velocity channel
    yield_s2: float  # by which the encoder goes further, by the square of the frequency [rad/s]


@dataclass(frozen=True, slots=True)
class Test:
    """An assumption as a term that should be absent."""

    name: str
    size: float  # of the term, in its unit
    half: float  # of its 95 % interval
    t: float  # size by its deviation
    critical: float  # |t| that chance exceeds in SIGNIFICANCE of all cases, for all tests together

    @property
    def significant(self) -> bool:
        """Whether chance alone hardly does this."""
        return abs(self.t) > self.critical


@dataclass(frozen=True, eq=False)
class Balance:
    """The solution. `sd` and `correlation` in the order of NAMES."""

    handle: Handle
    sd: Floats  # (RIGID,), or of all with a resonance
    correlation: Floats  # square
    blocks: int
    residual: float  # rms of what is left, of the torque
    pull_n: float  # that acts all the time, or friction that is greater one way
    pull_sd_n: float
    speed_m_per_s: float  # rms
    tests: tuple[Test, ...]
    clocks: tuple[Clock, ...]


# --- clocks ---------------------------------------------------------------------------------------


def clocked(run: Played) -> Clock:
    """Where the probe's intervals lie in the board's time."""
    late_us = run.board_us - SAMPLE_US * (run.last_index + 1.0)
    # an interval that had come was over, the next one was not
    phase_us = 0.5 * (float(late_us.max()) - SAMPLE_US + float(late_us.min()))
    corner = 0.0
    for _ in range(5):
        found = _phase(run, phase_us, corner)
        phase_us = found.phase_us
        corner = found.high_pass_rad_s
    return found


def passed(values: Floats, corner_rad_s: float) -> Floats:
    """`values` (n,) without their mean, as they were before a high-pass of that corner."""
    own = values - values.mean()
    return np.asarray(own + corner_rad_s * (np.cumsum(own) - 0.5 * own) * H_S)


def _phase(run: Played, phase_us: float, corner_rad_s: float) -> Clock:
    """The clock again, from a guess of its phase and of the channel's high-pass."""
    v = passed(run.velocity_m_per_s, corner_rad_s)
    way_m = np.concatenate(([0.0], np.cumsum(v))) * H_S
    at = (run.board_us - phase_us) / SAMPLE_US - run.first_index
    inside = (at >= 1.0) & (at < v.size - 2.0)
    whole = np.floor(at[inside]).astype(np.int64)
    part = at[inside] - whole
    bend = 0.25 * part * (1.0 - part) * (v[whole + 1] - v[whole - 1]) * H_S
    seen = way_m[whole] + part * v[whole] * H_S - bend
    speed = np.interp(at[inside] - 0.5, np.arange(v.size), v)
    rate_hz = US_PER_S / run.period_us
    lost = np.cumsum(seen - seen.mean()) / rate_hz
    bent = np.zeros(seen.size)
    bent[1:-1] = -np.diff(seen, 2) * rate_hz**2
    columns = (seen, speed, lost, bent, run.position_m[inside])
    parts = [_ticks(one[1:-1], rate_hz) for one in columns]
    fit = solved(np.dstack(parts[:-1]), parts[-1])
    gain, shift, corner, further = fit.values.tolist()
    return Clock(
        phase_us - US_PER_S * shift / gain,
        US_PER_S * float(fit.sd[1]) / gain,
        gain,
        float(fit.sd[0]),
        corner_rad_s + corner / gain,
        further / gain,
    )


def _ticks(values: Floats, rate_hz: float) -> Floats:
    return lines(values, round(CLOCK_BLOCK_S * rate_hz), rate_hz, CLOCK_HZ)


def lines(values: Floats, block: int, rate_hz: float, band_hz: tuple[float, float]) -> Floats:
    """Real and imaginary parts (blocks, 2 l) of `values` (n,) at l lines of each block."""
    count = values.size // block
    parts = values[: count * block].reshape(count, block)
    window = np.hanning(block)
    f = np.fft.rfftfreq(block, 1.0 / rate_hz)
    found = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    kept = found[:, (f >= band_hz[0]) & (f <= band_hz[1])]
    return np.concatenate((kept.real, kept.imag), axis=1)


class Solution(NamedTuple):
    """Least squares by blocks."""

    values: Floats  # (p,)
    left: Floats  # (blocks, p) with each block left out

    @property
    def covariance(self) -> Floats:
        """(p, p) by the jackknife."""
        away = self.left - self.left.mean(axis=0)
        blocks = len(self.left)
        return np.asarray((blocks - 1) / blocks * (away.T @ away))

    @property
    def sd(self) -> Floats:
        """(p,)"""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def solved(columns: Floats, target: Floats) -> Solution:
    """`target` (blocks, rows) by `columns` (blocks, rows, p). AnalysisError where these are no
    motion at all.
    """
    scale = np.sqrt((columns**2).sum(axis=(0, 1)))
    if not (scale > 0.0).all():
        raise AnalysisError(
            "nothing moved: is the perturbation connected, and stronger than friction?"
        )
    even = columns / scale
    normal = np.einsum("bri,brj->bij", even, even)
    right = np.einsum("bri,br->bi", even, target)
    whole = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    left = np.linalg.solve(normal.sum(axis=0) - normal, (right.sum(axis=0) - right)[..., None])
    return Solution(whole / scale, left[..., 0] / scale)


# --- the terms of the balance ---------------------------------------------------------------------


class Terms(NamedTuple):
    """Means (n,) under the triangles of two intervals, of one run."""

    acceleration: Floats
    slider: Floats  # acceleration of what hangs on the spring
    velocity: Floats
    friction: Floats  # phi
    command: Floats  # F
    torque: Floats
    pull_n: float  # f0
    pull_blocks_n: Floats  # (blocks,)


def commanded(run: Played, clock: Clock, lag_us: float, spread_us2: float) -> Floats:
    """F (N - 1,): the staircase of commands behind its delay and smoothing."""
    if spread_us2 < 0.0:  # continued evenly, so that noise about 0 has no edge to lean on
        straight = commanded(run, clock, lag_us, 0.0)
        return 2.0 * straight - commanded(run, clock, lag_us, -spread_us2)
    smooth_us = float(np.sqrt(spread_us2))
    edge_us = run.board_us + (lag_us - smooth_us)
    count = run.torque_n.size + 1
    grid_us = clock.phase_us + SAMPLE_US * (run.first_index + np.arange(count))
    twice = _integral(edge_us / US_PER_S, run.force_n, smooth_us / US_PER_S, grid_us / US_PER_S)
    return np.asarray(np.diff(twice, 2) / H_S**2)


def _integral(edge_s: Floats, value: Floats, smooth_s: float, at_s: Floats) -> Floats:
    """Double integral at `at_s` of the smoothed staircase of `value` (n,) from `edge_s` (n,) on."""
    length = np.diff(edge_s, append=2.0 * edge_s[-1] - edge_s[-2])
    tail = np.exp(-length / smooth_s) if smooth_s > 0.0 else np.zeros(length.size)
    away = _away(value, tail)
    passed = smooth_s * (1.0 - tail)
    once = np.concatenate(([0.0], np.cumsum(value * length + away * passed)))[:-1]
    step = once * length + 0.5 * value * length**2 + away * smooth_s * (length - passed)
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
    """How far (n,) the smoothed force is from each value when that begins."""
    force = float(value[0])
    found = []
    for share, target in zip(tail.tolist(), value.tolist(), strict=True):
        found.append(force - target)
        force = target + (force - target) * share
    return np.array(found)


def shifted(values: Floats, later_us: float, slopes: int = 0) -> Floats:
    """`values` (n,) as they were `later_us` later, or their derivative per us."""
    jw = 2j * np.pi * np.fft.rfftfreq(values.size, H_S) / US_PER_S
    turned = np.fft.rfft(values) * np.exp(jw * later_us) * jw**slopes
    return np.asarray(np.fft.irfft(turned, values.size))


def friction(push_n: Floats, velocity: Floats, handle: Handle) -> Floats:
    """phi (n,): the mean sign of friction in each interval, in which `push_n` acts and the mean
    velocity is `velocity`.
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


def terms(run: Played, clock: Clock, handle: Handle) -> Terms:
    """The terms of the balance, as far as `handle` is needed for them."""
    drift = (run.position_m[-1] - run.position_m[0]) / (run.board_us[-1] - run.board_us[0])
    velocity = passed(run.velocity_m_per_s, clock.high_pass_rad_s)
    velocity = velocity - velocity.mean() + drift * US_PER_S / clock.gain
    torque = shifted(passed(run.torque_n, handle.high_pass_rad_s), -handle.skew_us)
    command = commanded(run, clock, handle.lag_us, handle.spread_us2)
    acceleration = np.diff(velocity) / H_S
    slider = hung(acceleration, handle.slider_rad_s, handle.slider_ratio)
    push = torque + _widened(handle.gain * command - handle.slider_kg * slider)
    phi = np.zeros(velocity.size)
    pull = 0.0
    for _ in range(2):
        phi = friction(push - pull, velocity, handle)
        rest = push - handle.viscous_ns_per_m * velocity - handle.coulomb_n * phi
        pull = float(rest[EDGE:-EDGE].mean())
    blocks = rest[: rest.size // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    two = (0.5 * (one[1:] + one[:-1]) for one in (velocity, phi, torque))
    mean_velocity, mean_phi, mean_torque = two
    return Terms(acceleration, slider, mean_velocity, mean_phi, command, mean_torque, pull, blocks)


def _widened(means: Floats) -> Floats:
    """Interval means (n + 1,) by those under triangles (n,)."""
    return np.concatenate((means[:1], 0.5 * (means[1:] + means[:-1]), means[-1:]))


def hung(acceleration: Floats, rate_rad_s: float, ratio: float) -> Floats:
    """Acceleration (n,) of a mass that hangs by a spring and a damper on what moves with
    `acceleration` (n,); zeros for a rate of 0.
    """
    if rate_rad_s <= 0.0:
        return np.zeros(acceleration.size)
    s = 2j * np.pi * np.fft.rfftfreq(acceleration.size, H_S)
    tied = 2.0 * ratio * rate_rad_s * s + rate_rad_s**2
    found = np.fft.irfft(np.fft.rfft(acceleration) * tied / (s**2 + tied), acceleration.size)
    return np.asarray(found)


# --- solving --------------------------------------------------------------------------------------


class _Rows(NamedTuple):
    """The equation by lines."""

    columns: Floats  # (blocks, rows, RIGID or all) by NAMES
    target: Floats  # (blocks, rows)
    extra: dict[str, Floats]  # of each test, (blocks, rows)
    run: Floats  # (blocks,) to which run a block belongs
    pull_n: Floats  # (blocks,)


def balanced(runs: Sequence[Played], coupled: bool = False) -> Balance:
    """Solve the balance of all `runs` together, of one rigid mass or of two that are `coupled`.
    AnalysisError where they are too short or nothing moves.
    """
    if sum(run.torque_n.size // BLOCK for run in runs) < LEAST_BLOCKS:
        raise AnalysisError(f"less than {LEAST_BLOCKS} s of motion; play longer waveforms")
    clocks = tuple(clocked(run) for run in runs)
    handle = _begin(runs, clocks, coupled)
    weight: Floats | None = None
    for _ in range(ROUNDS):
        rows = _rows(runs, clocks, handle)
        fit = solved(*_weighted(rows, weight))
        weight = _weights(rows, fit.values)
        handle, stride = _moved(handle, fit.values)
        if stride < SETTLED_US:
            break
    return _concluded(runs, clocks, handle, rows, fit, weight)


def _begin(runs: Sequence[Played], clocks: Sequence[Clock], coupled: bool) -> Handle:
    """The best of some guesses of the smoothing, each after a few rounds."""
    known = np.concatenate([run.delay_us[run.delay_us >= 0.0] for run in runs])
    delay_us = float(np.median(known)) if known.size else 0.25 * runs[0].period_us
    best: tuple[float, Handle] | None = None
    for smooth_us in SPREADS_US:
        handle = Handle(1e-2, 0.0, 0.0, 1.0, delay_us + smooth_us, smooth_us**2, 0.0)
        if coupled:
            further = max(float(np.mean([clock.yield_s2 for clock in clocks])), 1e-8)
            rate = 1.0 / sqrt(further)
            handle = replace(handle, slider_kg=3e-3, slider_rad_s=rate, slider_ratio=RATIO)
        for _ in range(FIRST_ROUNDS):
            rows = _rows(runs, clocks, handle)
            fit = solved(rows.columns, rows.target)
            handle, _ = _moved(handle, fit.values)
        size = float(((rows.target - rows.columns @ fit.values) ** 2).sum())
        if best is None or size < best[0]:
            best = (size, handle)
    assert best is not None
    return best[1]


def _moved(handle: Handle, values: Floats) -> tuple[Handle, float]:
    """`handle` after a round, and how far the lag went [us]."""
    mass, viscous, coulomb, gain, lag, spread, skew, bend, corner = values[:RIGID].tolist()
    stride = float(np.clip(lag, -STRIDE_US, STRIDE_US))
    widest = max(4e4, abs(handle.spread_us2))
    moved = replace(
        handle,
        mass_kg=abs(mass) or handle.mass_kg,
        viscous_ns_per_m=viscous,
        coulomb_n=max(coulomb, 0.0),
        gain=gain,
        lag_us=handle.lag_us + stride,
        spread_us2=handle.spread_us2 + float(np.clip(spread, -widest, widest)),
        skew_us=handle.skew_us + float(np.clip(skew, -STRIDE_US, STRIDE_US)),
        bend_kg=bend,
        high_pass_rad_s=handle.high_pass_rad_s + corner,
    )
    if handle.slider_rad_s > 0.0:
        slider, rate, ratio = values[RIGID:].tolist()
        most = 0.1 * handle.slider_rad_s
        moved = replace(
            moved,
            slider_kg=max(slider, 1e-6),
            slider_rad_s=handle.slider_rad_s + float(np.clip(rate, -most, most)),
            slider_ratio=float(np.clip(handle.slider_ratio + ratio, 1e-3, 0.5)),
        )
    return moved, max(abs(stride), abs(skew))


def _rows(runs: Sequence[Played], clocks: Sequence[Clock], handle: Handle) -> _Rows:
    parts = [
        _of_run(run, clock, handle, number)
        for number, (run, clock) in enumerate(zip(runs, clocks, strict=True))
    ]
    return _Rows(
        np.concatenate([part.columns for part in parts]),
        np.concatenate([part.target for part in parts]),
        {name: np.concatenate([part.extra[name] for part in parts]) for name in parts[0].extra},
        np.concatenate([part.run for part in parts]),
        np.concatenate([part.pull_n for part in parts]),
    )


def _of_run(run: Played, clock: Clock, handle: Handle, number: int) -> _Rows:
    own = terms(run, clock, handle)
    lag = 0.5 * (
        commanded(run, clock, handle.lag_us + 1.0, handle.spread_us2)
        - commanded(run, clock, handle.lag_us - 1.0, handle.spread_us2)
    )
    wider = commanded(run, clock, handle.lag_us, handle.spread_us2 + SMALL_US2)
    slope = shifted(run.torque_n, -handle.skew_us, slopes=1)
    skew = 0.5 * (slope[1:] + slope[:-1])
    time = np.linspace(-1.0, 1.0, lag.size)
    speed = float(own.velocity.std()) or 1.0
    bent = np.zeros(lag.size)
    bent[1:-1] = -np.diff(own.acceleration, 2) / (2.0 * np.pi * HIGH_HZ * H_S) ** 2
    columns: tuple[Floats, ...] = (
        own.acceleration,
        own.velocity,
        own.friction,
        -own.command,
        -handle.gain * lag,
        -handle.gain * (wider - own.command) / SMALL_US2,
        skew,
        bent,
        -np.cumsum(own.torque - own.torque.mean()) * H_S,
    )
    high_hz = HIGH_HZ
    if handle.slider_rad_s > 0.0:
        columns = (*columns, *_of_slider(own, handle))
        high_hz = COUPLED_HZ
    extra = {
        "linear": own.velocity * np.abs(own.velocity) / speed,
        "direction": np.abs(own.velocity),
        "delay": -handle.gain * lag * time,
    }
    count = (lag.size - 2 * EDGE) // BLOCK
    return _Rows(
        np.dstack([_lines(one, high_hz) for one in columns]),
        _lines(own.torque, high_hz),
        {name: _lines(one, high_hz) for name, one in extra.items()},
        np.full(count, float(number)),
        own.pull_blocks_n[:count],
    )


def _of_slider(own: Terms, handle: Handle) -> tuple[Floats, Floats, Floats]:
    """Columns of the mass on a spring, of its frequency and of its damping."""
    rate = handle.slider_rad_s
    ratio = handle.slider_ratio
    faster = hung(own.acceleration, 1.001 * rate, ratio) - own.slider
    damped = hung(own.acceleration, rate, ratio + 1e-3) - own.slider
    mass = handle.slider_kg
    return own.slider, mass * faster / (1e-3 * rate), mass * damped / 1e-3


def _lines(values: Floats, high_hz: float) -> Floats:
    return lines(values[EDGE:-EDGE], BLOCK, PROBE_RATE_HZ, (LOW_HZ, high_hz))


def _weighted(rows: _Rows, weight: Floats | None) -> tuple[Floats, Floats]:
    if weight is None:
        return rows.columns, rows.target
    return rows.columns * weight[..., None], rows.target * weight


def _weights(rows: _Rows, values: Floats) -> Floats:
    """(blocks, rows): each line of each run by its residuals, smoothed over neighbours."""
    left = (rows.target - rows.columns @ values) ** 2
    half = left.shape[1] // 2
    found = np.empty_like(left)
    kernel = np.full(2 * SMOOTH_LINES + 1, 1.0 / (2 * SMOOTH_LINES + 1))
    for number in np.unique(rows.run):
        mine = rows.run == number
        power = left[mine].mean(axis=0)
        both = np.pad(0.5 * (power[:half] + power[half:]), SMOOTH_LINES, mode="edge")
        smooth = np.convolve(both, kernel, "valid")
        found[mine] = 1.0 / np.sqrt(np.tile(np.maximum(smooth, 1e-300), 2))
    return found


def _concluded(
    runs: Sequence[Played],
    clocks: tuple[Clock, ...],
    handle: Handle,
    rows: _Rows,
    fit: Solution,
    weight: Floats | None,
) -> Balance:
    left = rows.target - rows.columns @ fit.values
    covariance = fit.covariance
    sd = np.sqrt(np.diag(covariance))
    blocks = len(rows.run)
    pulls = rows.pull_n
    speeds = np.concatenate([run.velocity_m_per_s for run in runs])
    return Balance(
        handle,
        sd,
        covariance / np.outer(sd, sd),
        blocks,
        float(np.sqrt((left**2).sum() / (rows.target**2).sum())),
        float(pulls.mean()),
        float(pulls.std(ddof=1) / np.sqrt(blocks)),
        float(speeds.std()),
        _tests(rows, fit, weight),
        clocks,
    )


def _tests(rows: _Rows, fit: Solution, weight: Floats | None) -> tuple[Test, ...]:
    """Each assumption by itself, beside what is fitted."""
    columns, target = _weighted(rows, weight)
    bend = NAMES.index("bend_kg")
    found = {"rigid": (float(fit.values[bend]), float(fit.sd[bend]))}
    for name, one in rows.extra.items():
        term = one if weight is None else one * weight
        beside = solved(np.concatenate((columns, term[..., None]), axis=2), target)
        found[name] = (float(beside.values[-1]), float(beside.sd[-1]))
    pull_sd_n = float(rows.pull_n.std(ddof=1)) / sqrt(len(rows.pull_n))
    found["pull"] = (float(rows.pull_n.mean()), pull_sd_n)
    freedom = len(target) - 1
    critical = student_quantile(1.0 - 0.5 * SIGNIFICANCE / len(found), freedom)
    usual = student_quantile(0.975, freedom)
    return tuple(
        Test(name, size, usual * sd, size / sd if sd else 0.0, critical)
        for name, (size, sd) in found.items()
    )
