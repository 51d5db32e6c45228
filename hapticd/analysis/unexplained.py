"""What the perturbation does not explain of a motion: low coherence, and lines. Named with what
follows for |Z|.

low_coherence   the perturbation explains less than half of the motion over part of the band, or at
                its lower edge
oscillation     a narrow line carries much of the velocity and the perturbation does not explain it:
                a limit cycle
line            the same with little of it: a limit cycle or hum
unresolved      much of it in a line that is narrower than the window, which the perturbation may
                explain

Noise in the velocity makes "spa" read |Z| low by the coherence. The lower edge counts because it is
read with the band: the window's 1.95 Hz is anybody's 2 Hz. Thresholds are those at which a 90 s
trial of noise alone never raised them (tests).

A window makes a resonance that is narrower than itself incoherent: a coherence of 0.2 is no proof
of a limit cycle. What goes on by itself has none but that of chance, 2/nu. In between the record
decides (`resolved`), and without one nothing is decided.

What would break it: a limit cycle that the perturbation drives in part, where there is no record.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.diagnostics import Finding
from hapticd.analysis.impedance import Estimator
from hapticd.analysis.spectra import Spectra

LOW_COHERENCE = 0.5
LINE_WIDTH = 6  # neighbouring values that make a line
LINE_SHARE = 0.3  # of the velocity's power, unexplained, in a line
SMALL_LINE = 0.02  # the same, from which it is mentioned
LINE_HEIGHT = 5.0  # of a line over what is beside it
CHANCE = 3.0  # times the coherence that chance gives on average: below, a line has none


@dataclass(frozen=True, slots=True)
class Line:
    """A narrow line at `place` of the frequencies, in which `share` of the velocity's power is not
    explained; median `coherence` about it.
    """

    place: int
    frequency_hz: float
    share: float
    coherence: float


def coherence_findings(
    trial: Spectra, band_hz: tuple[float, float], estimator: Estimator = "spa"
) -> tuple[Finding, ...]:
    """Low coherence (named by share and range), and a line that the perturbation does not explain.

    Looked at are `band_hz` and what is read together with its lower edge: a resolution below it,
    where the window still says something.
    """
    low_hz = min(band_hz[0], max(trial.lowest_hz, band_hz[0] - trial.bandwidth_hz))
    inside = (trial.frequency_hz >= low_hz) & (trial.frequency_hz <= band_hz[1])
    return (
        *_incoherent(trial.frequency_hz[inside], trial.coherence[inside], estimator),
        *_line(trial),
    )


def _incoherent(
    frequency_hz: Floats, coherence: Floats, estimator: Estimator
) -> tuple[Finding, ...]:
    low = coherence < LOW_COHERENCE
    if not low.any():
        return ()
    message = (
        f"low coherence: below {LOW_COHERENCE:g} at {100 * low.mean():.2g} % of the frequencies,"
        f" from {frequency_hz[low][0]:.3g} to {frequency_hz[low][-1]:.3g} Hz; perturb more strongly"
        " there or record longer"
    )
    return (
        Finding(
            "low_coherence",
            message + (_shrunk(frequency_hz, coherence) if estimator == "spa" else ""),
        ),
    )


def _shrunk(frequency_hz: Floats, coherence: Floats) -> str:
    """What "spa" makes of noise in the velocity."""
    worst = int(np.argmin(coherence))
    return (
        f"; |Z| by spa reads low there by the coherence, at {frequency_hz[worst]:.3g} Hz to"
        f" {coherence[worst]:.2g} of its value, while the phase and the sign of Re Z stay; h_force"
        " does not shrink it"
    )


def line_of(trial: Spectra) -> Line | None:
    """The strongest line that is not explained, if it carries enough to be mentioned."""
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
    beside = max(float(np.median(side)) for side in sides)
    if close[peak] <= SMALL_LINE * total or close[peak] < LINE_HEIGHT * beside:
        return None
    about = trial.coherence[peak - LINE_WIDTH // 2 : peak + LINE_WIDTH // 2]
    share = float(close[peak]) / total
    return Line(peak, float(trial.frequency_hz[peak]), share, float(np.median(about)))


def _line(trial: Spectra) -> tuple[Finding, ...]:
    line = line_of(trial)
    if line is None:
        return ()
    where = f"at {line.frequency_hz:.3g} Hz: {100 * line.share:.2g} % of the velocity's power"
    known = trial.resolved or line.coherence < CHANCE * trial.variance_factor
    if line.share <= LINE_SHARE:
        message = (
            f"line {where}, which the perturbation does not explain; hum of a sensor, or a small"
            " limit cycle"
        )
        return (Finding("line", message),) if known else ()
    if not known:
        message = (
            f"line {where}, narrower than the {trial.span}: a resonance or a limit cycle; "
            "its record, or a longer window, tells them apart"
        )
        return (Finding("unresolved", message, voids=True),)
    message = (
        f"oscillation {where} is a line that the perturbation does not explain; the loop has a"
        " limit cycle"
    )
    return (Finding("oscillation", message, unstable=True),)
