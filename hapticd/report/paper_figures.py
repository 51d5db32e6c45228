"""Figures of a run of `reproduce` and of what the paper left for future work (`beyond`).

Figs. 3, 4 and 7-11, the limits beside the paper's, and K's over the lower band edge; then the lower
edge and free motion with negative virtual damping, limits over a corner and over a level of added
damping. Envelopes and impedances are drawn as those of every device are (`envelope`, `trial`), with
the paper's titles; walls, Fig. 2, and searches need nothing of their own (`passive_set`).

Of future work bands and bars are 95 % intervals of the mean over seeds, by Student's t; the bracket
at the foot spans the frequencies of the means in dB; a strip below an envelope says which part of
the lower edge's owner weighs most at that frequency. All figures are drawn within `styled`.
"""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import open_ends, passive_set
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predicted_impedance
from hapticd.measure.beyond import LOW_HZ, BeyondResult, Bounds, Corner, Motion, Shaped, mean_sd, shown_hz
from hapticd.measure.reproduce import (
    AXES,
    CALMED,
    EDGE_SEEDS,
    EDGES_HZ,
    POINTS,
    SECONDS,
    WINDOW_HZ,
    Found,
    Limit,
    Peak,
    ReproduceResult,
    Single,
    subject,
)
from hapticd.measure.reproduce_rows import ADDED_NS_PER_M, FIG_4, FIG_7, LEVELS, MAIN, NAMES, PAPER, TOLERANCE
from hapticd.report.envelope import SHOWN_HZ, Drawn, envelopes_figure, keys, strip, weightiest
from hapticd.report.paper_table import MIDDLE_HZ, compared
from hapticd.report.passive_set import draw_guess
from hapticd.report.style import (
    BELOW,
    BLACK,
    BLUE,
    DEVICES,
    FINE,
    FOREST,
    HOLLOW,
    INTERVAL,
    MARKS,
    NORMAL,
    OFF,
    OLIVE,
    ON,
    PARTS,
    PREDICTED,
    PURPLE,
    RED,
    SMALL_PT,
    WIDTH_IN,
    Axes,
    Figure,
    Look,
    averaged,
    axes,
    banded,
    handles_of,
    hertz_axis,
    mark,
    of_levels,
    of_mean,
    plain_axis,
    sheet,
    simulated,
    words_of,
)
from hapticd.report.trial import Curve, draw, dress, interval

LOOKS = tuple(of_levels(LEVELS))
WORDS = tuple(words_of(level) for level in LEVELS)
TRUSTED_HZ = (2.0, 500.0)
SIZE_RANGE = (0.08, 200.0)  # N s/m, the same for all envelopes that are compared
TICKS = (-100, -50, -20, -8, 0, 8, 20, 50, 100, 500)  # %
BESIDE, BESIDE_GUESS = 0.24, 0.08  # of the distance between two limits
TRIALS = ((FIG_4, "*", "Fig. 4: K = 100 N/m"), (FIG_7, "D", "Fig. 7: K = 50 N/m"))
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
DISC: Look = {"color": BLACK, "marker": "o"}
BY_TRIALS = f"by trials, {INTERVAL}"
BAND = f"{LOW_HZ[0]:g}-{LOW_HZ[1]:g} Hz"
CORNERS_HZ = (0.4, 600.0)


def _how(result: ReproduceResult | BeyondResult, more: str = "") -> str:
    """The line below a title; several seeds stand behind each number of future work."""
    seeds = result.plan.seeds
    count = f", {len(seeds)} seeds" if seeds and isinstance(result, BeyondResult) else ""
    return f"{simulated(MAIN, SECONDS if seeds else 0.0, more)}{count}"


# --- impedances and envelopes ----------------------------------------------------------------------------------------------------


def single_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> Figure:
    """|Z| and phase of single trials of the first seed; of two, the phase that the second gains
    over the first.
    """
    figure, (size, phase) = axes(2, 1, WIDTH_IN, 5.8, f"{title}\n{_how(result)}", sharex=True, height_ratios=[3.0, 2.4])
    shown = [result.singles[MAIN][place] for place in places]
    hertz_axis(phase, *SHOWN_HZ)
    for single in shown:
        _single(size, phase, single)
    if len(shown) == 2:
        _advantage(phase, float(compared(shown[0], shown[1], MAIN).mean(axis=0)[1]))
    known = [interval(LOOKS[shown[-1].level > 0.0])] if any(single.shown for single in shown) else []
    grey = dress(size, phase, TRUSTED_HZ, where=" at the probe")
    size.legend(handles=[*handles_of(size), *known, grey], loc="upper left")
    return figure


