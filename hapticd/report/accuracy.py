"""What accuracy costs in time, as a figure, a table and sentences."""

from math import inf, isnan
from typing import TYPE_CHECKING

from hapticd.measure.accuracy import AccuracyResult
from hapticd.measure.gauge import GROUP
from hapticd.measure.knee import Row
from hapticd.measure.scenes import SUBSTEPS
from hapticd.report import figures
from hapticd.report.table import Cell, Table, duration, shown, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS_OF_NOISE = [["tier", "sub-steps", "effect"], ["trial length", "window", "effect"]]
PANELS_OF_TRACES = [["tier", "sub-steps", "effect"]]
TITLES = {
    "tier": "ways to simulate",
    "sub-steps": "sub-steps per 4 kHz sample",
    "trial length": "length of the trial",
    "window": "window of the spectra, samples",
}
SWEEPS = ("tier", "sub-steps", "precision", "trial length", "window")
WAYS = ("v", "^", "s", "o", "D", "P")
LINES = ("sub-steps", "trial length", "window")
FEWEST_BARS = 8
NOTHING = 1e-6  # of the worst error: what is less is none


def accuracy_table(result: AccuracyResult) -> Table:
    """Every setting that was measured."""
    rows: list[list[Cell]] = [
        [row.sweep, row.label, duration(row.seconds), row.step, row.total, _marks(row)] for row in result.rows
    ]
    return table(["sweep", "setting", "for one trial", f"setting's error {result.unit}", f"total error {result.unit}", ""], rows)


def accuracy_words(result: AccuracyResult) -> list[str]:
    """What the defaults buy, and where each sweep has its knee."""
    default = result.default
    words = [
        f"Reference: {result.reference}. Error: {result.quantity}. Seconds of one core, for one of {GROUP} trials together.",
        f"The defaults ({_defaults(result)}) cost {duration(default.seconds)} and leave {shown(default.total)} {result.unit}, "
        f"{shown(default.step)} {result.unit} of it by the sub-step.",
    ]
    for sweep in (name for name in SWEEPS if name in {row.sweep for row in result.rows}):
        words.append(_knee(result, sweep))
    return words


