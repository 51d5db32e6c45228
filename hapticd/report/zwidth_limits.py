"""Figure of axis limits: the largest K, B and -M over added damping or over the perturbation."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.axis_scan import AxisLimit, LimitsResult
from hapticd.report import figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
