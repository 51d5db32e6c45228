"""Mass, friction, delay and smoothing from the balance of forces on a perturbed handle.

Every force on it is known: the probe's torque t, and the servo's commands f. The commands act after
a delay D as a zero-order hold through a smoothing of time constant s. So at every sample of 4 kHz

    m v' + b v + Fc phi + f0 = t + g F,     F = smoothed staircase of f,  g = gain of the motor

and m, b, Fc, g are linear in it (`force_terms` has each term). All terms pass the same window, and
the equation is solved at Fourier lines of LOW_HZ to HIGH_HZ (`result.jackknife`). Coulomb and
viscous friction differ because v grows with the amplitude and phi does not (their describing
functions), so two amplitudes are played.

Delay and smoothing. To second order in w the path of a command is 1 - jw L - w^2 (L^2 + q) / 2 with
the lag L = D + s and the spread q = s^2. L follows directly. q appears only as a curvature, as if a
mass K q / 2 were missing. So a mass known to MASS_SHARE leaves q uncertain by 2 m MASS_SHARE / K,
and D with it: D = L - sqrt(q). The delay by the board's clock is the lower bound of D.

Clocks. `force_terms.clocked` converts both streams to one time. The velocity may come later than
the torque (a skew), and the torque channel may have a high-pass: two more unknowns of the balance.

Two masses. A compliant transmission appears as a mass that grows with frequency. A velocity channel
delayed by interpolation droops, one with a plain delay does not, and a droop imitates part of that
growth. Which of the two it is remains unknown, so half the droop is assumed, and the effect of the
other half is included in the deviations. Each mass alone is known less well than their sum.

Assumptions. Each is a term that should be zero: a mass that changes with frequency (fitted along,
so that m is the mass at low frequency), friction that grows with the square of the speed, viscous
friction that depends on direction, a delay that drifts, a steady pull. Added to the equation its
coefficient has Student's t, so the probability of a false alarm is known: SIGNIFICANCE for all of
them together (Bonferroni).

Limitations: a substantial part of the motion above HIGH_HZ.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.rig.experiment import PerturbationRun
from hapticd.rig.result import Fit, jackknife, lines, quantile
from hapticd.rig.steps.force_terms import (
    BLOCK,
    EDGE,
    H_S,
    Clock,
    Handle,
    Terms,
    base_excited_response,
    clocked,
    commanded,
    shifted,
    terms,
)
from hapticd.signal.verdict import student_quantile

LEAST_BLOCKS = 8
LOW_HZ = 5.0
HIGH_HZ = 200.0
COUPLED_HZ = 450.0  # upper limit of the lines at which a resonance is fitted
RATIO = 0.05  # initial value, of critical damping
SMOOTH_LINES = 15  # on each side, of the residuals that weight the lines
FIRST_ROUNDS = 3
ROUNDS = 10
SETTLED_US = 0.05
STRIDE_US = 300.0  # maximum change of the lag in a round
SPREADS_US = (0.0, 300.0, 1000.0, 3000.0, 8000.0)  # initial values of the smoothing
SMALL_US2 = 1e3  # step of the derivative by the spread
SIGNIFICANCE = 0.01
NAMES = (
    "mass_kg",
    "viscous_ns_per_m",
    "coulomb_n",
    "gain",
    "lag_us",
    "spread_us2",
    "skew_us",
    "high_pass_rad_s",
    "slider_kg",
    "slider_rad_s",
    "slider_ratio",
)
COMMON = 8  # of them: a resonance has the last three instead of bend_kg
RIGID = 9  # one rigid mass: COMMON and bend_kg
ABSENT = ("linear", "direction", "delay")  # assumptions as terms of the equation
DROOP = 0.5  # relative to a channel that interpolates; anywhere between 0 and 1


@dataclass(frozen=True, slots=True)
class Test:
    """An assumption, as a term that should be zero."""

    name: str
    size: float  # of the term, in its unit
    half: float  # of its 95 % interval
    t: float  # size over its deviation
    critical: float  # |t| that noise exceeds in SIGNIFICANCE of all cases, for all tests together

    @property
    def significant(self) -> bool:
        """Whether noise alone is an unlikely explanation."""
        return abs(self.t) > self.critical


@dataclass(frozen=True, eq=False)
class Balance:
    """Solution of the balance. `fit` has the deviations of the quantities in NAMES: of the first
    RIGID, or of all with a resonance.
    """

    handle: Handle
    settled: bool  # whether another round would change nothing
    most_kg: float  # upper bound of the mass: all forces together could move no more in this way
    fit: Fit
    blocks: int
    residual: float  # rms of the residuals, relative to the torque
    speed_m_per_s: float  # rms
    tests: tuple[Test, ...]
    clocks: tuple[Clock, ...]

    def half(self, name: str) -> float:
        """Return half of the 95 % interval of the quantity `name`, from the blocks."""
        return float(self.fit.halves[NAMES.index(name)])

    def covariance(self, one: str, other: str) -> float:
        """Return the covariance of two quantities, from the blocks."""
        return float(self.fit.covariance[NAMES.index(one), NAMES.index(other)])


class _Rows(NamedTuple):
    """The equation at the Fourier lines."""

    columns: Floats  # (blocks, rows, RIGID or all), by NAMES
    target: Floats  # (blocks, rows)
    extra: Floats  # (blocks, rows, tests) terms that should be absent, by ABSENT
    run: Floats  # (blocks,) run of each block
    pull_n: Floats  # (blocks,)


def fit_two_masses(runs: Sequence[PerturbationRun], rigid: Balance) -> Balance:
    """Fit two coupled masses, starting from the fit of one `rigid` mass with its lag and smoothing.
    The droop of the velocity channel is unknown; its effect is included in the deviations.
    """
    further = max(float(np.mean([clock.yield_s2 for clock in rigid.clocks])), 1e-8)
    half_kg = 0.5 * rigid.handle.mass_kg
    begin = replace(
        rigid.handle,
        mass_kg=half_kg,
        slider_kg=half_kg,
        slider_rad_s=1.0 / sqrt(further),
        slider_ratio=RATIO,
        droop=DROOP,
    )
    two = _fit(runs, rigid.clocks, begin)
    pure = _fit(runs, rigid.clocks, replace(two.handle, droop=0.0))
    away = [getattr(two.handle, name) - getattr(pure.handle, name) for name in NAMES]
    covariance = two.fit.covariance + np.outer(away, away) / 4.0
    settled = two.settled and pure.settled
    return replace(two, settled=settled, fit=two.fit._replace(covariance=covariance))


def fit_rigid_mass(runs: Sequence[PerturbationRun]) -> Balance:
    """Solve the balance of all `runs` together, of one rigid mass. AnalysisError if they are too
    short or nothing moves.
    """
    if sum(run.torque_n.size // BLOCK for run in runs) < LEAST_BLOCKS:
        raise AnalysisError(f"less than {LEAST_BLOCKS} s of motion; play longer waveforms")
    clocks = tuple(clocked(run) for run in runs)
    return _fit(runs, clocks, _begin(runs, clocks))


def _fit(runs: Sequence[PerturbationRun], clocks: tuple[Clock, ...], handle: Handle) -> Balance:
    """Return the balance, starting from `handle`, with as many masses as it has."""
    weight = np.ones(1)
    for _ in range(ROUNDS):
        rows = _rows(runs, clocks, handle)
        fit = jackknife(rows.columns * weight[..., None], rows.target * weight)
        weight = _weights(rows, fit.values)
        handle, stride = _moved(handle, fit.values)
        if stride < SETTLED_US:
            break
    left = rows.target - rows.columns @ fit.values
    return Balance(
        handle,
        stride < SETTLED_US and bool(fit.values[0] > 0.0),
        _most_kg(rows, fit.values),
        fit,
        len(rows.run),
        float(np.sqrt((left**2).sum() / (rows.target**2).sum())),
        float(np.concatenate([run.velocity_m_per_s for run in runs]).std()),
        _tests(rows, fit, weight),
        clocks,
    )


def _begin(runs: Sequence[PerturbationRun], clocks: Sequence[Clock]) -> Handle:
    """Return the best of several guesses of the smoothing, each after a few rounds."""
    known = np.concatenate([run.delays_us for run in runs])
    delay_us = float(np.median(known)) if known.size else 0.25 * runs[0].period_us
    tried: list[tuple[float, Handle]] = []
    for smooth_us in SPREADS_US:
        handle = Handle(1e-2, 0.0, 0.0, 1.0, delay_us + smooth_us, smooth_us**2, 0.0)
        for _ in range(FIRST_ROUNDS):
            rows = _rows(runs, clocks, handle)
            fit = jackknife(rows.columns, rows.target)
            handle, _ = _moved(handle, fit.values)
        tried.append((float((fit.residuals**2).sum()), handle))
    return min(tried, key=itemgetter(0))[1]


def _moved(handle: Handle, values: Floats) -> tuple[Handle, float]:
    """Return `handle` after a round, and the change of the lag [us]."""
    mass, viscous, coulomb, gain, lag, spread, skew, corner = values[:COMMON].tolist()
    stride = float(np.clip(lag, -STRIDE_US, STRIDE_US))
    widest = max(4e4, abs(handle.spread_us2))
    moved = replace(
        handle,
        mass_kg=max(mass, 0.1 * handle.mass_kg),
        viscous_ns_per_m=viscous,
        coulomb_n=max(coulomb, 0.0),
        gain=gain,
        lag_us=handle.lag_us + stride,
        spread_us2=handle.spread_us2 + float(np.clip(spread, -widest, widest)),
        skew_us=handle.skew_us + float(np.clip(skew, -STRIDE_US, STRIDE_US)),
        high_pass_rad_s=handle.high_pass_rad_s + corner,
    )
    if handle.slider_rad_s > 0.0:
        slider, rate, ratio = values[COMMON:].tolist()
        most = 0.1 * handle.slider_rad_s
        moved = replace(
            moved,
            slider_kg=max(slider, 1e-6),
            slider_rad_s=handle.slider_rad_s + float(np.clip(rate, -most, most)),
            slider_ratio=float(np.clip(handle.slider_ratio + ratio, 1e-3, 0.5)),
        )
    return moved, max(abs(stride), abs(skew))


def _rows(runs: Sequence[PerturbationRun], clocks: Sequence[Clock], handle: Handle) -> _Rows:
    parts = [
        _of_run(run, clock, handle, number)
        for number, (run, clock) in enumerate(zip(runs, clocks, strict=True))
    ]
    return _Rows(*map(np.concatenate, zip(*parts, strict=True)))


def _of_run(run: PerturbationRun, clock: Clock, handle: Handle, number: int) -> _Rows:
    own = terms(run, clock, handle)
    slopes = _slopes(run, clock, handle, own)
    columns = [own.acceleration, own.velocity, own.friction, -own.command, *slopes]
    coupled = handle.slider_rad_s > 0.0
    columns += _of_slider(own, handle) if coupled else [_bent(own)]
    speed = float(own.velocity.std()) or 1.0
    lag = slopes[0]
    extra = {
        "linear": own.velocity * np.abs(own.velocity) / speed,
        "direction": np.abs(own.velocity),
        "delay": lag * np.linspace(-1.0, 1.0, lag.size),
    }
    high_hz = COUPLED_HZ if coupled else HIGH_HZ
    count = (lag.size - 2 * EDGE) // BLOCK
    return _Rows(
        np.dstack([_lines(one, high_hz) for one in columns]),
        _lines(own.torque, high_hz),
        np.dstack([_lines(extra[name], high_hz) for name in ABSENT]),
        np.full(count, float(number)),
        own.pull_n[:count],
    )


def _slopes(
    run: PerturbationRun, clock: Clock, handle: Handle, own: Terms
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return derivatives (n,) by the nonlinear unknowns: lag, spread, skew and high-pass."""
    later = commanded(run, clock, handle.lag_us + 1.0, handle.spread_us2)
    sooner = commanded(run, clock, handle.lag_us - 1.0, handle.spread_us2)
    wider = commanded(run, clock, handle.lag_us, handle.spread_us2 + SMALL_US2)
    slope = shifted(run.torque_n, -handle.skew_us, slopes=1)
    return (
        -handle.gain * 0.5 * (later - sooner),
        -handle.gain * (wider - own.command) / SMALL_US2,
        0.5 * (slope[1:] + slope[:-1]),
        -np.cumsum(own.torque - own.torque.mean()) * H_S,
    )


