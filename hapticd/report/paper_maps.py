"""Figs. 9 and 10: the passive environments of the grid, in space and from above."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.boundary import open_ends
from hapticd.measure.reproduce_grid import AXES, POINTS, Found
from hapticd.measure.reproduce_rows import FIG_4, FIG_7
from hapticd.measure.reproduce_trials import MAIN
from hapticd.report.paper_style import SMALL_PT, WIDTH_IN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRIALS = ((FIG_4, "*", "Fig. 4: K = 100 N/m"), (FIG_7, "D", "Fig. 7: K = 50 N/m"))


def set_figure(found: Found, title: str) -> "Figure":
    """The set in space, and the largest K over B and M."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, 4.1))
    FigureCanvasAgg(figure)
    space = figure.add_axes((-0.02, 0.0, 0.49, 0.86), projection="3d")
    flat = figure.add_axes((0.575, 0.13, 0.3, 0.6))
    colours, norm = _stiffness_colours()
    _space(space, found, colours, norm)
    drawn = _flat(flat, found, colours, norm)
    bar = figure.colorbar(drawn, cax=figure.add_axes((0.89, 0.13, 0.018, 0.6)), ticks=AXES[0])
    bar.set_label("K (N/m)")
    bar.ax.tick_params(labelsize=SMALL_PT)
    bar.ax.minorticks_off()
    count, how = (
        int(found.passive.sum()),
        f"{found.undecided} not certain at 95 %, {found.flown} trials" if found.flown else "predicted",
    )
    figure.suptitle(f"{title}\nSIMULATED {MAIN}, {count} of {len(POINTS)} environments ({how})", x=0.01, ha="left", fontsize=10)
    return figure


def _space(axis: Any, found: Found, colours: Any, norm: Any) -> None:
    k, b, m = (AXES[each][index] for each, index in enumerate(np.nonzero(found.passive)))
    order = np.argsort(b)[::-1]
    axis.scatter(1e3 * m[order], b[order], k[order], c=k[order], cmap=colours, norm=norm, s=5, depthshade=False, linewidths=0)
    axis.set_xlabel("M (g)", labelpad=-4)
    axis.set_ylabel("B (N s/m)", labelpad=-4)
    axis.set_zlabel("K (N/m)", labelpad=4)
    axis.set(xlim=(-24, 30), ylim=(0, 9), zlim=(0, 1000), xticks=(-20, 0, 20), yticks=(0, 3, 6, 9), zticks=(0, 500, 1000))
    axis.tick_params(labelsize=SMALL_PT, pad=-2)
    axis.tick_params(axis="z", pad=1)
    axis.view_init(elev=20, azim=-60)
    axis.set_box_aspect((1.0, 1.0, 1.15), zoom=0.98)


def _flat(axis: "Axes", found: Found, colours: Any, norm: Any) -> Any:
    """The largest passive K, and where the single trials lie."""
    stiffness = np.where(found.passive, AXES[0][:, None, None], -1.0).max(axis=0)
    shown = np.ma.masked_less(stiffness, 0.0)
    drawn = axis.pcolormesh(1e3 * AXES[2], AXES[1], shown, cmap=colours, norm=norm, edgecolors="white", linewidth=0.4)
    for (_, b, m), mark, words in TRIALS:
        axis.plot(1e3 * m, b, mark, color="white", markeredgecolor="black", markersize=6 if mark == "D" else 10, label=words)
    axis.set(xlabel="virtual mass M (g)", ylabel="virtual damping B (N s/m)", ylim=(-0.25, 11.3), yticks=range(0, 10, 2))
    axis.grid(visible=False)
    axis.legend(loc="upper left", fontsize=SMALL_PT, handletextpad=0.3)
    axis.set_title(f"Largest passive K at each B and M.\n{_cut(found)}", fontsize=9, loc="left")
    return drawn


def _cut(found: Found) -> str:
    """Where the grid ends and the set does not; K and B end at 0 by definition."""
    largest = (f"K = {AXES[0][-1]:g} N/m", f"B = {AXES[1][-1]:g} N s/m", f"M = {1e3 * AXES[2][-1]:g} g")
    names = {f"{name} max": words for name, words in zip("KBM", largest, strict=True)} | {"M min": f"M = {1e3 * AXES[2][0]:g} g"}
    cut = [names[end] for end in open_ends(found.as_set) if end in names]
    return f"The grid cuts the set at\n{', '.join(cut)}" if cut else "The grid reaches beyond the set"


def _stiffness_colours() -> Any:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm

    middle = 0.5 * (AXES[0][1:] + AXES[0][:-1])
    borders = np.concatenate(([-12.5], middle, [1100.0]))
    colours = colormaps["viridis"].resampled(len(AXES[0]))
    return colours, BoundaryNorm(borders, colours.N)
