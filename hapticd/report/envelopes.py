"""Envelopes of |Z| (or |Y|) and phase, and strips that say who owns them, as the paper's Figs. 3, 8 and 11 and maps show them.

The strip names the parameter of the owner that weighs most at each frequency, that of K/w, |B| and |M| w which is largest, and
its sign. Where the largest and the smallest of N equal trials would lie as far apart by their noise alone, 2 sqrt(2 ln N) standard
deviations, nobody owns the envelope. Bands are 95 % intervals of the owning trial alone; the smallest of many noisy values lies
below the smallest true one, so a lower edge lies below its prediction partly because it is a minimum.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.envelope import Edge, Envelope
from hapticd.report import figures
from hapticd.report.looks import PARTS, PREDICTED, Look, tint
from hapticd.report.owners import NOBODY, NOTHING, strip, weightiest
from hapticd.report.paper_style import SMALL_PT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDE = 0.09  # of a strip: room for a name

Ends = tuple[Floats, Floats]  # upper and lower, (F,) each


@dataclass(frozen=True, eq=False)
class Guess:
    """A predicted envelope: largest and smallest |Z| [N s/m] and phase [deg]."""

    frequency_hz: Floats
    size: Ends
    phase: Ends


@dataclass(frozen=True, eq=False)
class Drawn:
    """One envelope to draw; `environments` (N, 3) are K, B, M of its trials. `calm`: frequencies that one window spans."""

    envelope: Envelope
    environments: Floats
    look: Look
    words: str
    guess: Guess | None = None
    calm: int = 1


def guess_of(frequency_hz: Floats, z: Complexes) -> Guess:
    """The envelope of predicted Z (N, F)."""
    size, phase = np.abs(z), np.degrees(np.angle(z))
    return Guess(frequency_hz, (size.max(axis=0), size.min(axis=0)), (phase.max(axis=0), phase.min(axis=0)))


def rendered(shown: Sequence[Drawn]) -> tuple[tuple[str, str], ...]:
    """PARTS, without B < 0 where no trial has it."""
    negative = any((drawn.environments[:, 1] < 0.0).any() for drawn in shown)
    return tuple(part for part in PARTS if negative or part[0] != "B < 0")


def draw_edges(size: "Axes", phase: "Axes", shown: Sequence[Drawn]) -> None:
    """All of them, tinted between their edges, the first on top; what is predicted dotted."""
    for place, drawn in enumerate(shown):
        found, low = drawn.envelope, 0.4 - 0.01 * place
        _edges(size, drawn, (found.upper, found.lower), low, logarithmic=True)
        _edges(phase, drawn, (found.phase_upper, found.phase_lower), low, logarithmic=False)
    for drawn in shown:
        if drawn.guess is not None:
            for axis, ends in ((size, drawn.guess.size), (phase, drawn.guess.phase)):
                for values in ends:
                    axis.plot(drawn.guess.frequency_hz, values, **PREDICTED)
    if any(drawn.guess is not None for drawn in shown):
        size.plot([], [], label="predicted", **PREDICTED)


def _edges(axis: "Axes", drawn: Drawn, edges: tuple[Edge, Edge], low: float, logarithmic: bool) -> None:
    f, colour, (upper, lower) = drawn.envelope.frequency_hz, drawn.look["color"], edges
    axis.fill_between(f, lower.value, upper.value, color=tint(colour), linewidth=0, zorder=low)
    for edge, label in ((upper, drawn.words if logarithmic else None), (lower, None)):
        spread = figures.INTERVAL * edge.sd
        factor, summand = (np.exp(spread), 0.0) if logarithmic else (1.0, spread)
        bounds = edge.value / factor - summand, edge.value * factor + summand
        axis.fill_between(f, *bounds, color=colour, alpha=0.35, linewidth=0)
        axis.plot(f, edge.value, label=label, **drawn.look)


def draw_strip(axis: "Axes", drawn: Drawn) -> None:
    """Which part of the owner weighs most, for the largest (upper row) and the smallest."""
    f, found = drawn.envelope.frequency_hz, drawn.envelope
    rows = [weighty(drawn, edge) for edge in (found.lower, found.upper)]
    ends = strip(axis, f, rows, PARTS, NOTHING)
    for height, row in enumerate(rows):
        _names(axis, ends, row, 0.5 + height)
    axis.set_yticks([0.5, 1.5], ["min", "max"], fontsize=SMALL_PT)
    axis.set_title(f"owner of the envelope {drawn.words}", fontsize=SMALL_PT, loc="left", pad=2)


def _names(axis: "Axes", ends: Floats, row: Floats, height: float) -> None:
    """The owner's name wherever its part of the strip is wide enough, so that nobody needs the colours."""
    borders = [0, *(np.flatnonzero(np.diff(row)) + 1), row.size]
    low_hz, high_hz = axis.get_xlim()
    for first, last in pairwise(borders):
        low, high = ends[first], ends[last]
        if row[first] == NOBODY or np.log(high / low) < WIDE * np.log(high_hz / low_hz):
            continue
        name = PARTS[int(row[first])][0]
        ink = "white" if name == "B < 0" else "black"
        axis.text(float(np.sqrt(low * high)), height, name, fontsize=SMALL_PT, ha="center", va="center", color=ink)


def weighty(drawn: Drawn, edge: Edge) -> Floats:
    """(F,) index into PARTS, NOBODY where nothing is rendered or noise alone would make the envelope as wide."""
    found = drawn.envelope
    which = weightiest(found.frequency_hz, drawn.environments[edge.owner])
    upper, lower = found.upper, found.lower
    noise = 2.0 * np.sqrt(2.0 * np.log(max(2, len(drawn.environments)))) * np.maximum(upper.sd, lower.sd)
    which[np.log(upper.value / lower.value) < noise] = NOBODY
    return _majority(which, drawn.calm)


def _majority(which: Floats, count: int) -> Floats:
    """The most frequent value of each neighbourhood of `count`, which is odd."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(which, count // 2, mode="edge"), count)
    kinds = np.arange(NOBODY, len(PARTS))
    return np.asarray(kinds[(near[:, :, None] == kinds).sum(axis=1).argmax(axis=1)])
