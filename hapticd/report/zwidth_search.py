"""Figure of a directed search: the set that it holds, its trials, and how well each was foreseen."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.directed import SearchResult
from hapticd.report import figures
from hapticd.report.zwidth_map import highest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MASSES = 5


def search_figure(results: list[SearchResult]) -> "Figure":
    """A row for each damping level: largest passive K over B at several masses with the trials, and expected against found."""
    with figures.style():
        figure, places = figures.axes(len(results), 2, 10.0, 3.7 * len(results) + 0.4, width_ratios=(1.5, 1.0))
        figure.suptitle(f"SIMULATED {results[0].plan.params.conditions.scene.device}: directed search", fontsize=9.5)
        for result, left, right in zip(results, places[::2], places[1::2], strict=True):
            _boundary(left, result)
            _foreseen(right, result)
        return figure


def _boundary(place: "Axes", result: SearchResult) -> None:
    mass = result.found.axes[2]
    passive = np.flatnonzero(result.found.passive.any(axis=(0, 1)))  # K = B = M = 0 is, or there had been no search
    for look, panel in enumerate(np.unique(np.quantile(passive, np.linspace(0.0, 1.0, MASSES)).round().astype(int))):
        colour = figures.COLOURS[look % len(figures.COLOURS)]
        place.plot(result.found.axes[1], highest(result.found, int(panel)), color=colour, label=f"M = {1e3 * mass[panel]:.3g} g")
    for good, marker, name in ((True, "o", "trial, passes"), (False, "x", "trial, fails")):
        tried = np.array([step.outcome.environment for step in result.steps if step.outcome.passes is good]).reshape(-1, 3)
        place.plot(tried[:, 1], tried[:, 0], marker, color=figures.BLACK, markersize=4, label=name)
    place.set(xlabel="B [N s/m]", ylabel="largest passive K [N/m]", xlim=(0.0, None), ylim=(0.0, None))
    place.set_title(f"added damping {result.plan.params.damping_ns_per_m:g} N s/m, {len(result.steps)} trials")
    place.legend(loc="upper right")


def _foreseen(place: "Axes", result: SearchResult) -> None:
    known = [step for step in result.steps if np.isfinite(step.expected_ns_per_m) and np.isfinite(step.outcome.margin_ns_per_m)]
    found = np.array([step.outcome.margin_ns_per_m for step in known])
    half = np.array([(step.outcome.margin_upper - step.outcome.margin_lower) / 2 for step in known])
    at = np.array([place + 5 for place, step in enumerate(result.steps[4:]) if step in known])
    place.errorbar(
        at, found, np.nan_to_num(half), fmt="o", markersize=3, color=figures.BLUE, label="found, with interval", elinewidth=0.7
    )
    place.plot(at, [step.expected_ns_per_m for step in known], "x", color=figures.RED, markersize=5, label="expected before")
    place.axhline(0.0, color=figures.BLACK, linewidth=0.8)
    place.set(xlabel="trial", ylabel="least Re Z [N s/m]")
    low, high = np.quantile(found, (0.08, 0.95)) if found.size else (-1.0, 1.0)
    place.set_ylim(min(-1.0, 1.5 * low), max(1.0, 1.5 * high))
    place.legend(loc="best")
