"""Figures, tables and sentences of the studies that compare methods: the effects that a question
needs, the computing time of accuracy, and the gain of remedies.

Limitations: an error of 0 on a logarithmic axis. Zero errors are drawn below all others and called
exact; a change out of range is drawn at the end of its axis.
"""

from collections.abc import Sequence
from itertools import cycle
from math import inf, isnan, nan
from typing import Any

import numpy as np

from hapticd.core.arrays import Complexes
from hapticd.studies.accuracy import AccuracyResult, AccuracyRow
from hapticd.studies.effects import GROUP, EffectsResult, LeftOut
from hapticd.studies.port_energy import SECONDS, EnergyRow
from hapticd.studies.remedies import RENDERED_HZ, Row
from hapticd.zwidth.report.paper import Cell, Table, changed, duration, legends, shown, table
from hapticd.zwidth.report.style import (
    FINE,
    Axes,
    Colour,
    Figure,
    Look,
    axes,
    legend_handles,
    mark,
    mosaic,
    patch,
    plain_axis,
    size_in,
    styled,
)
from hapticd.zwidth.sources import SUBSTEPS

__all__ = [
    "accuracy_figure",
    "accuracy_table",
    "accuracy_words",
    "effects_figure",
    "effects_table",
    "effects_words",
    "port_energy_table",
    "remedies_table",
]


# ends of the axis of relative changes
LEAST = 1e-4
MOST = 20.0
QUESTIONS = {
    "limits": "what its passivity limits need",
    "phase": "what the phase of Z needs",
    "peak": "what the peak of |Z| needs",
}
ROOMY_IN = 4.0  # for all TICKS
TICKS = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)
DROPPED = "#c8d7e6"
PANELS_OF_NOISE = [["tier", "sub-steps", "effect"], ["trial length", "window", "effect"]]
TITLES = {
    "tier": "ways to simulate",
    "sub-steps": "sub-steps per 4 kHz sample",
    "trial length": "length of the trial",
    "window": "window of the spectra, samples",
}
SWEEPS = ("tier", "sub-steps", "precision", "trial length", "window")
WAYS = ("v", "^", "s", "o", "D", "P")
FEWEST_BARS = 8  # minimum room on an axis, in bars
TIMES = ((1.0,), (1.0, 3.0), *FINE)  # digits of ticks: their words are long
NOTHING = 1e-6  # of the worst error: smaller errors count as 0
DEFAULT: Look = {
    "marker": "o",
    "markersize": 12,
    "markerfacecolor": "none",
    "color": Colour.BLACK,
    "linestyle": "",
}
CHEAPEST = "cheapest setting within 10 % of the best"  # label of `knee`
KNEE: Look = {"marker": "*", "markersize": 13, "color": Colour.ORANGE, "linestyle": "", "zorder": 3}


# --- which effects a question needs ---------------------------------------------------------------


def effects_table(result: EffectsResult) -> Table:
    """Return the whole scene, every effect left out, and the proposal."""
    names = list(result.whole[0].numbers)
    rows = [
        *(("all effects", row) for row in result.whole),
        *((f"without {row.effect}", row) for row in result.rows),
        ("proposal", result.proposal),
    ]
    cells: list[list[Cell]] = [
        [
            name,
            *(row.numbers.get(each, nan) for each in names),
            row.note or changed(row.change),
            row.method,
            duration(row.cost_s),
        ]
        for name, row in rows
    ]
    return table(["scene", *names, "change", "method", "engine, per simulated s"], cells)


def effects_words(result: EffectsResult) -> str:
    """Describe the proposal."""
    params = result.plan.params
    kept = result.kept
    if all(isnan(number) for number in result.whole[0].numbers.values()):
        return (
            "Without any environment the scene is not passive already, so it has no"
            f" {params.question}; ask --for phase."
        )
    left_out = [key for key in params.scene.removable if key not in kept]
    if not left_out:
        return (
            f"Every effect changes {params.question} by more than {changed(params.tolerance)}: keep"
            " them all."
        )
    before = result.whole[1].cost_s
    after = result.proposal.cost_s
    return (
        f"For {params.question} within {changed(params.tolerance)} keep"
        f" {', '.join(kept) or 'none'}. Without {', '.join(left_out)} the answer changes by"
        f" {changed(result.proposal.change)} together, and a simulated second costs"
        f" {duration(after)} instead of {duration(before)}."
    )


