"""A simulated scene as a figure and a table: with added damping a solid line, without it a dashed one, as in the paper's Fig. 7."""

from typing import TYPE_CHECKING

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.scene_run import SceneResult, Trial
from hapticd.measure.scenes import frequencies, point
from hapticd.report import figures
from hapticd.report.looks import OFF, ON, PREDICTED, not_judged
from hapticd.report.table import Cell, Table, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOOKS = (OFF, ON)
SHOWN_S = 0.5  # of a noisy trace
POINTS = 1500  # of a line
SHOWN_HZ = (1.9, 1000.0)


def scene_figure(result: SceneResult) -> "Figure":
    """Traces; beside them |Z| and phase where the scene is moved by noise. ConfigError without matplotlib."""
    with figures.style():
        return _with_impedance(result) if result.plan.impedance else _traces_alone(result)


def scene_table(result: SceneResult) -> Table:
    """One row for each trial."""
    columns = ["trial", "velocity mm/s rms", "largest force N", "work of the probe mJ", "end"]
    rows: list[list[Cell]] = [
        [_name(trial), 1e3 * trial.velocity_sd_m_per_s, trial.max_force_n, 1e3 * trial.work_j, _end(trial)]
        for trial in result.trials
    ]
    if result.plan.impedance:
        columns += ["verdict", "margin deg", "at Hz"]
        for row, trial in zip(rows, result.trials, strict=True):
            judged = trial.verdict
            row += (
                ["-", np.nan, np.nan]
                if judged is None
                else [judged.answer.replace("_", " "), judged.margin_deg.value, judged.margin_deg.frequency_hz]
            )
    if any(trial.winding_c for trial in result.trials):
        columns.append("winding degC")
        for row, trial in zip(rows, result.trials, strict=True):
            row.append(np.nan if trial.winding_c is None else float(trial.winding_c[1][-1]))
    return table(columns, rows)


def _name(trial: Trial) -> str:
    return f"{trial.leg.name}{' (the scene)' if trial.leg.own else ''}"


def _end(trial: Trial) -> str:
    return "ran to its end" if trial.diverged_at_s == np.inf else f"diverged at {trial.diverged_at_s:.3g} s"


def _title(result: SceneResult) -> str:
    k, b, m = point(result.scene)
    wall = result.scene.environment.wall
    rendered = (
        f"K = {k:g} N/m, B = {b:g} N s/m, M = {1e3 * m:g} g"
        if not wall.side
        else (f"wall of {wall.stiffness_n_per_m:g} N/m and {wall.damping_ns_per_m:g} N s/m at {1e3 * wall.position_m:g} mm")
    )
    return f"{result.scene.title}: {rendered}  (simulated {result.scene.device})"


