"""The paper's figures, drawn from our results.

    Fig. 2                passive_set.walls_figure of `report`: stiffest walls that come to rest
    Figs. 3, 8 and 11     envelope_figure: envelopes without and with active damping, and both
    Figs. 4 and 7         single_figure: |Z| and phase of single trials
    Figs. 9 and 10        passive_figure: the passive set on the paper's grid
    limits                limits_figure: the six limits compared with the paper's (ours)
    band_edge             edges_figure: K limits over the lower edge of the judged band (ours)

`page` gives each its number, caption and file name. Envelopes and impedances are drawn like those
of every device (`zwidth.report.envelope`, `zwidth.report.trial`), with the paper's titles. Colours
and line styles are those of `zwidth.report.style`; all figures are drawn within `styled`. A bracket
at the bottom spans the frequencies of an average.

Envelopes must be compared on axes of one range; IMPEDANCE_RANGE is one for all of them.
"""

from math import isnan
from typing import Any

import numpy as np

from examples.weir2008.paper import FIG_4, FIG_7, LEVELS, MAIN, MODES, NAMES, PAPER
from examples.weir2008.rows import MIDDLE_HZ, TOLERANCE, compared, predicted
from examples.weir2008.run import (
    AXES,
    EDGE_SEEDS,
    EDGES_HZ,
    POINTS,
    SECONDS,
    SMOOTHED,
    WINDOW_HZ,
    GridResult,
    Peak,
    ReproduceResult,
)
from hapticd.zwidth.passive_set import PassiveSet
from hapticd.zwidth.report.envelope import SHOWN_HZ, Drawn, envelopes_figure
from hapticd.zwidth.report.paper import legends
from hapticd.zwidth.report.passive_set import draw_predicted
from hapticd.zwidth.report.style import (
    DEVICES,
    FINE,
    HOLLOW,
    NORMAL,
    PREDICTED,
    WIDTH_IN,
    Axes,
    Colour,
    Figure,
    Look,
    axes,
    hertz_axis,
    legend_handles,
    level_label,
    level_styles,
    mosaic,
    plain_axis,
    simulated,
)
from hapticd.zwidth.report.trial import draw, dress, interval

STYLES = tuple(level_styles(LEVELS))
LABELS = tuple(level_label(level) for level in LEVELS)
TRUSTED_HZ = (2.0, 500.0)  # not judged outside
IMPEDANCE_RANGE = (0.08, 200.0)  # |Z| in N s/m, the same for all compared envelopes
TICKS = (-100, -50, -20, -8, 0, 8, 20, 50, 100, 500)  # %
# positions of marks, in distances between two limits
BESIDE = 0.24
BESIDE_GUESS = 0.08
TRIALS = ((FIG_4, "*", "Fig. 4: K = 100 N/m"), (FIG_7, "D", "Fig. 7: K = 50 N/m"))
COLOURED: Look = {
    "cmap": "viridis",
    "vmin": 0,
    "vmax": len(AXES[0]) - 1,
}  # by the index of K on the grid
COLOURED_IN = 2.2  # of a panel and its colour bar
SPACE = {"space": {"projection": "3d"}}
PREDICTED_HZ = np.geomspace(*SHOWN_HZ, 400)


def _subtitle(result: ReproduceResult) -> str:
    """Return the line below a title: the device, and the method."""
    return simulated(MAIN, SECONDS if result.plan.seeds else 0.0)


# --- impedances and envelopes ---------------------------------------------------------------------


def single_figure(
    result: ReproduceResult,
    places: tuple[int, ...],
    title: str,
    width_mm: float | None = None,
) -> Figure:
    """Draw |Z| and phase of single trials of the first seed, with the prediction dotted.

    Without a trial only the prediction is drawn. For two places, also the phase advantage of the
    second over the first.
    """
    panels: Look = {"width_mm": width_mm, "sharex": True, "height_ratios": (3.0, 2.4)}
    whole = f"{title}\n{_subtitle(result)}"
    figure, (size, phase) = axes(2, 1, WIDTH_IN, 5.8, whole, **panels)
    shown = [result.singles[MAIN][place] for place in places]
    hertz_axis(phase, *SHOWN_HZ)
    known = []
    for single in shown:
        look = STYLES[single.level > 0.0]
        words = LABELS[single.level > 0.0]
        trial = single.shown
        guess = (look, f"{words}, predicted") if trial is None else (PREDICTED, "predicted")
        if trial is not None:
            z = (trial.frequency_hz, trial.impedance_ns_per_m)
            draw((size, phase), *z, look, words, NORMAL * trial.relative_sd)
            known = [interval(look)]
        draw((size, phase), PREDICTED_HZ, predicted(single, MAIN, PREDICTED_HZ), *guess)
    if len(shown) == 2:
        _advantage(phase, float(compared(shown[0], shown[1], MAIN).mean(axis=0)[1]))
    grey = dress(size, phase, TRUSTED_HZ, where=" at the probe")
    handles = [*legend_handles(size), *known, grey]
    legends(figure, (), 1, "", (size, handles, {"loc": "upper left"}))
    return figure


