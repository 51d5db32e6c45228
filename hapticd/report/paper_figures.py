"""Figures of a run of `reproduce`: Figs. 3, 4 and 7-11 of the paper, its limits beside ours, and
K's over the lower band edge.

Envelopes and impedances are drawn as those of every device are (`envelope`, `trial`), with the
paper's titles; walls, Fig. 2, need nothing of their own (`passive_set`). All of them are drawn
within `styled`.
"""

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import open_ends
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predicted_impedance
from hapticd.measure.reproduce import ReproduceResult, Single
from hapticd.measure.reproduce_grid import AXES, CALMED, POINTS, Found, Peak
from hapticd.measure.reproduce_limits import NAMES, Limit
from hapticd.measure.reproduce_read import MIDDLE_HZ, compared
from hapticd.measure.reproduce_rows import FIG_4, FIG_7, PAPER, TOLERANCE
from hapticd.measure.reproduce_trials import EDGES_HZ, LEVELS, MAIN, SECONDS, WINDOW_HZ, subject
from hapticd.report.envelope import SHOWN_HZ, Drawn, envelopes_figure
from hapticd.report.style import (
    BELOW,
    BLACK,
    DEVICES,
    HOLLOW,
    NORMAL,
    PREDICTED,
    SMALL_PT,
    WIDTH_IN,
    averaged,
    axes,
    handles_of,
    hertz_axis,
    of_levels,
    sheet,
    simulated,
    words_of,
)  # fmt: skip
from hapticd.report.trial import Curve, draw, dress, interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOOKS = tuple(of_levels(LEVELS))
WORDS = tuple(words_of(level) for level in LEVELS)
TRUSTED_HZ = (2.0, 500.0)
SIZE_RANGE = (0.08, 200.0)  # N s/m, the same for all envelopes that are compared
TICKS = (-100, -50, -20, -8, 0, 8, 20, 50, 100, 500)  # %
BESIDE, BESIDE_GUESS = 0.24, 0.08  # of the distance between two limits
TRIALS = ((FIG_4, "*", "Fig. 4: K = 100 N/m"), (FIG_7, "D", "Fig. 7: K = 50 N/m"))


def _how(result: ReproduceResult) -> str:
    return simulated(MAIN, SECONDS if result.plan.seeds else 0.0)


# --- impedances and envelopes ----------------------------------------------------------------------------------------------------


def single_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
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


def _single(size: "Axes", phase: "Axes", single: Single) -> None:
    """As measured, dotted what is predicted; the prediction alone where nothing was flown."""
    look, words = LOOKS[single.level > 0.0], WORDS[single.level > 0.0]
    device, f, shown = subject(MAIN), np.geomspace(*SHOWN_HZ, 400), single.shown
    z = predicted_impedance(device.model, single.point, f, single.level, device.filters, Perturbation())
    if shown is None:
        draw(size, phase, Curve(f, z, look, f"{words}, predicted"))
        return
    draw(size, phase, Curve(shown.frequency_hz, shown.impedance_ns_per_m, look, words, NORMAL * shown.relative_sd))
    draw(size, phase, Curve(f, z, PREDICTED, "predicted"))


def _advantage(phase: "Axes", degrees: float) -> None:
    averaged(phase, MIDDLE_HZ, 0.14)
    words = f"{degrees:.0f} degrees\nfarther\nfrom +90"
    phase.text(float(np.sqrt(MIDDLE_HZ[0] * MIDDLE_HZ[1])), -45.0, words, fontsize=SMALL_PT, ha="center", va="center")


def envelope_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
    """|Z| and phase envelopes of damping levels, with the owners' strips; of added damping alone
    with the paper's peak.
    """
    shown = [drawn(result, place) for place in places]
    figure = envelopes_figure(shown, f"{title}\n{_how(result)}", SHOWN_HZ, TRUSTED_HZ)
    peak = result.found[1].peak() if places == (1,) else None
    if peak is not None:
        _peak(figure.axes[0], peak)
    figure.axes[0].set_ylim(*SIZE_RANGE)
    return figure


def drawn(result: ReproduceResult, place: int) -> Drawn:
    """The envelope of one damping level, 0 or 1, with its prediction where it was made by trials."""
    found, predicted = result.found[place], result.predicted[MAIN][place]
    guess = predicted.envelope if predicted is not None and found.flown else None
    return Drawn(found.envelope, found.environments, LOOKS[place], WORDS[place], guess, CALMED if found.flown else 1)


def _peak(axis: "Axes", peak: Peak) -> None:
    axis.annotate(
        f"{peak.frequency_hz:.0f} Hz: M = {1e3 * peak.owner[2]:g} g\n(paper: near 100 Hz)",
        (peak.frequency_hz, peak.size_ns_per_m), (peak.frequency_hz, 2.6 * peak.size_ns_per_m),
        ha="center", fontsize=SMALL_PT, arrowprops={"arrowstyle": "-|>", "color": BLACK, "linewidth": 0.8},
    )  # fmt: skip


# --- limits ----------------------------------------------------------------------------------------------------------------------


