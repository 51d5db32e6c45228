"""Figure of a directed search: slices of the set that it holds, its trials with their order and answer, how each was foreseen."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.analysis.arrays import Flags
from hapticd.measure.directed import SearchResult, Step
from hapticd.measure.directed_slices import Slice, slice_at
from hapticd.report import figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHARES = (0.05, 0.35, 0.65, 0.95)  # of the set's masses: where it is sliced
NEAR = 0.08  # of the range of masses: trials so near to a slice are filled
COLUMNS = 12
LOOKS = {  # of a trial: marker, colour
    "passes": ("o", figures.BLUE),
    "fails": ("X", figures.RED),
    "escapes": ("^", figures.ORANGE),
}


def search_figure(results: list[SearchResult]) -> "Figure":
    """For each damping level a row of slices through the set; below, each trial's expected and found least Re Z."""
    rows = [[f"{row} {column * len(SHARES) // COLUMNS}" for column in range(COLUMNS)] for row in range(len(results))]
    below = [f"foreseen {column * len(results) // COLUMNS}" for column in range(COLUMNS)]
    with figures.style():
        figure, places = figures.mosaic([*rows, below], 11.0, 3.0 * len(rows) + 3.4)
        device = results[0].plan.params.conditions.scene.device
        seconds = results[0].plan.params.conditions.seconds
        figure.suptitle(f"SIMULATED {device}: directed search with trials of {seconds:g} s", fontsize=10)
        for row, result in enumerate(results):
            _slices([places[f"{row} {column}"] for column in range(len(SHARES))], result)
            _foreseen(places[f"foreseen {row}"], result)
        handles, labels = places["0 0"].get_legend_handles_labels()
        handles.append(places["0 0"].plot([], [], "s", markerfacecolor="none", markeredgecolor=figures.GREY)[0])
        labels.append(f"open: its M is more than {100 * NEAR:g} % of the range away")
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        return figure


def _slices(places: "list[Axes]", result: SearchResult) -> None:
    mass = result.found.axes[2]
    passive = mass[result.found.passive.any(axis=(0, 1))]  # K = B = M = 0 is, or there had been no search
    cuts = [slice_at(result, float(value)) for value in np.quantile(passive, SHARES)]
    tried = np.array([step.outcome.environment for step in result.steps])
    away = np.abs(tried[:, 2:] - np.array([cut.mass_kg for cut in cuts]))
    near = NEAR * (passive[-1] - passive[0])
    top = max(tried[:, 0].max(), *(np.nanmax((cut.held, cut.predicted)) for cut in cuts))
    for panel, (place, cut) in enumerate(zip(places, cuts, strict=True)):
        _boundaries(place, cut)
        _trials(place, result.steps, np.argmin(away, axis=1) == panel, away[:, panel] <= near)
        place.set(xlabel="B [N s/m]", xlim=(-0.02 * cut.damping[-1], cut.damping[-1]), ylim=(-0.02 * top, 1.08 * top))
        place.set_title(f"M = {1e3 * cut.mass_kg:.3g} g")
        place.tick_params(labelleft=panel == 0)
    places[0].set_ylabel(f"added damping {result.plan.params.damping_ns_per_m:g} N s/m\nK [N/m]")


def _boundaries(place: "Axes", cut: Slice) -> None:
    """The set that was found, shaded below its edge; the predicted edge dashed."""
    place.fill_between(cut.damping, 0.0, np.nan_to_num(cut.held), color=figures.SKY, alpha=0.25, linewidth=0)
    for edge, style, colour, name in ((cut.held, "-", figures.BLUE, "found"), (cut.predicted, "--", figures.BLACK, "predicted")):
        closed = np.where(np.isnan(edge) & ~np.isnan(np.roll(edge, 1)), 0.0, edge)
        place.plot(cut.damping, closed, style, color=colour, linewidth=1.2, label=f"edge of the set, {name}")


def _trials(place: "Axes", steps: tuple[Step, ...], mine: Flags, near: Flags) -> None:
    """Those nearest to this slice with their numbers, open where their M is farther away than `near`."""
    for answer, (marker, colour) in LOOKS.items():
        for close in (True, False):
            chosen = mine & (near == close) & np.array([_answer(step) == answer for step in steps])
            at_k, at_b = ([steps[at].outcome.environment[axis] for at in np.flatnonzero(chosen)] for axis in (0, 1))
            face, edge = (colour, "white") if close else ("none", colour)
            place.plot(
                at_b, at_k, marker, markerfacecolor=face, markeredgecolor=edge, markersize=5.5, markeredgewidth=0.6,
                label=f"trial {answer}" if close else None,
            )  # fmt: skip
    for at in np.flatnonzero(mine):
        k, b, _ = steps[at].outcome.environment
        place.annotate(str(at + 1), (b, k), (3.0, 2.0), textcoords="offset points", fontsize=6, color="#444444")


def _answer(step: Step) -> str:
    if step.outcome.passes:
        return "passes"
    return "escapes" if not step.teaches else "fails"


def _foreseen(place: "Axes", result: SearchResult) -> None:
    known = [(number, step) for number, step in enumerate(result.steps, start=1) if step.teaches]
    at = np.array([number for number, _ in known])
    found = np.array([step.outcome.margin_ns_per_m for _, step in known])
    reach = np.abs(np.array([(step.outcome.margin_lower, step.outcome.margin_upper) for _, step in known]).T - found)
    place.errorbar(
        at, found, np.nan_to_num(reach), fmt="o", markersize=3, color=figures.BLUE, elinewidth=0.7, label="found, 95 % interval"
    )
    place.plot(at, [step.expected_ns_per_m for _, step in known], "x", color=figures.RED, markersize=5, label="expected before")
    escaped = [number for number, step in enumerate(result.steps, start=1) if not step.teaches]
    low, high = np.quantile(found, (0.05, 0.95))
    place.set_ylim(min(-0.5, 1.6 * low), max(0.8, 1.4 * high))
    place.plot(escaped, np.full(len(escaped), place.get_ylim()[0]), "^", color=figures.ORANGE, markersize=5, clip_on=False)
    place.axhline(0.0, color=figures.BLACK, linewidth=0.8)
    place.set(xlabel="trial", ylabel="least Re Z [N s/m]", xlim=(0.0, len(result.steps) + 1.0))
    count = f"{len(escaped)} of {len(result.steps)} trials escape"
    place.set_title(f"added damping {result.plan.params.damping_ns_per_m:g} N s/m: {count}")
    place.legend(loc="upper right")
