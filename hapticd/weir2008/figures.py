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
from math import isnan
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.envelope import Edge
from hapticd.analysis.passive_set import open_ends, passive_set
from hapticd.report.envelope import SHOWN_HZ, Drawn, envelopes_figure, keys, strip, weightiest
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
    NORMAL,
    OFF,
    OLIVE,
    ON,
    PARTS,
    PREDICTED,
    PURPLE,
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
from hapticd.weir2008.future_work import (
    LOW_HZ,
    BeyondResult,
    Bounds,
    Corner,
    Motion,
    Shaped,
    mean_sd,
    shown_hz,
)
from hapticd.weir2008.paper import (
    ADDED_NS_PER_M,
    FIG_4,
    FIG_7,
    LEVELS,
    MAIN,
    MODES,
    NAMES,
    PAPER,
    TOLERANCE,
)
from hapticd.weir2008.run import (
    AXES,
    CALMED,
    EDGE_SEEDS,
    EDGES_HZ,
    POINTS,
    SECONDS,
    WINDOW_HZ,
    Found,
    Peak,
    ReproduceResult,
)
from hapticd.weir2008.table import MIDDLE_HZ, compared, predicted

LOOKS = tuple(of_levels(LEVELS))
WORDS = tuple(words_of(level) for level in LEVELS)
TRUSTED_HZ = (2.0, 500.0)
SIZE_RANGE = (0.08, 200.0)  # N s/m, the same for all envelopes that are compared
TICKS = (-100, -50, -20, -8, 0, 8, 20, 50, 100, 500)  # %
# of the distance between two limits
BESIDE = 0.24
BESIDE_GUESS = 0.08
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
COLOURED: Look = {
    "cmap": "viridis",
    "vmin": 0,
    "vmax": len(AXES[0]) - 1,
}  # by the place of K on the grid
PREDICTED_HZ = np.geomspace(*SHOWN_HZ, 400)
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


# --- impedances and envelopes ---------------------------------------------------------------------


def single_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> Figure:
    """|Z| and phase of single trials of the first seed, dotted what is predicted.

    The prediction stands alone where there was no trial; of two places, the phase that the second
    gains over the first.
    """
    figure, (size, phase) = axes(
        2, 1, WIDTH_IN, 5.8, f"{title}\n{_how(result)}", sharex=True, height_ratios=[3.0, 2.4]
    )
    shown = [result.singles[MAIN][place] for place in places]
    hertz_axis(phase, *SHOWN_HZ)
    known = []
    for single in shown:
        look = LOOKS[single.level > 0.0]
        words = WORDS[single.level > 0.0]
        trial = single.shown
        guess = (look, f"{words}, predicted") if trial is None else (PREDICTED, "predicted")
        if trial is not None:
            draw(
                size,
                phase,
                Curve(
                    trial.frequency_hz,
                    trial.impedance_ns_per_m,
                    look,
                    words,
                    NORMAL * trial.relative_sd,
                ),
            )
            known = [interval(look)]
        draw(size, phase, Curve(PREDICTED_HZ, predicted(single, MAIN, PREDICTED_HZ), *guess))
    if len(shown) == 2:
        _advantage(phase, float(compared(shown[0], shown[1], MAIN).mean(axis=0)[1]))
    grey = dress(size, phase, TRUSTED_HZ, where=" at the probe")
    size.legend(handles=[*handles_of(size), *known, grey], loc="upper left")
    return figure


def _advantage(phase: Axes, degrees: float) -> None:
    averaged(phase, MIDDLE_HZ, 0.14)
    words = f"{degrees:.0f} degrees\nfarther\nfrom +90"
    phase.text(
        float(np.sqrt(MIDDLE_HZ[0] * MIDDLE_HZ[1])),
        -45.0,
        words,
        fontsize=SMALL_PT,
        ha="center",
        va="center",
    )


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
    """The envelope of one damping level, 0 or 1, with its prediction where it was made by
    trials.
    """
    found = result.found[place]
    predicted = result.predicted[MAIN][place]
    guess = predicted.envelope if predicted is not None and found.flown else None
    return Drawn(
        found.envelope,
        found.environments,
        LOOKS[place],
        WORDS[place],
        guess,
        CALMED if found.flown else 1,
    )


