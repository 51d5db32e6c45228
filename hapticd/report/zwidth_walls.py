"""Figure of virtual walls: stable and unstable impacts and the boundary between them in the K-B plane, as in Weir 2008, Fig. 2."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.walls import WallResult
from hapticd.report import figures
from hapticd.report.zwidth import plain_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = ("o", "s", "^", "D")


def walls_figure(result: WallResult) -> "Figure":
    """A line for each damping level: filled marks are stable impacts, crosses the first that was not."""
    params, scene = result.plan.params, result.plan.params.scene
    with figures.style():
        figure, (place,) = figures.axes(1, 1, 7.4, 5.2)
        for look, level in enumerate(params.levels):
            colour, marker = figures.COLOURS[look % len(figures.COLOURS)], MARKERS[look % len(MARKERS)]
            lines = [line for line in result.lines if line.damping_ns_per_m == level]
            highest = np.array([line.highest_n_per_m or np.nan for line in lines])
            name = f"added damping {level:g} N s/m"
            place.plot([line.wall_damping_ns_per_m for line in lines], highest, color=colour, label=f"{name}: stiffest stable wall")
            for stable, mark in ((True, marker), (False, "x")):
                hits = [impact for line in lines for impact in line.impacts if impact.stable is stable]
                place.plot(
                    [impact.wall_damping_ns_per_m for impact in hits],
                    [impact.wall_stiffness_n_per_m for impact in hits],
                    mark, color=colour, markersize=3.5, linestyle="", alpha=0.6, label="stable impact" if stable else "oscillates",
                )  # fmt: skip
        plain_log(place)
        place.set(xlabel="wall damping B [N s/m]", ylabel="wall stiffness K [N/m]")
        place.set_title(
            f"SIMULATED {scene.device}: impact at {scene.start_velocity_m_per_s:g} m/s, push {scene.excitation.force_n:g} N;\n"
            f"stable: below {1e3 * params.still_m_per_s:g} mm/s after {params.settle_s:g} s",
            fontsize=9.5,
        )
        figure.legend(*place.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure
