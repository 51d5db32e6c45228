"""Figure of virtual walls: which come to rest and which oscillate, in the K-B plane, as in Weir 2008, Fig. 2."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.measure.walls import WallResult
from hapticd.report import figures
from hapticd.report.paper_style import OFF, ON, SMALL_PT, WIDTH_IN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = ("s", "o", "^", "D", "v", "P")
LOOKS: tuple[dict[str, Any], ...] = (OFF, ON, *({"color": colour, "linestyle": "-"} for colour in figures.COLOURS[2:]))


def walls_figure(result: WallResult, title: str = "Walls that come to rest") -> "Figure":
    """A line and an area for each damping level: marks are the stiffest stable walls, crosses the softest that was not."""
    params, scene = result.plan.params, result.plan.params.scene
    with figures.style():
        figure, (place,) = figures.axes(1, 1, WIDTH_IN, 4.2)
        for look, level in enumerate(params.levels):
            _line(place, result, level, LOOKS[look % len(LOOKS)], MARKERS[look % len(MARKERS)])
        place.plot([], [], "x", color=figures.BLACK, markersize=4, label="softest wall that oscillates")
        place.set(xlabel="virtual damping B of the wall (N s/m)", ylabel="virtual stiffness K of the wall (N/m)", ylim=(0.0, None))
        figure.legend(*place.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=SMALL_PT, frameon=False)
        impact = f"impact at {scene.start_velocity_m_per_s:g} m/s, push {scene.excitation.force_n:g} N"
        place.set_title(
            f"{title}\nSIMULATED {scene.device}: {impact}; below {1e3 * params.still_m_per_s:g} mm/s after {params.settle_s:g} s",
            loc="left", fontsize=9.5,
        )  # fmt: skip
        return figure


def _line(place: "Axes", result: WallResult, level: float, look: dict[str, Any], marker: str) -> None:
    lines = result.at(level)
    damping, highest = [line.wall_damping_ns_per_m for line in lines], np.array([line.highest_n_per_m for line in lines])
    first = np.array([line.first_unstable_n_per_m for line in lines])
    words = f"with {level:g} N s/m of added damping" if level else "without added damping"
    place.fill_between(damping, 0.0, highest, color=look["color"], alpha=0.10, linewidth=0)
    place.plot(
        damping, highest, marker=marker, markersize=4, label=f"stiffest wall that rests, {words}", clip_on=False, zorder=3, **look
    )
    place.plot(damping, np.where(np.isfinite(first), first, np.nan), "x", color=look["color"], markersize=4)