def _peak(axis: Axes, peak: Peak) -> None:
    axis.annotate(
        f"{peak.frequency_hz:.0f} Hz: M = {1e3 * peak.owner[2]:g} g\n(paper: near 100 Hz)",
        (peak.frequency_hz, peak.size_ns_per_m),
        (peak.frequency_hz, 2.6 * peak.size_ns_per_m),
        ha="center",
        fontsize=SMALL_PT,
        arrowprops={"arrowstyle": "-|>", "color": BLACK, "linewidth": 0.8},
    )


# --- limits ---------------------------------------------------------------------------------------


def limits_figure(result: ReproduceResult) -> Figure:
    """Ours over the paper's in percent, for each limit and device, with the scatter between seeds;
    a full mark at -100 % where nothing is passive.
    """
    seeds = (
        f"bars: one sd over {len(result.plan.seeds)} seeds" if result.plan.seeds else "predicted"
    )
    figure, (axis,) = axes(
        1, 1, WIDTH_IN, 4.1, f"Limits on their axes beside the paper's, SIMULATED; {seeds}"
    )
    names = list(PAPER)
    percent = 100.0 * TOLERANCE
    axis.axhspan(-percent, percent, color="#e4e4e4", zorder=0.4, label=f"±{percent:g} %")
    axis.axhline(0.0, color=BLACK, linewidth=0.8)
    for place, device in enumerate(result.plan.devices):
        limits = [limit for limit in result.limits if limit.device == device]
        quantities = [f"{NAMES[limit.axis]}_{MODES[limit.level]}" for limit in limits]
        scale = 100.0 / np.array([PAPER[name] for name in quantities])
        ours, sd, guess = (
            scale * np.array([getattr(one, part) for one in limits])
            for part in ("mean", "sd", "predicted")
        )
        x = np.array([names.index(name) for name in quantities]) + BESIDE * (place - 1)
        marked = {**DEVICES[place], "linestyle": "none"}
        told = np.array([one.values.size > 0 or isnan(one.predicted) for one in limits])
        axis.errorbar(x, np.where(told, ours - 100.0, np.nan), abs(sd), label=device, **marked)
        draw_guess(axis, x + BESIDE_GUESS, guess - 100.0, marked)
    axis.plot([], [], "o", color=BLACK, label="predicted (hollow)", **HOLLOW)
    axis.set_yscale("symlog", linthresh=20.0)
    axis.set_yticks(TICKS, [f"{tick:+d}" if tick else "0" for tick in TICKS])
    axis.set_xticks(range(len(names)), [_labelled(name) for name in names])
    axis.set(ylim=(-160, 800), ylabel="difference from the paper (%)")
    axis.minorticks_off()
    figure.legend(ncols=5, handletextpad=0.4, columnspacing=1.2, **BELOW)
    return figure


def _labelled(name: str) -> str:
    printed = PAPER[name]
    mode = "damped" if name.endswith("_on") else "undamped"
    unit = {"K": f"{printed:g} N/m", "B": f"{printed:g} N s/m", "M": f"{1e3 * printed:g} g"}[
        name[0]
    ]
    return f"{name[0]} {name[2:5]}\n{mode}\n{unit}"


def edges_figure(result: ReproduceResult) -> Figure:
    """K limits over the lower band edge, 0 where none is passive: what tells a lag in the force
    path from a high-pass in the probe.
    """
    seeds = (
        f"; bars: one sd over {min(len(result.plan.seeds), EDGE_SEEDS)} seeds"
        if result.plan.seeds
        else ", predicted"
    )
    title = f"K limits over the lower band edge, SIMULATED{seeds}"
    figure, pair = axes(1, 2, WIDTH_IN, 3.8, title, sharex=True)
    unseen: Look = {"facecolor": "none", "edgecolor": "#bbbbbb", "hatch": "///", "linewidth": 0}
    pair[1].set(yscale="log")
    for axis, level, words in zip(pair, LEVELS, WORDS, strict=True):
        for device, look in zip(result.plan.devices, DEVICES, strict=False):
            limits = [each for each in result.edges if (each.device, each.level) == (device, level)]
            axis.errorbar(
                EDGES_HZ,
                [each.mean for each in limits],
                [each.sd for each in limits],
                label=device,
                **look,
            )
        printed = PAPER["K_max_on" if level else "K_max_off"]
        axis.axhline(printed, color=BLACK, linewidth=0.8, label="the paper, its band is not stated")
        axis.axvspan(0.8, WINDOW_HZ, label="below the reach of the window", **unseen)
        axis.set(
            xscale="log", xlim=(0.8, 12.5), xlabel="lower edge of the judged band (Hz)", title=words
        )
        plain_axis(axis.xaxis, ((1.0, 2.0, 3.0, 5.0),))
    pair[0].set(ylim=(-15, None), ylabel="largest passive K on its axis (N/m)")
    pair[1].set(ylim=(250, 4000))
    plain_axis(pair[1].yaxis, FINE[1:])
    figure.legend(*pair[1].get_legend_handles_labels(), ncols=3, **BELOW)
    return figure


