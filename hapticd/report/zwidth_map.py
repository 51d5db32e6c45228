"""Figures of maps: the K-B boundary at several virtual masses, and the envelopes of |Z| and phase with their owners."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import PassiveSet
from hapticd.analysis.envelope import Edge, Envelope, admittance
from hapticd.measure.campaign import LevelMap, MapResult
from hapticd.measure.outcomes import Conditions
from hapticd.report import figures
from hapticd.report.zwidth import ADMITTANCE, IMPEDANCE, hertz_axis, plain_log

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Levels = Sequence[tuple[float, Envelope]]
PANELS = 6


def set_figure(result: MapResult) -> "Figure":
    """The largest passive K over B, a panel for each of up to six virtual masses, a line for each damping level."""
    mass = result.plan.params.axes[2]
    shown = np.unique(np.linspace(0, mass.size - 1, min(PANELS, mass.size)).round().astype(int))
    with figures.style():
        rows = -(-len(shown) // 3)
        figure, places = figures.axes(rows, 3, 9.6, 2.9 * rows + 0.8, sharex=True, sharey=True)
        figure.suptitle(
            f"SIMULATED {result.plan.params.conditions.scene.device}: passive set, trials filled, predicted points open",
            fontsize=9.5,
        )
        for panel, place in zip(shown, places, strict=False):
            for look, level in enumerate(result.levels):
                _plane(place, level, int(panel), figures.COLOURS[look % len(figures.COLOURS)])
            place.set_title(f"M = {1e3 * mass[panel]:.3g} g")
        for place in places[len(shown) :]:
            place.set_axis_off()
        for place in places[max(0, len(shown) - 3) : len(shown)]:
            place.set_xlabel("B [N s/m]")
            place.tick_params(labelbottom=True)
        for row in range(rows):
            places[3 * row].set_ylabel("K [N/m]")
        figure.legend(*places[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return figure


def envelope_figure(conditions: Conditions, envelopes: Levels, inverse: bool = False) -> "Figure":
    """Largest and smallest passive |Z| and phase of the trials, one colour for each damping level; owners below.

    `inverse`: of the admittance Y = 1/Z, whose largest values are owned by the smallest |Z|.

    `envelopes`: (added damping [Ns/m], envelope) of each level.
    """
    view = ADMITTANCE if inverse else IMPEDANCE
    shown = [(damping, admittance(found) if inverse else found) for damping, found in envelopes]
    with figures.style():
        figure, (size, phase) = figures.axes(2, 1, 8.4, 8.4, sharex=True)
        figure.suptitle(
            f"SIMULATED {conditions.scene.device}: Z-width envelope {'as admittance ' if inverse else ''}at the probe, "
            f"{conditions.seconds:g} s trials, bands: 95 % of the owner's estimate",
            fontsize=9.5,
        )
        for look, (damping, found) in enumerate(shown):
            _edges(size, phase, found, damping, figures.COLOURS[look % len(figures.COLOURS)])
        for place in (size, phase):
            hertz_axis(place)
        size.set_ylabel(f"|{view.symbol}| [{view.unit}]")
        plain_log(size)
        phase.set(ylabel=f"phase of {view.symbol} [deg]", xlabel="frequency [Hz]", yticks=range(-90, 91, 30))
        for edge in (-90.0, 90.0):
            phase.axhline(edge, color=figures.BLACK, linewidth=0.9, linestyle=":")
        size.legend(loc="upper right" if inverse else "lower right")
        figure.supxlabel(owners_text(shown), fontsize=7.5, x=0.02, ha="left", family="monospace")
        return figure


def owners_text(envelopes: Levels) -> str:
    """Which trials own most of the upper and the lower edge of |Z|, or of |Y|."""
    lines = [f"edges of |{'Y' if any(found.kind == 'admittance' for _, found in envelopes) else 'Z'}| are owned mostly by"]
    for damping, found in envelopes:
        for name, edge in (("largest ", found.upper), ("smallest", found.lower)):
            lines.append(f"{damping:g} N s/m, {name}: {'; '.join(_owners(found, edge))}")
    return "\n".join(lines)


def _owners(found: Envelope, edge: Edge) -> list[str]:
    index, count = np.unique(edge.owner, return_counts=True)
    most = index[np.argsort(-count, kind="stable")][:2]
    return [found.trials[place] for place in most]


def _edges(size: "Axes", phase: "Axes", found: Envelope, damping: float, colour: str) -> None:
    f = found.frequency_hz
    for edge, style in ((found.upper, "-"), (found.lower, "--")):
        spread = np.exp(figures.INTERVAL * edge.sd)
        size.fill_between(f, edge.value / spread, edge.value * spread, color=colour, alpha=0.2, linewidth=0)
        word = "largest" if style == "-" else "smallest"
        size.plot(f, edge.value, style, color=colour, label=f"{word}, added damping {damping:g} N s/m")
    for edge, style in ((found.phase_upper, "-"), (found.phase_lower, "--")):
        phase.fill_between(
            f,
            edge.value - figures.INTERVAL * edge.sd,
            edge.value + figures.INTERVAL * edge.sd,
            color=colour,
            alpha=0.2,
            linewidth=0,
        )
        phase.plot(f, edge.value, style, color=colour)


def _plane(place: "Axes", level: LevelMap, panel: int, colour: str) -> None:
    stiffness, damping, _ = level.found.axes
    shape = level.found.margin.shape
    passive, tried = level.found.passive[:, :, panel], level.tried.reshape(shape)[:, :, panel]
    k, b = np.meshgrid(stiffness, damping, indexing="ij")
    name = f"added damping {level.damping_ns_per_m:g} N s/m"
    place.plot(damping, highest(level.found, panel), color=colour, label=name)
    marker: dict[str, Any] = {"linestyle": "", "color": colour, "markersize": 3.5}
    place.plot(b[passive & tried], k[passive & tried], marker="o", **marker)
    place.plot(b[passive & ~tried], k[passive & ~tried], marker="o", fillstyle="none", markeredgewidth=0.6, **marker)


def highest(found: PassiveSet, panel: int) -> Floats:
    """Largest passive K [N/m] (nB,) of the grid at each damping; nan where none is."""
    stiffness, passive = found.axes[0], found.passive[:, :, panel]
    top = np.where(passive, stiffness[:, None], -np.inf).max(axis=0)
    return np.where(np.isfinite(top), top, np.nan)
