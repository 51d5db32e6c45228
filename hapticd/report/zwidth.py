"""Figures of trials: impedance with its interval, its coherence, and what was predicted."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.axis_scan import AxisLimit, LimitsResult
from hapticd.measure.referee import Referee
from hapticd.measure.trial import TrialResult
from hapticd.report import figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INTERVAL = 1.96  # standard deviations of the bands that are drawn
SHOWN_HZ = (1.0, 1000.0)


def trial_figure(result: TrialResult, referee: Referee | None = None) -> "Figure":
    """|Z|, phase and coherence of one trial, with the stepped sine's as points. ConfigError without matplotlib."""
    with figures.style():
        figure, (size, phase, known) = figures.axes(3, 1, 7.2, 8.0, sharex=True, height_ratios=(2.2, 2.2, 1.0))
        figure.suptitle(_title(result), fontsize=9.5)
        z = result.measured
        seen = (z.frequency_hz >= SHOWN_HZ[0]) & (z.frequency_hz <= SHOWN_HZ[1])
        f, spread = z.frequency_hz[seen], INTERVAL * z.relative_sd[seen]
        _curve(size, f, np.abs(z.impedance_ns_per_m[seen]), spread, "|Z| [N s/m]")
        _curve(phase, f, z.phase_deg[seen], spread, "phase of Z [deg]")
        if result.predicted is not None:
            grey: dict[str, Any] = {"color": figures.BLACK, "linestyle": "--", "linewidth": 0.9, "label": "predicted"}
            size.plot(f, np.abs(result.predicted[seen]), **grey)
            phase.plot(f, np.degrees(np.angle(result.predicted[seen])), **grey)
        if referee is not None:
            sine: dict[str, Any] = {
                "color": figures.PURPLE,
                "linestyle": "",
                "marker": "D",
                "markersize": 4,
                "label": "stepped sine",
            }
            size.plot(referee.frequency_hz, np.abs(referee.impedance_ns_per_m), **sine)
            phase.plot(referee.frequency_hz, np.degrees(np.angle(referee.impedance_ns_per_m)), **sine)
        known.semilogx(f, z.coherence[seen], color=figures.GREEN)
        known.set(ylabel="coherence", xlabel="frequency [Hz]", ylim=(0.0, 1.03), xlim=SHOWN_HZ)
        _finish(result, size, phase)
        figure.align_ylabels([size, phase, known])
        return figure


def hertz_axis(axis: "Axes", low_hz: float = SHOWN_HZ[0], high_hz: float = SHOWN_HZ[1]) -> None:
    """A logarithmic axis of frequencies with plain numbers."""
    axis.set(xscale="log", xlim=(low_hz, high_hz))
    axis.xaxis.set_major_formatter(lambda value, place: f"{value:g}")


def plain_log(axis: "Axes") -> None:
    """A logarithmic value axis with plain numbers at 1, 2, 5."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(lambda value, place: f"{value:g}")
    axis.yaxis.set_minor_formatter(NullFormatter())


def _curve(axis: "Axes", f: Floats, value: Floats, spread: Floats, label: str) -> None:
    axis.set_ylabel(label)
    if label.startswith("|"):
        low, high = value * np.exp(-spread), value * np.exp(spread)
        plain_log(axis)
    else:
        low, high = value - np.degrees(spread), value + np.degrees(spread)
    known = np.isfinite(spread) & (spread < 1.0)
    axis.fill_between(
        f, low, high, where=known, color=figures.BLUE, alpha=0.25, linewidth=0, label="95 % interval at each frequency"
    )
    axis.plot(f, value, color=figures.BLUE, label="measured")


def _finish(result: TrialResult, size: "Axes", phase: "Axes") -> None:
    verdict = result.verdict
    for axis in (size, phase):
        hertz_axis(axis)
        axis.axvspan(*verdict.band_hz, color="#f4f4f4", zorder=0)
    for edge in (-90.0, 90.0):
        phase.axhline(edge, color=figures.BLACK, linewidth=0.9, linestyle=":")
    phase.set(ylim=(-125.0, 125.0), yticks=range(-120, 121, 30))
    worst = verdict.margin_deg
    at = int(np.argmin(np.abs(result.measured.frequency_hz - worst.frequency_hz)))
    phase.plot(
        worst.frequency_hz, result.measured.phase_deg[at], "o", color=figures.RED, label=f"worst: margin {worst.value:.2g} deg"
    )
    size.legend(loc="best")
    phase.legend(loc="best")


def _title(result: TrialResult) -> str:
    k, b, m = result.plan.params.trial.environment
    verdict, simulated = result.verdict, "SIMULATED, " if result.recorded.simulated else ""
    low, high = verdict.band_hz
    return (
        f"{simulated}{result.recorded.origin}: K = {k:g} N/m, B = {b:g} N s/m, M = {1e3 * m:g} g, "
        f"added damping {result.plan.params.trial.damping_ns_per_m:g} N s/m\n"
        f"{verdict.answer.replace('_', ' ')} in {low:g}..{high:g} Hz at {100 * verdict.confidence:g} %, "
        f"Z at the {verdict.port} by {result.measured.estimator!r}, {verdict.seconds:.3g} s"
    )


AXIS_LABELS = {"K": ("K [N/m]", 1.0), "B": ("B [N s/m]", 1.0), "M": ("-M [g]", -1e3)}


def limits_figure(result: LimitsResult) -> "Figure":
    """Axis limits over added damping, or over the perturbation where several amplitudes were scanned."""
    params = result.plan.params
    many = len(params.amplitudes) > 1
    with figures.style():
        figure, places = figures.axes(1, len(params.axes), 3.4 * len(params.axes) + 0.4, 3.6)
        figure.suptitle(
            f"SIMULATED {params.conditions.scene.device}: axis limits, {params.conditions.seconds:g} s trials", fontsize=9.5
        )
        groups = params.levels if many else params.amplitudes
        for place, axis in zip(places, params.axes, strict=True):
            for look, group in enumerate(groups):
                mine = [
                    limit
                    for limit in result.limits
                    if limit.scan.axis == axis and group == (limit.scan.damping_ns_per_m if many else limit.scan.amplitude)
                ]
                _limit_line(place, mine, many, figures.COLOURS[look % len(figures.COLOURS)], group)
            place.set(ylabel=AXIS_LABELS[mine[0].name][0], ylim=(0.0, None))
            place.set_xlabel("perturbation [N²/Hz]" if many else "added damping [N s/m]")
        places[0].legend(loc="best")
        return figure


def _limit_line(place: "Axes", limits: list[AxisLimit], many: bool, colour: str, group: float) -> None:
    factor = AXIS_LABELS[limits[0].name][1]
    x = [limit.perturbation_psd if many else limit.scan.damping_ns_per_m for limit in limits]
    value, lower, upper = (factor * np.array([getattr(limit, name) for limit in limits]) for name in ("value", "lower", "upper"))
    spread = np.nan_to_num(np.array([np.maximum(value - lower, 0.0), np.maximum(upper - value, 0.0)]))
    name = f", added damping {group:g} N s/m" if many else ""
    place.errorbar(x, value, spread, color=colour, marker="o", markersize=4, capsize=3, label=f"trials, with interval{name}")
    place.plot(
        x, [factor * limit.scan.predicted for limit in limits], "--", color=colour, marker="x", linewidth=0.9, label="predicted"
    )
    if many:
        place.set_xscale("log")