def _single(size: Axes, phase: Axes, single: Single) -> None:
    """As measured, dotted what is predicted; the prediction alone where nothing was flown."""
    look, words = LOOKS[single.level > 0.0], WORDS[single.level > 0.0]
    device, f, shown = subject(MAIN), np.geomspace(*SHOWN_HZ, 400), single.shown
    z = predicted_impedance(device.model, single.point, f, single.level, device.filters, Perturbation())
    if shown is None:
        draw(size, phase, Curve(f, z, look, f"{words}, predicted"))
        return
    draw(size, phase, Curve(shown.frequency_hz, shown.impedance_ns_per_m, look, words, NORMAL * shown.relative_sd))
    draw(size, phase, Curve(f, z, PREDICTED, "predicted"))


def _advantage(phase: Axes, degrees: float) -> None:
    averaged(phase, MIDDLE_HZ, 0.14)
    words = f"{degrees:.0f} degrees\nfarther\nfrom +90"
    phase.text(float(np.sqrt(MIDDLE_HZ[0] * MIDDLE_HZ[1])), -45.0, words, fontsize=SMALL_PT, ha="center", va="center")


def envelope_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> Figure:
    """|Z| and phase envelopes of damping levels, with the owners' strips; of added damping alone
    with the paper's peak.
    """
    shown = [drawn(result, place) for place in places]
    figure = envelopes_figure(shown, f"{title}\n{_how(result)}", SHOWN_HZ, TRUSTED_HZ)
    peak = result.found[1].peak() if places == (1,) else None
    if peak is not None:
        _peak(figure.axes[0], peak)
    figure.axes[0].set_ylim(*SIZE_RANGE)
    plain_axis(figure.axes[0].yaxis, FINE)
    return figure


def drawn(result: ReproduceResult, place: int) -> Drawn:
    """The envelope of one damping level, 0 or 1, with its prediction where it was made by trials."""
    found, predicted = result.found[place], result.predicted[MAIN][place]
    guess = predicted.envelope if predicted is not None and found.flown else None
    return Drawn(found.envelope, found.environments, LOOKS[place], WORDS[place], guess, CALMED if found.flown else 1)


def _peak(axis: Axes, peak: Peak) -> None:
    axis.annotate(
        f"{peak.frequency_hz:.0f} Hz: M = {1e3 * peak.owner[2]:g} g\n(paper: near 100 Hz)",
        (peak.frequency_hz, peak.size_ns_per_m), (peak.frequency_hz, 2.6 * peak.size_ns_per_m),
        ha="center", fontsize=SMALL_PT, arrowprops={"arrowstyle": "-|>", "color": BLACK, "linewidth": 0.8},
    )  # fmt: skip


# --- limits ----------------------------------------------------------------------------------------------------------------------


def limits_figure(result: ReproduceResult) -> Figure:
    """Ours over the paper's, for each limit and device, with the scatter between seeds."""
    seeds = f"bars: one sd over {len(result.plan.seeds)} seeds" if result.plan.seeds else "predicted"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.1, f"Limits on their axes beside the paper's, SIMULATED; {seeds}")
    names, percent = list(PAPER), 100.0 * TOLERANCE
    for end in (-percent, percent):
        axis.axhline(end, color="#aaaaaa", linewidth=1.0, label=f"±{percent:g} %" if end > 0.0 else None)
    axis.axhline(0.0, color=BLACK, linewidth=0.8)
    for place, device in enumerate(result.plan.devices):
        axis.plot([], [], label=device, linestyle="none", **DEVICES[place])
        for limit in (each for each in result.limits if each.device == device):
            name = f"{NAMES[limit.axis]}_{'on' if limit.level else 'off'}"
            _beside_paper(axis, limit, names.index(name) + BESIDE * (place - 1), PAPER[name], DEVICES[place])
    axis.plot([], [], "o", color=BLACK, label="predicted (hollow)", **HOLLOW)
    axis.set_yscale("symlog", linthresh=20.0)
    axis.set_yticks(TICKS, [f"{tick:+d}" if tick else "0" for tick in TICKS])
    axis.set_xticks(range(len(names)), [_labelled(name) for name in names])
    axis.set(ylim=(-160, 800), ylabel="difference from the paper (%)")
    axis.minorticks_off()
    figure.legend(ncols=5, handletextpad=0.4, columnspacing=1.2, **BELOW)
    return figure


