"""Figures of the paper's future work.

    beyond_lower_edge    edge_figure: negative virtual damping and the lower edge of the Z-width
    beyond_free_motion   free_figure: |Z| without a rendered stiffness
    beyond_shaped        shape_figure: limits, free motion and envelope over a corner frequency
    beyond_levels        levels_figure: limits, passive set and free motion over active damping
    beyond_search        passive_set.search_figure of `report`: directed search

Bands and bars are 95 % intervals of the mean over seeds, by Student's t. The bracket at the bottom
spans the frequencies of the means in dB. A strip below an envelope shows the dominant parameter of
the lower edge's owner at that frequency. All figures are drawn within `styled`.

A result without seeds has no intervals, and the title then shows that all is predicted.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Any

from examples.weir2008.figures import draw_bracket
from examples.weir2008.future_work import (
    LOW_HZ,
    Bounds,
    Corner,
    FutureWorkResult,
    Motion,
    ShapedResult,
    mean_sd,
    shown_hz,
)
from examples.weir2008.paper import ADDED_NS_PER_M, LEVELS, MAIN
from examples.weir2008.run import SECONDS
from hapticd.core.arrays import Floats
from hapticd.signal.verdict import student_quantile
from hapticd.zwidth.passive_set import Edge
from hapticd.zwidth.report.envelope import keys, strip, weightiest
from hapticd.zwidth.report.paper import legends
from hapticd.zwidth.report.style import (
    INTERVAL,
    OFF,
    ON,
    PARTS,
    PREDICTED,
    WIDTH_IN,
    Axes,
    Colour,
    Figure,
    Look,
    axes,
    draw_band,
    hertz_axis,
    legend_handles,
    mark,
    plain_axis,
    simulated,
)

NEGATIVE: Look = {"color": Colour.FOREST, "linestyle": "-", "linewidth": 1.6}
WITH_MASS: Look = {"color": Colour.PURPLE, "linestyle": "-", "linewidth": 2.2}  # B < 0 and M < 0
ALONE: Look = {"color": Colour.BLACK, "linestyle": "-"}
CASES = (
    ("off", OFF, "no active damping"),
    ("on", ON, f"{ADDED_NS_PER_M:g} N s/m active, B ≥ 0"),
    ("on_negative_B", NEGATIVE, f"{ADDED_NS_PER_M:g} N s/m active, any B"),
)
COLOURS = dict(PARTS)
LIMITS: tuple[tuple[str, str, float, Look], ...] = (
    ("largest K", "N/m", 1.0, {"color": COLOURS["K"], "marker": "o"}),
    ("largest B", "N s/m", 1.0, {"color": COLOURS["B > 0"], "marker": "s"}),
    ("smallest M", "g", 1e3, {"color": COLOURS["M < 0"], "marker": "^"}),
)
DISC: Look = {"color": Colour.BLACK, "marker": "o"}
BY_TRIALS = f"by trials, {INTERVAL}"
BAND = f"{LOW_HZ[0]:g}-{LOW_HZ[1]:g} Hz"
CORNERS_HZ = (0.4, 600.0)
PROBABILITY = 0.975  # each side of an interval of 95 %


def _subtitle(result: FutureWorkResult, more: str = "") -> str:
    """Return the line below a title: the device, the method, and the number of seeds."""
    seeds = result.plan.seeds
    count = f", {len(seeds)} seeds" if seeds else ""
    return f"{simulated(MAIN, SECONDS if seeds else 0.0, more)}{count}"


def mean_interval(count: int) -> float:
    """Return half of the 95 % interval of a mean of `count` values, over their standard deviation:
    Student's t; 0 for a single one.
    """
    return student_quantile(PROBABILITY, count - 1) / sqrt(count) if count > 1 else 0.0


def _ends(axis: Axes) -> None:
    """Set axes of |Z| over the frequencies of all trials here."""
    f = shown_hz()
    hertz_axis(axis, float(f[0]), float(f[-1]))
    plain_axis(axis.yaxis)


def _by_trials(
    axis: Axes,
    x: Any,
    runs: Sequence[Floats],
    scale: float = 1.0,
    look: Look = DISC,
    label: str | None = BY_TRIALS,
) -> None:
    """Draw the mean of each of `runs` (seeds,), times `scale`, with its interval at `x`; nothing
    without trials.
    """
    known = [mean_sd(each) for each in runs if len(each)]
    bars = [
        abs(scale) * mean_interval(len(each)) * sd
        for each, (_, sd) in zip(runs, known, strict=False)
    ]
    if known:
        marked = {"markerfacecolor": look["color"], "zorder": 3, **look, "linestyle": ""}
        axis.errorbar(x, [scale * mean for mean, _ in known], bars, label=label, **marked)


# --- future work, over frequency ------------------------------------------------------------------


def edge_figure(result: FutureWorkResult, width_mm: float | None = None) -> Figure:
    """Draw envelopes without and with active damping and with B < 0, by the paper's rule and
    without friction, with the owners of their lower edges.
    """
    title = f"Negative virtual damping and the lower edge of the Z-width\n{_subtitle(result)}"
    heights = (3.4, 0.3, 0.3, 0.3)
    figure, grid = axes(
        4, 2, WIDTH_IN, 5.9, title, width_mm=width_mm, sharex=True, height_ratios=heights
    )
    grid[1].sharey(grid[0])
    grid[1].tick_params(labelleft=False)
    kinds = (
        ("", "passive at the perturbation of the trials"),
        ("_safe", "passive without counting on dry friction"),
    )
    for column, (kind, words) in enumerate(kinds):
        bounds = [result.envelopes[f"{name}{kind}"] for name, _, _ in CASES]
        size, *strips = grid[column::2]
        _lines(size, bounds, [(look, label) for _, look, label in CASES], len(result.plan.seeds))
        size.set(title=words, ylim=(None, 300.0))
        _ends(size)
        draw_bracket(size, LOW_HZ)
        for axis, found, (_, _, label) in zip(strips, bounds, CASES, strict=True):
            which = weightiest(shown_hz(), found.points[found.lower.owner])
            strip(axis, shown_hz(), [which], f"{label}: {found.lower_db().mean():+.1f} dB")
        for axis in (size, *strips):
            axis.set_xlabel("frequency (Hz)" if axis is strips[-1] else "")
    grid[0].set_ylabel("|Z| at the probe (N s/m)")
    predicted = [mark("lower edge, predicted", **PREDICTED)] if result.plan.seeds else []
    cases = [*(mark(label, **look) for _, look, label in CASES), *predicted]
    foot = (
        f"strips: owner of the lower edge, weightiest part; its mean over {BAND} (bracket), dB re 1"
        " N s/m"
    )
    legends(figure, keys(), 6, foot, (grid[1], cases, {"loc": "upper center"}))
    return figure


def _lines(
    axis: Axes, bounds: Sequence[Bounds], styles: Sequence[tuple[Look, str]], seeds: int
) -> None:
    """Draw both edges, the lower one heavier."""
    for found, (look, words) in zip(bounds, styles, strict=True):
        _line(
            axis,
            found.lower,
            found.predicted_lower if found.trials else None,
            seeds,
            {**look, "linewidth": 1.8},
            words,
        )
        _line(axis, found.upper, None, seeds, {**look, "linewidth": 0.8})


def _line(
    axis: Axes,
    size: Edge,
    predicted: Floats | None,
    seeds: int,
    look: Look,
    words: str | None = None,
) -> None:
    """Draw |Z| over `shown_hz()` with the interval of its mean over seeds, and its prediction
    dotted.
    """
    axis.set_yscale("log")
    draw_band(axis, shown_hz(), size.value, mean_interval(seeds) * size.sd, look, words)
    if predicted is not None:
        axis.plot(shown_hz(), predicted, **{**PREDICTED, "color": look["color"]})


def free_figure(result: FutureWorkResult, width_mm: float | None = None) -> Figure:
    """Draw |Z| over frequency without a rendered stiffness, for each way of making that lighter."""
    title = f"Free motion: passive for any input, friction not counted\n{_subtitle(result)}"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.4, title, width_mm=width_mm)
    for motion, look in zip(result.free.motions, (OFF, ON, NEGATIVE, WITH_MASS), strict=True):
        words = f"{_rendered(motion)}: {motion.low_db().mean():.1f} dB"
        _line(
            axis,
            motion.size,
            motion.predicted if len(motion.runs) else None,
            len(motion.runs),
            look,
            words,
        )
    bracket = mark(
        f"{BAND}: mean, dB re 1 N s/m", color=Colour.BLACK, marker="|", markersize=7, linewidth=1.0
    )
    _ends(axis)
    draw_bracket(axis, LOW_HZ)
    axis.set_ylabel("|Z| at the probe, K = 0 (N s/m)")
    legends(figure, [*legend_handles(axis), mark("predicted", **PREDICTED), bracket], 2)
    return figure


def _rendered(motion: Motion) -> str:
    active = f"{motion.level:g} N s/m active" if motion.level else "no active damping"
    damping = f", B = {motion.virtual_damping:.2f} N s/m" if motion.virtual_damping else ""
    return active + damping + (f", M = {1e3 * motion.mass_kg:.1f} g" if motion.mass_kg else "")


# --- future work, over a corner and over a level --------------------------------------------------


def shape_figure(result: FutureWorkResult, width_mm: float | None = None) -> Figure:
    """Draw limits, free motion and envelope over the corner frequency of the active damping."""
    shaped = result.shaped
    title = (
        f"Frequency-shaped active damping, {shaped.level:g} N"
        f" s/m\n{_subtitle(result, 'lines predicted, marks ')}"
    )
    figure, (above, below, free, size) = axes(2, 2, WIDTH_IN, 5.6, title, width_mm=width_mm)
    _shares(above, shaped, shaped.highpass, "damping above the corner only")
    _shares(below, shaped, shaped.lowpass, "damping below the corner only")
    for each in shaped.confirmed:
        scale = 100.0 / shaped.plain.limits[each.axis]
        _by_trials(above, shaped.best.corner_hz, [each.values], scale, LIMITS[each.axis][-1], None)
    above.set_ylabel("limit (% of unshaped)")
    _free(free, shaped)
    styles = ((OFF, "none"), (ON, "unshaped"), (ALONE, f"above {shaped.best.corner_hz:g} Hz"))
    _lines(
        size,
        [result.envelopes["off"], result.envelopes["on"], shaped.bounds],
        styles,
        len(result.plan.seeds),
    )
    size.set(ylabel="envelope, B ≥ 0 (N s/m)", ylim=(0.003, None))
    _ends(size)
    undamped = mark("without active damping", color=Colour.BLACK, linestyle=OFF["linestyle"])
    within = {"loc": "lower left"}
    legends(
        figure,
        [*legend_handles(above), undamped],
        4,
        "",
        (size, legend_handles(size), {**within, "title": "active damping"}),
        (free, legend_handles(free), within),
    )
    return figure


def _shares(axis: Axes, shaped: ShapedResult, corners: tuple[Corner, ...], words: str) -> None:
    """Draw limits in percent of those without a corner; those without active damping dashed."""
    at = [corner.corner_hz for corner in corners]
    for place, (name, _, _, look) in enumerate(LIMITS):
        scale = 100.0 / shaped.plain.limits[place]
        axis.plot(at, [scale * corner.limits[place] for corner in corners], label=name, **look)
        axis.axhline(
            scale * shaped.undamped.limits[place], color=look["color"], linestyle=OFF["linestyle"]
        )
    axis.axhline(100.0, color=Colour.BLACK, linewidth=0.8)
    hertz_axis(axis, at[0] / 1.15, at[-1] * 1.15)
    axis.set(ylim=(0.0, 118.0), xlabel="corner (Hz)", title=words)


def _free(axis: Axes, shaped: ShapedResult) -> None:
    for corners, sign, words in (
        (shaped.highpass, "o", "damping above it"),
        (shaped.lowpass, "x", "damping below it"),
    ):
        free_db = [each.free_db for each in corners]
        axis.plot(
            [each.corner_hz for each in corners],
            free_db,
            marker=sign,
            color=Colour.BLUE,
            linewidth=0.9,
            label=words,
        )
    for level, words, look in (
        (shaped.plain.free_db, "unshaped", ON),
        (shaped.undamped.free_db, "without active damping", OFF),
    ):
        axis.axhline(level, linewidth=0.9, **look)
        axis.text(0.45, level + 0.3, words, fontsize="small", color=look["color"])
    if len(shaped.free.runs):
        _by_trials(axis, shaped.best.corner_hz, [shaped.free.low_db()])
    hertz_axis(axis, *CORNERS_HZ)
    axis.set(
        xlabel="corner (Hz)",
        ylabel="free motion (dB re 1 N s/m)",
        ylim=(-2.0, None),
        xticks=[0.5, 2, 10, 50, 200],
    )


def levels_figure(result: FutureWorkResult, width_mm: float | None = None) -> Figure:
    """Draw limits, volume of the passive set and free motion over active damping."""
    levels = result.levels
    how = _subtitle(result, "lines predicted, marks ")
    figure, grid = axes(
        2,
        2,
        WIDTH_IN,
        5.4,
        f"Levels of active damping; the two upright lines are those of the paper\n{how}",
        width_mm=width_mm,
    )
    for axis, (panel, (name, unit, scale, look)) in enumerate(zip(grid, LIMITS, strict=False)):
        panel.plot(
            levels.level,
            scale * levels.limits[:, axis],
            color=look["color"],
            marker=".",
            label="predicted",
        )
        tried = [limit for limit in levels.confirmed if limit.axis == axis]
        _by_trials(panel, [each.level for each in tried], [each.values for each in tried], scale)
        panel.set_ylabel(f"{name} ({unit})")
    lines = _volume(grid[3], result)
    for panel in grid:
        for level in LEVELS:
            panel.axvline(level, color="#bbbbbb", linewidth=1.0, zorder=0.4)
        panel.set_xlabel("active damping (N s/m)")
    above = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False}
    first = (grid[0], legend_handles(grid[0]), {"loc": "upper left"})
    legends(figure, (), 1, "", first, (grid[3], lines, above))
    return figure


def _volume(axis: Axes, result: FutureWorkResult) -> list[Any]:
    """Draw both, and return the handles of their legend."""
    levels = result.levels
    beside = axis.twinx()
    growth = levels.volume / levels.volume[0]
    lines = axis.plot(
        levels.level, growth, color=Colour.BLACK, marker=".", label="volume of the set, predicted"
    )
    axis.set(yscale="log", ylim=(0.1, None), ylabel="passive set\n(without active damping = 1)")
    plain_axis(axis.yaxis)
    lines += beside.plot(
        levels.level,
        levels.free_db,
        color=Colour.OLIVE,
        marker="x",
        label=f"free motion, mean |Z| in {BAND}",
    )
    beside.set(ylim=(-6.0, None))
    beside.set_ylabel("free motion (dB re 1 N s/m)", color=Colour.OLIVE)
    beside.grid(visible=False)
    beside.spines["right"].set_visible(True)
    return lines
