"""Figures, tables and sentences of studies of a scene: its traces and impedance, its model
explained, the effects that a question needs, the computing time of accuracy, the instability of
explicit methods, and the gain of remedies.

There is one section per study: figure, table and sentences of the same result. Lines and colours
are those of `zwidth.report.style`: solid with active damping, dashed without.

Limitations: an error of 0 on a logarithmic axis. Zero errors are drawn below all others and called
exact; a change out of range is drawn at the end of its axis.
"""

from collections.abc import Sequence
from itertools import cycle
from math import inf, isinf, isnan, nan
from typing import Any

import numpy as np

from hapticd.core.arrays import Complexes
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.discrete import AtLevel, Explanation
from hapticd.model.scene import Scene
from hapticd.render.winding import LEAST_LOOP_GAIN
from hapticd.signal.verdict import DEFAULT_BAND_HZ
from hapticd.studies.accuracy import GROUP, AccuracyResult, AccuracyRow, Cost
from hapticd.studies.effects import EffectsResult, LeftOut
from hapticd.studies.port_energy import SECONDS, EnergyRow
from hapticd.studies.reference import candidates
from hapticd.studies.remedies import RENDERED_HZ, Row
from hapticd.studies.scene import Ceiling, Integrators, SceneResult, SceneTrial
from hapticd.zwidth.report.paper import Cell, Table, changed, duration, legends, shown, table
from hapticd.zwidth.report.style import (
    FINE,
    OFF,
    ON,
    PREDICTED,
    Axes,
    Colour,
    Figure,
    Look,
    axes,
    hertz_axis,
    legend_handles,
    mark,
    mosaic,
    patch,
    plain_axis,
    size_in,
    styled,
)
from hapticd.zwidth.report.trial import Trace, draw, draw_traces, dress
from hapticd.zwidth.sources import SUBSTEPS, frequencies

__all__ = [
    "accuracy_figure",
    "accuracy_table",
    "accuracy_words",
    "ceiling_table",
    "ceiling_words",
    "cost_words",
    "effects_figure",
    "effects_table",
    "effects_words",
    "explained",
    "impedance_rows",
    "integrators_figure",
    "port_energy_table",
    "remedies_table",
    "scene_figure",
    "scene_table",
    "step_words",
]

STYLES = (OFF, ON)
SHOWN_S = 0.5  # of a noisy trace
SHOWN_HZ = (1.9, 1000.0)
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
METHODS = {
    "exact": ("exact map", Colour.BLUE, "o"),
    "rk4": ("Runge-Kutta 4", Colour.GREEN, "s"),
    "euler": ("explicit Euler", Colour.RED, "^"),
}
# lowest error drawn; position of those without an answer
SMALLEST = 1e-16
GONE = 3.0


# --- the run of a scene ---------------------------------------------------------------------------


@styled()
def scene_figure(result: SceneResult, width_mm: float | None = None) -> Figure:
    """Draw traces, and |Z| and phase if noise moves the scene. ConfigError without matplotlib."""
    drawn = _with_impedance if result.plan.impedance else _traces_alone
    return drawn(result, width_mm)


def _with_impedance(result: SceneResult, width_mm: float | None) -> Figure:
    figure, (position, size, force, phase) = axes(
        2, 2, 10.0, 6.2, _title(result), width_mm=width_mm, width_ratios=(1.0, 1.3)
    )
    begin_s = min(1.0, 0.5 * result.plan.seconds)
    band_hz = DEFAULT_BAND_HZ
    draw_traces((position, force), _traces(result, (begin_s, begin_s + SHOWN_S)))
    position.set_xlabel("time (s)")
    for trial, look in zip(result.trials, STYLES, strict=True):
        _draw_impedance(size, phase, trial, look)
    for axis in (size, phase):
        hertz_axis(axis, *SHOWN_HZ)
    dress(size, phase, band_hz)
    phase.set(ylim=(-105.0, 140.0), yticks=range(-90, 91, 30))
    words = f"passive: within ±90 degrees in {band_hz[0]:g}..{band_hz[1]:g} Hz"
    phase.text(0.98 * band_hz[1], 122.0, words, ha="right", va="center", fontsize="small")
    legends(figure, legend_handles(size), 3)
    return figure


