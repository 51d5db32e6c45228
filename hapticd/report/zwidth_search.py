"""Figure of a directed search: slices of the set that it holds, its trials with their order and answer, how each was foreseen.

A slice shows only the trials whose M is next to its own, for a boundary in K and B moves with M; all trials are in the panel below.
"""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.measure.directed import SearchResult, Slice, Step, slice_at
from hapticd.report import figures
from hapticd.report.looks import ANSWERS, PREDICTED, Look, of_levels, tint, words_of
from hapticd.report.paper_style import SMALL_PT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHARES = (0.0, 0.2, 0.5, 0.8, 1.0)  # of the set's masses: between two of them it is sliced once
SLICES = len(SHARES) - 1
NEAR = 0.02  # of the range of masses: trials so near to a slice are shown in it
COLUMNS = 12
APART_IN = 0.17  # of two numbers
ESCAPES = "trial escapes: the loop ran away, or its command filled the range"


def search_figure(results: list[SearchResult]) -> "Figure":
    """For each damping level a row of slices through the set; below, each trial's expected and found least Re Z."""
    titled = [f"title {row}" for row in range(len(results))]
    rows = [[f"{row} {column * SLICES // COLUMNS}" for column in range(COLUMNS)] for row in range(len(results))]
    below = [f"foreseen {column * len(results) // COLUMNS}" for column in range(COLUMNS)]
    panels = [line for name, row in zip(titled, rows, strict=True) for line in ([name] * COLUMNS, row)]
    with figures.style():
        heights = [*[0.12, 3.0] * len(rows), 3.0]
        figure, places = figures.mosaic([*panels, below], 11.0, sum(heights) + 1.3, height_ratios=heights)
        conditions, looks = results[0].plan.params.conditions, of_levels([one.plan.params.damping_ns_per_m for one in results])
        figure.suptitle(
            f"Directed search: the set in slices of one M, and its trials\nSIMULATED {conditions.scene.device}, "
            f"{conditions.seconds:g} s of noise a trial", x=0.01, ha="left", fontsize=10,
        )  # fmt: skip
        for row, (result, look) in enumerate(zip(results, looks, strict=True)):
            level = words_of(result.plan.params.damping_ns_per_m)
            places[titled[row]].set_axis_off()
            places[titled[row]].text(0.0, 0.5, f"{level[0].upper()}{level[1:]}", va="center", fontweight="bold")
            _slices(figure, [places[f"{row} {column}"] for column in range(SLICES)], result, look)
            _foreseen(places[f"foreseen {row}"], result, look)
        figure.legend(handles=_keys(results, looks), loc="outside lower center", ncols=3, fontsize=SMALL_PT, frameon=False)
        return figure


def _slices(figure: "Figure", places: "list[Axes]", result: SearchResult, look: Look) -> None:
    mass = result.found.axes[2]
    passive = mass[result.found.passive.any(axis=(0, 1))]  # K = B = M = 0 is, or there had been no search
    tried = np.array([step.outcome.environment for step in result.steps])
    reach = NEAR * float(passive[-1] - passive[0])
    cuts = [slice_at(result, value) for value in _masses(tried[:, 2], np.quantile(passive, SHARES), reach)]
    top = max(np.nanmax((cut.held, cut.predicted)) for cut in cuts)
    for panel, (place, cut) in enumerate(zip(places, cuts, strict=True)):
        place.set(xlabel="B (N s/m)", xlim=(-0.02 * cut.damping[-1], cut.damping[-1]), ylim=(-0.02 * top, 1.15 * top))
        _boundaries(place, cut, look)
        near = np.abs(tried[:, 2] - cut.mass_kg) <= reach
        _trials(place, result.steps, near, look)
        place.set_title(f"M = {1e3 * cut.mass_kg:.3g} g")
        place.tick_params(labelleft=panel == 0)
    places[0].set_ylabel("K (N/m)")


def _masses(tried: Floats, borders: Floats, reach: float) -> list[float]:
    """Between any two borders the mass of the trial that has the most others within `reach`; the middle where none was tried."""
    chosen = []
    for low, high in pairwise(borders):
        here = tried[(tried >= low) & (tried <= high)]
        count = (np.abs(here[:, None] - tried) <= reach).sum(axis=1)
        chosen.append(float(here[np.argmax(count)] if here.size else 0.5 * (low + high)))
    return chosen