def _beside_paper(axis: Axes, limit: Limit, x: float, printed: float, look: dict[str, Any]) -> None:
    """In percent of the paper's; a full mark at -100 % where nothing is passive."""
    scale, marked = 100.0 / printed, {**look, "linestyle": "none"}
    if limit.values.size or not isfinite(limit.predicted):
        bars = abs(scale) * limit.sd if isfinite(limit.sd) else None
        axis.errorbar(x, scale * limit.mean - 100.0, bars, **marked)
    draw_guess(axis, x + BESIDE_GUESS, scale * limit.predicted - 100.0, marked)


def _labelled(name: str) -> str:
    printed, mode = PAPER[name], "damped" if name.endswith("_on") else "undamped"
    unit = {"K": f"{printed:g} N/m", "B": f"{printed:g} N s/m", "M": f"{1e3 * printed:g} g"}[name[0]]
    return f"{name[0]} {name[2:5]}\n{mode}\n{unit}"


def edges_figure(result: ReproduceResult) -> Figure:
    """K limits over the lower band edge: what tells a lag in the force path from a high-pass in the
    probe.
    """
    seeds = f"; bars: one sd over {min(len(result.plan.seeds), EDGE_SEEDS)} seeds" if result.plan.seeds else ", predicted"
    title = f"K limits over the lower band edge, SIMULATED{seeds}"
    figure, pair = axes(1, 2, WIDTH_IN, 3.8, title, sharex=True)
    unseen: Look = {"facecolor": "none", "edgecolor": "#bbbbbb", "hatch": "///", "linewidth": 0}
    pair[1].set(yscale="log")
    for axis, level, words in zip(pair, LEVELS, WORDS, strict=True):
        for place, device in enumerate(result.plan.devices):
            limits = [each for each in result.edges if (each.device, each.level) == (device, level)]
            _over_edges(axis, limits, DEVICES[place])
        printed = PAPER["K_max_on" if level else "K_max_off"]
        axis.axhline(printed, color=BLACK, linewidth=0.8, label="the paper, its band is not stated")
        axis.axvspan(0.8, WINDOW_HZ, label="below the reach of the window", **unseen)
        axis.set(xscale="log", xlim=(0.8, 12.5), xlabel="lower edge of the judged band (Hz)", title=words)
        plain_axis(axis.xaxis, ((1.0, 2.0, 3.0, 5.0),))
    pair[0].set(ylim=(0, None), ylabel="largest passive K on its axis (N/m)")
    pair[1].set(ylim=(250, 4000))
    plain_axis(pair[1].yaxis, FINE[1:])
    figure.legend(*pair[1].get_legend_handles_labels(), ncols=3, **BELOW)
    return figure


def _over_edges(axis: Axes, limits: Sequence[Limit], look: Look) -> None:
    device, means = limits[0].device, [limit.mean for limit in limits]
    if not any(means):
        axis.plot([], [], label=device, **look)
        axis.text(0.97, 0.04, f"{device}: none is passive", fontsize=SMALL_PT, ha="right", transform=axis.transAxes)
        return
    bars = [limit.sd for limit in limits] if isfinite(limits[0].sd) else None
    axis.errorbar(EDGES_HZ, means, bars, label=device, **look)


# --- the set on the paper's grid -------------------------------------------------------------------------------------------------