def _draw_impedance(size: Axes, phase: Axes, trial: SceneTrial, look: Look) -> None:
    if trial.judged is None or trial.judged.predicted is None:
        return
    z = trial.judged.measured
    seen = (z.frequency_hz >= SHOWN_HZ[0]) & (z.frequency_hz <= SHOWN_HZ[1])
    f = z.frequency_hz[seen]
    draw((size, phase), f, trial.judged.predicted[seen], PREDICTED, "predicted")
    draw((size, phase), f, z.impedance_ns_per_m[seen], look, trial.case.name)


def _traces_alone(result: SceneResult, width_mm: float | None) -> Figure:
    """Draw the traces with the steps of damping, and the temperature of a winding that warms up."""
    panels = _traces(result, (0.0, result.plan.seconds))
    pairs = list(zip(result.trials, STYLES, strict=True))
    panels.append(
        (
            "active damping (N s/m)",
            [_steps(trial, result.plan.seconds, look) for trial, look in pairs],
        )
    )
    if any(trial.winding_c for trial in result.trials):
        heated = [
            (*trial.winding_c, {**look, "marker": "."}) for trial, look in pairs if trial.winding_c
        ]
        panels.append(("winding (°C)", heated))
    high_in = 2.2 + 1.6 * len(panels)
    figure, places = axes(
        len(panels), 1, 9.0, high_in, _title(result), width_mm=width_mm, sharex=True
    )
    draw_traces(places, panels)
    places[2].margins(y=0.15)
    places[0].set_xlim(0.0, result.plan.seconds)
    legends(figure, legend_handles(places[0]), 2)
    return figure


def _steps(trial: SceneTrial, seconds: float, look: Look) -> Trace:
    at_s, levels = zip(
        *trial.case.active_damping, (seconds, trial.case.active_damping[-1][1]), strict=True
    )
    return np.array(at_s), np.array(levels), {**look, "drawstyle": "steps-post"}


def _title(result: SceneResult) -> str:
    scene = result.plan.scene
    wall = scene.environment.wall
    k, b, m = scene.environment.free
    rendered = (
        f"wall of {wall.stiffness_n_per_m:g} N/m and {wall.virtual_damping_ns_per_m:g} N s/m at"
        f" {1e3 * wall.position_m:g} mm"
        if wall.side
        else f"K = {k:g} N/m, B = {b:g} N s/m, M = {1e3 * m:g} g"
    )
    return f"{scene.title}: {rendered}  (simulated {scene.device})"


def _traces(result: SceneResult, span_s: tuple[float, float]) -> list[tuple[str, list[Trace]]]:
    """Position and force of each trial in that span."""
    panels: list[tuple[str, list[Trace]]] = [("position (mm)", []), ("virtual force (N)", [])]
    for trial, look in zip(result.trials, STYLES, strict=True):
        position_m, force_n = trial.found.traces(0)
        time_s = np.arange(force_n.size) / result.plan.scene.rate_hz
        inside = (time_s >= span_s[0]) & (time_s <= span_s[1])
        for (_, lines), values in zip(panels, (1e3 * position_m, force_n), strict=True):
            lines.append((time_s[inside], values[inside], {**look, "label": trial.case.name}))
    return panels


def scene_table(result: SceneResult) -> Table:
    """Return one row for each trial; a verdict if noise moves the scene, a temperature if its
    winding warms up.
    """
    heated = any(trial.winding_c for trial in result.trials)
    rows = [_ran(trial, result.plan.impedance, heated) for trial in result.trials]
    return table(list(rows[0]), [list(row.values()) for row in rows])


