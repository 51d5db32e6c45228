"""Figure of a trial that escaped: its force and velocity; a spectrum of them would be that of no impedance."""

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.trial import TrialResult
from hapticd.report import figures
from hapticd.report.looks import of_levels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LETTERS = 100  # of a line


def escape_figure(result: TrialResult, title: str) -> "Figure":
    """Force of the probe [N] and velocity [m/s] from the beginning to the end. Call it within `figures.style`."""
    recorded, look = result.recorded, of_levels([result.plan.params.trial.damping_ns_per_m])[0]
    figure, (force, velocity) = figures.axes(2, 1, 7.2, 5.4, sharex=True)
    why = fill(f"ESCAPED, so there is no impedance to draw: {recorded.ended.removeprefix('escape: ')}", LETTERS)
    figure.suptitle(f"{title}\n{why}", fontsize=9.5, x=0.01, ha="left")
    time_s = np.arange(recorded.force_n.size) / recorded.rate_hz
    for axis, values in ((force, recorded.force_n), (velocity, recorded.velocity_m_per_s)):
        axis.plot(time_s, values, color=look["color"], linewidth=0.6, rasterized=True)
    force.set_ylabel("force of the probe (N)")
    velocity.set(ylabel="velocity (m/s)", xlabel="time (s)", xlim=(0.0, recorded.seconds))
    figure.align_ylabels([force, velocity])
    return figure
