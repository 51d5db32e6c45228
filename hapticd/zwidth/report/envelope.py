"""Figures of envelopes: the largest and smallest passive |Z| (or |Y|) and phase, with strips that
show the owners.

The strip shows the dominant parameter of the owner at each frequency, the largest of K/w, |B| and
|M| w, and its sign. The envelope has no owner where noise alone would separate the largest and the
smallest of N equal trials as far, by 2 sqrt(2 ln N) standard deviations. Bands are 95 % intervals
of the owning trial alone. The smallest of many noisy values lies below the smallest true one, so a
lower edge lies below its prediction partly because it is a minimum.

Limitations: comparison of envelopes on unlike grids; a finer grid always goes lower.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.model.predict import frequencies
from hapticd.zwidth.outcomes import Conditions, Outcome, envelope_of, judged, kept_frequencies
from hapticd.zwidth.passive_set import Edge, Envelope
from hapticd.zwidth.report.paper import legends
from hapticd.zwidth.report.style import (
    NORMAL,
    PARTS,
    PREDICTED,
    WIDTH_IN,
    Axes,
    Figure,
    Look,
    axes,
    draw_band,
    hertz_axis,
    legend_handles,
    level_label,
    level_styles,
    patch,
    simulated,
    size_in,
    styled,
    tint,
)  # fmt: skip
from hapticd.zwidth.report.trial import ADMITTANCE, IMPEDANCE, View, dress, interval

__all__ = [
    "SHOWN_HZ",
    "Drawn",
    "envelope_figure",
    "envelopes_figure",
    "keys",
    "strip",
    "weightiest",
]

Levels = Sequence[tuple[float, Sequence[Outcome]]]

SHOWN_HZ = (2.0, 1000.0)
NAME_IN = 0.45  # width of a name in a strip
NOBODY = -1.0
NOTHING = "#ffffff"


@dataclass(frozen=True, eq=False)
class Drawn:
    """One envelope to draw; `environments` (N, 3) are K, B, M of its trials. `calm`: number of
    frequencies within one window.
    """

    envelope: Envelope
    environments: Floats
    look: Look
    words: str
    guess: Envelope | None = None
    calm: int = 1


@styled()
def envelope_figure(
    conditions: Conditions,
    levels: Levels,
    inverse: bool = False,
    width_mm: float | None = None,
) -> Figure:
    """Draw largest and smallest |Z| [N s/m] and phase [deg] of the trials that pass, a strip of
    owners for each level, and the predictions of the same trials, dotted. AnalysisError for a level
    at which no trial passes.

    `levels`: (active damping [N s/m], its trials). `inverse`: of the admittance, whose largest
    values are owned by the smallest |Z|.
    """
    shown = [
        _of_trials(conditions, *level, look, inverse)
        for level, look in zip(levels, level_styles([level for level, _ in levels]), strict=True)
    ]
    f = shown[0].envelope.frequency_hz
    seen = judged(trial for _, trials in levels for trial in trials)
    made = f"{simulated(conditions.scene.device, conditions.seconds)}, {seen}"
    title = f"Z-width envelope{' as admittance' if inverse else ''}\n{made}"
    view = ADMITTANCE if inverse else IMPEDANCE
    ends_hz = (float(f[0]), float(f[-1]))
    return envelopes_figure(shown, title, ends_hz, conditions.band_hz, view, width_mm)


def _of_trials(
    conditions: Conditions, level: float, trials: Sequence[Outcome], look: Look, inverse: bool
) -> Drawn:
    """Return the envelope of the trials that pass, and that predicted for the same environments
    within the range of the figure.
    """
    passed = [trial for trial in trials if trial.passes]
    points = np.array([trial.environment for trial in passed]).reshape(-1, 3)
    f = np.union1d(
        frequencies(conditions.band_hz, conditions.display.perturbation), kept_frequencies()
    )
    z = conditions.display.impedances(points, level, f)
    inside = (f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])
    found = (envelope_of(passed), Envelope.predicted(f[inside], z[:, inside]))
    measured, predicted = (one.admittance() if inverse else one for one in found)
    return Drawn(measured, points, look, level_label(level), predicted)


def envelopes_figure(
    shown: Sequence[Drawn],
    title: str,
    ends_hz: tuple[float, float],
    band_hz: tuple[float, float],
    view: View = IMPEDANCE,
    width_mm: float | None = None,
) -> Figure:
    """Draw edges of size, a strip of owners per envelope, edges of phase, within `styled`."""
    count = len(shown)
    figure, (size, *strips, phase) = axes(
        2 + count,
        1,
        WIDTH_IN,
        6.4 + 0.42 * count,
        title,
        width_mm=width_mm,
        sharex=True,
        height_ratios=[3.0, *([0.36] * count), 1.9],
    )
    hertz_axis(phase, *ends_hz)
    size.set_yscale("log")
    for rank, drawn in enumerate(shown):
        found = drawn.envelope
        own = (drawn.look, drawn.words, rank)
        edges(size, found.frequency_hz, (found.upper, found.lower), *own)
        edges(phase, found.frequency_hz, (found.phase_upper, found.phase_lower), *own, linear=True)
    for guess in (drawn.guess for drawn in shown if drawn.guess is not None):
        for edge in (guess.upper, guess.lower):
            size.plot(guess.frequency_hz, edge.value, label="predicted", **PREDICTED)
        for edge in (guess.phase_upper, guess.phase_lower):
            phase.plot(guess.frequency_hz, edge.value, **PREDICTED)
    for axis, drawn in zip(strips, shown, strict=True):
        rows = [weighty(drawn, edge) for edge in (drawn.envelope.lower, drawn.envelope.upper)]
        strip(axis, drawn.envelope.frequency_hz, rows, f"owner of the envelope {drawn.words}")
        axis.set_yticks([0.5, 1.5], ["min", "max"], fontsize="small")
    grey = dress(size, phase, band_hz, view, " at the probe")
    known = (
        [interval(shown[-1].look, " of the owning trial")]
        if any(one.envelope.upper.sd.any() for one in shown)
        else []
    )
    handles = [*legend_handles(size), *known, grey]
    negative = any((drawn.environments[:, 1] < 0.0).any() for drawn in shown)
    where = {"loc": "lower right" if view is IMPEDANCE else "lower center"}
    legends(figure, keys(negative), 6, "", (size, handles, where))
    return figure


def edges(
    axis: Axes,
    frequency_hz: Floats,
    pair: tuple[Edge, Edge],
    look: Look,
    words: str,
    rank: int = 0,
    linear: bool = False,
) -> None:
    """Draw both edges with their intervals, tinted between them, the first envelope on top."""
    upper, lower = pair
    axis.fill_between(
        frequency_hz,
        lower.value,
        upper.value,
        color=tint(look["color"]),
        linewidth=0,
        zorder=0.4 - 0.01 * rank,
    )
    draw_band(axis, frequency_hz, upper.value, NORMAL * upper.sd, look, words, linear)
    draw_band(axis, frequency_hz, lower.value, NORMAL * lower.sd, look, None, linear)


# --- owners ---------------------------------------------------------------------------------------


def weightiest(frequency_hz: Floats, owners: Floats) -> Floats:
    """Return (F,) 0 K, 1 B > 0, 2 M > 0, 3 B < 0, 4 M < 0, NOBODY for an owner without K, B and M;
    for owners (K, B, M) (F, 3).
    """
    w = 2.0 * np.pi * frequency_hz
    parts = np.stack((owners[:, 0] / w, owners[:, 1], owners[:, 2] * w))
    which = np.abs(parts).argmax(axis=0)
    below = np.take_along_axis(parts, which[None], 0)[0] < 0.0
    return np.where(parts.any(axis=0), which + 2.0 * below, NOBODY)


def weighty(drawn: Drawn, edge: Edge) -> Floats:
    """Return (F,) index into PARTS; NOBODY for an owner without K, B and M, or if noise alone would
    make the envelope as wide.
    """
    upper = drawn.envelope.upper
    lower = drawn.envelope.lower
    which = weightiest(drawn.envelope.frequency_hz, drawn.environments[edge.owner])
    noise = (
        2.0
        * np.sqrt(2.0 * np.log(max(2, len(drawn.environments))))
        * np.maximum(upper.sd, lower.sd)
    )
    which[np.log(upper.value / lower.value) < noise] = NOBODY
    return _majority(which, drawn.calm)


def _majority(which: Floats, count: int) -> Floats:
    """Return the most frequent value of each neighbourhood of `count`, which is odd."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(which, count // 2, mode="edge"), count)
    kinds = np.arange(NOBODY, len(PARTS))
    return np.asarray(kinds[(near[:, :, None] == kinds).sum(axis=1).argmax(axis=1)])