def passive_figure(found: Found, title: str) -> Figure:
    """The set in space, and the largest K over B and M."""
    count = int(found.passive.sum())
    how = f"{found.undecided} not certain at 95 %, {found.flown} trials" if found.flown else "predicted"
    whole = f"{title}\nSIMULATED {MAIN}, {count} of {len(POINTS)} environments ({how})"
    figure = sheet(WIDTH_IN, 4.1, whole, layout=None)
    space: Any = figure.add_axes((-0.02, 0.0, 0.49, 0.86), projection="3d")
    flat = figure.add_axes((0.575, 0.13, 0.3, 0.6))
    colours = _stiffness_colours()
    _space(space, found, colours)
    bar = figure.colorbar(_flat(flat, found, colours), cax=figure.add_axes((0.89, 0.13, 0.018, 0.6)), ticks=AXES[0])
    bar.set_label("K (N/m)")
    bar.ax.tick_params(labelsize=SMALL_PT)
    bar.ax.minorticks_off()
    return figure


def _space(axis: Any, found: Found, colours: dict[str, Any]) -> None:
    k, b, m = (AXES[each][index] for each, index in enumerate(np.nonzero(found.passive)))
    order = np.argsort(b)[::-1]
    axis.scatter(1e3 * m[order], b[order], k[order], c=k[order], s=5, depthshade=False, linewidths=0, **colours)
    axis.set_xlabel("M (g)", labelpad=-4)
    axis.set_ylabel("B (N s/m)", labelpad=-4)
    axis.set_zlabel("K (N/m)", labelpad=4)
    axis.set(xlim=(-24, 30), ylim=(0, 9), zlim=(0, 1000), xticks=(-20, 0, 20), yticks=(0, 3, 6, 9), zticks=(0, 500, 1000))
    axis.tick_params(labelsize=SMALL_PT, pad=-2)
    axis.tick_params(axis="z", pad=1)
    axis.view_init(elev=20, azim=-60)
    axis.set_box_aspect((1.0, 1.0, 1.15), zoom=0.98)


def _flat(axis: Axes, found: Found, colours: dict[str, Any]) -> Any:
    """The largest passive K, and where the single trials lie."""
    stiffness = np.where(found.passive, AXES[0][:, None, None], -1.0).max(axis=0)
    shown = np.ma.masked_less(stiffness, 0.0)
    painted = axis.pcolormesh(1e3 * AXES[2], AXES[1], shown, edgecolors="white", linewidth=0.4, **colours)
    for (_, b, m), sign, words in TRIALS:
        size = 6 if sign == "D" else 10
        axis.plot(1e3 * m, b, sign, color="white", markeredgecolor="black", markersize=size, label=words)
    axis.set(
        xlabel="virtual mass M (g)", ylabel="virtual damping B (N s/m)", ylim=(-0.25, 11.3), yticks=range(0, 10, 2),
        title=f"Largest passive K at each B and M.\n{_cut(found)}",
    )  # fmt: skip
    axis.grid(visible=False)
    axis.legend(loc="upper left", handletextpad=0.3)
    return painted


def _cut(found: Found) -> str:
    """Where the grid ends and the set does not; K and B end at 0 by definition."""
    ends = {"K max": f"K = {AXES[0][-1]:g} N/m", "B max": f"B = {AXES[1][-1]:g} N s/m"}
    ends |= {"M max": f"M = {1e3 * AXES[2][-1]:g} g", "M min": f"M = {1e3 * AXES[2][0]:g} g"}
    cut = [ends[end] for end in open_ends(passive_set(AXES, np.where(found.passive, 1.0, -1.0))) if end in ends]
    return f"The grid cuts the set at\n{', '.join(cut)}" if cut else "The grid reaches beyond the set"


def _stiffness_colours() -> dict[str, Any]:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm

    middle = 0.5 * (AXES[0][1:] + AXES[0][:-1])
    colours = colormaps["viridis"].resampled(len(AXES[0]))
    return {"cmap": colours, "norm": BoundaryNorm(np.concatenate(([-12.5], middle, [1100.0])), colours.N)}


def _ends(axis: Axes) -> None:
    """Axes of |Z| over the frequencies of all trials here."""
    f = shown_hz()
    hertz_axis(axis, float(f[0]), float(f[-1]))
    plain_axis(axis.yaxis)