def _advantage(phase: Axes, degrees: float) -> None:
    draw_bracket(phase, MIDDLE_HZ, 0.14)
    words = f"{degrees:.0f} degrees\nfarther\nfrom +90"
    phase.text(
        float(np.sqrt(MIDDLE_HZ[0] * MIDDLE_HZ[1])),
        -45.0,
        words,
        fontsize="small",
        ha="center",
        va="center",
    )


def envelope_figure(
    result: ReproduceResult,
    places: tuple[int, ...],
    title: str,
    width_mm: float | None = None,
) -> Figure:
    """Draw |Z| and phase envelopes of damping levels, with the owners' strips; for active damping
    alone with the paper's peak.
    """
    shown = [drawn(result, place) for place in places]
    whole = f"{title}\n{_subtitle(result)}"
    figure = envelopes_figure(shown, whole, SHOWN_HZ, TRUSTED_HZ, width_mm=width_mm)
    peak = result.found[1].peak() if places == (1,) else None
    if peak is not None:
        _peak(figure.axes[0], peak)
    figure.axes[0].set_ylim(*IMPEDANCE_RANGE)
    plain_axis(figure.axes[0].yaxis, FINE)
    return figure


def drawn(result: ReproduceResult, place: int) -> Drawn:
    """Return the envelope of one damping level, 0 or 1, with its prediction if it was made by
    trials.
    """
    found = result.found[place]
    predicted = result.predicted[MAIN][place]
    guess = predicted.envelope if predicted is not None and found.trials else None
    return Drawn(
        found.envelope,
        found.environments,
        STYLES[place],
        LABELS[place],
        guess,
        SMOOTHED if found.trials else 1,
    )


def _peak(axis: Axes, peak: Peak) -> None:
    _, _, mass_kg = peak.owner
    axis.annotate(
        f"{peak.frequency_hz:.0f} Hz: M = {1e3 * mass_kg:g} g\n(paper: near 100 Hz)",
        (peak.frequency_hz, peak.size_ns_per_m),
        (peak.frequency_hz, 2.6 * peak.size_ns_per_m),
        ha="center",
        fontsize="small",
        arrowprops={"arrowstyle": "-|>", "color": Colour.BLACK, "linewidth": 0.8},
    )


def draw_bracket(axis: Axes, band_hz: tuple[float, float], height: float = 0.03) -> None:
    """Draw a bracket at a share of the axes' height under the averaged frequencies, as far as their
    range shows them.
    """
    low, high = axis.get_xlim()
    ends = max(low, band_hz[0]), min(high, band_hz[1])
    bracket: Look = {"color": Colour.BLACK, "linewidth": 1.0, "marker": "|", "markersize": 7}
    axis.plot(
        ends, (height, height), transform=axis.get_xaxis_transform(), clip_on=False, **bracket
    )


# --- limits ---------------------------------------------------------------------------------------


def limits_figure(result: ReproduceResult, width_mm: float | None = None) -> Figure:
    """Draw our limits relative to the paper's in percent, for each limit and device, with the
    scatter between seeds. A full mark at -100 % means that nothing is passive.
    """
    seeds = (
        f"bars: one sd over {len(result.plan.seeds)} seeds" if result.plan.seeds else "predicted"
    )
    title = f"Axis limits and those of the paper, SIMULATED; {seeds}"
    figure, (axis,) = axes(1, 1, WIDTH_IN, 4.1, title, width_mm=width_mm)
    names = list(PAPER)
    percent = 100.0 * TOLERANCE
    axis.axhspan(-percent, percent, color="#e4e4e4", zorder=0.4, label=f"±{percent:g} %")
    axis.axhline(0.0, color=Colour.BLACK, linewidth=0.8)
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
        known = np.array([one.values.size > 0 or isnan(one.predicted) for one in limits])
        axis.errorbar(x, np.where(known, ours - 100.0, np.nan), abs(sd), label=device, **marked)
        draw_predicted(axis, x + BESIDE_GUESS, guess - 100.0, marked)
    axis.plot([], [], "o", color=Colour.BLACK, label="predicted (hollow)", **HOLLOW)
    axis.set_yscale("symlog", linthresh=20.0)
    axis.set_yticks(TICKS, [f"{tick:+d}" if tick else "0" for tick in TICKS])
    axis.set_xticks(range(len(names)), [_labelled(name) for name in names], fontsize="small")
    axis.set(ylim=(-160, 800), ylabel="difference from the paper (%)")
    axis.minorticks_off()
    legends(figure, legend_handles(axis), 5)
    return figure