def _ran(trial: SceneTrial, impedance: bool, heated: bool) -> dict[str, Cell]:
    """A row of the table, by column."""
    numbers = trial.numbers
    found = trial.judged.verdict if trial.judged else None
    at_s = numbers["diverged_at_s"]
    row: dict[str, Cell] = {
        "trial": f"{trial.case.name}{' (the scene)' if trial.case.own else ''}",
        "velocity mm/s rms": 1e3 * numbers["velocity_sd_m_per_s"],
        "largest force N": numbers["max_force_n"],
        "work of the probe mJ": 1e3 * numbers["work_j"],
        "end": "ran to its end" if at_s == inf else f"diverged at {at_s:.3g} s",
    }
    if impedance:
        row["verdict"] = found.answer.replace("_", " ") if found else "-"
        row["margin deg"] = found.margin_deg.value if found else nan
        row["at Hz"] = found.margin_deg.frequency_hz if found else nan
    if heated:
        row["winding degC"] = float(trial.winding_c[1][-1]) if trial.winding_c else nan
    return row


def impedance_rows(trial: SceneTrial) -> list[dict[str, float]]:
    """Return |Z| and phase, measured and predicted, at a few frequencies of the band; empty without
    noise.
    """
    if trial.judged is None or trial.judged.predicted is None:
        return []
    measured = trial.judged.measured
    f = frequencies()
    at = np.abs(measured.frequency_hz - f[:, None]).argmin(axis=1)
    z = measured.impedance_ns_per_m[at]
    expected = trial.judged.predicted[at]
    columns = {
        "frequency_hz": f,
        "impedance_ns_per_m": np.abs(z),
        "phase_deg": np.degrees(np.angle(z)),
        "phase_sd_deg": np.degrees(measured.relative_sd[at]),
        "predicted_ns_per_m": np.abs(expected),
        "predicted_phase_deg": np.degrees(np.angle(expected)),
    }
    return [
        dict(zip(columns, map(float, row), strict=True))
        for row in zip(*columns.values(), strict=True)
    ]


# --- the model explained --------------------------------------------------------------------------


def explained(found: Explanation) -> tuple[Table, ...]:
    """Return the states; the purpose, additions and speed of every effect; the time constants of
    the whole device at each damping level of the scene; every number with its source.
    """
    states = [
        [str(place), state.name, state.unit, state.effect]
        for place, state in enumerate(found.states)
    ]
    effects = [
        [
            note.effect,
            _adds(note.states, note.nonlinearity),
            ", ".join(map(duration, note.time_constants_s)) or "-",
            note.why,
        ]
        for note in found.notes
    ]
    numbers = [
        [note.effect, name, shown(value), unit, tag]
        for note in found.notes
        for name, value, unit, tag in note.parameters
    ]
    modes = [
        [shown(at.active_damping_ns_per_m), *_mode(at, place)]
        for at in found.levels
        for place in range(len(at.modes))
    ]
    return (
        table(["", "state", "unit", "effect"], states, "STATES"),
        table(["effect", "adds", "time constant", "why it is there"], effects, "EFFECTS"),
        table(
            ["active damping N s/m", "time constant", "frequency Hz", "damping ratio"],
            modes,
            "MODES OF THE OPEN DEVICE",
        ),
        table(["effect", "parameter", "value", "unit", "source"], numbers, "PARAMETERS"),
    )


def _adds(states: tuple[str, ...], nonlinearity: str) -> str:
    count = f"{len(states)} state{'s' if len(states) > 1 else ''}" if states else ""
    return "; ".join(filter(None, (count, nonlinearity))) or "numbers"


def _mode(at: AtLevel, place: int) -> tuple[str, str, str]:
    mode = at.modes[place]
    if isinf(mode.time_constant_s):
        return "drifts", "-", "-"
    return (
        duration(mode.time_constant_s),
        shown(mode.frequency_hz) if mode.frequency_hz else "-",
        shown(mode.damping_ratio),
    )