def strip(axis: Axes, frequency_hz: Floats, rows: Sequence[Floats], title: str) -> None:
    """Paint rows (F,) of indices into PARTS from below, white for NOBODY, with the names where they
    fit, so that the strip is readable without colours.
    """
    from matplotlib.colors import ListedColormap

    middle = np.sqrt(frequency_hz[1:] * frequency_hz[:-1])
    borders = np.concatenate((frequency_hz[:1], middle, frequency_hz[-1:]))
    axis.pcolormesh(
        borders,
        np.arange(len(rows) + 1.0),
        np.array(rows),
        cmap=ListedColormap([NOTHING, *(colour for _, colour in PARTS)]),
        vmin=-1.5,
        vmax=len(PARTS) - 0.5,
        rasterized=True,
    )
    axis.grid(visible=False)
    axis.tick_params(length=0)
    axis.set_yticks([])
    axis.set_title(title, fontsize="small", pad=2)
    for height, row in enumerate(rows):
        _names(axis, borders, row, 0.5 + height)


def _names(axis: Axes, borders: Floats, row: Floats, height: float) -> None:
    wide = NAME_IN / size_in(axis)[0]
    changes = [0, *(np.flatnonzero(np.diff(row)) + 1), row.size]
    low_hz, high_hz = axis.get_xlim()
    for first, last in pairwise(changes):
        low = borders[first]
        high = borders[last]
        if row[first] == NOBODY or np.log(high / low) < wide * np.log(high_hz / low_hz):
            continue
        name = PARTS[int(row[first])][0]
        axis.text(
            float(np.sqrt(low * high)),
            height,
            name,
            fontsize="small",
            ha="center",
            va="center",
            color="white" if name == "B < 0" else "black",
        )


def keys(negative: bool = True) -> list[Any]:
    """Return handles of a legend: the parts, without B < 0 if no trial has it, and NOBODY."""
    parts = (*(part for part in PARTS if negative or part[0] != "B < 0"), ("nobody", NOTHING))
    return [patch(name, colour, linewidth=0.6) for name, colour in parts]
