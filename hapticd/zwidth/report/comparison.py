"""The figure and the tables that compare displays: as they are, and per kilogram of moving mass,
where size alone is not an advantage.

Limitations: displays measured under unlike conditions. The title of the figure and of the tables
names the differences.
"""

from textwrap import fill

import numpy as np

from hapticd.core.errors import AnalysisError
from hapticd.signal.verdict import Judged
from hapticd.zwidth.compare import widths_db
from hapticd.zwidth.passive_set import AXES, Envelope
from hapticd.zwidth.portable import Compared, Comparison, Level, Reach
from hapticd.zwidth.report.envelope import edges
from hapticd.zwidth.report.paper import Cell, Table, legends, table
from hapticd.zwidth.report.style import (
    DEVICES,
    FINE,
    OFF,
    WIDTH_IN,
    Axes,
    Figure,
    Look,
    hertz_axis,
    legend_handles,
    level_label,
    mosaic,
    plain_axis,
    styled,
)  # fmt: skip

__all__ = ["comparison_figure", "comparison_tables"]

LINE_WIDTH = 100  # characters of a title
UNITS = {"K": "N/m", "B": "N s/m", "M": "g"}
SCALES = {"K": 1.0, "B": 1.0, "M": 1e3}
PANELS = (("size",) * 3 + ("mass",) * 3, ("K", "K", "B", "B", "M", "M"))


@styled()
def comparison_figure(found: Comparison, width_mm: float | None = None) -> Figure:
    """Draw envelopes |Z| [N s/m] and |Z| per mass [1/s] of all displays on the same axes, and below
    them the limits of K, B and M alone, with their intervals. A dashed line is without active
    damping.
    """
    names = " and ".join(one.name for one in found.displays)
    title = f"{_badge(found)}{names}\n{how(found)}"
    figure, places = mosaic(PANELS, WIDTH_IN, 5.6, title, width_mm, height_ratios=(1.5, 1.0))
    for rank, display in enumerate(found.displays):
        for level in display.levels:
            look = {
                "color": _device(rank)["color"],
                "linestyle": "-" if level.active_damping_ns_per_m else OFF["linestyle"],
            }
            words = f"{display.name} {level_label(level.active_damping_ns_per_m)}"
            for name, shown in (("size", level.envelope), ("mass", level.per_mass)):
                if shown is not None:
                    edges(
                        places[name],
                        shown.frequency_hz,
                        (shown.upper, shown.lower),
                        look,
                        words,
                        rank,
                    )
    judged_hz = np.array([one.conditions.judged_hz for one in found.displays])
    for name, words in (("size", "|Z| (N s/m)"), ("mass", "|Z| per moving mass (1/s)")):
        places[name].set(yscale="log", ylabel=words)
        hertz_axis(places[name], float(judged_hz[:, 0].min()), float(judged_hz[:, 1].max()))
        plain_axis(places[name].yaxis, FINE)
    for name in AXES:
        _limits(places[name], found, name)
    legends(figure, legend_handles(places["size"]), 2)
    return figure


def how(found: Comparison) -> str:
    """Describe the common conditions, and name the differences."""
    first = found.displays[0].conditions
    same = fill(
        f"{first.seconds:g} s of noise of {first.perturbation_psd_n2_per_hz:.3g} N^2/Hz a trial, "
        f"{100 * first.confidence:g} %, {Judged(*first.judged_hz).words}",
        LINE_WIDTH,
    )
    return f"{same}\nunlike: {', '.join(found.unlike)}" if found.unlike else same


def comparison_tables(found: Comparison) -> tuple[Table, ...]:
    """Return conditions; limits with their intervals and per mass; widths of the envelopes and
    other numbers.
    """
    return _conditions(found), _reaches(found), _widths(found)


def _conditions(found: Comparison) -> Table:
    rows = [
        (
            one.name,
            1e3 * one.conditions.mass_kg,
            *one.conditions.judged_hz,
            f"{one.conditions.perturbation_psd_n2_per_hz:.3g}",
            one.conditions.seconds,
            100.0 * one.conditions.confidence,
        )
        for one in found.displays
    ]
    return table(
        ("display", "mass g", "judged from Hz", "to Hz", "N^2/Hz", "s a trial", "confidence %"),
        rows,
        _badge(found) + how(found),
    )


def _reaches(found: Comparison) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            f"{reach.name} {UNITS[reach.name]}",
            display.name,
            level.active_damping_ns_per_m,
            *(SCALES[reach.name] * value for value in (reach.value, reach.lower, reach.upper)),
            reach.per_mass,
        )
        for name in AXES
        for display in found.displays
        for level, reach in _reached(display, name)
    ]
    return table(
        (
            "limit",
            "display",
            "added N s/m",
            "reaches",
            "passive up to",
            "not passive from",
            "per kg",
        ),
        rows,
    )


def _widths(found: Comparison) -> Table:
    every = [
        (display, level, _bands(level.envelope))
        for display in found.displays
        for level in display.levels
    ]
    names = list(every[0][2])
    rows: list[list[Cell]] = []
    for display, level, bands in every:
        widths = [bands.get(name, float("nan")) for name in names]
        rows.append([display.name, level.active_damping_ns_per_m, *widths, *level.numbers.values()])
    others = ("K-B area N^2 s/m^2", "dK/dB 1/s", "free to Hz")
    return table(("Z-width dB", "added N s/m", *names, *others), rows)


def _bands(envelope: Envelope) -> dict[str, float]:
    try:
        return {
            f"{band.low_hz:g}..{band.high_hz:g} Hz": band.width_db for band in widths_db(envelope)
        }
    except AnalysisError:
        return {}


def _badge(found: Comparison) -> str:
    return "SIMULATED " if any(one.conditions.simulated for one in found.displays) else ""


def _device(rank: int) -> Look:
    return DEVICES[rank % len(DEVICES)]


def _limits(axis: Axes, found: Comparison, name: str) -> None:
    """Draw a mark and its interval for each display and level, hollow without active damping."""
    reached = [
        (rank, *one)
        for rank, display in enumerate(found.displays)
        for one in _reached(display, name)
    ]
    for at, (rank, level, reach) in enumerate(reached):
        look = _device(rank)
        ends = sorted(SCALES[name] * end for end in (reach.lower, reach.upper))
        axis.vlines(at, ends[0], ends[1], color=look["color"])
        filled = look["color"] if level.active_damping_ns_per_m else "white"
        axis.plot(at, SCALES[name] * reach.value, linestyle="", markerfacecolor=filled, **look)
    axis.set_xticks(
        range(len(reached)), [f"{level.active_damping_ns_per_m:g}" for _, level, _ in reached]
    )
    axis.set(
        xlim=(-0.6, len(reached) - 0.4),
        ylabel=f"{name} ({UNITS[name]})",
        xlabel="active damping (N s/m)",
    )


def _reached(display: Compared, name: str) -> list[tuple[Level, Reach]]:
    """Return the limit of that name at each level."""
    return [
        (level, reach) for level in display.levels for reach in level.limits if reach.name == name
    ]