# --- the set on the paper's grid ------------------------------------------------------------------


def passive_figure(found: Found, title: str) -> Figure:
    """The set in space, and the largest K over B and M; a colour for each K of the grid."""
    count = int(found.passive.sum())
    how = (
        f"{found.undecided} not certain at 95 %, {found.flown} trials"
        if found.flown
        else "predicted"
    )
    whole = f"{title}\nSIMULATED {MAIN}, {count} of {len(POINTS)} environments ({how})"
    figure = sheet(WIDTH_IN, 4.1, whole, layout=None)
    _space(figure.add_axes((-0.02, 0.0, 0.49, 0.86), projection="3d"), found)
    painted = _flat(figure.add_axes((0.575, 0.13, 0.3, 0.6)), found)
    bar = figure.colorbar(painted, cax=figure.add_axes((0.89, 0.13, 0.018, 0.6)), label="K (N/m)")
    bar.set_ticks(range(len(AXES[0])), labels=[f"{k:g}" for k in AXES[0]], fontsize=SMALL_PT)
    bar.ax.minorticks_off()
    return figure


def _space(axis: Any, found: Found) -> None:
    rank, at_b, at_m = np.nonzero(found.passive)
    m_g = 1e3 * AXES[2][at_m]
    axis.scatter(
        m_g, AXES[1][at_b], AXES[0][rank], c=rank, s=5, depthshade=False, linewidths=0, **COLOURED
    )
    axis.set(
        xlim=(-24, 30),
        ylim=(0, 9),
        zlim=(0, 1000),
        xticks=(-20, 0, 20),
        yticks=(0, 3, 6, 9),
        zticks=(0, 500, 1000),
    )
    axis.set_xlabel("M (g)", labelpad=-4)
    axis.set_ylabel("B (N s/m)", labelpad=-4)
    axis.set_zlabel("K (N/m)", labelpad=4)
    axis.tick_params(labelsize=SMALL_PT, pad=-2)
    axis.tick_params(axis="z", pad=1)
    axis.view_init(elev=20, azim=-60)
    axis.set_box_aspect((1.0, 1.0, 1.15), zoom=0.95)


def _flat(axis: Axes, found: Found) -> Any:
    """The largest passive K, and where the single trials lie; the ends at which the grid is smaller
    than the set. K and B end at 0 by definition.
    """
    rank = np.where(found.passive, np.arange(len(AXES[0]))[:, None, None], -1).max(axis=0)
    shown = np.ma.masked_less(rank, 0)
    painted = axis.pcolormesh(
        1e3 * AXES[2], AXES[1], shown, edgecolors="white", linewidth=0.4, **COLOURED
    )
    for (_, b, m), sign, words in TRIALS:
        size = 6 if sign == "D" else 10
        axis.plot(
            1e3 * m, b, sign, color="white", markeredgecolor="black", markersize=size, label=words
        )
    ends = open_ends(passive_set(AXES, np.where(found.passive, 1.0, -1.0)))
    cut = ", ".join(end for end in ends if end not in ("K min", "B min"))
    reach = f"The grid cuts the set at\n{cut}" if cut else "The grid reaches beyond the set"
    axis.set(
        xlabel="virtual mass M (g)",
        ylabel="virtual damping B (N s/m)",
        ylim=(-0.25, 11.3),
        yticks=range(0, 10, 2),
        title=f"Largest passive K at each B and M.\n{reach}",
    )
    axis.grid(visible=False)
    axis.legend(loc="upper left", handletextpad=0.3)
    return painted


