"""Figures, tables and sentences of a scene: its traces and impedance, its model explained, the
ceiling of active damping, and the instability of explicit methods.

`report_methods` does the same for the studies that compare methods. Each study has a section with
its figure, table and sentences. Lines and colours are those of `zwidth.report.style`: solid with
active damping, dashed without.
"""

from math import inf, isinf, isnan, nan

import numpy as np

from hapticd.core.units import DEFAULT_BAND_HZ, PROBE_RATE_HZ
from hapticd.model.discrete import AtLevel, Explanation
from hapticd.model.scene import Scene
from hapticd.render.winding import LEAST_LOOP_GAIN
from hapticd.studies.effects import Cost
from hapticd.studies.scene import Ceiling, Integrators, SceneResult, SceneTrial
from hapticd.zwidth.report.paper import Cell, Table, duration, legends, shown, table
from hapticd.zwidth.report.style import (
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
    styled,
)
from hapticd.zwidth.report.trial import Trace, draw, draw_traces, dress
from hapticd.zwidth.sources import frequencies

__all__ = [
    "ceiling_table",
    "ceiling_words",
    "cost_words",
    "explained",
    "impedance_rows",
    "integrators_figure",
    "scene_figure",
    "scene_table",
    "step_words",
]

STYLES = (OFF, ON)
SHOWN_S = 0.5  # of a noisy trace
SHOWN_HZ = (1.9, 1000.0)
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
