"""Lines that the perturbation does not explain, below those that the window can show.

A window of M samples shows a line by what is beside it, and beside its first twelve frequencies, 2
to 11.7 Hz for the paper's, there is not enough. A limit cycle or a hum there is told from a
resonance by the whole record, which resolves 1/(N T): with its transforms F of the force and V of
the velocity

    f F(f) = Q(f) V(f) + J(f) + E(f),     Q = f Z

as in `resolved`, Q and J here polynomials over all of these frequencies: of mass, damper and spring
Q is one of second order, however sharply the velocity rises in their resonance. E is what the
perturbation does not explain, and E / Q that as velocity: nothing in a resonance, a narrow line in
a limit cycle, broad where friction or noise is.

Least squares would fit Q to the line, which is in V: a strong one draws Q to 0 and hides itself. So
the equations are taken not with V but with what the force alone would move, f F / Q of the round
before, which the line has no part in (instrumental variables; Young 1970, "An instrumental variable
method for real-time identification of a noisy process", Automatica 6). Frequencies with a large E
count less in the next round (Cauchy's weights).

A line is named where it carries a fiftieth of the velocity's power and E stands out of the median
beside it, at one of three widths: 4 frequencies of the record, 16 and 64, or two thirds of a hertz.
Friction, noise and counts never came near either (tests).

What would break it: a resonance of a light part below 12 Hz that a polynomial does not follow; a
limit cycle that wanders over more than a hertz.
"""

from dataclasses import dataclass
from math import log

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import legvander

from hapticd.core.arrays import Complexes, Floats
from hapticd.signal.covariances import detrended, same_length
from hapticd.signal.findings import LINE_WIDTH, SMALL_LINE, Finding, line_finding
from hapticd.signal.kernels import TINY
from hapticd.signal.spectra import Spectra

__all__ = ["hinted", "low_line"]

FIRST_SHOWN = 2 * LINE_WIDTH  # of the window's own lines, which shows what is unexplained
HINT = 2.0  # of a line over those beyond the window's width
ORDER = 4  # of both polynomials; the device's own is of the second
ROUNDS = 6
RIDGE = 1e-12
WIDTHS = (4, 16, 64)  # frequencies of the record: a sine between two of them, and wandering ones
WIDEST = 1.0 / 3.0  # of 1/(M T)
REACH = 0.75  # of 1/(M T): how far beside a line E is looked at
HEIGHT = 6.0  # of a line over that; four values of noise reach it once in 10^7
STRIDE = 16  # frequencies between medians
WEIGHT = 4.0  # times the usual |E|^2: there a frequency counts half


@dataclass(frozen=True, eq=False)
class LowFit:
    """The fit at F frequencies of a record."""

    frequency_hz: Floats  # (F,)
    rest: Floats  # (F,) |E|^2
    unexplained: Floats  # (F,) |E / Q|^2 over the velocity's power


def hinted(trial: Spectra) -> bool:
    """Whether a window's spectra hint at a line among their first frequencies: unexplained power
    that is not less than beside it and falls within the window's width. Their record decides.
    """
    if not trial.whole or trial.frequency_hz.size <= 2 * FIRST_SHOWN:
        return False
    lines = trial.part(slice(FIRST_SHOWN + 4))
    near = lines.velocity * (1.0 - lines.coherence)
    some = np.arange(2, FIRST_SHOWN + 1)
    close = near[some - 1] + near[some] + near[some + 1]
    least = np.minimum(near[some - 1], near[some + 1])
    falls = (near[some] >= least) & (near[some] > HINT * near[some + 3])
    return bool((falls & (close > SMALL_LINE * trial.velocity.sum())).any())


def low_line(
    force_n: npt.ArrayLike, velocity_m_per_s: npt.ArrayLike, trial: Spectra
) -> tuple[Finding, ...]:
    """Name the strongest line of a record (N,) between the lowest frequency of the window of
    `trial`, its spectra, and the first at which that shows lines; nothing unless they hint at one.

    AnalysisError for unequal lengths.
    """
    if not hinted(trial):
        return ()
    force = np.asarray(force_n, np.float64)
    velocity = np.asarray(velocity_m_per_s, np.float64)
    same_length(force, velocity)
    found = _fitted(force, velocity, trial)
    widest = int(WIDEST * trial.lowest_hz * trial.n_samples / trial.rate_hz)
    widths = {min(width, widest) for width in WIDTHS if widest >= WIDTHS[0]}
    lines = [_strongest(found, trial, width) for width in sorted(widths)]
    share, frequency_hz = max(lines, default=(0.0, 0.0))
    return (line_finding(frequency_hz, min(share, 1.0)),) if share > SMALL_LINE else ()


