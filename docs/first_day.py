"""The figures of docs/first-day.md: `python docs/first_day.py`, from one blind rig of the tests.

The shown steps run on the rig SEED, in virtual time, so the same code gives the same bytes. The
truth is drawn only here, for comparison: the steps do not have it.
"""

import sys
from pathlib import Path

import numpy as np

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent / "tests")]

from support.blind_rig import BlindRig, first_day  # noqa: E402

from hapticd.rig.result import StepResult, line  # noqa: E402
from hapticd.zwidth.report.style import WIDTH_IN, Colour, axes, styled  # noqa: E402

SEED = 2026
SHOWN_S = 0.15  # of a push
FIGURE = DOCS / "figures" / "first-day.svg"


def moved(axis, result: StepResult) -> None:
    """Draw the handle moving to positive x, with falling or rising counts."""
    counts = result.arrays["moving"]
    axis.plot(np.arange(len(counts)) / 1e3, counts / 1e3, color=Colour.BLUE)
    axis.set(title="encoder: moved to positive x", xlabel="time (s)", ylabel="thousand counts")


def pushed(axis, result: StepResult) -> None:
    """Draw two pushes, and the resulting motion, by the encoder's new sign."""
    for number, colour in ((0, Colour.BLUE), (1, Colour.ORANGE)):
        force = result.arrays[f"force_n_{number}"]
        position = result.arrays[f"position_m_{number}"]
        begin = int(np.flatnonzero(force)[0])
        at = slice(max(0, begin - 20), begin + round(1e3 * SHOWN_S))
        time_ms = np.arange(at.start, at.start + len(position[at])) - begin
        label = f"{np.abs(force).max() * np.sign(force[begin]):+.2g} N for 20 ms"
        axis.plot(time_ms, 1e3 * (position[at] - position[begin]), color=colour, label=label)
    axis.set(title="motor: two pushes", xlabel="time (ms)", ylabel="moved by (mm)")
    axis.legend()


def hung(axis, result: StepResult) -> None:
    """Draw the commanded force at rest under each weight, from above and from below,
    and the line.
    """
    weights = result.arrays["weights_n"]
    readings = result.arrays["readings_n"]
    slope, intercept = line(weights, readings.mean(axis=1)).values
    axis.plot(weights, intercept + slope * weights, color=Colour.BLACK, linewidth=0.8)
    for place, colour in ((0, Colour.BLUE), (1, Colour.ORANGE)):
        label = ("from positive x", "from negative x")[place]
        axis.plot(weights, readings[:, place], "o", color=colour, label=label)
    axis.set(title="motor: masses", xlabel="weight (N)", ylabel="commanded at rest (N)")
    axis.legend()


def found(axis, results: list[StepResult], rig: BlindRig) -> None:
    """Draw the found values over the true ones, with intervals; the newest if two steps
    found it.
    """
    known = {one.name: one for result in results for one in result.values if one.high > one.low}
    truths = {name: rig.true(name) for name in known if name not in LEFT_OUT}
    shown = [(known[name], true) for name, true in truths.items() if true]
    for row, (one, true) in enumerate(shown):
        ends = 100.0 * (np.array([one.low, one.value, one.high]) / true - 1.0)
        axis.plot(ends[[0, 2]], [row, row], color=Colour.BLUE)
        axis.plot(ends[1], row, "o", color=Colour.BLUE)
    axis.axvline(0.0, color=Colour.BLACK, linewidth=0.8)
    axis.set(title="measured, and true value", xlabel="difference (%)", xlim=(-6.0, 6.0))
    axis.set_yticks(range(len(shown)), [one.name for one, _ in shown], fontsize=7)
    axis.invert_yaxis()


# values near 0, for which a share has no meaning, and those as wide as the axis: the division of a
# lag into delay and smoothing
LEFT_OUT = (
    "delay",
    "smoothing",
    "clock drift",
    "friction seen",
    "force.offset_count",
    "watchdog",
)


def with_array(results: list[StepResult], name: str) -> StepResult:
    """Return the result that was computed from the array `name`."""
    return next(result for result in results if name in result.arrays)


def main() -> None:
    """Run the day and draw it."""
    with BlindRig(SEED) as rig, styled():
        day = first_day(rig)
        if day.error:
            raise SystemExit(day.error)
        figure, (first, second, third, fourth) = axes(2, 2, WIDTH_IN, 5.0)
        moved(first, with_array(day.results, "moving"))
        pushed(second, with_array(day.results, "force_n_0"))
        hung(third, with_array(day.results, "weights_n"))
        found(fourth, day.results, rig)
        figure.savefig(FIGURE, metadata={"Date": None})


if __name__ == "__main__":
    main()