def accuracy_figure(result: AccuracyResult) -> "Figure":
    """Error over seconds, a panel for each sweep, and what leaving an effect out does. ConfigError without matplotlib."""
    noise = result.plan.noise
    with figures.style():
        figure, places = figures.mosaic(PANELS_OF_NOISE if noise else PANELS_OF_TRACES, 12.5, 7.0 if noise else 5.0)
        figure.suptitle(
            f"{result.plan.params.scene.title}: what accuracy costs in time\n"
            f"error: {result.quantity}; reference: {result.reference}"
        )
        for name, axis in places.items():
            if name == "effect":
                _draw_effects(result, axis)
            else:
                _draw_sweep(result, name, axis)
        figure.legend(*places["sub-steps"].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure


def _defaults(result: AccuracyResult) -> str:
    window = ", window 2048" if result.plan.noise else ""
    return f"{result.plan.seconds:g} s, {SUBSTEPS} sub-steps, f64{window}"


def _knee(result: AccuracyResult, sweep: str) -> str:
    rows = [row for row in result.sweep(sweep) if not isnan(row.seconds)]
    best = next((row for row in rows if row.knee), None)
    if best is None:
        return f"{sweep}: nothing could be measured."
    words = f"{sweep}: the knee is {best.label} ({duration(best.seconds)}, {shown(best.total)} {result.unit})"
    if sweep == "trial length" and best is rows[-1]:
        return f"{words}; the error still falls as 1/sqrt(length), a longer trial would buy more."
    return f"{words}; dearer settings gain less than 10 %." if best is not rows[-1] else f"{words}."


def _marks(row: Row) -> str:
    return ", ".join([*(["default"] if row.default else []), *(["knee"] if row.knee else []), *([row.note] if row.note else [])])


def _draw_sweep(result: AccuracyResult, sweep: str, axis: "Axes") -> None:
    rows = [row for row in result.sweep(sweep) if row.total < inf]
    least = _least(result)
    for place, row in enumerate(rows):
        error, marker = max(row.total, least), WAYS[place % len(WAYS)] if sweep == "tier" else "o"
        label = f"{row.label} (exact)" if row.total < least else row.label
        axis.plot(
            row.seconds,
            error,
            marker,
            color=figures.BLUE,
            label=label if sweep == "tier" else "total error of one trial" if not place else None,
        )
        _mark(row, error, axis)
        if sweep != "tier":
            axis.annotate(label, (row.seconds, error), xytext=(4, 6), textcoords="offset points", fontsize=8)
    if sweep in LINES:
        axis.plot([row.seconds for row in rows], [max(row.total, least) for row in rows], "-", color=figures.BLUE)
    if sweep == "sub-steps":
        _draw_step_errors(result, rows, axis)
    axis.set(yscale="log", xscale="log", title=TITLES[sweep], xlabel="time for one trial", ylabel=f"error ({result.unit})")
    axis.margins(x=0.2, y=0.2)
    figures.seconds_axis(axis.xaxis)
    figures.plain_axis(axis.yaxis)
    if sweep == "tier":
        axis.margins(x=0.2, y=0.9)
        axis.legend(loc="best", fontsize=7.5)


def _least(result: AccuracyResult) -> float:
    """Where errors are drawn that are none: below the least that is one."""
    known = [row.total for row in result.rows if row.total < inf]
    return 0.3 * min(total for total in known if total >= NOTHING * max(known))


def _draw_step_errors(result: AccuracyResult, rows: list[Row], axis: "Axes") -> None:
    """Of the sub-step alone, and single precision beside it; the marks that all panels share get their names here."""
    stepped = [row for row in rows if row.step > NOTHING * max(row.total for row in rows)]
    axis.plot(
        [row.seconds for row in stepped],
        [row.step for row in stepped],
        "o:",
        color=figures.SKY,
        label="error of the sub-step alone",
    )
    single = [row for row in result.sweep("precision") if row.label.startswith("f32") and row.total < inf]
    axis.plot(
        [row.seconds for row in single],
        [row.total for row in single],
        "v",
        color=figures.PURPLE,
        label="single precision, 1 and 4 sub-steps",
    )
    axis.plot([], [], "o", markersize=12, markerfacecolor="none", color=figures.BLACK, label="defaults")
    axis.plot([], [], "*", markersize=13, color=figures.ORANGE, label="knee")


def _mark(row: Row, error: float, axis: "Axes") -> None:
    if row.default:
        axis.plot(row.seconds, error, "o", markersize=12, markerfacecolor="none", color=figures.BLACK)
    if row.knee:
        axis.plot(row.seconds, error, "*", markersize=13, color=figures.ORANGE, zorder=3)


def _draw_effects(result: AccuracyResult, axis: "Axes") -> None:
    """Bars of what leaving an effect out does to the answer; with the share of time that it saves."""
    rows = sorted(result.sweep("effect"), key=lambda row: row.step)
    known = [row.step for row in rows if row.step < inf]
    worst = max([*known, result.default.total])
    least = 1e-4 * worst
    for place, row in enumerate(rows):
        shown_error = min(max(row.step, least), 3.0 * worst)
        axis.barh(place, shown_error, color=figures.GREEN)
        axis.text(1.15 * shown_error, place, _told(row, least), va="center", fontsize=8)
    axis.axvline(result.default.total, color=figures.BLACK, linestyle="--", linewidth=1.0)
    axis.text(result.default.total, max(len(rows), FEWEST_BARS) - 0.4, "one trial's error", fontsize=8, ha="center", va="bottom")
    axis.set(
        xscale="log", xlim=(least, 60.0 * worst), ylim=(-0.6, max(len(rows), FEWEST_BARS) + 0.3), xlabel=f"error ({result.unit})"
    )
    axis.set(yticks=range(len(rows)), yticklabels=[row.label for row in rows], title="effects, each left out")
    axis.grid(visible=False, axis="y")


def _told(row: Row, least: float) -> str:
    if row.step == inf:
        return "cannot be left out"
    return "none" if row.step < least else shown(row.step)
