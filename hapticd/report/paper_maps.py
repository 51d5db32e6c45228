"""Figures of a run of `reproduce` in the space of K, B and M: walls, passive sets, limits beside the paper's, and the band edge."""

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_grid import AXES, Found
from hapticd.measure.reproduce_limits import NAMES
from hapticd.measure.reproduce_rows import PAPER
from hapticd.measure.reproduce_trials import EDGES_HZ, LEVELS
from hapticd.measure.reproduce_walls import DAMPINGS
from hapticd.report import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS = ("o", "s", "^")
TOLERANCE_PERCENT = 8.0
WINDOW_HZ = 4000 / 2048


def walls_figure(result: ReproduceResult) -> "Figure":
    """Fig. 2."""
    figure, (axis,) = figures.axes(1, 1, 6.4, 4.2)
    looks: tuple[dict[str, Any], ...] = (
        {"color": figures.RED, "linestyle": (0, (4, 1.5)), "marker": "s", "label": "without added damping"},
        {"color": figures.BLUE, "linestyle": "-", "marker": "o", "label": "with 1.74 N s/m of added damping"},
    )
    for level, look in zip(LEVELS, looks, strict=True):
        values = result.walls[level]
        axis.fill_between(DAMPINGS, 0.0, values, color=look["color"], alpha=0.10, linewidth=0)
        axis.plot(DAMPINGS, values, markersize=4, **look)
    axis.set_xlabel("virtual damping B of the wall (N s/m)")
    axis.set_ylabel("largest stable stiffness K (N/m)")
    axis.set_xlim(0.0, DAMPINGS[-1])
    axis.set_ylim(0.0, None)
    axis.legend(loc="upper right")
    axis.set_title("Fig. 2: walls that come to rest, M = 0\n0.1 m/s impact, 0.5 N push, simulated, weir2008", loc="left")
    return figure


def set_figure(found: Found, title: str) -> "Figure":
    """Fig. 9 or 10: the set in space, and the largest K over B and M."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.4, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    colours, norm = _stiffness_colours()
    engine: Any = figure.get_layout_engine()
    engine.set(wspace=0.06)
    space: Any = figure.add_subplot(1, 2, 1, projection="3d")
    k, b, m = (AXES[axis][index] for axis, index in enumerate(np.nonzero(found.passive)))
    order = np.argsort(b)[::-1]
    space.scatter(1e3 * m[order], b[order], k[order], c=k[order], cmap=colours, norm=norm, s=7, depthshade=False, linewidths=0)
    space.set_xlabel("M (g)")
    space.set_ylabel("B (N s/m)")
    space.set_zlabel("K (N/m)", labelpad=7)
    space.set_xlim(-24, 30)
    space.set_ylim(0, 9)
    space.set_zlim(0, 1000)
    space.view_init(elev=20, azim=-60)
    space.set_box_aspect(None, zoom=0.84)
    flat = figure.add_subplot(1, 2, 2)
    stiffness = np.where(found.passive, AXES[0][:, None, None], -1.0).max(axis=0)
    shown = np.ma.masked_less(stiffness, 0.0)
    drawn = flat.pcolormesh(1e3 * AXES[2], AXES[1], shown, cmap=colours, norm=norm, edgecolors="white", linewidth=0.4)
    flat.set_xlabel("virtual mass M (g)")
    flat.set_ylabel("virtual damping B (N s/m)")
    flat.grid(visible=False)
    flat.set_title("largest passive K at each B and M", fontsize=9)
    bar = figure.colorbar(drawn, ax=flat, ticks=AXES[0])
    bar.set_label("K (N/m)")
    how = f"{found.flown} trials flown" if found.flown else "predicted"
    figure.suptitle(f"{title}: {int(found.passive.sum())} of 6384 ({how})", x=0.01, ha="left", fontsize=10)
    return figure


def _stiffness_colours() -> Any:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm

    middle = 0.5 * (AXES[0][1:] + AXES[0][:-1])
    borders = np.concatenate(([-12.5], middle, [1100.0]))
    colours = colormaps["viridis"].resampled(len(AXES[0]))
    return colours, BoundaryNorm(borders, colours.N)


def limits_figure(result: ReproduceResult) -> "Figure":
    """Ours over the paper's, for each limit and device, with the scatter between seeds."""
    figure, (axis,) = figures.axes(1, 1, 7.2, 4.0)
    names = list(PAPER)
    axis.axhspan(
        -TOLERANCE_PERCENT, TOLERANCE_PERCENT, color=figures.GREY, alpha=0.15, linewidth=0, label=f"within {TOLERANCE_PERCENT:g} %"
    )
    axis.axhline(0.0, color=figures.BLACK, linewidth=0.8)
    for place, device in enumerate(result.plan.params.devices):
        for limit in (each for each in result.limits if each.device == device):
            name = f"{NAMES[limit.axis]}_{'on' if limit.level else 'off'}"
            x, printed = names.index(name) + 0.22 * (place - 1), PAPER[name]
            colour, label = figures.COLOURS[place], device if name == names[0] else None
            value = 100.0 * (limit.mean / printed - 1.0)
            if limit.values.size:
                error = 100.0 * limit.sd / abs(printed) if isfinite(limit.sd) else 0.0
                axis.errorbar(
                    x, value, error, color=colour, marker=MARKS[place], markersize=5, capsize=3, linestyle="none", label=label
                )
            elif label:
                axis.plot([], [], color=colour, marker=MARKS[place], markerfacecolor="white", linestyle="none", label=label)
            if isfinite(limit.predicted):
                guess = 100.0 * (limit.predicted / printed - 1.0)
                axis.plot(
                    x + 0.07, guess, color=colour, marker=MARKS[place], markerfacecolor="white", markersize=4, linestyle="none"
                )
    axis.set_yscale("symlog", linthresh=20.0)
    axis.set_yticks(
        [-100, -50, -20, -8, 0, 8, 20, 50, 100, 500], ["-100", "-50", "-20", "-8", "0", "+8", "+20", "+50", "+100", "+500"]
    )
    axis.set_ylim(-160, 800)
    axis.set_xticks(range(len(names)), [_labelled(name) for name in names])
    axis.set_ylabel("ours over the paper's, less one (%)")
    axis.legend(loc="upper left", ncols=2)
    axis.set_title("Six axis limits beside the paper's; bars: one sd between seeds, hollow: predicted", loc="left")
    return figure


