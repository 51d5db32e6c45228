"""What may be wrong with a trial, detected from its record, and named.

saturation      a channel stays at its end value: given limits, or a flat top that no noise has
escape          the velocity of some second is several times that of the calm ones, under a force
                that did not grow as much: the loop ran away
drift           offset or trend of the velocity, or a level that changes between the halves of the
                record
dropout         seconds without a perturbation, or with a velocity that stands still: silence is no
                knowledge

Low coherence and lines are in `unexplained`, skew and high-pass of the channels in `channels`, what
window and record did to a spring in `leakage`. A finding with `voids` leaves nothing to decide, one
with `unstable` says that the loop is not stable. Thresholds are those at which a 90 s trial of
noise alone never raised them (tests).
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Flags, Floats, Integers
from hapticd.analysis.energy import Energy, energy
from hapticd.analysis.sections import same_length
from hapticd.analysis.trend import detrended
from hapticd.errors import AnalysisError

# of all samples at the end value; how far below it others are counted
FLAT_SHARE = 1e-4
FLAT_BELOW = 0.02
ESCAPE_RATIO = 4.0  # of a second's rms to the lower quartile of all
SILENT = 0.1  # of the upper quartile of a second's rms: there the force is none
DRIFT_SHARE = 0.5  # of the standard deviation
LEVEL_RATIO = 1.25  # of the force's rms between the halves; the velocity may change twice as much


@dataclass(frozen=True, slots=True)
class Finding:
    """`code` for programs, `message` with value and remedy for people."""

    code: str
    message: str
    voids: bool = False
    unstable: bool = False


@dataclass(frozen=True, slots=True)
class Record:
    """What the samples say before any spectrum: duration, energy, standard deviation of the
    detrended velocity, findings.
    """

    seconds: float
    energy: Energy
    velocity_sd_m_per_s: float
    findings: tuple[Finding, ...]


def examine(
    force_n: Floats,
    velocity_m_per_s: Floats,
    rate_hz: float,
    force_limit_n: float | None = None,
    velocity_limit_m_per_s: float | None = None,
) -> Record:
    """Look at the samples of a trial, both (N,) float64 at `rate_hz`. The limits are those of the
    channels.

    AnalysisError for unequal lengths or less than two seconds.
    """
    same_length(force_n, velocity_m_per_s)
    if force_n.size < 2 * rate_hz:
        raise AnalysisError(
            f"record of {force_n.size / rate_hz:.3g} s: at least 2 s are needed to tell noise from"
            " drift"
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
) -> tuple[Finding, ...]:
    size = np.abs(signal)
    top = float(size.max()) if limit is None else limit
    at = np.flatnonzero(size >= top * (1.0 - 1e-9))
    if top <= 0.0 or not at.size or (limit is None and not _is_flat(size, top, at)):
        return ()
    share = 100.0 * at.size / size.size
    return (
        Finding(
            "saturation",
            f"{name} saturated at {top:.4g} {unit} in {share:.2g} % of the samples; {remedy}",
            voids=True,
        ),
    )


def _is_flat(size: Floats, top: float, at: Integers) -> bool:
    """Whether the largest value is met oftener than by chance: more than just below it, and not
    once a period.
    """
    below = int(((size > (1.0 - FLAT_BELOW) * top) & (size < top * (1.0 - 1e-9))).sum())
    crowded = at.size >= FLAT_SHARE * size.size and at.size > 2 * below
    return bool(crowded and np.unique(np.diff(at)).size > 2)


def _by_seconds(
    force: Floats, velocity: Floats, raw_velocity: Floats, rate_hz: float
) -> tuple[Finding, ...]:
    """Dropouts, and an escape among the seconds that have none."""
    pushed, moved = (_seconds(signal, rate_hz).std(axis=1) for signal in (force, velocity))
    silent = pushed < SILENT * np.quantile(pushed, 0.75)
    still = ~silent & (np.ptp(_seconds(raw_velocity, rate_hz), axis=1) == 0.0)
    rms = np.sqrt(np.mean(_seconds(velocity, rate_hz) ** 2, axis=1))
    live = moved[~(silent | still)]
    rms[silent | still] = np.quantile(live, 0.25) if live.size else 0.0
    escaped = escape_findings(rms, 1.0, pushed)
    return (
        *_dropout("no perturbation", silent),
        *_dropout("velocity stood still", still),
        *escaped,
    )


def _seconds(signal: Floats, rate_hz: float) -> Floats:
    """Rows of a second each; the last one ends with the record."""
    window = int(rate_hz)
    rows = signal[: signal.size // window * window].reshape(-1, window)
    return np.concatenate((rows, signal[None, -window:])) if signal.size % window else rows


def _dropout(what: str, where: Flags) -> tuple[Finding, ...]:
    if not where.any():
        return ()
    message = (
        f"{what} in {100.0 * where.mean():.2g} % of the record, from {where.argmax()} s on; cut"
        " that out, or repeat the trial"
    )
    return (Finding("dropout", message, voids=True),)


def escape_findings(
    rms: Floats, window_s: float, pushed: Floats | None = None
) -> tuple[Finding, ...]:
    """Escape by the rms velocity of windows of about a second (n,), and that of the force (n,)
    where it may change: a force that is stronger than usual moves a stable device as much faster.
    """
    calm = float(np.quantile(rms, 0.25))
    usual = 0.0 if pushed is None else float(np.quantile(pushed, 0.25))
    stronger = np.maximum(1.0, pushed / usual) if pushed is not None and usual > 0.0 else 1.0
    loud = np.flatnonzero(rms > ESCAPE_RATIO * calm * stronger)
    if not loud.size:
        return ()
    at_s = loud[0] * window_s
    message = (
        f"escape at {at_s:.3g} s: the velocity grew from {calm:.3g} to {rms.max():.3g} m/s rms; the"
        " loop is not stable there"
    )
    return (Finding("escape", message, unstable=True),)


def _drift(raw: Floats, without: Floats) -> tuple[Finding, ...]:
    spread = float(without.std())
    offset = float(raw.mean())
    trend = float((raw - without)[-1] - (raw - without)[0])
    if max(abs(offset), abs(trend)) <= DRIFT_SHARE * spread:
        return ()
    message = (
        f"velocity drift: offset {offset:.3g} m/s, trend {trend:.3g} m/s over the record, noise"
        f" {spread:.3g} m/s; zero the sensor"
    )
    return (Finding("drift", message),)


def _level(name: str, signal: Floats, most: float) -> tuple[Finding, ...]:
    middle = signal.size // 2
    first, second = (float(half.std()) for half in (signal[:middle], signal[middle:]))
    if max(first, second) <= most * min(first, second):
        return ()
    message = (
        f"{name} drift: {first:.3g} rms in the first half, {second:.3g} in the second; the trial"
        " mixes two conditions, repeat it"
    )
    return (Finding("drift", message),)