def _bent(own: Terms) -> Floats:
    """Return the column of a mass that grows with the square of the frequency."""
    bent = np.zeros(own.acceleration.size)
    bent[1:-1] = -np.diff(own.acceleration, 2) / (2.0 * np.pi * HIGH_HZ * H_S) ** 2
    return bent


def _of_slider(own: Terms, handle: Handle) -> list[Floats]:
    """Return the columns of the mass on a spring, of its frequency and of its damping."""
    rate = handle.slider_rad_s
    ratio = handle.slider_ratio
    faster = base_excited_response(own.acceleration, 1.001 * rate, ratio) - own.slider
    damped = base_excited_response(own.acceleration, rate, ratio + 1e-3) - own.slider
    mass = handle.slider_kg
    return [own.slider, mass * faster / (1e-3 * rate), mass * damped / 1e-3]


def _lines(values: Floats, high_hz: float) -> Floats:
    return lines(values[EDGE:-EDGE], BLOCK, PROBE_RATE_HZ, (LOW_HZ, high_hz))


def _weights(rows: _Rows, values: Floats) -> Floats:
    """Return weights (blocks, rows) of the lines of each run: 1 / their residuals, smoothed."""
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


def _most_kg(rows: _Rows, values: Floats) -> float:
    """Return an upper bound of the moving mass, from all forces together (triangle inequality)."""
    sizes = np.sqrt((rows.columns[..., :4] ** 2).sum(axis=(0, 1)))
    torque = np.sqrt((rows.target**2).sum())
    return float((torque + np.abs(values[1:4]) @ sizes[1:]) / sizes[0])


def _tests(rows: _Rows, fit: Fit, weight: Floats) -> tuple[Test, ...]:
    """Test each assumption separately, added to the fitted terms."""
    found = {}
    if rows.columns.shape[-1] == RIGID:
        found["rigid"] = (float(fit.values[-1]), float(fit.sd[-1]))
    for number, name in enumerate(ABSENT):
        columns = np.dstack((rows.columns, rows.extra[..., number]))
        beside = jackknife(columns * weight[..., None], rows.target * weight)
        found[name] = (float(beside.values[-1]), float(beside.sd[-1]))
    pull_sd_n = float(rows.pull_n.std(ddof=1)) / sqrt(len(rows.pull_n))
    found["pull"] = (float(rows.pull_n.mean()), pull_sd_n)
    critical = student_quantile(1.0 - 0.5 * SIGNIFICANCE / len(found), fit.freedom)
    return tuple(
        Test(name, size, quantile(fit.freedom) * sd, size / sd if sd else 0.0, critical)
        for name, (size, sd) in found.items()
    )