def _fitted(force_n: Floats, velocity_m_per_s: Floats, trial: Spectra) -> LowFit:
    """From half the window's lowest frequency to a little above the first that it shows."""
    seconds = trial.n_samples / trial.rate_hz
    low = 0.5 * trial.lowest_hz
    high = (0.5 * FIRST_SHOWN + 1.0) * trial.lowest_hz
    bins = np.arange(int(np.ceil(low * seconds)), int(high * seconds) + 1)
    f = bins / seconds
    force = np.fft.rfft(force_n)[bins]
    moved = np.fft.rfft(detrended(velocity_m_per_s))
    whole = float(np.vdot(moved[1:], moved[1:]).real)
    powers = legvander((2.0 * f - low - high) / (high - low), ORDER).astype(np.float64)
    rest, slope = _explained(f * force, force, moved[bins], powers)
    unexplained = rest / np.maximum(np.abs(slope) ** 2 * whole, TINY)
    return LowFit(f, rest, unexplained)


def _explained(
    wanted: Complexes, force: Complexes, velocity: Complexes, powers: Floats
) -> tuple[Floats, Complexes]:
    """|E|^2 and Q (F,) of `wanted` = Q `velocity` + J + E, of polynomials in `powers` (F, p)."""
    columns = _columns(velocity, powers)
    instrument = force
    weights = np.ones(wanted.size)
    for _ in range(ROUNDS):
        taken = _columns(instrument, powers).conj() * weights[:, None]
        normal = np.einsum("fc,fd->cd", taken, columns) + RIDGE * np.eye(columns.shape[1])
        found = np.linalg.solve(normal, np.einsum("fc,f->c", taken, wanted))
        rest = np.abs(wanted - np.einsum("fc,c->f", columns, found)) ** 2
        slope = np.einsum("fp,p->f", powers, found[: powers.shape[1]]) / _size(velocity)
        instrument = wanted / np.where(slope == 0.0, TINY, slope)
        weights = 1.0 / (1.0 + rest / max(WEIGHT * _mean(rest), TINY))
    return rest, slope


def _columns(moved: Complexes, powers: Floats) -> Complexes:
    """Of Q and of J, (F, 2 p), each of mean size 1."""
    return np.concatenate((powers * (moved / _size(moved))[:, None], powers + 0j), axis=1)


def _size(values: Complexes) -> float:
    return max(float(np.sqrt(np.mean(np.abs(values) ** 2))), float(TINY))


def _mean(power: Floats) -> float:
    """Mean of a power that is exponentially distributed but for a few lines: by its median."""
    return float(np.median(power)) / log(2.0)


def _strongest(found: LowFit, trial: Spectra, width: int) -> tuple[float, float]:
    """Share of the velocity's power, and frequency [Hz], of the strongest line that stands out."""
    f = found.frequency_hz
    rest, share = (
        np.convolve(one, np.ones(width), "same") for one in (found.rest, found.unexplained)
    )
    reach = max(1, int(REACH * trial.lowest_hz / (f[1] - f[0])))
    starts = range(0, f.size, STRIDE)
    usual = [_mean(found.rest[max(0, at - reach) : at + reach + 1]) for at in starts]
    stands_out = rest > HEIGHT * width * np.repeat(usual, STRIDE)[: f.size]
    last_hz = 0.5 * FIRST_SHOWN * trial.lowest_hz
    share[~stands_out | (f < trial.lowest_hz) | (f > last_hz)] = 0.0
    best = int(np.argmax(share))
    about = slice(max(0, best - width // 2), best + width // 2 + 1)
    centre_hz = float(np.average(f[about], weights=found.unexplained[about] + TINY))
    return float(share[best]), centre_hz