def _with_impedance(result: SceneResult) -> "Figure":
    figure, places = figures.axes(2, 2, 10.0, 6.2, width_ratios=(1.0, 1.3))
    figure.suptitle(_title(result))
    begin_s = min(1.0, 0.5 * result.plan.seconds)
    _draw_traces(result, [places[0], places[2]], (begin_s, begin_s + SHOWN_S))
    for axis in (places[0], places[2]):
        axis.set_xlabel("time (s)")
    _draw_impedance(result, places[1], places[3])
    figure.legend(*places[1].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _traces_alone(result: SceneResult) -> "Figure":
    heat = any(trial.winding_c for trial in result.trials)
    figure, places = figures.axes(4 if heat else 3, 1, 9.0, 8.6 if heat else 7.0, sharex=True)
    figure.suptitle(_title(result))
    _draw_traces(result, places[:2], (0.0, result.plan.seconds))
    _draw_damping(result, places[2])
    if heat:
        for trial, look in zip(result.trials, LOOKS, strict=True):
            if trial.winding_c is not None:
                places[3].plot(*trial.winding_c, marker=".", **look)
        places[3].set_ylabel("winding (°C)")
    places[-1].set_xlabel("time (s)")
    figure.align_ylabels(places)
    figure.legend(*places[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _draw_traces(result: SceneResult, places: "list[Axes]", span_s: tuple[float, float]) -> None:
    channels = (("position (mm)", 1e3, "position_m"), ("virtual force (N)", 1.0, "force_n"))
    for axis, (label, factor, name) in zip(places, channels, strict=True):
        for trial, look in zip(result.trials, LOOKS, strict=True):
            values = factor * getattr(trial, name)
            time_s = np.arange(values.size) / result.scene.rate_hz
            inside = (time_s >= span_s[0]) & (time_s <= span_s[1])
            axis.plot(*thinned(time_s[inside], values[inside]), label=trial.leg.name, **look)
        axis.set(ylabel=label, xlim=span_s)


def _draw_damping(result: SceneResult, axis: "Axes") -> None:
    for trial, look in zip(result.trials, LOOKS, strict=True):
        times = [at_s for at_s, _ in trial.leg.damping] + [result.plan.seconds]
        levels = [level for _, level in trial.leg.damping]
        axis.step(times, [*levels, levels[-1]], where="post", **look)
    axis.set_ylabel("added damping (N s/m)")
    axis.margins(y=0.15)


def _draw_impedance(result: SceneResult, size: "Axes", phase: "Axes") -> None:
    for trial, look in zip(result.trials, LOOKS, strict=True):
        if trial.measured is None or trial.predicted is None:
            continue
        f, label = trial.measured.frequency_hz, "" if trial.leg.own else "_"
        shown = (f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])
        for z, drawn in (
            (trial.predicted[shown], {**PREDICTED, "label": f"{label}predicted"}),
            (trial.measured.impedance_ns_per_m[shown], {**look, "label": trial.leg.name}),
        ):
            size.plot(f[shown], np.abs(z), **drawn)
            phase.plot(f[shown], np.degrees(np.angle(z)), **drawn)
    _finish_impedance(result.plan.params.band_hz, size, phase)


def _finish_impedance(band_hz: tuple[float, float], size: "Axes", phase: "Axes") -> None:
    for axis in (size, phase):
        figures.hertz_axis(axis, *SHOWN_HZ)
    not_judged((size, phase), band_hz)
    size.set(yscale="log", ylabel="|Z| (N s/m)")
    figures.plain_axis(size.yaxis)
    for edge in (-90.0, 90.0):
        phase.axhline(edge, color=figures.BLACK, linewidth=0.8)
    phase.set(ylabel="phase of Z (degrees)", ylim=(-105.0, 140.0), yticks=range(-90, 91, 30))
    words = f"passive: within ±90 degrees in {band_hz[0]:g}..{band_hz[1]:g} Hz"
    phase.text(0.98 * band_hz[1], 127.0, words, ha="right", va="center", fontsize=8.5)


def thinned(time_s: Floats, values: Floats, most: int = POINTS) -> tuple[Floats, Floats]:
    """A line of at most about `most` points that looks the same: lowest and highest of each stretch, in their order."""
    if values.size <= most:
        return time_s, values
    stretch = int(np.ceil(2 * values.size / most))
    count = values.size // stretch * stretch
    parts = values[:count].reshape(-1, stretch)
    ends = np.sort(np.stack((parts.argmin(axis=1), parts.argmax(axis=1)), axis=1), axis=1)
    at = (ends + stretch * np.arange(len(parts))[:, None]).ravel()
    return time_s[at], values[at]


def impedance_rows(result: SceneResult, trial: Trial) -> list[dict[str, float]]:
    """|Z| and phase, measured and predicted, on a few frequencies of the band; empty without noise."""
    if trial.measured is None or trial.predicted is None:
        return []
    rows = []
    for f in frequencies(result.plan.params.band_hz):
        at = int(np.argmin(np.abs(trial.measured.frequency_hz - f)))
        z, expected = trial.measured.impedance_ns_per_m[at], trial.predicted[at]
        rows.append(
            {
                "frequency_hz": float(f),
                "impedance_ns_per_m": float(abs(z)),
                "phase_deg": float(np.degrees(np.angle(z))),
                "phase_sd_deg": float(np.degrees(trial.measured.relative_sd[at])),
                "predicted_ns_per_m": float(abs(expected)),
                "predicted_phase_deg": float(np.degrees(np.angle(expected))),
            }
        )
    return rows
