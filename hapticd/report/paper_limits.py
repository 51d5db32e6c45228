"""The limits of a run of `reproduce`: each beside the paper's, and how K's depend on the lower edge of the judged band."""

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_limits import NAMES, Limit
from hapticd.measure.reproduce_rows import PAPER, TOLERANCE
from hapticd.measure.reproduce_trials import EDGES_HZ, LEVELS, WINDOW_HZ
from hapticd.report import figures
from hapticd.report.looks import DEVICES, Look
from hapticd.report.paper_style import SMALL_PT, WIDTH_IN, WORDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TICKS = (-100, -50, -20, -8, 0, 8, 20, 50, 100, 500)  # %
BESIDE, BESIDE_GUESS = 0.24, 0.08  # of the distance between two limits


def limits_figure(result: ReproduceResult) -> "Figure":
    """Ours over the paper's, for each limit and device, with the scatter between seeds."""
    figure, (axis,) = figures.axes(1, 1, WIDTH_IN, 4.1)
    names, percent = list(PAPER), 100.0 * TOLERANCE
    for end in (-percent, percent):
        axis.axhline(end, color="#aaaaaa", linewidth=1.0, label=f"±{percent:g} %" if end > 0.0 else None)
    axis.axhline(0.0, color=figures.BLACK, linewidth=0.8)
    for place, device in enumerate(result.plan.params.devices):
        look: Look = {**DEVICES[place], "linestyle": "none"}
        axis.plot([], [], label=device, markersize=5, **look)
        for limit in (each for each in result.limits if each.device == device):
            name = f"{NAMES[limit.axis]}_{'on' if limit.level else 'off'}"
            _beside_paper(axis, limit, names.index(name) + BESIDE * (place - 1), PAPER[name], look)
    axis.plot([], [], "o", color=figures.BLACK, markerfacecolor="white", markersize=4, label="predicted (hollow)")
    axis.set_yscale("symlog", linthresh=20.0)
    axis.set_yticks(TICKS, [f"{tick:+d}" if tick else "0" for tick in TICKS])
    axis.set_ylim(-160, 800)
    axis.minorticks_off()
    axis.set_xticks(range(len(names)), [_labelled(name) for name in names])
    axis.set_ylabel("difference from the paper (%)")
    figure.legend(loc="outside lower center", ncols=5, fontsize=SMALL_PT, frameon=False, handletextpad=0.4, columnspacing=1.2)
    seeds = f"bars: one sd over {len(result.plan.seeds)} seeds" if result.plan.seeds else "predicted"
    axis.set_title(f"Limits on their axes beside the paper's, SIMULATED; {seeds}", loc="left")
    return figure


def _beside_paper(axis: "Axes", limit: Limit, x: float, printed: float, look: dict[str, Any]) -> None:
    def percent(value: float) -> float:
        return 100.0 * (value / printed - 1.0)

    if limit.values.size:
        error = 100.0 * limit.sd / abs(printed) if isfinite(limit.sd) else 0.0
        axis.errorbar(x, percent(limit.mean), error, markersize=5, capsize=3, **look)
    if isfinite(limit.predicted):
        axis.plot(x + BESIDE_GUESS, percent(limit.predicted), markerfacecolor="white", markersize=4, **look)
    else:  # nothing is passive
        axis.plot(x, percent(0.0), markersize=5, **look)


def _labelled(name: str) -> str:
    printed, mode = PAPER[name], "damped" if name.endswith("_on") else "undamped"
    unit = {"K": f"{printed:g} N/m", "B": f"{printed:g} N s/m", "M": f"{1e3 * printed:g} g"}[name[0]]
    return f"{name[0]} {name[2:5]}\n{mode}\n{unit}"


def edges_figure(result: ReproduceResult) -> "Figure":
    """K limits over the lower band edge: what tells a lag in the force path from a high-pass in the probe."""
    figure, pair = figures.axes(1, 2, WIDTH_IN, 3.8, sharex=True)
    for axis, level, words in zip(pair, LEVELS, WORDS, strict=True):
        for place, device in enumerate(result.plan.params.devices):
            _over_edges(axis, np.nan_to_num(result.edges[device, level]), place, device)
        printed = PAPER["K_max_on" if level else "K_max_off"]
        axis.axhline(printed, color=figures.BLACK, linewidth=0.8, label="the paper, its band is not stated")
        axis.axvspan(
            0.8, WINDOW_HZ, facecolor="none", edgecolor="#bbbbbb", hatch="///", linewidth=0, label="below the reach of the window"
        )
        axis.set(xscale="log", xlim=(0.8, 12.5), xlabel="lower edge of the judged band (Hz)")
        axis.set_xticks(EDGES_HZ, [f"{edge:g}" for edge in EDGES_HZ])
        axis.set_title(words, loc="left", fontsize=9)
    pair[0].set_ylim(0, None)
    pair[1].set_ylim(250, 4000)
    pair[1].set_yscale("log")
    pair[0].set_ylabel("largest passive K on its axis (N/m)")
    pair[1].set_yticks([300, 600, 1000, 2000, 3000], ["300", "600", "1000", "2000", "3000"])
    for axis in pair:
        axis.minorticks_off()
    figure.legend(*pair[1].get_legend_handles_labels(), ncols=3, loc="outside lower center", frameon=False, fontsize=SMALL_PT)
    seeds = f"; bars: one sd over {len(next(iter(result.edges.values())))} seeds" if result.plan.seeds else ", predicted"
    figure.suptitle(f"K limits over the lower band edge, SIMULATED{seeds}", x=0.01, ha="left", fontsize=10)
    return figure


def _over_edges(axis: "Axes", values: Any, place: int, device: str) -> None:
    look: Look = {**DEVICES[place], "linestyle": "-"}
    if not values.any():
        axis.plot([], [], label=device, **look)
        axis.text(0.97, 0.04, f"{device}: none is passive", fontsize=SMALL_PT, ha="right", transform=axis.transAxes)
        return
    sd = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(EDGES_HZ))
    axis.errorbar(EDGES_HZ, values.mean(axis=0), sd, markersize=5, capsize=3, label=device, **look)
