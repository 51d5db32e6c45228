"""What the perturbation does not explain of a motion: low coherence, and lines. Named with what follows for |Z|.

low_coherence   the perturbation explains less than half of the motion over part of the band, or at its lower edge
oscillation     a narrow line carries much of the velocity and the perturbation does not explain it: a limit cycle
line            the same with little of it: a limit cycle or hum

Noise in the velocity makes "spa" read |Z| low by the coherence. The lower edge counts because it is read with the band: the
window's 1.95 Hz is anybody's 2 Hz. Thresholds are those at which a 90 s trial of noise alone never raised them (tests).

What would break it: a line as wide as the resolution, such as a resonance (its coherence is high).
"""

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


def coherence_findings(trial: Spectra, band_hz: tuple[float, float], estimator: Estimator = "spa") -> tuple[Finding, ...]:
    """Low coherence (named by share and range), and a line that the perturbation does not explain.

    Looked at are `band_hz` and what is read together with its lower edge: a resolution below it, where the window still says
    something.
    """
    low_hz = min(band_hz[0], max(trial.lowest_hz, band_hz[0] - trial.bandwidth_hz))
    inside = (trial.frequency_hz >= low_hz) & (trial.frequency_hz <= band_hz[1])
    return (*_incoherent(trial.frequency_hz[inside], trial.coherence[inside], estimator), *_line(trial))


def _incoherent(frequency_hz: Floats, coherence: Floats, estimator: Estimator) -> tuple[Finding, ...]:
    low = coherence < LOW_COHERENCE
    if not low.any():
        return ()
    message = (
        f"low coherence: below {LOW_COHERENCE:g} at {100 * low.mean():.2g} % of the frequencies, from {frequency_hz[low][0]:.3g} "
        f"to {frequency_hz[low][-1]:.3g} Hz; perturb more strongly there or record longer"
    )
    return (Finding("low_coherence", message + (_shrunk(frequency_hz, coherence) if estimator == "spa" else "")),)


def _shrunk(frequency_hz: Floats, coherence: Floats) -> str:
    """What "spa" makes of noise in the velocity."""
    worst = int(np.argmin(coherence))
    return (
        f"; |Z| by spa reads low there by the coherence, at {frequency_hz[worst]:.3g} Hz to {coherence[worst]:.2g} of its value, "
        "while the phase and the sign of Re Z stay; h_force does not shrink it"
    )


def _line(trial: Spectra) -> tuple[Finding, ...]:
    if trial.frequency_hz.size <= 4 * LINE_WIDTH:
        return ()
    unexplained = trial.velocity * (1.0 - trial.coherence)
    total = float(trial.velocity.sum())
    close = np.convolve(unexplained, np.ones(LINE_WIDTH), "same")
    peak = 2 * LINE_WIDTH + int(np.argmax(close[2 * LINE_WIDTH : -2 * LINE_WIDTH]))
    sides = (close[peak - 2 * LINE_WIDTH : peak - LINE_WIDTH], close[peak + LINE_WIDTH : peak + 2 * LINE_WIDTH])
    if close[peak] <= SMALL_LINE * total or close[peak] < LINE_HEIGHT * max(float(np.median(side)) for side in sides):
        return ()
    if close[peak] <= LINE_SHARE * total:
        message = (
            f"line at {trial.frequency_hz[peak]:.3g} Hz: {100 * close[peak] / total:.2g} % of the velocity's power, which the "
            "perturbation does not explain; hum of a sensor, or a small limit cycle"
        )
        return (Finding("line", message),)
    message = (
        f"oscillation at {trial.frequency_hz[peak]:.3g} Hz: {100 * close[peak] / total:.2g} % of the velocity's power is a line "
        "that the perturbation does not explain; the loop has a limit cycle"
    )
    return (Finding("oscillation", message, unstable=True),)
