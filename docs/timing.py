"""Benefit of a shorter delay: `python docs/timing.py` fills the table of docs/timing.md and draws
its figure; about five minutes on two cores.

A board with two sequential transfers of 0.4 ms makes the force act 0.69 periods after its sample
(ADR-0008). With transfers in flight it can act after 0.25. Each row is one limit of K or B at both
delays:

    law          b / (T/2 + delay + lags): the low-frequency bound, for K with B = 0
    theorem      no friction, every input (model.theorem), including stability
    prediction   white noise, friction linearised (model.predict), as in trials
    trials       90 s of noise each, searched to 1 % (zwidth.limits), mean over SEEDS

Nothing is fitted, and no bus is simulated: the delay is that of the model.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent)]

from pages.markdown import replaced, table  # noqa: E402

from benchmarks.timing import (  # noqa: E402
    IN_FLIGHT_PERIODS,
    PHYSICAL_NS_PER_M,
    SEQUENTIAL_PERIODS,
    rigid,
    tried_limit,
)
from hapticd.model.bases import Conditions, Theorem  # noqa: E402
from hapticd.model.effects import Amplifier, Delay, Smoothing, Viscous  # noqa: E402
from hapticd.model.scene import Scene  # noqa: E402
from hapticd.settings.scene import load_scene  # noqa: E402
from hapticd.zwidth.limits import ORIGIN, AxisLimit, predicted_limit  # noqa: E402
from hapticd.zwidth.outcomes import Point  # noqa: E402
from hapticd.zwidth.passive_set import axis_limit  # noqa: E402
from hapticd.zwidth.report.style import PREDICTED, WIDTH_IN, Colour, axes, styled  # noqa: E402
from hapticd.zwidth.sources import display  # noqa: E402

PAGE = DOCS / "timing.md"
FIGURE = DOCS / "figures" / "timing.svg"
DELAYS = (SEQUENTIAL_PERIODS, IN_FLIGHT_PERIODS)
SHOWN = np.linspace(0.0, 1.0, 33)  # periods, of the figure
SEEDS = 4
REACH = (5e3, 10.0)  # of K [N/m] and B [N s/m]
HEADINGS = ("display", "limit", "method", "0.69 periods", "0.25 periods", "ratio")


@dataclass(frozen=True)
class Row:
    """One limit of one display, at any delay."""

    name: str
    axis: int  # 0 K, 1 B
    scene: Callable[[float], Scene]  # with that delay [periods]
    base: Point = ORIGIN

    @property
    def unit(self) -> str:
        """K or B with its unit."""
        return ("K [N/m]", "B [N s/m]")[self.axis]

    @property
    def has_law(self) -> bool:
        """Whether the low-frequency bound applies: for K without B."""
        return self.axis == 0 and self.base == ORIGIN


def paper_display(delay_periods: float) -> Scene:
    """Return the device `weir2008` of Fig. 4 with another delay."""
    scene = load_scene("fig4")
    effects = (
        replace(one, periods=delay_periods) if isinstance(one, Delay) else one
        for one in scene.effects
    )
    return replace(scene, effects=tuple(effects))


ROWS = (
    Row("rigid, b = 0.36 N s/m, B = 0", 0, lambda delay: rigid(PHYSICAL_NS_PER_M, delay)),
    Row("rigid, b = 2.1 N s/m, B = 2 N s/m", 0, lambda delay: rigid(2.1, delay), (0.0, 2.0, 0.0)),
    Row("rigid, b = 0.36 N s/m, K = 0", 1, lambda delay: rigid(PHYSICAL_NS_PER_M, delay)),
    Row("weir2008, without active damping", 0, paper_display),
)


def law(scene: Scene, delay_periods: float) -> float:
    """Return K [N/m] at the low-frequency bound, with the lags of the device."""
    rate_hz = display(scene).model.rate_hz
    lags_s = (0.5 + delay_periods) / rate_hz
    physical_ns_per_m = 0.0
    for one in scene.effects:
        if isinstance(one, Smoothing):
            lags_s += 1.0 / (2.0 * np.pi * one.corner_hz)
        elif isinstance(one, Amplifier):
            lags_s += 1.0 / (2.0 * np.pi * one.bandwidth_hz)
        elif isinstance(one, Viscous):
            physical_ns_per_m = one.rotor_ns_per_m + one.slider_ns_per_m
    return physical_ns_per_m / lags_s


def theorem(row: Row, delay_periods: float) -> float:
    """Return the limit for every input, without friction."""
    shown = display(row.scene(delay_periods))
    at = Conditions(0.0, shown.filters, delay_periods, 0.0)
    basis = Theorem(shown.model)
    return axis_limit(lambda points: basis.safe(points, at), row.axis, REACH[row.axis], row.base)


def prediction(row: Row, delay_periods: float) -> float:
    """Return the limit under white noise, with the friction of the trials."""
    shown = display(row.scene(delay_periods))
    return predicted_limit(shown, 0.0, row.axis, row.base, reach=REACH[row.axis])


def trials(row: Row, delay_periods: float, seeds: int = SEEDS) -> AxisLimit:
    """Return the limit by trials."""
    return tried_limit(row.scene(delay_periods), row.axis, row.base, seeds)


def line(row: Row, method: str, values: tuple[float, float], more: str = "") -> tuple[str, ...]:
    """Return one line of the table."""
    digits = (".0f", ".3f")[row.axis] if row.name.startswith("rigid") else ".1f"
    shown = [f"{value:{digits}}" for value in values]
    return row.name, row.unit, method + more, *shown, f"{values[1] / values[0]:.2f}"


def quick_lines(row: Row) -> list[tuple[str, ...]]:
    """Return the lines of a row that need no trials."""
    first, second = DELAYS
    lines = [
        line(row, "theorem", (theorem(row, first), theorem(row, second))),
        line(row, "prediction", (prediction(row, first), prediction(row, second))),
    ]
    if row.has_law:
        bounds = (law(row.scene(first), first), law(row.scene(second), second))
        lines.insert(0, line(row, "law", bounds))
    return lines


def tried_line(row: Row, found: list[AxisLimit]) -> tuple[str, ...]:
    """Return the line of a row by trials."""
    scatter = max(one.sd / one.value for one in found)
    more = f" ({SEEDS} seeds, scatter {100.0 * scatter:.1f} %)"
    return line(row, "trials", (found[0].value, found[1].value), more)


def drawn(axis, row: Row, found: list[AxisLimit]) -> None:
    """Draw a limit over the delay."""
    bounds = [theorem(row, delay) for delay in SHOWN]
    axis.plot(SHOWN, bounds, color=Colour.BLUE, label="theorem")
    axis.plot(SHOWN, [prediction(row, delay) for delay in SHOWN], **PREDICTED, label="predicted")
    if row.has_law:
        bounds = [law(row.scene(delay), delay) for delay in SHOWN]
        axis.plot(SHOWN, bounds, color=Colour.GREY, linewidth=0.8, label="b / (T/2 + delay + lags)")
    axis.plot(DELAYS, [one.value for one in found], "o", color=Colour.BLACK, label="trials")
    axis.set(title=row.name, xlabel="delay, sample to force (periods)", ylabel=row.unit)
    axis.set(xlim=(0.0, 1.0), ylim=(0.0, None))
    axis.legend()


@styled()
def draw(found: list[list[AxisLimit]]) -> None:
    """Draw all rows, each in a panel."""
    figure, panels = axes(2, 2, WIDTH_IN, 5.4)
    for panel, row, limits in zip(panels, ROWS, found, strict=True):
        drawn(panel, row, limits)
    figure.savefig(FIGURE, metadata={"Date": None})


def main() -> None:
    """Compute everything, fill the page, draw the figure."""
    found = [[trials(row, delay) for delay in DELAYS] for row in ROWS]
    lines = [
        one
        for row, limits in zip(ROWS, found, strict=True)
        for one in (*quick_lines(row), tried_line(row, limits))
    ]
    PAGE.write_text(replaced(PAGE.read_text(), "timing", table(HEADINGS, lines)))
    draw(found)


if __name__ == "__main__":
    main()
