"""A grid of K, B and M: which environments are passive, and the envelope over them."""

from math import nan
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.core.arrays import Floats
    from hapticd.zwidth.map import LevelMap, MapParams, MapResult
    from hapticd.zwidth.outcomes import Conditions, Outcome

Stiffness = Annotated[
    common.Range, typer.Option("--stiffness", metavar="LOW HIGH N", help="Grid of K, N/m.")
]
Viscous = Annotated[
    common.Range, typer.Option("--viscous", metavar="LOW HIGH N", help="Grid of B, N s/m.")
]
Mass = Annotated[common.Range, typer.Option("--mass", metavar="LOW HIGH N", help="Grid of M, kg.")]
Near = Annotated[
    float,
    typer.Option(
        "--near", help="Share about the predicted boundary that is tried.", min=0.0, max=0.9
    ),
]
Everywhere = Annotated[bool, typer.Option("--everywhere", help="Try every point, the paper's way.")]
Refine = Annotated[
    int,
    typer.Option(
        "--refine", metavar="N", help="Then halve the grid at the boundary.", min=0, max=1
    ),
]
REDRAW_S = 5.0  # between two drawings of the envelope while trials arrive
COLUMNS = (
    "active N s/m",
    "points",
    "tried",
    "unlike predicted",
    "passive",
    "K max N/m",
    "B max N s/m",
    "M min g",
    "width at 10-50 Hz dB",
)
NOTE = (
    "unlike predicted: trials that came out otherwise; K max, B max, M min: extremes over the set,"
    " not alone on their axis"
)


def command(
    scene: common.SceneName = "fig4",
    active_damping: common.Damping = "0,1.74",
    stiffness: Stiffness = (0.0, 1400.0, 15),
    viscous: Viscous = (0.0, 9.0, 10),
    mass: Mass = (-0.030, 0.024, 10),
    near: Near = 0.15,
    everywhere: Everywhere = False,
    refine: Refine = 0,
    *,
    trials: common.TrialsOptions,
    results: common.ResultsOptions,
) -> None:
    """Map the passive set of a simulated display. Predicted first; trials where the prediction
    leaves doubt.

    Ctrl-C is safe: the same command with the same --out goes on where it ended. With --json each
    new outcome is a line, and the last line is the result; trials that --out had kept already are
    in its trials.jsonl.
    """
    from hapticd.zwidth.executors import checked, executor
    from hapticd.zwidth.map import MapParams, plan_map, run_map
    from hapticd.zwidth.store import TrialStore, to_json

    terminal.need_engine()
    terminal.need_figures(results.plot)
    conditions = common.conditions(common.scene_of(scene), trials.seconds, trials.seed, trials.band)
    axes = _axes(stiffness, viscous, mass)
    folder = common.folder(results.out, "map")
    store = TrialStore(folder / "trials.jsonl")
    redraw = _Redrawn(conditions, folder, results.figure_width)

    def follow(new: "list[Outcome]") -> None:
        if results.as_json:
            common.print_outcomes(new)
        if results.plot:
            redraw(new)

    params = MapParams(conditions, axes, common.levels(active_damping), near, everywhere, refine)
    checked(trials.where)
    with common.keeping(store, folder):
        plan = plan_map(params)
        points = len(plan.levels) * axes[0].size * axes[1].size * axes[2].size
        terminal.talk(f"{points} points predicted, {plan.trials} to be tried")
        missing = plan.trials - len(store.known)
        with executor(trials.where, trials=missing) as pool, progress() as tell:
            result = run_map(plan, store, tell, pool, follow)
    levels = [_level(level) for level in result.levels]
    asked = {"near": near, "everywhere": everywhere, "refine": refine}
    _write(folder, scene, params, trials, asked, levels)
    with common.drawing(folder):
        paths = draw_map(result, folder, results.figure_width) if results.plot else []
    if results.as_json:
        common.print_result({"made": result.made, "levels": to_json(levels)}, folder, paths)
        return
    _print(result, levels)
    terminal.data(f"{result.made} trials made, kept in {folder}")
    for path in paths:
        terminal.data(str(path))


def _axes(
    stiffness: common.Range, viscous: common.Range, mass: common.Range
) -> "tuple[Floats, Floats, Floats]":
    import numpy as np

    return (
        np.linspace(*common.ranged("--stiffness", stiffness)),
        np.linspace(*common.ranged("--viscous", viscous)),
        np.linspace(*common.ranged("--mass", mass)),
    )


