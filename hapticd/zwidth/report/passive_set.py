"""Figures of the passive set: its map in slices of one M, a directed search of it, its limits on
the axes, and virtual walls.

The set is drawn as the largest K over B, a line with a tinted area below it, dotted where it is
predicted. A slice of a search contains only the trials with an M close to its own, because the
boundary in K and B moves with M; the panel below has all trials.

A set drawn over another must have its rank: the first level, the smaller set, must be on top.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags, Floats, Integers
from hapticd.signal.verdict import Judged
from hapticd.zwidth.limits import AxisLimit, LimitsResult
from hapticd.zwidth.map import LevelMap, MapResult
from hapticd.zwidth.outcomes import Conditions
from hapticd.zwidth.passive_set import PassiveSet
from hapticd.zwidth.report.paper import legends, spread
from hapticd.zwidth.report.style import (
    ANSWERS,
    HOLLOW,
    LEVEL_MARKS,
    MARKS,
    PREDICTED,
    WIDTH_IN,
    Axes,
    Colour,
    Figure,
    Look,
    axes,
    legend_handles,
    level_label,
    level_styles,
    mark,
    mosaic,
    simulated,
    size_in,
    styled,
    tint,
)
from hapticd.zwidth.search import SearchResult, Step, slice_at
from hapticd.zwidth.walls import WallResult

__all__ = ["draw_predicted", "limits_figure", "search_figure", "set_figure", "walls_figure"]

PANELS = 6  # of a map, at most
COLUMNS = 3
ASIDE = 0.12  # of a step of B: distance of the marks of two levels at one point
SHARES = (0.0, 0.2, 0.5, 0.8, 1.0)  # of the set's masses: there is one slice between two of them
NEAR = 0.02  # of the range of masses: trials this close to a slice are shown in it
APART_IN = 0.17  # minimum distance of two numbers
AXIS_LABELS = {
    "K": ("largest K (N/m)", 1.0),
    "B": ("largest B (N s/m)", 1.0),
    "M": ("largest -M (g)", -1e3),
}
PSD_UNIT = 1e-5  # N^2/Hz
MOST_TICKS = 5
NARROWEST_IN = 6.0  # figure of the limits
ALONE: Look = {"color": Colour.BLACK, "linestyle": "-"}


def how(conditions: Conditions, ranges: Iterable[Judged]) -> str:
    """Return the line below a title, with the judged range."""
    judged = sorted({str(one) for one in ranges})
    return ", ".join((simulated(conditions.scene.device, conditions.seconds), *judged))


def area(
    axis: Axes, damping: Floats, stiffness: Floats, look: Look, rank: int = 0, **more: Any
) -> None:
    """Draw the largest K over B, tinted below; the first level, the smaller set, is on top."""
    low = 0.4 - 0.01 * rank
    axis.fill_between(damping, 0.0, stiffness, color=tint(look["color"]), linewidth=0, zorder=low)
    axis.plot(damping, stiffness, **{**look, **more})


def _closed(edge: Floats) -> Floats:
    """Return an edge (nB,) extended down to K = 0 where it ends."""
    known = ~np.isnan(edge)
    return np.where(~known & np.roll(known, 1), 0.0, edge)


# --- a map ----------------------------------------------------------------------------------------


@styled()
def set_figure(result: MapResult, width_mm: float | None = None) -> Figure:
    """Draw the largest passive K over B, a panel for each of up to six virtual masses, a line and
    marks for each damping level.

    M = 0, or the mass nearest to it, is among them. ConfigError without matplotlib.
    """
    mass = result.levels[0].found.axes[2]
    shown = slices(result)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    figure, places = axes(
        rows,
        columns,
        0.6 + 3.0 * columns,
        2.7 * rows + 1.2,
        "Passive set: the largest passive K at each"
        f" B\n{how(result.plan.params.conditions, [result.judged])}",
        width_mm=width_mm,
        sharex=True,
        sharey=True,
    )
    styles = level_styles([level.active_damping_ns_per_m for level in result.levels])
    for panel, place in zip(shown, places, strict=True):
        for turn, (level, look) in enumerate(zip(result.levels, styles, strict=True)):
            _plane(place, level, int(panel), look, turn, len(styles))
        place.set(title=f"M = {1e3 * mass[panel]:.3g} g", xlabel="B (N s/m)", ylabel="K (N/m)")
        place.label_outer()
    handles = [
        *(
            mark(level_label(level.active_damping_ns_per_m), **look)
            for level, look in zip(result.levels, styles, strict=True)
        ),
        mark("trial passes", marker=ANSWERS["passes"], **MARKS),
        mark("trial fails or escapes", marker=ANSWERS["fails"], **MARKS),
        mark("no trial: predicted, or between neighbours, to pass", marker="o", **MARKS, **HOLLOW),
    ]
    legends(figure, handles, 3)
    return figure


def slices(result: MapResult) -> Integers:
    """Return up to six indices on the axis of M, two rows or one: the nearest to 0 and others
    evenly apart, where an environment passes or was tried.
    """
    shapes = [level.found.margin.shape for level in result.levels]
    shown = [
        level.found.passive | level.tried.reshape(shape)
        for level, shape in zip(result.levels, shapes, strict=True)
    ]
    zero = int(np.argmin(np.abs(result.levels[0].found.axes[2])))
    places = np.union1d(np.flatnonzero(np.any(shown, axis=(0, 1, 2))), zero)
    count = max(count for count in (1, 2, COLUMNS, PANELS) if count <= len(places))
    chosen = places[np.linspace(0, len(places) - 1, count).round().astype(int)]
    chosen[np.abs(chosen - zero).argmin()] = zero
    return np.asarray(chosen)


def _plane(place: Axes, level: LevelMap, panel: int, look: Look, rank: int, count: int) -> None:
    """Draw one of `count` levels in one panel: passing, failing and only predicted points."""
    stiffness, damping, _ = level.found.axes
    passive, tried = (
        flags.reshape(level.found.margin.shape)[:, :, panel]
        for flags in (level.found.passive, level.tried)
    )
    aside = ASIDE * (damping[1] - damping[0]) * (rank - 0.5 * (count - 1))
    k, b = np.meshgrid(stiffness, damping + aside, indexing="ij")
    area(place, damping, highest(level.found, panel), look, rank)
    marks: Look = {**MARKS, "color": look["color"], "markersize": 4, "zorder": 3}
    for shown, kind in (
        (passive & tried, {"marker": ANSWERS["passes"]}),
        (~passive & tried, {"marker": ANSWERS["fails"]}),
        (passive & ~tried, {"marker": "o", **HOLLOW, "markersize": 3}),
    ):
        place.plot(b[shown], k[shown], **{**marks, **kind})


def highest(found: PassiveSet, panel: int) -> Floats:
    """Return the largest passive K [N/m] (nB,) of the grid at each damping; nan without one."""
    stiffness = found.axes[0]
    passive = found.passive[:, :, panel]
    return np.where(
        passive.any(axis=0), np.where(passive, stiffness[:, None], -np.inf).max(axis=0), np.nan
    )


# --- a directed search ----------------------------------------------------------------------------


@styled()
def search_figure(results: Sequence[SearchResult], width_mm: float | None = None) -> Figure:
    """Draw for each damping level a row of slices through the set, and below them the expected and
    measured minimum Re Z of each trial.
    """
    rows = [[f"{row} {panel}" for panel in range(len(SHARES) - 1)] for row in range(len(results))]
    below = [f"foreseen {row}" for row in range(len(results))]
    seen = (result.judged for result in results)
    title = (
        "Directed search: the set in slices of one M, and its"
        f" trials\n{how(results[0].plan.params.conditions, seen)}"
    )
    panels = spread([*rows, below])
    figure, places = mosaic(panels, 11.0, 3.1 * len(panels) + 1.3, title, width_mm)
    levels = [one.plan.params.active_damping_ns_per_m for one in results]
    styles = level_styles(levels)
    for row, foreseen, result, look in zip(rows, below, results, styles, strict=True):
        _slices([places[name] for name in row], result, look)
        _foreseen(places[foreseen], result, look)
    handles = [
        *(
            mark(f"edge found, {level_label(level)}", **look)
            for level, look in zip(levels, styles, strict=True)
        ),
        mark("edge predicted", **PREDICTED),
        mark("trial passes", marker=ANSWERS["passes"], **MARKS),
        mark("trial fails", marker=ANSWERS["fails"], **MARKS),
        mark(
            "trial escapes: the loop ran away, or its command filled the range",
            marker=ANSWERS["escapes"],
            **MARKS,
        ),
        mark("below: found, with its 95 % interval", marker="_", markersize=8, **MARKS),
        mark("below: expected before the trial", marker="o", **MARKS, **HOLLOW),
        mark(f"slices show trials within {100 * NEAR:g} % of the range of M", linestyle=""),
    ]
    legends(figure, handles, 3)
    return figure


def _slices(places: list[Axes], result: SearchResult, look: Look) -> None:
    mass = result.found.axes[2]
    passive = mass[
        result.found.passive.any(axis=(0, 1))
    ]  # K = B = M = 0 is passive, otherwise there is no search
    tried = np.array([step.outcome.environment for step in result.steps])
    reach = NEAR * float(passive[-1] - passive[0])
    level = f"{level_label(result.plan.params.active_damping_ns_per_m)}\n"
    cuts = [
        slice_at(result, value)
        for value in slice_masses(tried[:, 2], np.quantile(passive, SHARES), reach)
    ]
    top = max(np.nanmax((cut.held, cut.predicted)) for cut in cuts)
    for panel, (place, cut) in enumerate(zip(places, cuts, strict=True)):
        place.set(
            xlabel="B (N s/m)",
            xlim=(-0.02 * cut.virtual_damping[-1], cut.virtual_damping[-1]),
            ylim=(-0.02 * top, 1.15 * top),
        )
        area(place, cut.virtual_damping, _closed(cut.held), look)
        place.plot(cut.virtual_damping, _closed(cut.predicted), **PREDICTED)
        _trials(place, result.steps, np.abs(tried[:, 2] - cut.mass_kg) <= reach, look)
        place.set_title(f"{'' if panel else level}M = {1e3 * cut.mass_kg:.3g} g")
        place.tick_params(labelleft=panel == 0)
    places[0].set_ylabel("K (N/m)")


def slice_masses(tried: Floats, borders: Floats, reach: float) -> list[float]:
    """Return between any two borders the mass of the trial that has the most others within `reach`;
    the middle if none was tried.
    """
    chosen = []
    for low, high in pairwise(borders):
        here = tried[(tried >= low) & (tried <= high)]
        count = (np.abs(here[:, None] - tried) <= reach).sum(axis=1)
        chosen.append(float(here[np.argmax(count)] if here.size else 0.5 * (low + high)))
    return chosen


def _trials(place: Axes, steps: tuple[Step, ...], near: Flags, look: Look) -> None:
    """Draw the trials of this slice, with their numbers where there is room."""
    left, right = place.get_xlim()
    foot, head = place.get_ylim()
    wide_in, high_in = size_in(place)
    numbered: list[tuple[float, float]] = []
    for at in np.flatnonzero(near):
        k, b, _ = steps[at].outcome.environment
        place.plot(
            b,
            k,
            ANSWERS[_answer(steps[at])],
            color=look["color"],
            markersize=5,
            clip_on=False,
            zorder=3,
        )
        here = wide_in * (b - left) / (right - left), high_in * (k - foot) / (head - foot)
        if all(abs(here[0] - x) > APART_IN or abs(here[1] - y) > APART_IN for x, y in numbered):
            numbered.append(here)
            place.annotate(
                str(at + 1), (b, k), (4.0, 3.0), textcoords="offset points", fontsize="small"
            )


def _answer(step: Step) -> str:
    if step.outcome.passes:
        return "passes"
    return "escapes" if not step.teaches else "fails"


def _foreseen(place: Axes, result: SearchResult, look: Look) -> None:
    from matplotlib.ticker import MaxNLocator

    known = [(number, step) for number, step in enumerate(result.steps, start=1) if step.teaches]
    escaped = [number for number, step in enumerate(result.steps, start=1) if not step.teaches]
    at = [number for number, _ in known]
    found = np.array([step.outcome.margin_ns_per_m for _, step in known])
    reach = np.abs(
        np.array([(step.outcome.margin_lower, step.outcome.margin_upper) for _, step in known]).T
        - found
    )
    place.errorbar(
        at,
        found,
        np.nan_to_num(reach),
        fmt="_",
        markersize=7,
        color=look["color"],
        elinewidth=0.8,
        capsize=0,
    )
    place.plot(
        at,
        [step.expected_ns_per_m for _, step in known],
        **{**MARKS, **HOLLOW, "marker": "o", "markerfacecolor": "none"},
    )
    low, high = np.quantile(found, (0.05, 0.95))
    foot = min(-0.5, 1.6 * low)
    if escaped:
        place.plot(
            escaped,
            np.full(len(escaped), foot),
            ANSWERS["escapes"],
            color=look["color"],
            markersize=6,
            clip_on=False,
        )
    place.axhline(0.0, color=Colour.BLACK, linewidth=0.8)
    place.xaxis.set_major_locator(MaxNLocator(integer=True))
    place.set(
        xlabel="trial",
        ylabel="least Re Z (N s/m)",
        xlim=(0.0, len(result.steps) + 1.0),
        ylim=(foot, max(0.8, 1.4 * high)),
        title=(
            f"{level_label(result.plan.params.active_damping_ns_per_m)}: {len(escaped)} of"
            f" {len(result.steps)} trials escape"
        ),
    )


# --- limits on the axes ---------------------------------------------------------------------------


@styled()
def limits_figure(result: LimitsResult, width_mm: float | None = None) -> Figure:
    """Draw axis limits over active damping, or over the perturbation if several amplitudes were
    scanned.
    """
    params = result.plan.params
    many = len(params.amplitudes) > 1
    groups, styles = (
        (params.levels, level_styles(params.levels)) if many else ((params.amplitudes[0],), [ALONE])
    )
    figure, places = axes(
        1,
        len(params.axes),
        max(NARROWEST_IN, 3.2 * len(params.axes)),
        4.2,
        "Axis limits, the other two being"
        f" 0\n{how(params.conditions, (limit.judged for limit in result.limits))}",
        width_mm=width_mm,
    )
    for place, axis in zip(places, params.axes, strict=True):
        mine = [limit for limit in result.limits if limit.scan.axis == axis]
        for group, look in zip(groups, styles, strict=True):
            _limit_line(
                place,
                [one for one in mine if not many or one.scan.active_damping_ns_per_m == group],
                many,
                look,
                f"by trials, {level_label(group)}" if many else "by trials",
            )
        place.set(
            ylabel=AXIS_LABELS[mine[0].name][0], ylim=(0.0, None), xlabel="active damping (N s/m)"
        )
        if many:
            _perturbation_axis(place, sorted({limit.perturbation_psd for limit in mine}))
    more = [
        mark("predicted", **PREDICTED, marker="o", **HOLLOW),
        mark("bar: from surely passive to surely not", marker="|", markersize=12, **MARKS),
    ]
    legends(figure, [*legend_handles(places[0]), *more], 2)
    return figure


def _limit_line(place: Axes, limits: list[AxisLimit], many: bool, look: Look, name: str) -> None:
    factor = AXIS_LABELS[limits[0].name][1]
    x = np.array(
        [
            limit.perturbation_psd / PSD_UNIT if many else limit.scan.active_damping_ns_per_m
            for limit in limits
        ]
    )
    value, lower, upper = (
        factor * np.array([getattr(limit, part) for limit in limits])
        for part in ("value", "lower", "upper")
    )
    bars = np.nan_to_num([np.maximum(value - lower, 0.0), np.maximum(upper - value, 0.0)])
    place.errorbar(x, value, bars, marker="o", label=name, **look)
    dotted = {**PREDICTED, "color": look["color"], "marker": "o", "markersize": 6}
    draw_predicted(place, x, np.array([factor * limit.scan.predicted for limit in limits]), dotted)


def draw_predicted(place: Axes, x: Any, value: Any, look: Look) -> None:
    """Draw predicted limits: the same marks, hollow."""
    place.plot(x, value, **{**look, **HOLLOW, "markerfacecolor": "none"})


def _perturbation_axis(place: Axes, psd: list[float]) -> None:
    """Set a logarithmic axis with ticks at the tried values, as many as fit."""
    shown = [value / PSD_UNIT for value in psd[:: -(-len(psd) // MOST_TICKS)]]
    place.set(xscale="log", xlabel="perturbation ($10^{-5}$ N²/Hz)")
    place.set_xticks(
        shown, [f"{value:.3g}" if value < 1000.0 else f"{value:,.0f}" for value in shown]
    )
    place.minorticks_off()
    place.margins(x=0.1)


# --- virtual walls --------------------------------------------------------------------------------


@styled()
def walls_figure(
    result: WallResult,
    title: str = "Walls that come to rest",
    width_mm: float | None = None,
) -> Figure:
    """Draw a line and an area for each damping level: marks are the stiffest stable walls, crosses
    the softest unstable one.
    """
    params = result.plan.params
    scene = result.plan.params.scene
    impact = f"impact at {scene.start_velocity_m_per_s:g} m/s, push {scene.excitation.force_n:g} N"
    rest = f"below {1e3 * params.still_m_per_s:g} mm/s after {params.settle_s:g} s"
    whole = f"{title}\nSIMULATED {scene.device}: {impact}; {rest}"
    figure, (place,) = axes(1, 1, WIDTH_IN, 4.2, whole, width_mm=width_mm)
    for rank, (level, look) in enumerate(
        zip(params.levels, level_styles(params.levels), strict=True)
    ):
        _walls(place, result, level, {**look, "marker": LEVEL_MARKS[rank % len(LEVEL_MARKS)]}, rank)
    least = f"none rests: less than the least tried, {params.stiffnesses[0]:g} N/m"
    more = [
        mark("softest wall that oscillates", marker="x", **MARKS),
        mark(least, marker="v", **MARKS),
    ]
    place.set(
        xlabel="virtual damping B of the wall (N s/m)",
        ylabel="stiffness K of the wall (N/m)",
        ylim=(0.0, None),
    )
    legends(figure, [*legend_handles(place), *more], 2)
    return figure


def _walls(place: Axes, result: WallResult, level: float, look: Look, rank: int) -> None:
    """Draw the walls of one level; if even the softest wall is unstable the line is at 0 and its
    mark points down.
    """
    lines = result.at(level)
    damping, highest, first = (
        np.array([getattr(line, name) for line in lines])
        for name in ("wall_virtual_damping_ns_per_m", "highest_n_per_m", "first_unstable_n_per_m")
    )
    rests = highest > 0.0
    shown: Look = {
        "clip_on": False,
        "zorder": 3,
        "label": f"stiffest wall that rests, {level_label(level)}",
    }
    area(
        place,
        damping,
        highest,
        look,
        rank,
        **shown,
        markevery=[int(at) for at in np.flatnonzero(rests)],
    )
    if not rests.all():  # an empty unclipped line would take room in the layout
        place.plot(
            damping[~rests],
            highest[~rests],
            "v",
            color=look["color"],
            markersize=6,
            clip_on=False,
            zorder=3,
        )
    place.plot(
        damping[rests], np.where(np.isfinite(first), first, np.nan)[rests], "x", color=look["color"]
    )