def step_words(found: Explanation, scene: Scene, substeps: int) -> list[str]:
    """Describe step, delay and rates."""
    step_s = 1.0 / (PROBE_RATE_HZ * substeps)
    delay = duration(found.delay_s) if found.delay_s else "no delay"
    nonlinear = ", ".join(effect for effect, _ in found.nonlinearities) or "nothing"
    return [
        (
            f"Step: {duration(step_s)}, {substeps} per 4 kHz sample of the record, exact for what"
            f" is linear however stiff (fastest time constant {duration(found.fastest_s)})."
        ),
        f"Not linear: {nonlinear}; friction, ends and cogging are solved once per step.",
        (
            f"Servo: {scene.rate_hz:g} Hz, {delay} from the encoder sample to the force, beside the"
            " hold."
        ),
    ]


def cost_words(found: Cost) -> list[str]:
    """Describe the cost of a simulated second."""
    engine, lockstep = (
        f"{duration(each)} ({1.0 / each:,.0f} x real time)"
        for each in (found.engine_s, found.lockstep_s)
    )
    return [
        "Cost of a simulated second on one core:",
        f"  batch engine, each of {found.lanes} trials together: {engine}",
        f"  lock-step, the whole product: {lockstep}",
    ]


def ceiling_words(found: Ceiling) -> list[str]:
    """Describe the limits of active damping."""
    device = (
        "no limit, the device alone is stable at any active damping"
        if isinf(found.device)
        else f"{shown(found.device)} N s/m; beyond it the device oscillates by itself at"
        f" {shown(found.oscillation_hz)} Hz"
    )
    top = "any level" if found.highest == inf else f"{shown(found.highest)} N s/m"
    loop = (
        "never stable at any active damping, friction not counted"
        if isnan(found.lowest)
        else f"stable from {shown(found.lowest)} to {top}, friction not counted"
    )
    return [
        f"Largest stable active damping: {device}.",
        f"With the scene's environment: {loop}.",
        (
            f"The scene asks for {shown(found.scene)} N s/m: loop gain g dR / K^2 ="
            f" {shown(found.loop_gain)}, unstable at -1; {LEAST_LOOP_GAIN:g} is allowed"
            + ("." if isinf(found.bounded) else f", up to {shown(found.bounded)} N s/m.")
        ),
    ]


def ceiling_table(found: Ceiling) -> Table:
    """Return the ceiling over the winding's temperature."""
    rows = [
        [f"{kelvin:+g} K", *("none" if isinf(level) else shown(level) for level in levels)]
        for kelvin, *levels in found.warmer
    ]
    return table(["winding against its compensation", "ceiling N s/m", "allowed N s/m"], rows)


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
    left_out = [key for key in candidates(params.scene) if key not in kept]
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


# --- explicit methods and the exact map -----------------------------------------------------------


@styled()
def integrators_figure(found: Integrators, title: str, width_mm: float | None = None) -> Figure:
    """Draw error over steps per millisecond; crosses where the answer is lost. ConfigError without
    matplotlib.
    """
    figure, (axis,) = axes(1, 1, 8.0, 4.8, title, width_mm=width_mm)
    for method, (name, colour, marker) in METHODS.items():
        error = found.error[method]
        steps = found.steps_per_ms
        limit = found.longest_s[method]
        kept = np.isfinite(error)
        stable = "stable at any step" if np.isinf(limit) else f"stable below {duration(limit)}"
        axis.plot(
            steps[kept],
            np.maximum(error[kept], SMALLEST),
            color=colour,
            marker=marker,
            label=f"{name}: {stable}",
        )
        gone = np.full(int((~kept).sum()), GONE * (1.6 if method == "euler" else 0.9))
        axis.plot(steps[~kept], gone, "x", color=colour, markersize=7)
        if np.isfinite(limit):
            axis.axvline(1e-3 / limit, color=colour, linewidth=0.8)
    axis.set_xscale("log", base=2)
    axis.set(
        yscale="log",
        ylim=(SMALLEST, 30.0),
        xlabel="steps per millisecond",
        ylabel="relative error after 20 ms",
    )
    axis.xaxis.set_major_formatter(lambda value, place: f"{value:g}")
    axis.text(found.steps_per_ms[-1], GONE, "blown up", ha="right", va="center", fontsize="small")
    legends(figure, (), 1, "", (axis, legend_handles(axis), {"loc": "center right"}))
    return figure


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