def _by_trials(axis: Axes, x: float, runs: Floats, scale: float = 1.0, look: Look = DISC, label: str | None = BY_TRIALS) -> None:
    """The mean of `runs` (seeds,), times `scale`, with its interval; nothing without trials."""
    if len(runs):
        mean, sd = mean_sd(runs)
        marked = {
            "marker": "o",
            "zorder": 3,
            "markerfacecolor": look["color"],
            **MARKS,
            **{k: look[k] for k in ("marker",) if k in look},
        }
        axis.errorbar(x, scale * mean, abs(of_mean(len(runs)) * scale * sd), label=label, **marked)


# --- future work, over frequency -------------------------------------------------------------------------------------------------


def edge_figure(result: BeyondResult) -> Figure:
    """Envelopes undamped, damped and with B < 0: by the paper's rule, and without counting on
    friction.
    """
    title = f"Negative virtual damping and the lower edge of the Z-width\n{_how(result)}"
    figure, grid = axes(4, 2, WIDTH_IN, 5.9, title, sharex=True, sharey="row", height_ratios=[3.4, 0.3, 0.3, 0.3])
    kinds = (("", "passive at the perturbation of the trials"), ("_safe", "passive without counting on dry friction"))
    for column, (kind, words) in enumerate(kinds):
        bounds = [result.envelopes[f"{name}{kind}"] for name, _, _ in CASES]
        size, *strips = grid[column::2]
        _lines(size, bounds, [(look, label) for _, look, label in CASES], len(result.plan.seeds))
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


def _lines(axis: Axes, bounds: Sequence[Bounds], looks: Sequence[tuple[Look, str]], seeds: int) -> None:
    """Edges with their intervals, the lower one heavier, and the lower one predicted where there were trials."""
    axis.set_yscale("log")
    for found, (look, words) in zip(bounds, looks, strict=True):
        for edge, width, label in ((found.lower, 1.8, words), (found.upper, 0.8, None)):
            banded(axis, found.frequency_hz, edge.value, of_mean(seeds) * edge.sd, {**look, "linewidth": width}, label)
        if found.flown:
            axis.plot(found.frequency_hz, found.predicted_lower, **{**PREDICTED, "color": look["color"]})


def free_figure(result: BeyondResult) -> Figure:
    """|Z| of the device that renders no stiffness, for each way of making it lighter."""
    title = f"Free motion: passive for any input, friction not counted\n{_how(result)}"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.4, title)
    axis.set_yscale("log")
    for motion, look in zip(result.free.motions, (OFF, ON, NEGATIVE, WITH_MASS), strict=True):
        _motion(axis, motion, look)
    bracket = mark(f"{BAND}: mean, dB re 1 N s/m", color=BLACK, marker="|", markersize=7, linewidth=1.0)
    _ends(axis)
    averaged(axis, LOW_HZ)
    axis.set_ylabel("|Z| at the probe, K = 0 (N s/m)")
    handles = [*handles_of(axis), mark("predicted", **PREDICTED), bracket]
    figure.legend(handles=handles, ncols=2, **BELOW)
    return figure


def _motion(axis: Axes, motion: Motion, look: Look) -> None:
    added = f"{motion.level:g} N s/m added" if motion.level else "no added damping"
    rendered = f", B = {motion.damping:.2f} N s/m" if motion.damping else ""
    rendered += f", M = {1e3 * motion.mass_kg:.1f} g" if motion.mass_kg else ""
    logs = np.log(motion.runs if len(motion.runs) else motion.predicted[None])
    spread = of_mean(len(logs)) * logs.std(axis=0, ddof=1) if len(logs) > 1 else np.zeros(logs.shape[1])
    label = f"{added}{rendered}: {motion.low_db().mean():.1f} dB"
    banded(axis, shown_hz(), np.exp(logs.mean(axis=0)), spread, look, label)
    if len(motion.runs):
        axis.plot(shown_hz(), motion.predicted, **{**PREDICTED, "color": look["color"]})


# --- future work, over a corner and over a level ---------------------------------------------------------------------------------