@styled()
def effects_figure(result: EffectsResult, width_mm: float | None = None) -> Figure:
    """Draw the change of the answer, effect by effect. ConfigError without matplotlib."""
    params = result.plan.params
    rows = result.rows[::-1]
    title = f"{params.scene.title}: {QUESTIONS[params.question]}"
    figure, (axis,) = axes(1, 1, 8.5, 1.8 + 0.3 * len(rows), title, width_mm=width_mm)
    changes = [min(max(row.change, LEAST), MOST) for row in rows]
    _bars(
        axis,
        [row.effect for row in rows],
        changes,
        [_changed(row) for row in rows],
        color=[Colour.BLUE if row.effect in result.kept else DROPPED for row in rows],
        hatch=["" if row.method == "predicted" else "///" for row in rows],
    )
    axis.axvline(params.tolerance, color=Colour.RED)
    words = f"tolerance {changed(params.tolerance)}"
    axis.text(
        1.05 * params.tolerance,
        len(rows) - 0.45,
        words,
        color=Colour.RED,
        va="bottom",
        fontsize="small",
    )
    axis.set(
        xlim=(LEAST, 4 * MOST),
        ylim=(-0.6, len(rows) + 0.2),
        xlabel=f"change of {params.question} when left out",
    )
    shown_ticks = TICKS if size_in(axis)[0] > ROOMY_IN else TICKS[::2]
    axis.set_xticks(shown_ticks, [changed(tick) for tick in shown_ticks])
    kinds = (
        ("kept", Colour.BLUE, ""),
        ("left out", DROPPED, ""),
        ("by prediction", Colour.GREY, ""),
        ("by simulation", Colour.GREY, "///"),
    )
    handles = [patch(name, colour, hatch=hatch, edgecolor="white") for name, colour, hatch in kinds]
    legends(figure, (), 1, "", (axis, handles, {"loc": "lower right"}))
    return figure


def _bars(
    axis: Axes, names: list[str], values: list[float], labels: list[str], **look: Any
) -> None:
    """Draw one bar for each effect on a logarithmic axis, from below, with its label."""
    bars = axis.barh(
        range(len(names)),
        values,
        tick_label=names,
        log=True,
        edgecolor="white",
        linewidth=0.0,
        **look,
    )
    axis.bar_label(bars, labels, padding=3, fontsize="small")
    axis.grid(visible=False, axis="y")


def _changed(row: LeftOut) -> str:
    if row.note:
        return "cannot be left out"
    return "the answer is gone" if row.change == inf else changed(row.change)


# --- the computing time of accuracy ---------------------------------------------------------------


def accuracy_table(result: AccuracyResult) -> Table:
    """Return every measured setting."""
    errors = f"setting's error {result.unit}", f"total error {result.unit}"
    rows: list[list[Cell]] = []
    for row in result.rows:
        marks = filter(None, ("default" * row.default, CHEAPEST * row.knee, row.note))
        rows.append(
            [row.sweep, row.label, duration(row.seconds), row.step, row.total, ", ".join(marks)]
        )
    return table(["sweep", "setting", "for one trial", *errors, ""], rows)


def accuracy_words(result: AccuracyResult) -> list[str]:
    """Describe the errors of the defaults, and the cheapest setting of each sweep within 10 % of
    its best.
    """
    default = result.default
    window = ", window 2048" if result.plan.noise else ""
    defaults = f"{result.plan.exact.seconds:g} s, {SUBSTEPS} sub-steps, f64{window}"
    return [
        (
            f"Reference: {result.reference}. Error: {result.quantity}. Seconds of one core, for one"
            f" of {GROUP} trials together."
        ),
        (
            f"The defaults ({defaults}) cost {duration(default.seconds)} and leave"
            f" {shown(default.total)} {result.unit}, {shown(default.step)} {result.unit} of it by"
            " the sub-step."
        ),
        *(_cheapest(result, sweep) for sweep in SWEEPS if result.sweep(sweep)),
    ]


