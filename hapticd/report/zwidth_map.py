"""Figure of a map: slices of the passive set at several virtual masses, with its trials and what was only predicted."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats, Integers
from hapticd.analysis.boundary import PassiveSet
from hapticd.measure.campaign import LevelMap, MapResult
from hapticd.report import figures
from hapticd.report.looks import ANSWERS, Look, of_levels, words_of
from hapticd.report.paper_style import SMALL_PT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS = 6
COLUMNS = 3
ASIDE = 0.12  # of a step of B: how far apart the marks of two levels stand at one point


def set_figure(result: MapResult) -> "Figure":
    """The largest passive K over B, a panel for each of up to six virtual masses, a line and marks for each damping level.

    M = 0, or the mass nearest to it, is among them. ConfigError without matplotlib.
    """
    mass = result.levels[0].found.axes[2]
    shown = slices(result)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    with figures.style():
        figure, places = figures.axes(rows, columns, 0.6 + 3.0 * columns, 2.7 * rows + 1.2, sharex=True, sharey=True)
        figure.suptitle(
            f"Passive set: the largest passive K at each B\n"
            f"SIMULATED {result.plan.params.conditions.scene.device}, {result.plan.params.conditions.seconds:g} s of noise a trial",
            x=0.01, ha="left", fontsize=10,
        )  # fmt: skip
        looks = of_levels([level.damping_ns_per_m for level in result.levels])
        for panel, place in zip(shown, places, strict=False):
            for turn, (level, look) in enumerate(zip(result.levels, looks, strict=True)):
                _plane(place, level, int(panel), look, turn - 0.5 * (len(looks) - 1))
            place.set_title(f"M = {1e3 * mass[panel]:.3g} g")
        for place in places[len(shown) :]:
            place.remove()
        for place in places[len(shown) - columns : len(shown)]:
            place.set_xlabel("B (N s/m)")
            place.tick_params(labelbottom=True)
        for row in range(rows):
            places[columns * row].set_ylabel("K (N/m)")
        _legend(figure, result, looks)
        return figure


def slices(result: MapResult) -> Integers:
    """Up to six places on the axis of M: those nearest to 0 and others evenly apart, where something passes or was tried."""
    mass = result.levels[0].found.axes[2]
    there = np.zeros(mass.size, bool)
    for level in result.levels:
        there |= level.found.passive.any(axis=(0, 1)) | level.tried.reshape(level.found.margin.shape).any(axis=(0, 1))
    zero = int(np.argmin(np.abs(mass)))
    there[zero] = True
    places = np.flatnonzero(there)
    count = min(PANELS - PANELS % COLUMNS, len(places))
    count = count if count <= COLUMNS else COLUMNS * (count // COLUMNS)
    chosen = places[np.linspace(0, len(places) - 1, count).round().astype(int)]
    if zero not in chosen:
        inner = slice(1, -1) if len(chosen) > 2 else slice(None)
        nearest = int(np.argmin(np.abs(chosen[inner] - zero))) + (1 if len(chosen) > 2 else 0)
        chosen[nearest] = zero
    return np.asarray(chosen)


def _plane(place: "Axes", level: LevelMap, panel: int, look: Look, aside: float) -> None:
    """One level in one panel: what passes, what fails, what was only predicted to pass."""
    stiffness, damping, _ = level.found.axes
    shape = level.found.margin.shape
    passive, tried = level.found.passive[:, :, panel], level.tried.reshape(shape)[:, :, panel]
    k, b = np.meshgrid(stiffness, damping + aside * ASIDE * (damping[1] - damping[0]), indexing="ij")
    place.plot(damping, highest(level.found, panel), **look)
    marks: Look = {"linestyle": "", "color": look["color"], "markersize": 4, "zorder": 3}
    place.plot(b[passive & tried], k[passive & tried], ANSWERS["passes"], **marks)
    place.plot(b[~passive & tried], k[~passive & tried], ANSWERS["fails"], **marks)
    place.plot(
        b[passive & ~tried], k[passive & ~tried], "o", **{**marks, "markersize": 3}, markerfacecolor="white", markeredgewidth=0.6
    )


def _legend(figure: "Figure", result: MapResult, looks: list[Look]) -> None:
    from matplotlib.lines import Line2D

    black: dict[str, Any] = {"color": figures.BLACK, "linestyle": "", "markersize": 4}
    handles = [
        *(Line2D([], [], label=words_of(level.damping_ns_per_m), **look) for level, look in zip(result.levels, looks, strict=True)),
        Line2D([], [], marker=ANSWERS["passes"], label="trial passes", **black),
        Line2D([], [], marker=ANSWERS["fails"], label="trial fails or escapes", **black),
        Line2D([], [], marker="o", markerfacecolor="white", label="no trial: predicted, or between neighbours, to pass", **black),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=SMALL_PT, frameon=False)


def highest(found: PassiveSet, panel: int) -> Floats:
    """Largest passive K [N/m] (nB,) of the grid at each damping; nan where none is."""
    stiffness, passive = found.axes[0], found.passive[:, :, panel]
    top = np.where(passive, stiffness[:, None], -np.inf).max(axis=0)
    return np.where(np.isfinite(top), top, np.nan)
