"""Figure of axis limits: the largest K, B and -M over added damping or over the perturbation."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.limits import AxisLimit, LimitsResult
from hapticd.report import figures
from hapticd.report.looks import PREDICTED, Look, of_levels, words_of
from hapticd.report.paper_style import SMALL_PT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXIS_LABELS = {"K": ("largest K (N/m)", 1.0), "B": ("largest B (N s/m)", 1.0), "M": ("largest -M (g)", -1e3)}
PSD_UNIT = 1e-5  # N^2/Hz
MOST_TICKS = 5
NARROWEST_IN = 6.0
ALONE: Look = {"color": figures.BLACK, "linestyle": "-"}


def limits_figure(result: LimitsResult) -> "Figure":
    """Axis limits over added damping, or over the perturbation where several amplitudes were scanned."""
    params = result.plan.params
    many = len(params.amplitudes) > 1
    groups, looks = (params.levels, of_levels(params.levels)) if many else ((params.amplitudes[0],), [ALONE])
    with figures.style():
        width = max(NARROWEST_IN, 3.2 * len(params.axes))
        figure, places = figures.axes(1, len(params.axes), width, 4.2)
        seconds = f"{params.conditions.seconds:g} s of noise a trial"
        figure.suptitle(
            f"Axis limits, the other two being 0\nSIMULATED {params.conditions.scene.device}, {seconds}", x=0.01, ha="left"
        )
        for place, axis in zip(places, params.axes, strict=True):
            mine = [limit for limit in result.limits if limit.scan.axis == axis]
            for group, look in zip(groups, looks, strict=True):
                name = f"by trials, {words_of(group)}" if many else "by trials"
                _limit_line(place, [one for one in mine if not many or one.scan.damping_ns_per_m == group], many, look, name)
            place.set(ylabel=AXIS_LABELS[mine[0].name][0], ylim=(0.0, None), xlabel="added damping (N s/m)")
            if many:
                _perturbation_axis(place, sorted({limit.perturbation_psd for limit in mine}))
        handles, words = places[0].get_legend_handles_labels()
        unique = dict(zip(words, handles, strict=True))
        unique["bar: from surely passive to surely not"] = _bar(places[0])
        figure.legend([*unique.values()], [*unique], loc="outside lower center", ncols=2, fontsize=SMALL_PT, frameon=False)
        return figure


def _limit_line(place: "Axes", limits: list[AxisLimit], many: bool, look: Look, name: str) -> None:
    factor = AXIS_LABELS[limits[0].name][1]
    x = [limit.perturbation_psd / PSD_UNIT if many else limit.scan.damping_ns_per_m for limit in limits]
    value, lower, upper = (factor * np.array([getattr(limit, part) for limit in limits]) for part in ("value", "lower", "upper"))
    spread = np.nan_to_num(np.array([np.maximum(value - lower, 0.0), np.maximum(upper - value, 0.0)]))
    bars = place.errorbar(x, value, spread, marker="o", markersize=4, capsize=3, label=name, **look)
    bars[2][0].set_linestyle("-")
    hollow = {**PREDICTED, "marker": "o", "markersize": 6, "markerfacecolor": "none", "markeredgewidth": 0.8}
    place.plot(x, [factor * limit.scan.predicted for limit in limits], **{**hollow, "color": look["color"]})
    place.plot([], [], label="predicted", **hollow)


def _bar(place: "Axes") -> object:
    return place.errorbar([], [], [], color=figures.BLACK, linestyle="", capsize=3)


def _perturbation_axis(place: "Axes", psd: list[float]) -> None:
    """A logarithmic axis with ticks at what was tried, and no more of them than there is room for."""
    shown = [value / PSD_UNIT for value in psd[:: -(-len(psd) // MOST_TICKS)]]
    place.set(xscale="log", xlabel="perturbation ($10^{-5}$ N²/Hz)")
    place.set_xticks(shown, [f"{value:.3g}" if value < 1000.0 else f"{value:,.0f}" for value in shown])
    place.minorticks_off()
    place.margins(x=0.1)
