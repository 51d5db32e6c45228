"""Figures at the width of a column: type, panels, words, ticks; the same bytes each time."""

from typing import Any

import numpy as np

from hapticd.zwidth.report.paper import legends
from hapticd.zwidth.report.style import axes, hertz_axis, legend_handles, styled

LONG = "a label of a line that is longer than half of a column, in words"


@styled()
def drawn(width_mm: float | None = None) -> Any:
    """Six panels in two rows, wide as a screen, with long words, narrow ticks and a legend."""
    title = "A title that goes on, SIMULATED, for K = 100 N/m " * 3
    figure, places = axes(2, 3, 9.6, 6.0, title, width_mm=width_mm, sharey=True)
    f = np.geomspace(1.0, 1000.0, 50)
    for at, place in enumerate(places):
        place.plot(f, f * (1 + at), label=f"{LONG} {at % 2}")
        hertz_axis(place, 1.0, 1000.0)
        place.set(title=f"M = {at} g, and what else is to be said of it", ylabel="force (N)")
        place.label_outer()
        place.set_xlabel("frequency (Hz)")
    legends(figure, legend_handles(places[0]) + legend_handles(places[1]), 3)
    return figure