def _labelled(name: str) -> str:
    scale, unit = {"K": (1.0, "N/m"), "B": (1.0, "N s/m"), "M": (1e3, "g")}[name[0]]
    mode = "with" if name.endswith("_on") else "without"
    return f"{name[0]} {name[2:5]}\n{mode}\nactive\ndamping\n{scale * PAPER[name]:g} {unit}"


def edges_figure(result: ReproduceResult, width_mm: float | None = None) -> Figure:
    """Draw K limits over the lower edge of the judged band, 0 if none is passive. They separate a
    lag in the force path from a high-pass in the probe.
    """
    seeds = (
        f"; bars: one sd over {min(len(result.plan.seeds), EDGE_SEEDS)} seeds"
        if result.plan.seeds
        else ", predicted"
    )
    title = f"K limits over the lower band edge, SIMULATED{seeds}"
    figure, pair = axes(1, 2, WIDTH_IN, 3.8, title, width_mm=width_mm, sharex=True)
    unseen: Look = {"facecolor": "none", "edgecolor": "#bbbbbb", "hatch": "///", "linewidth": 0}
    pair[1].set(yscale="log")
    for axis, level, words in zip(pair, LEVELS, LABELS, strict=True):
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
        axis.axhline(
            printed, color=Colour.BLACK, linewidth=0.8, label="the paper, its band is not stated"
        )
        axis.axvspan(0.8, WINDOW_HZ, label="below the reach of the window", **unseen)
        axis.set(
            xscale="log", xlim=(0.8, 12.5), xlabel="lower edge of the judged band (Hz)", title=words
        )
        plain_axis(axis.xaxis, ((1.0, 2.0, 3.0, 5.0),))
    pair[0].set(ylim=(-15, None), ylabel="largest passive K on its axis (N/m)")
    pair[1].set(ylim=(250, 4000))
    plain_axis(pair[1].yaxis, FINE[1:])
    legends(figure, legend_handles(pair[1]), 3)
    return figure


# --- the set on the paper's grid ------------------------------------------------------------------


def passive_figure(found: GridResult, title: str, width_mm: float | None = None) -> Figure:
    """Draw the passive set in three dimensions, and the largest K over B and M as a colour."""
    count = int(found.passive.sum())
    how = (
        f"{found.undecided} not certain at 95 %, {found.trials} trials"
        if found.trials
        else "predicted"
    )
    whole = f"{title}\nSIMULATED {MAIN}, {count} of {len(POINTS)} environments ({how})"
    figure, panels = mosaic(
        [["space", "flat"]],
        WIDTH_IN,
        4.1,
        whole,
        width_mm,
        panel_in=COLOURED_IN,
        per_subplot_kw=SPACE,
    )
    _space(panels["space"], found)
    painted = _flat(panels["flat"], found)
    bar = figure.colorbar(painted, ax=panels["flat"], label="K (N/m)", aspect=30)
    bar.set_ticks(range(len(AXES[0])), labels=[f"{k:g}" for k in AXES[0]], fontsize="small")
    bar.ax.minorticks_off()
    return figure


def _space(axis: Any, found: GridResult) -> None:
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
    axis.set_title("K (N/m) upwards")  # a label next to the axis would lie on the next panel's
    axis.tick_params(labelsize="small", pad=-2)
    axis.tick_params(axis="z", pad=1)
    axis.view_init(elev=20, azim=-60)
    axis.set_box_aspect((1.0, 1.0, 1.15), zoom=0.85)


def _flat(axis: Axes, found: GridResult) -> Any:
    """Draw the largest passive K, and the places of the single trials; return the ends at which the
    grid is smaller than the set. K and B end at 0 by definition.
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
    ends = PassiveSet.of(AXES, np.where(found.passive, 1.0, -1.0)).open_ends()
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
