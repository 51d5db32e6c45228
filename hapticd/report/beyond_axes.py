"""Figures of a run of `beyond` over a corner frequency or a level of added damping."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.measure.beyond import BeyondResult, mean_sd
from hapticd.measure.beyond_shape import Corner, Shaped
from hapticd.measure.reproduce_trials import LEVELS
from hapticd.report import figures
from hapticd.report.beyond import made_how
from hapticd.report.looks import INTERVAL, OFF, OLIVE, ON, PARTS, Look, of_mean
from hapticd.report.paper_style import WIDTH_IN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES = ("largest K", "largest B", "smallest M")
UNITS = ("N/m", "N s/m", "g")
SCALES = (1.0, 1.0, 1e3)
BY_TRIALS = f"by trials, {INTERVAL}"
COLOURS = dict(PARTS)
LOOKS: tuple[Look, ...] = (
    {"color": COLOURS["K"], "marker": "o"},
    {"color": COLOURS["B > 0"], "marker": "s"},
    {"color": COLOURS["M < 0"], "marker": "^"},
)
MARKED: Look = {"color": figures.BLACK, "linestyle": "none", "marker": "o", "markersize": 4.5, "capsize": 3}


def shape_figure(result: BeyondResult) -> "Figure":
    """What a corner in the damping circuit does to the limits, to free motion, and to the envelope."""
    shaped = result.shaped
    figure, grid = figures.axes(2, 2, WIDTH_IN, 5.6)
    _shares(grid[0], shaped, shaped.highpass, "highpass_hz", "damping above the corner only")
    _shares(grid[1], shaped, shaped.lowpass, "lowpass_hz", "damping below the corner only")
    _confirmed(grid[0], shaped)
    _free(grid[2], shaped)
    _envelopes(grid[3], result)
    grid[0].set_ylabel("limit (% of unshaped)")
    figure.legend(*grid[0].get_legend_handles_labels(), fontsize=8, ncols=4, loc="outside lower center", frameon=False)
    figure.suptitle(
        f"Frequency-shaped added damping, {shaped.level:g} N s/m\n{made_how(result, 'lines predicted, marks ')}",
        x=0.01,
        ha="left",
        fontsize=10,
    )
    return figure


def _shares(axis: "Axes", shaped: Shaped, corners: tuple[Corner, ...], which: str, words: str) -> None:
    at = [getattr(corner, which) for corner in corners]
    for place, (name, look) in enumerate(zip(NAMES, LOOKS, strict=True)):
        share = [100.0 * corner.limits[place] / shaped.plain.limits[place] for corner in corners]
        axis.plot(at, share, markersize=4, label=name, **look)
        axis.axhline(
            100.0 * shaped.undamped.limits[place] / shaped.plain.limits[place], color=look["color"], linestyle=OFF["linestyle"]
        )
    axis.axhline(100.0, color=figures.BLACK, linewidth=0.8)
    axis.set_ylim(0.0, 118.0)
    figures.hertz_axis(axis, at[0] / 1.15, at[-1] * 1.15)
    axis.set_xlabel("corner (Hz)")
    axis.set_title(words, fontsize=9, loc="left")
    if which == "highpass_hz":
        axis.plot([], [], color=figures.BLACK, linestyle=OFF["linestyle"], label="without damping")


def _confirmed(axis: "Axes", shaped: Shaped) -> None:
    for each, look in zip(shaped.confirmed, LOOKS, strict=True):
        if len(each.runs):
            mean, sd = (100.0 * value / shaped.plain.limits[each.axis] for value in mean_sd(each.runs))
            marked = {**MARKED, "marker": look["marker"], "markerfacecolor": look["color"], "zorder": 3}
            axis.errorbar(shaped.best.highpass_hz, mean, of_mean(len(each.runs)) * abs(sd), **marked)


def _free(axis: "Axes", shaped: Shaped) -> None:
    for corners, which, mark, words in (
        (shaped.highpass, "highpass_hz", "o", "damping above it"),
        (shaped.lowpass, "lowpass_hz", "x", "damping below it"),
    ):
        at, low = [getattr(each, which) for each in corners], [each.free_db for each in corners]
        axis.plot(at, low, marker=mark, markersize=4, color=figures.BLUE, linewidth=0.9, label=words)
    axis.axhline(shaped.plain.free_db, color=figures.BLUE, linewidth=0.8)
    axis.axhline(shaped.undamped.free_db, linewidth=1.0, **OFF)
    axis.text(0.45, shaped.plain.free_db + 0.3, "unshaped", fontsize=8, color=figures.BLUE)
    axis.text(0.45, shaped.undamped.free_db + 0.3, "without damping", fontsize=8, color=figures.RED)
    if len(shaped.free_runs):
        mean, sd = mean_sd(shaped.free_runs)
        axis.errorbar(shaped.best.highpass_hz, mean, of_mean(len(shaped.free_runs)) * sd, **MARKED, label=BY_TRIALS)
    figures.hertz_axis(axis, 0.4, 600.0)
    axis.set_xticks([0.5, 2, 10, 50, 200])
    axis.set_xlabel("corner (Hz)")
    axis.set_ylabel("free motion (dB re 1 N s/m)")
    axis.set_ylim(-2.0, None)
    axis.legend(loc="lower left", fontsize=8)


def _envelopes(axis: "Axes", result: BeyondResult) -> None:
    looks = (
        ("off", OFF, "none"),
        ("on", ON, "unshaped"),
    )
    bounds = [(result.envelopes[name], look, words) for name, look, words in looks]
    best = result.shaped.best.highpass_hz
    bounds.append((result.shaped.bounds, {"color": figures.BLACK, "linestyle": "-"}, f"above {best:g} Hz"))
    axis.set_yscale("log")
    for found, look, words in bounds:
        for edge, label in ((found.lower, words), (found.upper, None)):
            spread = np.exp(of_mean(len(result.plan.seeds)) * edge.sd)
            axis.fill_between(
                found.frequency_hz, edge.value / spread, edge.value * spread, color=look["color"], alpha=0.2, linewidth=0
            )
            axis.plot(found.frequency_hz, edge.value, label=label, **look)
    figures.hertz_axis(axis, float(bounds[0][0].frequency_hz[0]), float(bounds[0][0].frequency_hz[-1]))
    figures.plain_axis(axis.yaxis)
    axis.set_ylabel("envelope, B ≥ 0 (N s/m)")
    axis.set_ylim(0.003, None)
    axis.legend(loc="lower left", fontsize=8, title="added damping", title_fontsize=8)


def levels_figure(result: BeyondResult) -> "Figure":
    """Limits, volume and free motion over the level of added damping."""
    levels = result.levels
    figure, grid = figures.axes(2, 2, WIDTH_IN, 5.4)
    for axis, panel in enumerate(grid[:3]):
        panel.plot(levels.level, SCALES[axis] * levels.limits[:, axis], color=LOOKS[axis]["color"], marker=".", label="predicted")
        for each in (limit for limit in levels.confirmed if limit.axis == axis):
            mean, sd = (SCALES[axis] * value for value in mean_sd(each.runs))
            panel.errorbar(
                each.level,
                mean,
                of_mean(len(each.runs)) * abs(sd),
                **MARKED,
                label=BY_TRIALS if each is levels.confirmed[axis] else None,
            )
        panel.set_ylabel(f"{NAMES[axis]} ({UNITS[axis]})")
        _marked(panel)
    _volume(grid[3], result)
    grid[0].legend(loc="upper left", fontsize=8)
    figure.suptitle(
        f"Levels of added damping; the two upright lines are those of the paper\n{made_how(result, 'lines predicted, marks ')}",
        x=0.01,
        ha="left",
        fontsize=10,
    )
    return figure


def _volume(axis: "Axes", result: BeyondResult) -> None:
    levels = result.levels
    axis.set_yscale("log")
    axis.plot(levels.level, levels.volume / levels.volume[0], color=figures.BLACK, marker=".", label="volume of the set, predicted")
    axis.set_ylabel("passive set (undamped = 1)")
    axis.set_ylim(0.1, None)
    figures.plain_axis(axis.yaxis)
    beside: Any = axis.twinx()
    beside.plot(levels.level, levels.free_db, color=OLIVE, marker="x", markersize=4, label="free motion, mean |Z| in 2-20 Hz")
    beside.set_ylabel("free motion (dB re 1 N s/m)", color=OLIVE)
    beside.set_ylim(-6.0, None)
    beside.grid(visible=False)
    beside.spines["right"].set_visible(True)
    lines = [*axis.get_lines()[:1], *beside.get_lines()]
    axis.legend(
        lines, [str(line.get_label()) for line in lines], loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8, frameon=False
    )
    _marked(axis)


def _marked(axis: "Axes") -> None:
    """The paper's two levels."""
    for level in LEVELS:
        axis.axvline(level, color="#bbbbbb", linewidth=1.0, zorder=0.4)
    axis.set_xlabel("added damping (N s/m)")
