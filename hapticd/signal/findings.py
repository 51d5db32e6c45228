"""Defects and anomalies of a record, found in its samples and spectra.

In the samples (`examine`):

    saturation      a channel stays at its end value: a given limit, or a flat top that noise cannot
                    make
    escape          in some second the velocity is several times that of the calm ones, the force
                    did not grow as much, and the growth is faster than a noise-driven resonance
                    allows: the loop ran away
    swells          the same without that growth: a resonance that rings for long, or a loop that
                    runs away so slowly that only the record distinguishes them
    drift           offset or trend of the velocity, or a level that changes between the halves of
                    the record
    dropout         seconds without a perturbation, or with a constant velocity: silence is not
                    evidence

In the motion that the perturbation does not explain (`coherence_findings`):

    low_coherence   the perturbation explains less than half of the motion over part of the band, or
                    at its lower edge
    oscillation     a narrow line carries much of the velocity and the perturbation does not explain
                    it: a limit cycle
    line            the same with little of the velocity: a limit cycle or hum
    unresolved      much of the velocity is in a line narrower than the window, which the
                    perturbation may explain

Noise drives the amplitude of a resonance as a random walk. Over n seconds it changes by about the
square root of n times its change in one second, whatever its size. If the ring is as long as the
record, the calm seconds precede it and the loud ones prove nothing. A runaway gains in proportion
to its size (`outgrows_walk`).

Lines below the first twelve frequencies of a window are found in the record (`resolved`).

The lower edge counts because it is estimated together with the band: the window's 1.95 Hz is close
to 2 Hz. Noise in the velocity makes "spa" read |Z| low by the coherence. A window makes a resonance
narrower than itself incoherent, so a coherence of 0.2 does not prove a limit cycle. A
self-sustained oscillation has only the coherence of chance, 2/nu. In between, the record decides
(`resolved`); without a record the question stays open.

From the window and the ends of the record (`leakage_findings`): "spa" reads |Z| low where the
velocity has little power, below the resonance of a lightly damped spring. There the spring passes v
~ f / K, so the velocity's spectrum is steep and small compared with that of the resonance. Two
effects add power to it, and Z = Phi_yu / Phi_u shrinks:

    window          covariances at lag t are multiplied by W(t): the spectrum is smoothed, and |Z|
                    of a spring shrinks by s^2 / (f^2 + s^2), 5 % at 3 Hz for M = 2048
    record          those of a record of N samples are multiplied by 1 - |t|/N as well: a sharp
                    resonance leaks down to the band edge, whatever the window

Applying both once more shows their effect (twicing, Tukey 1977); this is a product with the
covariances. The phase is pulled towards 0 as well, which can hide a little activity. A longer
window cures the first, a longer record the second, whole periods (`assess`) both. "h_force" does
not use Phi_u, the affected spectrum.

The energy (`energy`) is the definition of passivity: E(t), the integral of F v, is never less than
minus the energy stored at the start. With interval means of both channels, sum(F_k v_k) T is the
exact work of a force held over each interval. No trend is removed, because the energy of a trial is
that of its true force and velocity. A passive device that starts at rest keeps E >= 0. If the noise
drives mostly frequencies where the device dissipates, E stays far above 0 although the device is
active at others: the spectral verdict is the sharper statement, this one the unconditional one.

Skew, high-pass and units of the channels are in `channels`. The thresholds are those that a 90 s
trial of noise alone never exceeded (tests).

Limitations: a limit cycle that the perturbation drives in part, without a record. Spectra off the
window's own grid do not contain the covariances, so they give no leakage finding.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats, Integers
from hapticd.core.errors import AnalysisError
from hapticd.core.units import percent
from hapticd.signal.covariances import detrended, same_length
from hapticd.signal.impedance import Estimator, impedance
from hapticd.signal.spectra import Spectra

__all__ = [
    "ESCAPE_RATIO",
    "Energy",
    "Finding",
    "Record",
    "escape_findings",
    "examine",
    "outgrows_walk",
]

FLAT_SHARE = 1e-4  # of all samples, at the end value
FLAT_BELOW = 0.02  # of the end value: range below it in which other values are counted
ESCAPE_RATIO = 4.0  # of a second's rms to the lower quartile of all
# of a walk's usual step times the root of the number of steps. Rings of 0.5 to 60 s reached 7.6 in
# 360 trials of 90 s; loops that doubled three times in a trial reached 10 and more.
WALK = 9.0
USUAL_STEP = 0.6745  # of a standard deviation: the median of a normal value's size
SILENT = 0.1  # of the upper quartile of the rms per second: below it the force counts as absent
DRIFT_SHARE = 0.5  # of the standard deviation
LEVEL_RATIO = 1.25  # of the force's rms between the halves; the velocity may change twice as much
LOW_COHERENCE = 0.5  # less than half of the motion is explained
LINE_WIDTH = 6  # neighbouring values that make a line
LINE_SHARE = 0.3  # of the velocity's power, unexplained, in a line
SMALL_LINE = 0.02  # the same, from which it is reported
LINE_HEIGHT = 5.0  # of a line relative to its surroundings
CHANCE = 3.0  # times the mean coherence of chance: a line below it has none
LOW_SHARE = 0.05  # of |Z|, from which it is reported
CERTAINTY = 3.0  # standard deviations of |Z|
SWELLS = "the velocity swells and fades 4 times and more, as the perturbation drives a resonance"


@dataclass(frozen=True, slots=True)
class Energy:
    """Energy that flowed into the device during a record."""

    minimum_j: float  # minimum of the integral, 0 at the start included
    minimum_s: float  # time of the minimum
    end_j: float  # at the end of the record


def energy(force_n: Floats, velocity_m_per_s: Floats, rate_hz: float) -> Energy:
    """Return the energy integral of force and velocity (N,), N >= 1, sampled at `rate_hz`."""
    flowed = np.concatenate(([0.0], np.cumsum(force_n * velocity_m_per_s) / rate_hz))
    lowest = int(np.argmin(flowed))
    return Energy(float(flowed[lowest]), lowest / rate_hz, float(flowed[-1]))


@dataclass(frozen=True, slots=True)
class Finding:
    """A defect or anomaly of a record."""

    code: str  # for programs
    message: str  # for people, with value and remedy
    voids: bool = False  # makes a verdict impossible
    unstable: bool = False  # shows that the loop is not stable


@dataclass(frozen=True, slots=True)
class Record:
    """Summary of the samples, before any spectrum is computed."""

    seconds: float  # length of the record
    energy: Energy
    velocity_sd_m_per_s: float  # of the detrended velocity
    findings: tuple[Finding, ...]


def examine(
    force_n: Floats,
    velocity_m_per_s: Floats,
    rate_hz: float,
    force_limit_n: float | None = None,
    velocity_limit_m_per_s: float | None = None,
) -> Record:
    """Examine the samples of a trial, force and velocity (N,) float64 at `rate_hz`. The limits are
    those of the measuring channels, if known.

    AnalysisError for unequal lengths or less than two seconds.
    """
    same_length(force_n, velocity_m_per_s)
    if force_n.size < 2 * rate_hz:
        raise AnalysisError(
            f"record of {force_n.size / rate_hz:.3g} s: at least 2 s are needed to separate noise"
            " from drift"
        )
    force = detrended(force_n)
    velocity = detrended(velocity_m_per_s)
    findings = (
        *_saturation("torque", force_n, force_limit_n, "N", "lower the perturbation"),
        *_saturation(
            "velocity",
            velocity_m_per_s,
            velocity_limit_m_per_s,
            "m/s",
            "lower the perturbation or the gain",
        ),
        *_by_seconds(force, velocity, velocity_m_per_s, rate_hz),
        *_drift(velocity_m_per_s, velocity),
        *_level("perturbation", force, LEVEL_RATIO),
        *_level("velocity", velocity, 2.0 * LEVEL_RATIO),
    )
    flowed = energy(force_n, velocity_m_per_s, rate_hz)
    return Record(force.size / rate_hz, flowed, float(velocity.std()), findings)


def _saturation(
    name: str, signal: Floats, limit: float | None, unit: str, remedy: str
) -> Iterator[Finding]:
    size = np.abs(signal)
    top = float(size.max()) if limit is None else limit
    at = np.flatnonzero(size >= top * (1.0 - 1e-9))
    if top > 0.0 and at.size and (limit is not None or _is_flat(size, top, at)):
        share = at.size / size.size
        yield Finding(
            "saturation",
            f"{name} saturated at {top:.4g} {unit} in {percent(share)} of the samples; {remedy}",
            voids=True,
        )


def _is_flat(size: Floats, top: float, at: Integers) -> bool:
    """Whether the largest value occurs more often than by chance: more than values just below
    it, and not once a period.
    """
    below = int(((size > (1.0 - FLAT_BELOW) * top) & (size < top * (1.0 - 1e-9))).sum())
    return (
        at.size >= FLAT_SHARE * size.size
        and at.size > 2 * below
        and np.unique(np.diff(at)).size > 2
    )


def _by_seconds(
    force: Floats, velocity: Floats, raw_velocity: Floats, rate_hz: float
) -> Iterator[Finding]:
    """Find dropouts, and an escape among the seconds that have none."""
    pushed, moved = (_seconds(signal, rate_hz).std(axis=1) for signal in (force, velocity))
    silent = pushed < SILENT * np.quantile(pushed, 0.75)
    still = ~silent & (np.ptp(_seconds(raw_velocity, rate_hz), axis=1) == 0.0)
    rms = np.sqrt(np.mean(_seconds(velocity, rate_hz) ** 2, axis=1))
    live = moved[~(silent | still)]
    rms[silent | still] = np.quantile(live, 0.25) if live.size else 0.0
    yield from _dropout("no perturbation", silent)
    yield from _dropout("velocity stood still", still)
    yield from escape_findings(rms, 1.0, pushed)


def _seconds(signal: Floats, rate_hz: float) -> Floats:
    """Cut a signal into rows of a second each; the last row ends with the record."""
    window = int(rate_hz)
    rows = signal[: signal.size // window * window].reshape(-1, window)
    return np.concatenate((rows, signal[None, -window:])) if signal.size % window else rows


def _dropout(what: str, where: Flags) -> Iterator[Finding]:
    message = (
        f"{what} in the whole record; perturb the device while it records"
        if where.all()
        else f"{what} in {percent(where.mean())} of the record, from {where.argmax()} s on; cut"
        " that out, or repeat the trial"
    )
    if where.any():
        yield Finding("dropout", message, voids=True)


def escape_findings(
    rms: Floats, window_s: float, pushed: Floats | None = None
) -> tuple[Finding, ...]:
    """Detect an escape, or a possible one, in the rms velocity (n,) of windows of about a second.
    Pass the rms force (n,) where it may change: a stronger force moves a stable device
    proportionally faster.
    """
    calm = _lower_quartile(rms)
    usual = 0.0 if pushed is None else _lower_quartile(pushed)
    stronger = np.maximum(1.0, pushed / usual) if pushed is not None and usual > 0.0 else 1.0
    loud = np.flatnonzero(rms > ESCAPE_RATIO * calm * stronger)
    if not loud.size:
        return ()
    if not outgrows_walk(rms / stronger):
        return (Finding("swells", SWELLS, voids=True),)
    message = (
        f"escape at {loud[0] * window_s:.3g} s: the velocity grew from {calm:.3g} to"
        f" {rms.max():.3g} m/s rms; the loop is not stable there"
    )
    return (Finding("escape", message, unstable=True),)


def outgrows_walk(rms: Floats) -> bool:
    """Whether the rms velocity of windows (n,) grew by more than a random walk of its amplitude."""
    usual = float(np.median(np.abs(np.diff(rms)))) / USUAL_STEP
    return any(
        bool((rms[steps:] - rms[:-steps] > WALK * usual * np.sqrt(steps)).any())
        for steps in range(1, rms.size)
    )


def _lower_quartile(values: Floats) -> float:
    """As `np.quantile`, which takes ten times as long for a few values."""
    place = 0.25 * (values.size - 1)
    return float(np.interp(place, np.arange(values.size), np.sort(values)))


def _drift(raw: Floats, without: Floats) -> Iterator[Finding]:
    spread = float(without.std())
    offset = float(raw.mean())
    trend = float((raw - without)[-1] - (raw - without)[0])
    if max(abs(offset), abs(trend)) > DRIFT_SHARE * spread:
        yield Finding(
            "drift",
            f"velocity drift: offset {offset:.3g} m/s, trend {trend:.3g} m/s over the record, noise"
            f" {spread:.3g} m/s; zero the sensor",
        )


def _level(name: str, signal: Floats, most: float) -> Iterator[Finding]:
    middle = signal.size // 2
    first, second = (float(half.std()) for half in (signal[:middle], signal[middle:]))
    if max(first, second) > most * min(first, second):
        yield Finding(
            "drift",
            f"{name} drift: {first:.3g} rms in the first half, {second:.3g} in the second; the"
            " trial mixes two conditions, repeat it",
        )


@dataclass(frozen=True, slots=True)
class UnexplainedLine:
    """A narrow line of the velocity that the perturbation does not explain."""

    place: int  # index into the frequencies
    frequency_hz: float
    share: float  # of the velocity's power, unexplained, in it
    coherence: float  # median about it


def coherence_findings(
    trial: Spectra, band_hz: tuple[float, float], estimator: Estimator = "spa"
) -> tuple[Finding, ...]:
    """Report low coherence, by share and range, and a line that the perturbation does not explain.

    The search covers `band_hz` and one resolution below its lower edge, down to the lowest
    frequency of the window.
    """
    low_hz = min(band_hz[0], max(trial.lowest_hz, band_hz[0] - trial.bandwidth_hz))
    inside = (trial.frequency_hz >= low_hz) & (trial.frequency_hz <= band_hz[1])
    return (
        *_incoherent(trial.frequency_hz[inside], trial.coherence[inside], estimator),
        *_line(trial),
    )


def _incoherent(frequency_hz: Floats, coherence: Floats, estimator: Estimator) -> Iterator[Finding]:
    low = coherence < LOW_COHERENCE
    if low.any():
        yield Finding(
            "low_coherence",
            f"low coherence: below {LOW_COHERENCE:g} at {percent(low.mean())} of the frequencies,"
            f" from {frequency_hz[low][0]:.3g} to {frequency_hz[low][-1]:.3g} Hz; perturb more"
            " strongly there or record longer"
            f"{_shrunk(frequency_hz, coherence) if estimator == 'spa' else ''}",
        )


def _shrunk(frequency_hz: Floats, coherence: Floats) -> str:
    """Describe how "spa" reads |Z| with noise in the velocity."""
    worst = int(np.argmin(coherence))
    return (
        f"; |Z| by spa reads low there by the coherence, at {frequency_hz[worst]:.3g} Hz to"
        f" {coherence[worst]:.2g} of its value, while the phase and the sign of Re Z stay; h_force"
        " does not shrink it"
    )


def line_of(trial: Spectra) -> UnexplainedLine | None:
    """Return the strongest unexplained line, if it carries enough power to report."""
    if trial.frequency_hz.size <= 4 * LINE_WIDTH:
        return None
    unexplained = trial.velocity * (1.0 - trial.coherence)
    total = float(trial.velocity.sum())
    close = np.convolve(unexplained, np.ones(LINE_WIDTH), "same")
    peak = 2 * LINE_WIDTH + int(np.argmax(close[2 * LINE_WIDTH : -2 * LINE_WIDTH]))
    sides = (
        close[peak - 2 * LINE_WIDTH : peak - LINE_WIDTH],
        close[peak + LINE_WIDTH : peak + 2 * LINE_WIDTH],
    )
    beside = float(np.median(sides, axis=1).max())
    if close[peak] <= SMALL_LINE * total or close[peak] < LINE_HEIGHT * beside:
        return None
    about = trial.coherence[peak - LINE_WIDTH // 2 : peak + LINE_WIDTH // 2]
    share = float(close[peak]) / total
    return UnexplainedLine(peak, float(trial.frequency_hz[peak]), share, float(np.median(about)))


def _line(trial: Spectra) -> Iterator[Finding]:
    line = line_of(trial)
    if line is None:
        return
    if trial.resolved or line.coherence < CHANCE * trial.variance_factor:
        yield line_finding(line.frequency_hz, line.share)
    elif line.share > LINE_SHARE:
        yield Finding(
            "unresolved",
            f"line {_where(line.frequency_hz, line.share)}, narrower than the {trial.span}: a"
            " resonance or a limit cycle; its record, or a longer window, tells them apart",
            voids=True,
        )


def line_finding(frequency_hz: float, share: float) -> Finding:
    """Return the finding for a line with a `share` of the velocity's power and no coherence: an
    oscillation if the share is large.
    """
    where = _where(frequency_hz, share)
    if share <= LINE_SHARE:
        return Finding(
            "line",
            f"line {where}, which the perturbation does not explain; hum of a sensor, or a small"
            " limit cycle",
        )
    return Finding(
        "oscillation",
        f"oscillation {where} is a line that the perturbation does not explain; the loop has a"
        " limit cycle",
        unstable=True,
    )


def _where(frequency_hz: float, share: float) -> str:
    return f"at {frequency_hz:.3g} Hz: {float(f'{100.0 * share:.2g}'):g} % of the velocity's power"


def shrinkage(trial: Spectra, estimator: Estimator = "spa") -> Complexes:
    """Return the effect of window and record ends on Z: the complex factor (F,) by which applying
    them once more changes it; 1 where unknown.
    """
    if trial.frequency_hz.size != trial.lag + 1 or trial.exact:
        return np.ones(trial.frequency_hz.size, np.complex128)
    rows = np.stack((trial.velocity + 0j, trial.force + 0j, trial.cross))
    lags = np.abs(np.fft.fftfreq(2 * trial.lag, 0.5 / trial.lag))
    again = 0.5 * (1.0 + np.cos(np.pi * lags / trial.lag)) * (1.0 - lags / trial.n_samples)
    velocity, force, cross = np.fft.rfft(np.fft.irfft(rows, axis=1) * again, axis=1)
    twice = Spectra(
        trial.frequency_hz,
        np.maximum(velocity.real, 0.0),
        np.maximum(force.real, 0.0),
        cross,
        trial.rate_hz,
        trial.n_samples,
        trial.lag,
    )
    z, changed = (impedance(one, estimator).impedance_ns_per_m for one in (trial, twice))
    return np.asarray(np.divide(changed, z, out=np.ones_like(z), where=np.isfinite(z) & (z != 0.0)))


def leakage_findings(
    trial: Spectra, band_hz: tuple[float, float], estimator: Estimator = "spa"
) -> tuple[Finding, ...]:
    """Report |Z| that is read low inside `band_hz` by more than a twentieth and more than chance
    explains, with the range of frequencies.

    Frequencies of low coherence are left to `coherence_findings`.
    """
    inside = (trial.frequency_hz >= band_hz[0]) & (trial.frequency_hz <= band_hz[1])
    factor = shrinkage(trial, estimator)[inside]
    low = 1.0 - np.abs(factor)
    spread = impedance(trial, estimator).relative_sd[inside]
    named = (
        (low > LOW_SHARE) & (low > CERTAINTY * spread) & (trial.coherence[inside] > LOW_COHERENCE)
    )
    if not named.any():
        return ()
    f = trial.frequency_hz[inside]
    worst = int(np.argmax(np.where(named, low, 0.0)))
    message = (
        f"leakage: |Z| reads about {percent(low[worst])} low at {f[worst]:.3g} Hz and the phase"
        f" is pulled {abs(np.degrees(np.angle(factor[worst]))):.2g} deg towards 0, from"
        f" {f[named][0]:.3g} to {f[named][-1]:.3g} Hz more than {100 * LOW_SHARE:g} %: a window of"
        f" {trial.lag} samples does not resolve so lightly damped a motion; take a longer window"
        " (--lag), h_force, a multisine, or begin the band higher"
    )
    return (Finding("leakage", message),)
