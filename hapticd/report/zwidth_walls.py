"""Figure of virtual walls: which come to rest and which oscillate, in the K-B plane, as in Weir 2008, Fig. 2."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.walls import WallResult
from hapticd.report import figures
from hapticd.report.looks import LEVEL_MARKS, Look, of_levels, tint, words_of
from hapticd.report.paper_style import SMALL_PT, WIDTH_IN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def walls_figure(result: WallResult, title: str = "Walls that come to rest") -> "Figure":
    """A line and an area for each damping level: marks are the stiffest stable walls, crosses the softest that was not."""
    params, scene = result.plan.params, result.plan.params.scene
    with figures.style():
        figure, (place,) = figures.axes(1, 1, WIDTH_IN, 4.2)
        for rank, (level, look) in enumerate(zip(params.levels, of_levels(params.levels), strict=True)):
            _line(place, result, level, {**look, "marker": LEVEL_MARKS[rank % len(LEVEL_MARKS)]}, 0.4 - 0.01 * rank)
        black: Look = {"color": figures.BLACK, "linestyle": ""}
        place.plot([], [], "x", markersize=4, label="softest wall that oscillates", **black)
        softest = params.stiffnesses[0]
        place.plot([], [], "v", markersize=5, label=f"none rests: less than the least tried, {softest:g} N/m", **black)
        place.set(xlabel="virtual damping B of the wall (N s/m)", ylabel="virtual stiffness K of the wall (N/m)", ylim=(0.0, None))
        figure.legend(*place.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=SMALL_PT, frameon=False)
        impact = f"impact at {scene.start_velocity_m_per_s:g} m/s, push {scene.excitation.force_n:g} N"
        place.set_title(
            f"{title}\nSIMULATED {scene.device}: {impact}; below {1e3 * params.still_m_per_s:g} mm/s after {params.settle_s:g} s",
            loc="left", fontsize=9.5,
        )  # fmt: skip
        return figure


def _line(place: "Axes", result: WallResult, level: float, look: Look, low: float) -> None:
    """Of one level; where not even the softest wall rests the line is at 0 and its mark points down."""
    lines = result.at(level)
    damping, highest = np.array([line.wall_damping_ns_per_m for line in lines]), np.array([line.highest_n_per_m for line in lines])
    first = np.array([line.first_unstable_n_per_m for line in lines])
    none = highest <= 0.0
    place.fill_between(damping, 0.0, highest, color=tint(look["color"]), linewidth=0, zorder=low)
    shown: Look = {"markersize": 4, "clip_on": False, "zorder": 3, **look}
    label = f"stiffest wall that rests, {words_of(level)}"
    place.plot(damping, highest, label=label, markevery=[int(at) for at in np.flatnonzero(~none)], **shown)
    if none.any():
        place.plot(damping[none], highest[none], **{**shown, "marker": "v", "markersize": 6, "linestyle": ""})
    place.plot(damping[~none], np.where(np.isfinite(first), first, np.nan)[~none], "x", color=look["color"], markersize=4)
