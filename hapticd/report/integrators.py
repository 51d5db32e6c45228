"""Where explicit methods blow up beside the exact map, as a figure."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.integrators import Comparison
from hapticd.report import figures
from hapticd.report.table import duration

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {"exact": "exact map", "rk4": "Runge-Kutta 4", "euler": "explicit Euler"}
LOOKS = {"exact": (figures.BLUE, "o"), "rk4": (figures.GREEN, "s"), "euler": (figures.RED, "^")}
LEAST, GONE = 1e-16, 3.0  # lowest error drawn; where those without an answer are drawn


def integrators_figure(found: Comparison, title: str) -> "Figure":
    """Error over steps per millisecond; crosses where nothing is left of the answer. ConfigError without matplotlib."""
    with figures.style():
        figure, (axis,) = figures.axes(1, 1, 8.0, 4.8)
        for method, (colour, marker) in LOOKS.items():
            error, steps = found.error[method], found.steps_per_ms
            kept = np.isfinite(error)
            limit = found.longest_s[method]
            stable = "stable at any step" if np.isinf(limit) else f"stable below {duration(limit)}"
            axis.plot(steps[kept], np.maximum(error[kept], LEAST), color=colour, marker=marker, label=f"{NAMES[method]}: {stable}")
            axis.plot(
                steps[~kept],
                np.full(int((~kept).sum()), GONE * (1.6 if method == "euler" else 0.9)),
                "x",
                color=colour,
                markersize=7,
            )
            if np.isfinite(limit):
                axis.axvline(1e-3 / limit, color=colour, linestyle=":", linewidth=1.0)
        axis.set_xscale("log", base=2)
        axis.set(yscale="log", ylim=(LEAST, 30.0), xlabel="steps per millisecond", ylabel="relative error after 20 ms", title=title)
        axis.xaxis.set_major_formatter(lambda value, place: f"{value:g}")
        axis.text(found.steps_per_ms[-1], GONE, "blown up", ha="right", va="center", fontsize=8.5)
        axis.legend(loc="center right")
    return figure