def _ends(axis: Axes) -> None:
    """Axes of |Z| over the frequencies of all trials here."""
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
    """The mean of each of `runs` (seeds,), times `scale`, with its interval at `x`; nothing
    without trials.
    """
    known = [mean_sd(each) for each in runs if len(each)]
    bars = [
        abs(scale) * of_mean(len(each)) * sd for each, (_, sd) in zip(runs, known, strict=False)
    ]
    if known:
        marked = {"markerfacecolor": look["color"], "zorder": 3, **look, "linestyle": ""}
        axis.errorbar(x, [scale * mean for mean, _ in known], bars, label=label, **marked)


# --- future work, over frequency ------------------------------------------------------------------


def edge_figure(result: BeyondResult) -> Figure:
    """Envelopes undamped, damped and with B < 0: by the paper's rule, and without counting on
    friction.
    """
    title = f"Negative virtual damping and the lower edge of the Z-width\n{_how(result)}"
    figure, grid = axes(
        4, 2, WIDTH_IN, 5.9, title, sharex=True, sharey="row", height_ratios=[3.4, 0.3, 0.3, 0.3]
    )
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
        averaged(size, LOW_HZ)
        for axis, found, (_, _, label) in zip(strips, bounds, CASES, strict=True):
            which = weightiest(shown_hz(), found.points[found.lower.owner])
            strip(
                axis, shown_hz(), [which], f"{label}: {found.lower_db().mean():+.1f} dB", columns=2
            )
        for axis in (size, *strips):
            axis.set_xlabel("frequency (Hz)" if axis is strips[-1] else "")
    grid[0].set_ylabel("|Z| at the probe (N s/m)")
    predicted = [mark("lower edge, predicted", **PREDICTED)] if result.plan.seeds else []
    grid[1].legend(
        handles=[*(mark(label, **look) for _, look, label in CASES), *predicted], loc="upper center"
    )
    foot = (
        f"strips: owner of the lower edge, weightiest part; its mean over {BAND} (bracket), dB re 1"
        " N s/m"
    )
    figure.legend(handles=keys(), ncols=6, title=foot, **BELOW)
    return figure


def _lines(
    axis: Axes, bounds: Sequence[Bounds], looks: Sequence[tuple[Look, str]], seeds: int
) -> None:
    """Both edges, the lower one heavier."""
    for found, (look, words) in zip(bounds, looks, strict=True):
        _line(
            axis,
            found.lower,
            found.predicted_lower if found.flown else None,
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
    """|Z| over `shown_hz()` with the interval of its mean over seeds; dotted what was predicted
    of it.
    """
    axis.set_yscale("log")
    banded(axis, shown_hz(), size.value, of_mean(seeds) * size.sd, look, words)
    if predicted is not None:
        axis.plot(shown_hz(), predicted, **{**PREDICTED, "color": look["color"]})


def free_figure(result: BeyondResult) -> Figure:
    """|Z| of the device that renders no stiffness, for each way of making it lighter."""
    title = f"Free motion: passive for any input, friction not counted\n{_how(result)}"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.4, title)
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
        f"{BAND}: mean, dB re 1 N s/m", color=BLACK, marker="|", markersize=7, linewidth=1.0
    )
    _ends(axis)
    averaged(axis, LOW_HZ)
    axis.set_ylabel("|Z| at the probe, K = 0 (N s/m)")
    figure.legend(
        handles=[*handles_of(axis), mark("predicted", **PREDICTED), bracket], ncols=2, **BELOW
    )
    return figure


def _rendered(motion: Motion) -> str:
    added = f"{motion.level:g} N s/m added" if motion.level else "no added damping"
    damping = f", B = {motion.damping:.2f} N s/m" if motion.damping else ""
    return added + damping + (f", M = {1e3 * motion.mass_kg:.1f} g" if motion.mass_kg else "")


# --- future work, over a corner and over a level --------------------------------------------------