def _write(
    folder: Path,
    scene: str,
    params: "MapParams",
    trials: common.TrialsOptions,
    asked: dict[str, Any],
    levels: list[dict[str, Any]],
) -> None:
    """run.json, from which `zwidth report` draws the map again."""
    alike = {"seconds": trials.seconds, "seed": trials.seed, "band_hz": trials.band}
    about = {
        "kind": "map",
        "scene": scene,
        "axes": params.axes,
        "parameters": {**alike, **asked},
        "levels": levels,
    }
    common.write_summary(folder, about, seed=trials.seed)


class _Redrawn:
    """Draws the envelope again as trials arrive, at most every few seconds."""

    def __init__(self, conditions: "Conditions", folder: Path, width_mm: float | None) -> None:
        self._conditions = conditions
        self._folder = folder
        self._width_mm = width_mm
        self._drawn_s = monotonic()
        self._passed: dict[float, list[Outcome]] = {}

    def __call__(self, new: "list[Outcome]") -> None:
        from hapticd.zwidth.report import style
        from hapticd.zwidth.report.envelope import envelope_figure

        for outcome in new:
            if outcome.passes:
                self._passed.setdefault(outcome.active_damping_ns_per_m, []).append(outcome)
        if self._passed and monotonic() - self._drawn_s > REDRAW_S:
            self._drawn_s = monotonic()
            figure = envelope_figure(
                self._conditions, list(self._passed.items()), width_mm=self._width_mm
            )
            style.save(figure, self._folder, "envelope_so_far")


def _level(level: "LevelMap") -> dict[str, Any]:
    """What was found at one level of active damping, for run.json, JSON and the table."""
    from hapticd.signal.compare import widths_db
    from hapticd.signal.passive_set import open_ends, set_limits, volume
    from hapticd.zwidth.outcomes import judged

    found: dict[str, Any] = {
        "judged": judged(level.outcomes),
        "active_damping_ns_per_m": level.active_damping_ns_per_m,
        "points": level.found.margin.size,
        "passive": int(level.found.passive.sum()),
        "tried": int(level.tried.sum()),
        "unlike_prediction": level.disagreements,
        "set_limits": set_limits(level.found) if level.found.passive.any() else None,
        "open_ends": open_ends(level.found),
        "volume": volume(level.found),
        "widths_db": widths_db(level.envelope) if level.envelope else (),
    }
    return found


def _print(result: "MapResult", levels: list[dict[str, Any]]) -> None:
    from hapticd.zwidth.report.table import table, text

    title = f"SIMULATED {result.plan.params.conditions.scene.device}: the set on the grid"
    terminal.data(text(table(COLUMNS, [_row(level) for level in levels], title)))
    terminal.data(result.judged.words)
    terminal.data(NOTE)
    for level in levels:
        common.tell_open(level, "grid")


def _row(level: dict[str, Any]) -> tuple[float, ...]:
    limits = level["set_limits"]
    extremes = (nan, nan, nan)
    if limits:
        extremes = (limits.stiffness[1], limits.virtual_damping[1], 1e3 * limits.mass[0])
    width_db = level["widths_db"][1].width_db if level["widths_db"] else nan
    counts = (level[name] for name in ("points", "tried", "unlike_prediction", "passive"))
    return (level["active_damping_ns_per_m"], *counts, *extremes, width_db)


def draw_map(result: "MapResult", folder: Path, width_mm: float | None) -> list[Path]:
    """The set, and the envelopes of impedance and admittance where a trial passed."""
    from hapticd.zwidth.report import style
    from hapticd.zwidth.report.envelope import envelope_figure
    from hapticd.zwidth.report.passive_set import set_figure

    paths = [*style.save(set_figure(result, width_mm), folder, "set")]
    drawn = [
        (level.active_damping_ns_per_m, level.outcomes) for level in result.levels if level.envelope
    ]
    if drawn:
        conditions = result.plan.params.conditions
        impedance = envelope_figure(conditions, drawn, width_mm=width_mm)
        admittance = envelope_figure(conditions, drawn, inverse=True, width_mm=width_mm)
        paths += style.save(impedance, folder, "envelope")
        paths += style.save(admittance, folder, "envelope_admittance")
    return paths
