"""Figs. 3, 8 and 11: envelopes of |Z| and phase over all passive trials of the grid, and who owns them.

Bands are 95 % of the owner's estimate; dotted lines are predicted. The strip says which parameter of the owner weighs most at that
frequency: that of K/w, B and |M| w which is largest, and whether that M is negative. Where the largest and the smallest of N equal
trials would lie as far apart by their noise alone, 2 sqrt(2 ln N) standard deviations, nobody owns the envelope.
"""

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.envelope import Edge
from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_grid import CALMED, Found
from hapticd.measure.reproduce_trials import MAIN
from hapticd.report import figures
from hapticd.report.owners import NOBODY, patches, strip, weightiest
from hapticd.report.paper_impedance import dressed
from hapticd.report.paper_style import LOOKS, PREDICTED, SMALL_PT, TRUSTED, WIDTH_IN, WORDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PARTS = (("K", figures.ORANGE), ("B", figures.GREEN), ("M > 0", figures.SKY), ("M < 0", figures.PURPLE))
WITHIN_NOISE = ("within the noise", "#eeeeee")
SIZE_RANGE = (0.08, 200.0)  # N s/m, the same for all that are compared
WIDE = 0.09  # of a strip: room for a name


def envelope_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
    """|Z| and phase envelopes of damping levels, with the owners' strips."""
    strips = len(places)
    ratios = [3.0, *([0.36] * strips), 1.9]
    height = 6.3 + 0.4 * strips
    figure, grid = figures.axes(2 + strips, 1, WIDTH_IN, height, sharex=True, gridspec_kw={"height_ratios": ratios})
    size, phase = grid[0], grid[-1]
    for place in places:
        found, look = result.found[place], LOOKS[place]
        _edges(size, found, (found.envelope.upper, found.envelope.lower), look, WORDS[place], logarithmic=True)
        _edges(phase, found, (found.envelope.phase_upper, found.envelope.phase_lower), look, "", logarithmic=False)
        guess = result.predicted[MAIN][place]
        if guess is not None and found.flown:
            _predicted(size, phase, guess, last=place == places[-1])
    for place, below in zip(places, grid[1:-1], strict=True):
        _strip(below, result.found[place], f"owner of the envelope {WORDS[place]}")
    if any(result.found[place].flown for place in places):
        size.fill_between([], [], [], color=figures.GREY, alpha=0.5, linewidth=0, label=TRUSTED)
    figure.legend(handles=patches(PARTS, WITHIN_NOISE), fontsize=SMALL_PT, ncols=5, loc="outside lower center", frameon=False)
    if places == (1,):
        _peak(size, result.found[1])
    dressed(size, phase, title, result)
    size.set_ylim(*SIZE_RANGE)
    size.legend(loc="upper center", fontsize=SMALL_PT)
    return figure


def _edges(axis: "Axes", found: Found, edges: tuple[Edge, Edge], look: dict[str, Any], words: str, logarithmic: bool) -> None:
    f, (upper, lower) = found.envelope.frequency_hz, edges
    axis.fill_between(f, lower.value, upper.value, color=look["color"], alpha=0.10, linewidth=0)
    for edge, label in ((upper, words), (lower, None)):
        spread = figures.INTERVAL * edge.sd
        factor, summand = (np.exp(spread), 0.0) if logarithmic else (1.0, spread)
        axis.fill_between(
            f, edge.value / factor - summand, edge.value * factor + summand, color=look["color"], alpha=0.35, linewidth=0
        )
        axis.plot(f, edge.value, label=label, **look)


def _predicted(size: "Axes", phase: "Axes", guess: Found, last: bool) -> None:
    e = guess.envelope
    for axis, edges in ((size, (e.upper, e.lower)), (phase, (e.phase_upper, e.phase_lower))):
        for edge in edges:
            axis.plot(e.frequency_hz, edge.value, **PREDICTED)
    if last:
        size.plot([], [], label="predicted", **PREDICTED)


def _strip(axis: "Axes", found: Found, words: str) -> None:
    """Which part of the owner weighs most, for the largest (upper row) and the smallest |Z|."""
    f = found.envelope.frequency_hz
    rows = [weighty(f, found, edge) for edge in (found.envelope.lower, found.envelope.upper)]
    ends = strip(axis, f, rows, PARTS, WITHIN_NOISE)
    for height, row in enumerate(rows):
        _names(axis, ends, row, 0.5 + height)
    axis.set_yticks([0.5, 1.5], ["min", "max"], fontsize=SMALL_PT)
    axis.set_title(words, fontsize=SMALL_PT, loc="left", pad=2)


def _names(axis: "Axes", ends: Floats, row: Floats, height: float) -> None:
    """The owner's name wherever its part of the strip is wide enough, so that nobody needs the colours."""
    borders = [0, *(np.flatnonzero(np.diff(row)) + 1), row.size]
    whole = np.log(ends[-1] / ends[0])
    for first, last in pairwise(borders):
        low, high = ends[first], ends[last]
        if row[first] == NOBODY or np.log(high / low) < WIDE * whole:
            continue
        name = PARTS[int(row[first])][0]
        axis.text(float(np.sqrt(low * high)), height, name, fontsize=SMALL_PT, ha="center", va="center")


def weighty(frequency_hz: Floats, found: Found, edge: Edge) -> Floats:
    """(F,) index into PARTS, NOBODY where nothing is rendered or noise alone would make the envelope as wide."""
    which = weightiest(frequency_hz, found.owners(edge.owner))
    which[which == 4.0] = 3.0  # the grid of the paper has no B < 0
    upper, lower = found.envelope.upper, found.envelope.lower
    noise = 2.0 * np.sqrt(2.0 * np.log(max(2, len(found.environments)))) * np.maximum(upper.sd, lower.sd)
    which[np.log(upper.value / lower.value) < noise] = NOBODY
    return _majority(which) if found.flown else which


def _majority(which: Floats) -> Floats:
    """The most frequent value of each neighbourhood that the window cannot resolve."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(which, CALMED // 2, mode="edge"), CALMED)
    kinds = np.arange(NOBODY, len(PARTS))
    return np.asarray(kinds[(near[:, :, None] == kinds).sum(axis=1).argmax(axis=1)])


def _peak(axis: "Axes", found: Found) -> None:
    peak = found.peak()
    if peak is None:
        return
    axis.annotate(
        f"{peak.frequency_hz:.0f} Hz: M = {1e3 * peak.owner[2]:g} g\n(paper: near 100 Hz)",
        (peak.frequency_hz, peak.size_ns_per_m), (peak.frequency_hz, 2.6 * peak.size_ns_per_m),
        ha="center", fontsize=SMALL_PT, arrowprops={"arrowstyle": "-|>", "color": figures.BLACK, "linewidth": 0.8},
    )  # fmt: skip