def _cheapest(result: AccuracyResult, sweep: str) -> str:
    rows = [row for row in result.sweep(sweep) if not isnan(row.seconds)]
    best = next((row for row in rows if row.knee), None)
    if best is None:
        return f"{sweep}: nothing could be measured."
    words = (
        f"{sweep}: the {CHEAPEST} is {best.label} ({duration(best.seconds)},"
        f" {shown(best.total)} {result.unit})"
    )
    if sweep == "trial length" and best is rows[-1]:
        return f"{words}; the error still falls as 1/sqrt(length), a longer trial would buy more."
    return f"{words}; dearer settings gain less than 10 %." if best is not rows[-1] else f"{words}."


@styled()
def accuracy_figure(result: AccuracyResult, width_mm: float | None = None) -> Figure:
    """Draw error over seconds, a panel for each sweep, and the effect of leaving an effect out.
    ConfigError without matplotlib.
    """
    noise = result.plan.noise
    scene = result.plan.scene
    title = (
        f"{scene.title}: what accuracy costs in time\nerror: {result.quantity}; reference:"
        f" {result.reference}"
    )
    panels = PANELS_OF_NOISE if noise else PANELS_OF_NOISE[:1]
    figure, places = mosaic(panels, 12.5, 7.0 if noise else 5.0, title, width_mm)
    _draw_effects(result, places.pop("effect"))
    ways = places["tier"]
    for name, axis in places.items():
        _draw_sweep(result, name, axis)
    handles = [
        *legend_handles(places["sub-steps"]),
        mark("defaults", **DEFAULT),
        mark(f"the {CHEAPEST}", **KNEE),
    ]
    legends(figure, handles, 6, "", (ways, legend_handles(ways), {"loc": "best"}))
    return figure


def _draw_sweep(result: AccuracyResult, sweep: str, axis: Axes) -> None:
    rows = [row for row in result.sweep(sweep) if row.total < inf]
    known = [row.total for row in result.rows if row.total < inf]
    ways = sweep == "tier"
    least = 0.3 * min(
        total for total in known if total >= NOTHING * max(known)
    )  # zero errors are drawn below all others
    labels = [f"{row.label} (exact)" if row.total < least else row.label for row in rows]
    places = [(row.seconds, max(row.total, least)) for row in rows]
    if ways:
        for place, label, sign in zip(places, labels, cycle(WAYS), strict=False):
            axis.plot(*place, sign, color=Colour.BLUE, markersize=6, label=label)
    else:
        axis.plot(
            *zip(*places, strict=True),
            "o-",
            color=Colour.BLUE,
            markersize=6,
            label="total error of one trial",
        )
        for place, label in zip(places, labels, strict=True):
            axis.annotate(label, place, xytext=(4, 6), textcoords="offset points", fontsize="small")
    for place, row in zip(places, rows, strict=True):
        if row.default:
            axis.plot(*place, **DEFAULT)
        if row.knee:
            axis.plot(*place, **KNEE)
    if sweep == "sub-steps":
        _draw_step_errors(result, rows, axis)
    axis.set(
        yscale="log",
        xscale="log",
        title=TITLES[sweep],
        xlabel="time for one trial",
        ylabel=f"error ({result.unit})",
    )
    axis.margins(x=0.2, y=0.9 if ways else 0.2)
    plain_axis(axis.xaxis, TIMES, duration)
    plain_axis(axis.yaxis)