def shape_figure(result: BeyondResult) -> Figure:
    """What a corner in the damping circuit does to the limits, to free motion, and to the
    envelope.
    """
    shaped = result.shaped
    title = (
        f"Frequency-shaped added damping, {shaped.level:g} N"
        f" s/m\n{_how(result, 'lines predicted, marks ')}"
    )
    figure, (above, below, free, size) = axes(2, 2, WIDTH_IN, 5.6, title)
    _shares(above, shaped, shaped.highpass, "damping above the corner only")
    _shares(below, shaped, shaped.lowpass, "damping below the corner only")
    for each in shaped.confirmed:
        scale = 100.0 / shaped.plain.limits[each.axis]
        _by_trials(above, shaped.best.hertz, [each.values], scale, LIMITS[each.axis][-1], None)
    above.set_ylabel("limit (% of unshaped)")
    _free(free, shaped)
    looks = ((OFF, "none"), (ON, "unshaped"), (ALONE, f"above {shaped.best.hertz:g} Hz"))
    _lines(
        size,
        [result.envelopes["off"], result.envelopes["on"], shaped.bounds],
        looks,
        len(result.plan.seeds),
    )
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
        axis.axhline(
            scale * shaped.undamped.limits[place], color=look["color"], linestyle=OFF["linestyle"]
        )
    axis.axhline(100.0, color=BLACK, linewidth=0.8)
    hertz_axis(axis, at[0] / 1.15, at[-1] * 1.15)
    axis.set(ylim=(0.0, 118.0), xlabel="corner (Hz)", title=words)


def _free(axis: Axes, shaped: Shaped) -> None:
    for corners, sign, words in (
        (shaped.highpass, "o", "damping above it"),
        (shaped.lowpass, "x", "damping below it"),
    ):
        free_db = [each.free_db for each in corners]
        axis.plot(
            [each.hertz for each in corners],
            free_db,
            marker=sign,
            color=BLUE,
            linewidth=0.9,
            label=words,
        )
    for level, words, look in (
        (shaped.plain.free_db, "unshaped", ON),
        (shaped.undamped.free_db, "without damping", OFF),
    ):
        axis.axhline(level, linewidth=0.9, **look)
        axis.text(0.45, level + 0.3, words, fontsize=SMALL_PT, color=look["color"])
    if len(shaped.free.runs):
        _by_trials(axis, shaped.best.hertz, [shaped.free.low_db()])
    hertz_axis(axis, *CORNERS_HZ)
    axis.set(
        xlabel="corner (Hz)",
        ylabel="free motion (dB re 1 N s/m)",
        ylim=(-2.0, None),
        xticks=[0.5, 2, 10, 50, 200],
    )
    axis.legend(loc="lower left")


def levels_figure(result: BeyondResult) -> Figure:
    """Limits, volume and free motion over the level of added damping."""
    levels = result.levels
    how = _how(result, "lines predicted, marks ")
    figure, grid = axes(
        2,
        2,
        WIDTH_IN,
        5.4,
        f"Levels of added damping; the two upright lines are those of the paper\n{how}",
    )
    for axis, (panel, (name, unit, scale, look)) in enumerate(zip(grid, LIMITS, strict=False)):
        panel.plot(
            levels.level,
            scale * levels.limits[:, axis],
            color=look["color"],
            marker=".",
            label="predicted",
        )
        flown = [limit for limit in levels.confirmed if limit.axis == axis]
        _by_trials(panel, [each.level for each in flown], [each.values for each in flown], scale)
        panel.set_ylabel(f"{name} ({unit})")
    _volume(grid[3], result)
    for panel in grid:
        for level in LEVELS:
            panel.axvline(level, color="#bbbbbb", linewidth=1.0, zorder=0.4)
        panel.set_xlabel("added damping (N s/m)")
    grid[0].legend(loc="upper left")
    return figure


def _volume(axis: Axes, result: BeyondResult) -> None:
    levels = result.levels
    beside = axis.twinx()
    growth = levels.volume / levels.volume[0]
    lines = axis.plot(
        levels.level, growth, color=BLACK, marker=".", label="volume of the set, predicted"
    )
    axis.set(yscale="log", ylim=(0.1, None), ylabel="passive set (undamped = 1)")
    plain_axis(axis.yaxis)
    lines += beside.plot(
        levels.level,
        levels.free_db,
        color=OLIVE,
        marker="x",
        label=f"free motion, mean |Z| in {BAND}",
    )
    beside.set(ylim=(-6.0, None))
    beside.set_ylabel("free motion (dB re 1 N s/m)", color=OLIVE)
    beside.grid(visible=False)
    beside.spines["right"].set_visible(True)
    axis.legend(handles=lines, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
