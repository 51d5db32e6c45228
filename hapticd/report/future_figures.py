"""Figures of a run of `beyond`: the lower edge and free motion over frequency, limits over a corner
and over a level of damping.

Colours and lines are those of `style`; the envelope with negative virtual damping has its colour,
forest. Bands and bars are 95 % intervals of the mean over seeds, by Student's t; the bracket at the
foot spans the frequencies of the means in dB. A strip below an envelope says which part of the
lower edge's owner weighs most at that frequency (`envelope`). All are drawn within `styled`.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.beyond import BeyondResult, mean_sd
from hapticd.measure.beyond_display import shown_hz
from hapticd.measure.beyond_envelope import LOW_HZ, Bounds
from hapticd.measure.beyond_motion import Motion
from hapticd.measure.beyond_shape import Corner, Shaped
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M, LEVELS, MAIN, SECONDS
from hapticd.report.envelope import keys, strip, weightiest
from hapticd.report.style import (
    BELOW,
    BLACK,
    BLUE,
    FOREST,
    INTERVAL,
    OFF,
    OLIVE,
    ON,
    PARTS,
    PREDICTED,
    PURPLE,
    RED,
    SMALL_PT,
    WIDTH_IN,
    Look,
    averaged,
    axes,
    banded,
    hertz_axis,
    mark,
    of_mean,
    plain_axis,
    simulated,
)  # fmt: skip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NEGATIVE: Look = {"color": FOREST, "linestyle": "-", "linewidth": 1.6}
WITH_MASS: Look = {"color": PURPLE, "linestyle": "-", "linewidth": 2.2}  # B < 0 and M < 0
ALONE: Look = {"color": BLACK, "linestyle": "-"}
CASES = (
    ("off", OFF, "no added damping"),
    ("on", ON, f"{ADDED_NS_PER_M:g} N s/m added, B ≥ 0"),
    ("on_negative_B", NEGATIVE, f"{ADDED_NS_PER_M:g} N s/m added, any B"),
)
COLOURS = dict(PARTS)
LIMITS: tuple[tuple[str, str, float, Look], ...] = (
    ("largest K", "N/m", 1.0, {"color": COLOURS["K"], "marker": "o"}),
    ("largest B", "N s/m", 1.0, {"color": COLOURS["B > 0"], "marker": "s"}),
    ("smallest M", "g", 1e3, {"color": COLOURS["M < 0"], "marker": "^"}),
)
BY_TRIALS = f"by trials, {INTERVAL}"
BAND = f"{LOW_HZ[0]:g}-{LOW_HZ[1]:g} Hz"
CORNERS_HZ = (0.4, 600.0)


def _how(result: BeyondResult, more: str = "") -> str:
    count = len(result.plan.seeds)
    return f"{simulated(MAIN, SECONDS if count else 0.0, more)}{f', {count} seeds' if count else ''}"


def _ends(axis: "Axes") -> None:
    """Axes of |Z| over the frequencies of all trials here."""
    f = shown_hz()
    hertz_axis(axis, float(f[0]), float(f[-1]))
    plain_axis(axis.yaxis)


def _by_trials(axis: "Axes", x: float, runs: Floats, scale: float = 1.0, look: Look = ALONE, label: str | None = BY_TRIALS) -> None:
    """The mean of `runs` (seeds,), times `scale`, with its interval; nothing without trials."""
    if len(runs):
        mean, sd = mean_sd(runs)
        marked = {"marker": "o", "zorder": 3, "color": BLACK, "linestyle": "", "markerfacecolor": look["color"]}
        spread = abs(of_mean(len(runs)) * scale * sd)
        axis.errorbar(x, scale * mean, spread, label=label, **{**marked, "marker": look.get("marker", "o")})


# --- over frequency --------------------------------------------------------------------------------------------------------------


def edge_figure(result: BeyondResult) -> "Figure":
    """Envelopes undamped, damped and with B < 0: by the paper's rule, and without counting on
    friction.
    """
    title = f"Negative virtual damping and the lower edge of the Z-width\n{_how(result)}"
    figure, grid = axes(4, 2, WIDTH_IN, 5.9, title, sharex=True, sharey="row", height_ratios=[3.4, 0.3, 0.3, 0.3])
    kinds = (("", "passive at the perturbation of the trials"), ("_safe", "passive without counting on dry friction"))
    for column, (kind, words) in enumerate(kinds):
        bounds = [result.envelopes[f"{name}{kind}"] for name, _, _ in CASES]
        size, *strips = grid[column::2]
        _bounds(size, bounds, [{**look, "label": label} for _, look, label in CASES], len(result.plan.seeds))
        size.set(title=words, ylim=(None, 300.0))
        _ends(size)
        averaged(size, LOW_HZ)
        for axis, found, (_, _, label) in zip(strips, bounds, CASES, strict=True):
            which = weightiest(found.frequency_hz, found.points[found.lower.owner])
            strip(axis, found.frequency_hz, [which], f"{label}: {found.lower_db().mean():+.1f} dB", columns=2)
        for axis in (size, *strips):
            axis.set_xlabel("frequency (Hz)" if axis is strips[-1] else "")
    grid[0].set_ylabel("|Z| at the probe (N s/m)")
    predicted = [mark("lower edge, predicted", **PREDICTED)] if result.plan.seeds else []
    grid[1].legend(handles=[*(mark(label, **look) for _, look, label in CASES), *predicted], loc="upper center")
    foot = f"strips: owner of the lower edge, weightiest part; its mean over {BAND} (bracket), dB re 1 N s/m"
    figure.legend(handles=keys(), ncols=6, title=foot, **BELOW)
    return figure


def _bounds(axis: "Axes", bounds: Sequence[Bounds], looks: Sequence[Look], seeds: int) -> None:
    """Edges with their intervals, the lower one heavier, and the lower one predicted where there
    were trials.
    """
    axis.set_yscale("log")
    for found, look in zip(bounds, looks, strict=True):
        line = {name: value for name, value in look.items() if name != "label"}
        for edge, width, words in ((found.lower, 1.8, look["label"]), (found.upper, 0.8, None)):
            banded(axis, found.frequency_hz, edge.value, of_mean(seeds) * edge.sd, {**line, "linewidth": width}, words)
        if found.flown:
            axis.plot(found.frequency_hz, found.predicted_lower, **{**PREDICTED, "color": look["color"]})


def free_figure(result: BeyondResult) -> "Figure":
    """|Z| of the device that renders no stiffness, for each way of making it lighter."""
    title = f"Free motion: passive for any input, friction not counted\n{_how(result)}"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.4, title)
    axis.set_yscale("log")
    for motion, look in zip(result.free.motions, (OFF, ON, NEGATIVE, WITH_MASS), strict=True):
        _motion(axis, motion, look)
    axis.plot([], [], label="predicted", **PREDICTED)
    axis.plot([], [], color=BLACK, marker="|", markersize=7, linewidth=1.0, label=f"{BAND}: mean, dB re 1 N s/m")
    _ends(axis)
    averaged(axis, LOW_HZ)
    axis.set_ylabel("|Z| at the probe, K = 0 (N s/m)")
    figure.legend(*axis.get_legend_handles_labels(), ncols=2, **BELOW)
    return figure


def _motion(axis: "Axes", motion: Motion, look: Look) -> None:
    added = f"{motion.level:g} N s/m added" if motion.level else "no added damping"
    rendered = f", B = {motion.damping:.2f} N s/m" if motion.damping else ""
    rendered += f", M = {1e3 * motion.mass_kg:.1f} g" if motion.mass_kg else ""
    logs = np.log(motion.runs if len(motion.runs) else motion.predicted[None])
    spread = of_mean(len(logs)) * logs.std(axis=0, ddof=1) if len(logs) > 1 else np.zeros(logs.shape[1])
    label = f"{added}{rendered}: {motion.low_db().mean():.1f} dB"
    banded(axis, shown_hz(), np.exp(logs.mean(axis=0)), spread, look, label)
    if len(motion.runs):
        axis.plot(shown_hz(), motion.predicted, **{**PREDICTED, "color": look["color"]})


# --- over a corner and over a level ----------------------------------------------------------------------------------------------


def shape_figure(result: BeyondResult) -> "Figure":
    """What a corner in the damping circuit does to the limits, to free motion, and to the envelope."""
    shaped = result.shaped
    title = f"Frequency-shaped added damping, {shaped.level:g} N s/m\n{_how(result, 'lines predicted, marks ')}"
    figure, (above, below, free, size) = axes(2, 2, WIDTH_IN, 5.6, title)
    _shares(above, shaped, shaped.highpass, "highpass_hz", "damping above the corner only")
    _shares(below, shaped, shaped.lowpass, "lowpass_hz", "damping below the corner only")
    for each in shaped.confirmed:
        scale = 100.0 / shaped.plain.limits[each.axis]
        _by_trials(above, shaped.best.highpass_hz, each.runs, scale, LIMITS[each.axis][-1], None)
    above.plot([], [], color=BLACK, linestyle=OFF["linestyle"], label="without damping")
    above.set_ylabel("limit (% of unshaped)")
    _free(free, shaped)
    best = f"above {shaped.best.highpass_hz:g} Hz"
    looks = [{**look, "label": words} for look, words in ((OFF, "none"), (ON, "unshaped"), (ALONE, best))]
    _bounds(size, [result.envelopes["off"], result.envelopes["on"], shaped.bounds], looks, len(result.plan.seeds))
    size.set(ylabel="envelope, B ≥ 0 (N s/m)", ylim=(0.003, None))
    _ends(size)
    size.legend(loc="lower left", title="added damping")
    figure.legend(*above.get_legend_handles_labels(), ncols=4, **BELOW)
    return figure


def _shares(axis: "Axes", shaped: Shaped, corners: tuple[Corner, ...], which: str, words: str) -> None:
    """Limits in percent of those without a corner; dashed those without damping."""
    at = [getattr(corner, which) for corner in corners]
    for place, (name, _, _, look) in enumerate(LIMITS):
        scale = 100.0 / shaped.plain.limits[place]
        axis.plot(at, [scale * corner.limits[place] for corner in corners], label=name, **look)
        axis.axhline(scale * shaped.undamped.limits[place], color=look["color"], linestyle=OFF["linestyle"])
    axis.axhline(100.0, color=BLACK, linewidth=0.8)
    hertz_axis(axis, at[0] / 1.15, at[-1] * 1.15)
    axis.set(ylim=(0.0, 118.0), xlabel="corner (Hz)", title=words)


def _free(axis: "Axes", shaped: Shaped) -> None:
    for corners, which, sign, words in (
        (shaped.highpass, "highpass_hz", "o", "damping above it"),
        (shaped.lowpass, "lowpass_hz", "x", "damping below it"),
    ):
        at, low = [getattr(each, which) for each in corners], [each.free_db for each in corners]
        axis.plot(at, low, marker=sign, color=BLUE, linewidth=0.9, label=words)
    axis.axhline(shaped.plain.free_db, color=BLUE, linewidth=0.8)
    axis.axhline(shaped.undamped.free_db, linewidth=1.0, **OFF)
    for level, words, colour in ((shaped.plain.free_db, "unshaped", BLUE), (shaped.undamped.free_db, "without damping", RED)):
        axis.text(0.45, level + 0.3, words, fontsize=SMALL_PT, color=colour)
    _by_trials(axis, shaped.best.highpass_hz, shaped.free_runs)
    hertz_axis(axis, *CORNERS_HZ)
    axis.set(xlabel="corner (Hz)", ylabel="free motion (dB re 1 N s/m)", ylim=(-2.0, None), xticks=[0.5, 2, 10, 50, 200])
    axis.legend(loc="lower left")


def levels_figure(result: BeyondResult) -> "Figure":
    """Limits, volume and free motion over the level of added damping."""
    levels = result.levels
    how = _how(result, "lines predicted, marks ")
    figure, grid = axes(2, 2, WIDTH_IN, 5.4, f"Levels of added damping; the two upright lines are those of the paper\n{how}")
    for axis, (panel, (name, unit, scale, look)) in enumerate(zip(grid, LIMITS, strict=False)):
        panel.plot(levels.level, scale * levels.limits[:, axis], color=look["color"], marker=".", label="predicted")
        for count, each in enumerate(limit for limit in levels.confirmed if limit.axis == axis):
            _by_trials(panel, each.level, each.runs, scale, label=None if count else BY_TRIALS)
        panel.set_ylabel(f"{name} ({unit})")
    _volume(grid[3], result)
    for panel in grid:
        for level in LEVELS:
            panel.axvline(level, color="#bbbbbb", linewidth=1.0, zorder=0.4)
        panel.set_xlabel("added damping (N s/m)")
    grid[0].legend(loc="upper left")
    return figure


def _volume(axis: "Axes", result: BeyondResult) -> None:
    levels, beside = result.levels, axis.twinx()
    growth = levels.volume / levels.volume[0]
    lines = axis.plot(levels.level, growth, color=BLACK, marker=".", label="volume of the set, predicted")
    axis.set(yscale="log", ylim=(0.1, None), ylabel="passive set (undamped = 1)")
    plain_axis(axis.yaxis)
    lines += beside.plot(levels.level, levels.free_db, color=OLIVE, marker="x", label=f"free motion, mean |Z| in {BAND}")
    beside.set(ylim=(-6.0, None))
    beside.set_ylabel("free motion (dB re 1 N s/m)", color=OLIVE)
    beside.grid(visible=False)
    beside.spines["right"].set_visible(True)
    axis.legend(handles=lines, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