def _draw_step_errors(result: AccuracyResult, rows: list[AccuracyRow], axis: Axes) -> None:
    """Draw the errors of the sub-step alone, and single precision."""
    stepped = [row for row in rows if row.step > NOTHING * max(row.total for row in rows)]
    single = [row for row in result.sweep("precision") if row.dtype == "f32" and row.total < inf]
    axis.plot(
        [row.seconds for row in stepped],
        [row.step for row in stepped],
        "o-",
        color=Colour.SKY,
        label="error of the sub-step alone",
    )
    axis.plot(
        [row.seconds for row in single],
        [row.total for row in single],
        "v",
        color=Colour.PURPLE,
        label="single precision, 1 and 4 sub-steps",
    )


def _draw_effects(result: AccuracyResult, axis: Axes) -> None:
    """Draw the change of the answer without each effect, and the error of one trial."""
    rows = sorted(result.sweep("effect"), key=lambda row: row.step)
    own = result.default.total
    worst = max([*(row.step for row in rows if row.step < inf), own])
    least = 1e-4 * worst
    top = max(len(rows), FEWEST_BARS)
    labels = [
        "cannot be left out" if row.step == inf else "none" if row.step < least else shown(row.step)
        for row in rows
    ]
    errors = [min(max(row.step, least), 3.0 * worst) for row in rows]
    _bars(axis, [row.label for row in rows], errors, labels, color=Colour.GREEN)
    axis.axvline(own, color=Colour.BLACK, linewidth=0.8)
    axis.text(own, top - 0.4, "one trial's error", fontsize="small", ha="center", va="bottom")
    axis.set(
        xlim=(least, 60.0 * worst),
        ylim=(-0.6, top + 0.3),
        xlabel=f"error ({result.unit})",
        title="effects, each left out",
    )


# --- remedies -------------------------------------------------------------------------------------


def remedies_table(rows: Sequence[Row]) -> Table:
    """Return every device with every remedy: by theory, then by trials if there are any."""
    hertz = ", ".join(f"{hz:g}" for hz in RENDERED_HZ)
    columns = [
        "device", "remedy", "ticks/s", "corner Hz", "K at B = 0", "best B", "K at best B", "volume",
        f"|Z|/asked at {hertz} Hz", "phase less asked deg", "noise mN", "K predicted",
        "K by trials", "sd", "passive up to", "not from",
    ]  # fmt: skip
    return table(columns, map(_remedy_cells, rows))


def _remedy_cells(row: Row) -> list[Cell]:
    tried = row.trials
    known = (nan,) * 5
    if tried is not None:
        known = (tried.scan.predicted, tried.value, tried.sd, tried.lower, tried.upper)
    return [
        row.device,
        row.remedy,
        row.rate_hz,
        row.corner_hz,
        row.stiffness_alone_n_per_m,
        row.virtual_damping_ns_per_m,
        row.stiffness_n_per_m,
        row.volume,
        *_felt_cells(row.rendered),
        1e3 * row.noise_n,
        *known,
    ]


def _felt_cells(rendered: Complexes) -> tuple[str, str]:
    return (
        ", ".join(f"{size:.3g}" for size in np.abs(rendered)),
        ", ".join(f"{degrees:.0f}" for degrees in np.degrees(np.angle(rendered))),
    )


def port_energy_table(rows: Sequence[EnergyRow]) -> Table:
    """Every device with every remedy that is judged by the energy at its port."""
    columns = [
        "device", "remedy", "its number", "best B", "K in every hand", "K in a draw", "5 %", "95 %",
        "K asked", f"given out in {SECONDS:g} s mJ", "diverged",
        f"|Z|/asked at {', '.join(f'{hz:g}' for hz in RENDERED_HZ)} Hz", "phase less asked deg",
        "noise mN",
    ]  # fmt: skip
    cells = (
        [
            row.device, row.remedy, row.number, row.virtual_damping_ns_per_m,
            row.stiffness_n_per_m, *map(float, np.quantile(row.draws_n_per_m, (0.5, 0.05, 0.95))),
            row.asked_n_per_m, 1e3 * row.given_out_j, "yes" if row.diverged else "no",
            *_felt_cells(row.rendered), 1e3 * row.noise_n,
        ]
        for row in rows
    )  # fmt: skip
    return table(columns, cells)