def _labelled(name: str) -> str:
    printed, mode = PAPER[name], "damped" if name.endswith("_on") else "undamped"
    unit = {"K": f"{printed:g} N/m", "B": f"{printed:g} N s/m", "M": f"{1e3 * printed:g} g"}[name[0]]
    return f"{name[0]} {name[2:5]}\n{mode}\n{unit}"


def edges_figure(result: ReproduceResult) -> "Figure":
    """K limits over the lower band edge: what tells a lag in the force path from a high-pass in the probe."""
    figure, pair = figures.axes(1, 2, 8.2, 4.3, sharex=True)
    for axis, level, words in zip(pair, LEVELS, ("without added damping", "with 1.74 N s/m of added damping"), strict=True):
        for place, device in enumerate(result.plan.params.devices):
            values = np.nan_to_num(result.edges[device, level])
            if not values.any():
                continue
            sd = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(EDGES_HZ))
            axis.errorbar(
                EDGES_HZ, values.mean(axis=0), sd, color=figures.COLOURS[place], marker=MARKS[place], markersize=5, capsize=3,
                label=device, linestyle=("-", "--", ":")[place],
            )  # fmt: skip
        axis.axhline(
            PAPER["K_max_on" if level else "K_max_off"], color=figures.BLACK, linewidth=0.8, label="the paper, band not stated"
        )
        axis.axvspan(0.8, WINDOW_HZ, color=figures.GREY, alpha=0.15, linewidth=0, label="below the window's reach")
        axis.set_xscale("log")
        axis.set_xlim(0.8, 12.5)
        axis.set_xticks(EDGES_HZ, [f"{edge:g}" for edge in EDGES_HZ])
        axis.minorticks_off()
        axis.set_title(words, loc="left")
        axis.set_xlabel("lower edge of the judged band (Hz)")
    pair[0].set_ylim(0, None)
    pair[1].set_yscale("log")
    pair[0].set_ylabel("largest passive K on its axis (N/m)")
    pair[1].set_yticks([200, 300, 600, 1000, 2000, 3000], ["200", "300", "600", "1000", "2000", "3000"])
    pair[1].minorticks_off()
    figure.legend(*pair[1].get_legend_handles_labels(), ncols=3, loc="outside lower center", frameon=False)
    return figure