def shape_figure(result: BeyondResult) -> Figure:
    """What a corner in the damping circuit does to the limits, to free motion, and to the envelope."""
    shaped = result.shaped
    title = f"Frequency-shaped added damping, {shaped.level:g} N s/m\n{_how(result, 'lines predicted, marks ')}"
    figure, (above, below, free, size) = axes(2, 2, WIDTH_IN, 5.6, title)
    _shares(above, shaped, shaped.highpass, "damping above the corner only")
    _shares(below, shaped, shaped.lowpass, "damping below the corner only")
    for each in shaped.confirmed:
        scale = 100.0 / shaped.plain.limits[each.axis]
        _by_trials(above, shaped.best.hertz, each.values, scale, LIMITS[each.axis][-1], None)
    above.set_ylabel("limit (% of unshaped)")
    _free(free, shaped)
    looks = ((OFF, "none"), (ON, "unshaped"), (ALONE, f"above {shaped.best.hertz:g} Hz"))
    _lines(size, [result.envelopes["off"], result.envelopes["on"], shaped.bounds], looks, len(result.plan.seeds))
    size.set(ylabel="envelope, B ≥ 0 (N s/m)", ylim=(0.003, None))
    _ends(size)
    size.legend(loc="lower left", title="added damping")
    undamped = mark("without damping", color=BLACK, linestyle=OFF["linestyle"])
    figure.legend(handles=[*handles_of(above), undamped], ncols=4, **BELOW)
    return figure


def _shares(axis: Axes, shaped: Shaped, corners: tuple[Corner, ...], words: str) -> None:
    """Limits in percent of those without a corner; dashed those without damping."""
    at = [corner.hertz for corner in corners]
    for place, (name, _, _, look) in enumerate(LIMITS):
        scale = 100.0 / shaped.plain.limits[place]
        axis.plot(at, [scale * corner.limits[place] for corner in corners], label=name, **look)
        axis.axhline(scale * shaped.undamped.limits[place], color=look["color"], linestyle=OFF["linestyle"])
    axis.axhline(100.0, color=BLACK, linewidth=0.8)
    hertz_axis(axis, at[0] / 1.15, at[-1] * 1.15)
    axis.set(ylim=(0.0, 118.0), xlabel="corner (Hz)", title=words)


def _free(axis: Axes, shaped: Shaped) -> None:
    for corners, sign, words in ((shaped.highpass, "o", "damping above it"), (shaped.lowpass, "x", "damping below it")):
        axis.plot(
            [each.hertz for each in corners],
            [each.free_db for each in corners],
            marker=sign,
            color=BLUE,
            linewidth=0.9,
            label=words,
        )
    axis.axhline(shaped.plain.free_db, color=BLUE, linewidth=0.8)
    axis.axhline(shaped.undamped.free_db, linewidth=1.0, **OFF)
    for level, words, colour in ((shaped.plain.free_db, "unshaped", BLUE), (shaped.undamped.free_db, "without damping", RED)):
        axis.text(0.45, level + 0.3, words, fontsize=SMALL_PT, color=colour)
    if len(shaped.free.runs):
        _by_trials(axis, shaped.best.hertz, shaped.free.low_db())
    hertz_axis(axis, *CORNERS_HZ)
    axis.set(xlabel="corner (Hz)", ylabel="free motion (dB re 1 N s/m)", ylim=(-2.0, None), xticks=[0.5, 2, 10, 50, 200])
    axis.legend(loc="lower left")


def levels_figure(result: BeyondResult) -> Figure:
    """Limits, volume and free motion over the level of added damping."""
    levels = result.levels
    how = _how(result, "lines predicted, marks ")
    figure, grid = axes(2, 2, WIDTH_IN, 5.4, f"Levels of added damping; the two upright lines are those of the paper\n{how}")
    for axis, (panel, (name, unit, scale, look)) in enumerate(zip(grid, LIMITS, strict=False)):
        panel.plot(levels.level, scale * levels.limits[:, axis], color=look["color"], marker=".", label="predicted")
        for count, each in enumerate(limit for limit in levels.confirmed if limit.axis == axis):
            _by_trials(panel, each.level, each.values, scale, label=None if count else BY_TRIALS)
        panel.set_ylabel(f"{name} ({unit})")
    _volume(grid[3], result)
    for panel in grid:
        for level in LEVELS:
            panel.axvline(level, color="#bbbbbb", linewidth=1.0, zorder=0.4)
        panel.set_xlabel("added damping (N s/m)")
    grid[0].legend(loc="upper left")
    return figure


def _volume(axis: Axes, result: BeyondResult) -> None:
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