def _boundaries(place: "Axes", cut: Slice, look: Look) -> None:
    """The set that was found, tinted below its edge; the predicted edge dotted."""
    place.fill_between(cut.damping, 0.0, np.nan_to_num(cut.held), color=tint(look["color"]), linewidth=0, zorder=0.4)
    for edge, drawn in ((cut.held, look), (cut.predicted, PREDICTED)):
        closed = np.where(np.isnan(edge) & ~np.isnan(np.roll(edge, 1)), 0.0, edge)
        place.plot(cut.damping, closed, **drawn)


def _trials(place: "Axes", steps: tuple[Step, ...], near: Flags, look: Look) -> None:
    """Those of this slice; with their numbers where no other number stands."""
    width, height = 2.4, 2.3  # in, of the axes, about
    (left, right), (foot, head), numbered = place.get_xlim(), place.get_ylim(), list[tuple[float, float]]()
    for at in np.flatnonzero(near):
        k, b, _ = steps[at].outcome.environment
        place.plot(b, k, ANSWERS[_answer(steps[at])], color=look["color"], markersize=5, clip_on=False, zorder=3)
        here = width * (b - left) / (right - left), height * (k - foot) / (head - foot)
        if all(abs(here[0] - x) > APART_IN or abs(here[1] - y) > APART_IN for x, y in numbered):
            numbered.append(here)
            place.annotate(str(at + 1), (b, k), (4.0, 3.0), textcoords="offset points", fontsize=SMALL_PT)


def _answer(step: Step) -> str:
    if step.outcome.passes:
        return "passes"
    return "escapes" if not step.teaches else "fails"


def _foreseen(place: "Axes", result: SearchResult, look: Look) -> None:
    from matplotlib.ticker import MaxNLocator

    known = [(number, step) for number, step in enumerate(result.steps, start=1) if step.teaches]
    at = np.array([number for number, _ in known])
    found = np.array([step.outcome.margin_ns_per_m for _, step in known])
    reach = np.abs(np.array([(step.outcome.margin_lower, step.outcome.margin_upper) for _, step in known]).T - found)
    place.errorbar(at, found, np.nan_to_num(reach), fmt="_", markersize=7, color=look["color"], elinewidth=0.8)
    expected = [step.expected_ns_per_m for _, step in known]
    place.plot(at, expected, "o", color=figures.BLACK, markerfacecolor="none", markersize=4, markeredgewidth=0.8)
    escaped = [number for number, step in enumerate(result.steps, start=1) if not step.teaches]
    low, high = np.quantile(found, (0.05, 0.95))
    place.set_ylim(min(-0.5, 1.6 * low), max(0.8, 1.4 * high))
    if escaped:
        place.plot(escaped, np.full(len(escaped), place.get_ylim()[0]), ANSWERS["escapes"], color=look["color"], clip_on=False)
    place.axhline(0.0, color=figures.BLACK, linewidth=0.8)
    place.xaxis.set_major_locator(MaxNLocator(integer=True))
    place.set(xlabel="trial", ylabel="least Re Z (N s/m)", xlim=(0.0, len(result.steps) + 1.0))
    count = f"{len(escaped)} of {len(result.steps)} trials escape"
    place.set_title(f"{words_of(result.plan.params.damping_ns_per_m)}: {count}", loc="left")


def _keys(results: list[SearchResult], looks: list[Look]) -> list[object]:
    from matplotlib.lines import Line2D

    black: Look = {"color": figures.BLACK, "linestyle": ""}
    words = {"passes": "trial passes", "fails": "trial fails", "escapes": ESCAPES}
    return [
        *(
            Line2D([], [], label=f"edge found, {words_of(result.plan.params.damping_ns_per_m)}", **look)
            for result, look in zip(results, looks, strict=True)
        ),
        Line2D([], [], label="edge predicted", **PREDICTED),
        *(Line2D([], [], marker=ANSWERS[name], markersize=5, label=words[name], **black) for name in ANSWERS),
        Line2D([], [], marker="_", markersize=8, label="below: found, with its 95 % interval", **black),
        Line2D([], [], marker="o", markersize=4, markerfacecolor="none", label="below: expected before the trial", **black),
        Line2D([], [], linestyle="", label=f"slices show trials within {100 * NEAR:g} % of the range of M"),
    ]