def limits_figure(result: ReproduceResult) -> "Figure":
    """Ours over the paper's, for each limit and device, with the scatter between seeds."""
    seeds = f"bars: one sd over {len(result.plan.seeds)} seeds" if result.plan.seeds else "predicted"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.1, f"Limits on their axes beside the paper's, SIMULATED; {seeds}")
    names, percent = list(PAPER), 100.0 * TOLERANCE
    for end in (-percent, percent):
        axis.axhline(end, color="#aaaaaa", linewidth=1.0, label=f"±{percent:g} %" if end > 0.0 else None)
    axis.axhline(0.0, color=BLACK, linewidth=0.8)
    for place, device in enumerate(result.plan.params.devices):
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


def _beside_paper(axis: "Axes", limit: Limit, x: float, printed: float, look: dict[str, Any]) -> None:
    """In percent of the paper's; a full mark at 0 where nothing is passive."""
    to_percent, marked = 100.0 / printed, {"linestyle": "none", **look}
    if limit.values.size:
        error = abs(to_percent) * limit.sd if isfinite(limit.sd) else 0.0
        axis.errorbar(x, to_percent * limit.mean - 100.0, error, **marked)
    if isfinite(limit.predicted):
        axis.plot(x + BESIDE_GUESS, to_percent * limit.predicted - 100.0, **marked, **HOLLOW)
    else:
        axis.plot(x, -100.0, **marked)


def _labelled(name: str) -> str:
    printed, mode = PAPER[name], "damped" if name.endswith("_on") else "undamped"
    unit = {"K": f"{printed:g} N/m", "B": f"{printed:g} N s/m", "M": f"{1e3 * printed:g} g"}[name[0]]
    return f"{name[0]} {name[2:5]}\n{mode}\n{unit}"


def edges_figure(result: ReproduceResult) -> "Figure":
    """K limits over the lower band edge: what tells a lag in the force path from a high-pass in the
    probe.
    """
    seeds = f"; bars: one sd over {len(next(iter(result.edges.values())))} seeds" if result.plan.seeds else ", predicted"
    title = f"K limits over the lower band edge, SIMULATED{seeds}"
    figure, pair = axes(1, 2, WIDTH_IN, 3.8, title, sharex=True)
    for axis, level, words in zip(pair, LEVELS, WORDS, strict=True):
        for place, device in enumerate(result.plan.params.devices):
            _over_edges(axis, np.nan_to_num(result.edges[device, level]), place, device)
        axis.axhline(
            PAPER["K_max_on" if level else "K_max_off"], color=BLACK, linewidth=0.8, label="the paper, its band is not stated"
        )
        unseen: dict[str, Any] = {"facecolor": "none", "edgecolor": "#bbbbbb", "hatch": "///", "linewidth": 0}
        axis.axvspan(0.8, WINDOW_HZ, label="below the reach of the window", **unseen)
        axis.set(xscale="log", xlim=(0.8, 12.5), xlabel="lower edge of the judged band (Hz)", title=words)
        axis.set_xticks(EDGES_HZ, [f"{edge:g}" for edge in EDGES_HZ])
    pair[0].set(ylim=(0, None), ylabel="largest passive K on its axis (N/m)")
    pair[1].set(ylim=(250, 4000), yscale="log")
    pair[1].set_yticks([300, 600, 1000, 2000, 3000], ["300", "600", "1000", "2000", "3000"])
    for axis in pair:
        axis.minorticks_off()
    figure.legend(*pair[1].get_legend_handles_labels(), ncols=3, **BELOW)
    return figure


def _over_edges(axis: "Axes", values: Floats, place: int, device: str) -> None:
    if not values.any():
        axis.plot([], [], label=device, **DEVICES[place])
        axis.text(0.97, 0.04, f"{device}: none is passive", fontsize=SMALL_PT, ha="right", transform=axis.transAxes)
        return
    sd = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(EDGES_HZ))
    axis.errorbar(EDGES_HZ, values.mean(axis=0), sd, label=device, **DEVICES[place])


# --- the set on the paper's grid -------------------------------------------------------------------------------------------------


def set_figure(found: Found, title: str) -> "Figure":
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


def _flat(axis: "Axes", found: Found, colours: dict[str, Any]) -> Any:
    """The largest passive K, and where the single trials lie."""
    stiffness = np.where(found.passive, AXES[0][:, None, None], -1.0).max(axis=0)
    shown = np.ma.masked_less(stiffness, 0.0)
    painted = axis.pcolormesh(1e3 * AXES[2], AXES[1], shown, edgecolors="white", linewidth=0.4, **colours)
    for (_, b, m), mark, words in TRIALS:
        axis.plot(1e3 * m, b, mark, color="white", markeredgecolor="black", markersize=6 if mark == "D" else 10, label=words)
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
    cut = [ends[end] for end in open_ends(found.as_set) if end in ends]
    return f"The grid cuts the set at\n{', '.join(cut)}" if cut else "The grid reaches beyond the set"


def _stiffness_colours() -> dict[str, Any]:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm

    middle = 0.5 * (AXES[0][1:] + AXES[0][:-1])
    colours = colormaps["viridis"].resampled(len(AXES[0]))
    return {"cmap": colours, "norm": BoundaryNorm(np.concatenate(([-12.5], middle, [1100.0])), colours.N)}
