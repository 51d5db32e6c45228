"""Figures of trials: impedance or admittance with its interval, its coherence and its prediction; a
replayed motion.

Every figure of an impedance has the same two axes, size above phase, and `draw` puts a line on
both. Logarithm and phase of the admittance are those of the impedance with the other sign, and the
interval is the same.

An interval of more than a factor of e is omitted, because it is no longer normal.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.recording.file import ReplayResult
from hapticd.signal.assess import PeriodicSpectra
from hapticd.signal.impedance import Impedance
from hapticd.signal.verdict import half_width
from hapticd.zwidth.report.paper import legends
from hapticd.zwidth.report.style import (
    FINE,
    INTERVAL,
    MARKS,
    PREDICTED,
    PROBABILITY,
    Axes,
    Colour,
    Figure,
    Look,
    axes,
    draw_band,
    hertz_axis,
    legend_handles,
    level_styles,
    not_judged,
    patch,
    plain_axis,
    styled,
)
from hapticd.zwidth.sources import ReferenceSines
from hapticd.zwidth.store import EndReason
from hapticd.zwidth.trial import TrialResult

__all__ = [
    "Trace",
    "draw",
    "draw_traces",
    "dress",
    "interval",
    "replay_figure",
    "trial_figure",
]

Trace = tuple[Floats, Floats, Look]  # time [s], values, style

RANDOM = " of the random error"  # without the uncertainty of the calibrations
FEWEST = 4.0  # minimum degrees of freedom for an interval
SHOWN_HZ = (1.0, 1000.0)
# characters of a line
TITLE_WIDTH = 95
REASON_WIDTH = 100


@dataclass(frozen=True)
class View:
    """The drawn quantity: the impedance or its inverse."""

    symbol: str
    unit: str
    sign: int


IMPEDANCE = View("Z", "N s/m", 1)
ADMITTANCE = View("Y", "m/(N s) = s/kg", -1)


def draw(
    places: tuple[Axes, Axes],
    frequency_hz: Floats,
    z: Complexes,
    look: Look,
    words: str | None = None,
    spread: Any = np.nan,
    view: View = IMPEDANCE,
) -> None:
    """Draw size and phase of Z (F,) [N s/m], tinted where the interval is known: `spread` (F,) is
    the half-width for ln |Z|, and for the phase in radians.
    """
    size, phase = places
    known = np.where(spread < 1.0, spread, np.nan)
    draw_band(size, frequency_hz, np.abs(z) ** view.sign, known, look, words)
    turned = view.sign * np.degrees(np.angle(z))
    draw_band(phase, frequency_hz, turned, np.degrees(known), look, words, linear=True)


def dress(
    size: Axes,
    phase: Axes,
    band_hz: tuple[float, float],
    view: View = IMPEDANCE,
    where: str = "",
    more: Iterable[Axes] = (),
) -> Any:
    """Add labels, the passive range of the phase, and grey over everything not judged; return the
    mark of grey for a legend.

    Call it when everything is drawn and the frequency axes have their range.
    """
    size.set(yscale="log", ylabel=f"|{view.symbol}|{where} ({view.unit})")
    plain_axis(size.yaxis, FINE)
    phase.set(
        ylabel=f"phase of {view.symbol} (degrees)", ylim=(-105.0, 105.0), yticks=range(-90, 91, 45)
    )
    for edge in (-90.0, 90.0):
        phase.axhline(edge, color=Colour.BLACK, linewidth=0.8)
    return not_judged((size, phase, *more), band_hz)


def interval(look: Look, more: str = "") -> Any:
    """Return the mark of an interval in a legend."""
    return patch(f"{INTERVAL}{more}", look["color"], alpha=0.35)


@styled()
def trial_figure(
    result: TrialResult,
    sines: ReferenceSines | None = None,
    admittance: bool = False,
    width_mm: float | None = None,
) -> Figure:
    """Draw size, phase and coherence of Z (or Y) of one trial, with the stepped sine's as points.
    ConfigError without matplotlib.

    Of a trial that escaped force and velocity are drawn: their spectrum would not be an impedance.
    """
    view = ADMITTANCE if admittance else IMPEDANCE
    look = level_styles([result.plan.params.trial.active_damping_ns_per_m])[0]
    ended = result.recorded.ended
    if ended and ended.reason is EndReason.ESCAPE:
        why = f"ESCAPED, so there is no impedance to draw: {ended.text}"
        return _undrawn(result, view, why, width_mm)
    z = result.measured
    seen = (z.frequency_hz >= SHOWN_HZ[0]) & (z.frequency_hz <= SHOWN_HZ[1]) & (z.coherence > 0.0)
    if not seen.any():
        why = "no impedance to draw: force and velocity have nothing in common at any frequency"
        return _undrawn(result, view, why, width_mm)
    panels: Look = {"width_mm": width_mm, "sharex": True, "height_ratios": (2.2, 2.2, 1.0)}
    figure, (size, phase, known) = axes(3, 1, 7.2, 8.4, _title(result, view), **panels)
    worst = result.verdict.margin_deg
    f = z.frequency_hz[seen]
    places = (size, phase)
    draw(places, f, z.impedance_ns_per_m[seen], look, "measured", _interval(z)[seen], view)
    if result.predicted is not None:
        draw(places, f, result.predicted[seen], PREDICTED, "predicted", view=view)
    if sines is not None:
        points = {**MARKS, "marker": "D"}
        z_of_sines = sines.impedance_ns_per_m
        draw(places, sines.frequency_hz, z_of_sines, points, "stepped sine", view=view)
    phase.plot(
        worst.frequency_hz,
        view.sign * np.interp(worst.frequency_hz, z.frequency_hz, z.phase_deg),
        "o",
        color=Colour.BLACK,
        markersize=6,
        label=f"worst: margin {worst.value:.2g} degrees",
    )
    known.plot(f, z.coherence[seen], **look)
    known.set(ylabel="coherence", ylim=(0.0, 1.03))
    hertz_axis(known, max(SHOWN_HZ[0], float(f[0])), min(SHOWN_HZ[1], float(f[-1])))
    judged = result.verdict.judged
    grey = dress(size, phase, (judged.first_hz, judged.last_hz), view, more=(known,))
    legends(figure, [*legend_handles(phase), interval(look, RANDOM), grey], 3)
    figure.align_ylabels([size, phase, known])
    return figure


def _interval(z: Impedance) -> Floats:
    """Return half of the 95 % interval (F,) of ln|Z|, and of the phase in radians, for the random
    error; Student's t, because realisations may be few.
    """
    if z.degrees_of_freedom < FEWEST:
        return np.full(z.frequency_hz.size, np.inf)
    return half_width(z.coherence, z.degrees_of_freedom, PROBABILITY)


def _title(result: TrialResult, view: View) -> str:
    k, b, m = result.plan.params.trial.environment
    verdict = result.verdict
    simulated = "SIMULATED, " if result.recorded.simulated else ""
    low, high = verdict.band_hz
    who = f"{simulated}{result.recorded.origin}:"
    level = result.plan.params.trial.active_damping_ns_per_m
    what = f"K = {k:g} N/m, B = {b:g} N s/m, M = {1e3 * m:g} g, active damping {level:g} N s/m"
    judged = (
        f"{verdict.answer.replace('_', ' ')} in {low:g}..{high:g} Hz at"
        f" {100 * verdict.confidence:g} %, {verdict.judged}\n{view.symbol} at the {verdict.port} by"
        f" {result.measured.estimator!r}, {_excited(result)}"
    )
    between = " " if len(who) + len(what) < TITLE_WIDTH else "\n"
    return f"{who}{between}{what}\n{judged}"


def _excited(result: TrialResult) -> str:
    if isinstance(result.spectra, PeriodicSpectra):
        return (
            f"multisine: {result.spectra.realisations} realisations of {result.spectra.periods}"
            " periods"
        )
    return f"{result.verdict.seconds:.3g} s of noise"


# --- over time ------------------------------------------------------------------------------------


def draw_traces(places: Sequence[Axes], panels: Sequence[tuple[str, Sequence[Trace]]]) -> None:
    """Draw a label and lines for each of the axes, which share their time."""
    for place, (label, lines) in zip(places, panels, strict=True):
        for time_s, values, look in lines:
            place.plot(time_s, values, **look)
        place.set_ylabel(label)
    places[-1].set_xlabel("time (s)")
    places[-1].figure.align_ylabels(places)


def _undrawn(result: TrialResult, view: View, why: str, width_mm: float | None) -> Figure:
    """Draw force and velocity over time; `why` is the reason for the missing spectrum."""
    recorded = result.recorded
    title = _title(result, view).rsplit("\n", 1)[0]
    look = level_styles([result.plan.params.trial.active_damping_ns_per_m])[0]
    line = {"color": look["color"], "linewidth": 0.6, "rasterized": True}
    title = f"{title}\n{fill(why, REASON_WIDTH)}"
    figure, places = axes(2, 1, 7.2, 5.4, title, width_mm=width_mm, sharex=True)
    time_s = np.arange(recorded.force_n.size) / recorded.rate_hz
    channels = (
        ("force of the probe (N)", recorded.force_n),
        ("velocity (m/s)", recorded.velocity_m_per_s),
    )
    draw_traces(places, [(label, [(time_s, values, line)]) for label, values in channels])
    places[-1].set_xlim(0.0, recorded.seconds)
    return figure


@styled()
def replay_figure(
    result: ReplayResult,
    title: str,
    changed: str = "replayed",
    width_mm: float | None = None,
) -> Figure:
    """Draw a motion, the recorded force, the replayed force, and their difference over time;
    `changed`: the settings that differ. ConfigError without matplotlib.
    """
    figure, places = axes(3, 1, 10.0, 8.0, title, width_mm=width_mm, sharex=True)
    was = {
        "color": Colour.GREY,
        "linewidth": 3.0,
        "label": "recorded",
    }  # visible below the other one
    would = {"color": Colour.GREEN, "linewidth": 0.9, "label": changed}
    time_s = result.time_s
    recorded = result.recorded["force_n"]
    replayed = result.replayed["force_n"]
    panels: list[tuple[str, list[Trace]]] = [
        ("position as recorded (mm)", [(time_s, 1e3 * result.recorded["position_m"], was)]),
        ("force (N)", [(time_s, recorded, was), (time_s, replayed, would)]),
        ("difference (N)", [(time_s, replayed - recorded, would)]),
    ]
    draw_traces(places, panels)
    above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 2}
    legends(figure, (), 2, "", (places[1], legend_handles(places[1]), above))
    return figure
