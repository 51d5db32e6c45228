"""A motion, the force that was, and the force that would have been."""

from typing import TYPE_CHECKING

from hapticd.measure.reflight import Reflight
from hapticd.report import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def reflight_figure(flight: Reflight, title: str, changed: str = "flown again") -> "Figure":
    """Position, both forces and their difference over time. `changed`: what was held otherwise. ConfigError without matplotlib."""
    with figures.style():
        figure, (position, force, difference) = figures.axes(3, 1, 10.0, 8.0, sharex=True)
        time_s, recorded, flown = flight.time_s, flight.recorded["force_n"], flight.flown["force_n"]
        position.plot(time_s, 1e3 * flight.recorded["position_m"], color=figures.BLACK)
        position.set_ylabel("position as recorded (mm)")
        force.plot(time_s, recorded, color=figures.BLACK, label="recorded")
        force.plot(time_s, flown, color=figures.GREEN, linewidth=0.9, label=changed)
        force.set_ylabel("force (N)")
        force.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        difference.plot(time_s, flown - recorded, color=figures.GREEN)
        difference.set_ylabel("difference (N)")
        difference.set_xlabel("time (s)")
        figure.suptitle(title)
    return figure
