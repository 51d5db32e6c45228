"""Verbs of `zwidth` for the passive set of K, B and M: on a grid, or its boundary alone.

Grid (`map_command`). It shows which environments are passive, and the envelope over them.

Boundary (`search_command`). It is found from few, selected trials.
"""

from functools import partial
from math import nan
from pathlib import Path
from time import monotonic
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import common

with terminal.deferred_imports():
    import numpy as np

    from hapticd.core import arrays
    from hapticd.zwidth import compare, executors, outcomes, search, store
    from hapticd.zwidth import map as maps
    from hapticd.zwidth.report import envelope, paper, style
    from hapticd.zwidth.report import passive_set as figures

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


def map_command(
    scene: common.SceneName = "fig4",
    active_damping: common.Damping = "0,1.74",
    stiffness: Annotated[
        common.Range, typer.Option("--stiffness", metavar="LOW HIGH N", help="Grid of K, N/m.")
    ] = (0.0, 1400.0, 15),
    viscous: Annotated[
        common.Range, typer.Option("--viscous", metavar="LOW HIGH N", help="Grid of B, N s/m.")
    ] = (0.0, 9.0, 10),
    mass: Annotated[
        common.Range, typer.Option("--mass", metavar="LOW HIGH N", help="Grid of M, kg.")
    ] = (-0.030, 0.024, 10),
    near: Annotated[
        float,
        typer.Option(
            "--near",
            help="Relative width of the zone around the predicted boundary that is tried.",
            min=0.0,
            max=0.9,
        ),
    ] = 0.15,
    everywhere: Annotated[
        bool, typer.Option("--everywhere", help="Try every point, as the paper does.")
    ] = False,
    refine: Annotated[
        int,
        typer.Option(
            "--refine", metavar="N", help="Times to halve the grid at the boundary.", min=0, max=1
        ),
    ] = 0,
    *,
    trials: common.TrialsOptions,
    results: common.ResultsOptions,
) -> None:
    """Map the passive set of a simulated display: by prediction, and by trials where the prediction
    is uncertain.

    Ctrl-C is safe: the same command with the same --out continues where it ended. With --json each
    new outcome is a line, and the last line is the result; earlier trials of --out are in its
    trials.jsonl.
    """
    terminal.need_engine(results.plot)
    conditions = common.conditions(common.scene_of(scene), trials.seconds, trials.seed, trials.band)
    axes = _axes(stiffness, viscous, mass)
    folder = common.folder(results.out, "map")
    kept = store.TrialStore(folder / "trials.jsonl")
    redraw = _Redrawn(conditions, folder, results.figure_width)

    def follow(new: "list[outcomes.Outcome]") -> None:
        if results.as_json:
            common.print_outcomes(new)
        if results.plot:
            redraw(new)

    dampings = common.levels(active_damping)
    params = maps.MapParams(conditions, axes, dampings, near, everywhere, refine)
    executors.checked(trials.where)
    with common.keeping(kept, folder):
        plan = maps.plan_map(params)
        points = len(plan.levels) * axes[0].size * axes[1].size * axes[2].size
        terminal.talk(f"{points} points predicted, {plan.trials} to be tried")
        missing = plan.trials - len(kept.known)
        with executors.executor(trials.where, trials=missing) as pool, terminal.progress() as tell:
            result = maps.run_map(plan, kept, tell, pool, follow)
    levels = [_level(level) for level in result.levels]
    asked = {"near": near, "everywhere": everywhere, "refine": refine}
    _write(folder, scene, params, trials, asked, levels)
    with common.drawing(folder):
        paths = draw_map(result, folder, results.figure_width) if results.plot else []
    title = f"SIMULATED {conditions.scene.device}: the set on the grid"
    rows = paper.text(paper.table(COLUMNS, [_row(level) for level in levels], title))
    lines = [rows, result.judged.words, NOTE, f"{result.made} trials made"]
    found = {"made": result.made, "levels": store.to_json(levels)}
    common.show_result(found, lines, folder, paths, results.as_json)
    if not results.as_json:
        common.tell_open(levels, "grid")


def _axes(
    stiffness: common.Range, viscous: common.Range, mass: common.Range
) -> "tuple[arrays.Floats, arrays.Floats, arrays.Floats]":
    return (
        np.linspace(*common.ranged("--stiffness", stiffness)),
        np.linspace(*common.ranged("--viscous", viscous)),
        np.linspace(*common.ranged("--mass", mass)),
    )


def _write(
    folder: Path,
    scene: str,
    params: "maps.MapParams",
    trials: common.TrialsOptions,
    asked: dict[str, Any],
    levels: list[dict[str, Any]],
) -> None:
    """Write run.json, from which `zwidth report` draws the map again."""
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
    """Redraws the envelope as trials arrive, at most every few seconds."""

    def __init__(
        self, conditions: "outcomes.Conditions", folder: Path, width_mm: float | None
    ) -> None:
        self._conditions = conditions
        self._folder = folder
        self._width_mm = width_mm
        self._drawn_s = monotonic()
        self._passed: dict[float, list[outcomes.Outcome]] = {}

    def __call__(self, new: "list[outcomes.Outcome]") -> None:
        for outcome in new:
            if outcome.passes:
                self._passed.setdefault(outcome.active_damping_ns_per_m, []).append(outcome)
        if self._passed and monotonic() - self._drawn_s > REDRAW_S:
            self._drawn_s = monotonic()
            figure = envelope.envelope_figure(
                self._conditions, list(self._passed.items()), width_mm=self._width_mm
            )
            style.save(figure, self._folder, "envelope_so_far")


def _level(level: "maps.LevelMap") -> dict[str, Any]:
    """Return the result at one level of active damping, for run.json, JSON and the table."""
    return {
        "judged": outcomes.judged(level.outcomes),
        "active_damping_ns_per_m": level.active_damping_ns_per_m,
        "points": level.found.margin.size,
        "passive": int(level.found.passive.sum()),
        "tried": int(level.tried.sum()),
        "unlike_prediction": level.disagreements,
        "set_limits": level.found.limits() if level.found.passive.any() else None,
        "open_ends": level.found.open_ends(),
        "volume": level.found.volume(),
        "widths_db": compare.widths_db(level.envelope) if level.envelope else (),
    }


def _row(level: dict[str, Any]) -> tuple[float, ...]:
    limits = level["set_limits"]
    extremes = (nan, nan, nan)
    if limits:
        extremes = (limits.stiffness[1], limits.virtual_damping[1], 1e3 * limits.mass[0])
    width_db = level["widths_db"][1].width_db if level["widths_db"] else nan
    counts = (level[name] for name in ("points", "tried", "unlike_prediction", "passive"))
    return (level["active_damping_ns_per_m"], *counts, *extremes, width_db)


def draw_map(result: "maps.MapResult", folder: Path, width_mm: float | None) -> list[Path]:
    """Draw the set, and the envelopes of impedance and admittance if a trial passed."""
    paths = [*style.save(figures.set_figure(result, width_mm), folder, "set")]
    drawn = [
        (level.active_damping_ns_per_m, level.outcomes) for level in result.levels if level.envelope
    ]
    if drawn:
        conditions = result.plan.params.conditions
        impedance = envelope.envelope_figure(conditions, drawn, width_mm=width_mm)
        admittance = envelope.envelope_figure(conditions, drawn, inverse=True, width_mm=width_mm)
        paths += style.save(impedance, folder, "envelope")
        paths += style.save(admittance, folder, "envelope_admittance")
    return paths


# --- the boundary ---------------------------------------------------------------------------------
SEARCH_COLUMNS = (
    "active N s/m",
    "trials",
    "not stable",
    "doubt %",
    "K max N/m",
    "B max N s/m",
    "M min g",
    "volume",
    "miss N s/m",
)
SEARCH_NOTE = (
    "not stable: trials that ran away; doubt: share of the volume that noise leaves open; volume of"
    " the set over K, B and M: N/m x N s/m x kg;\nmiss: median difference of expected and found"
    " least Re Z over the last half of the trials"
)


def search_command(
    scene: common.SceneName = "fig4",
    active_damping: common.Damping = "0,1.74",
    budget: Annotated[
        int,
        typer.Option(
            "--budget", metavar="N", min=5, help="Most trials at each level of active damping."
        ),
    ] = 40,
    doubt: Annotated[
        float,
        typer.Option(
            "--doubt", help="Stop when noise leaves this share of the volume undecided.", min=0.0
        ),
    ] = 0.02,
    together: Annotated[
        int, typer.Option("--together", metavar="N", min=1, max=16, help="Trials chosen together.")
    ] = 4,
    *,
    trials: common.TrialsOptions,
    results: common.ResultsOptions,
) -> None:
    """Find the boundary with few trials: start from the prediction, model how Re Z differs from it
    over K, B and M, and next try the point of the boundary that is farthest from all trials.

    Ctrl-C is safe: the same command with the same --out continues where it ended. With --json each
    new outcome is a line, and the last line is the result.
    """
    terminal.need_engine(results.plot)
    conditions = common.conditions(common.scene_of(scene), trials.seconds, trials.seed, trials.band)
    folder = common.folder(results.out, "search")
    kept = store.TrialStore(folder / "trials.jsonl")
    found = []
    follow = common.print_outcomes if results.as_json else lambda new: None
    with (
        common.keeping(kept, folder),
        executors.executor(trials.where) as pool,
        terminal.progress() as tell,
    ):
        for level in common.levels(active_damping):
            params = search.SearchParams(conditions, level, budget, together, doubt)
            found.append(search.run_search(search.plan_search(params), kept, tell, pool, follow))
    levels = [_search_level(result) for result in found]
    about = {"kind": "search", "scene": scene, "levels": levels}
    common.write_summary(folder, about, seed=trials.seed)
    figure = partial(figures.search_figure, found, results.figure_width)
    paths = common.drawn(folder, "search", figure, results.plot)
    judged = "; ".join(sorted({result.judged.words for result in found}))
    lines = [_table(conditions.scene.device, levels), judged, SEARCH_NOTE]
    common.show_result({"levels": store.to_json(levels)}, lines, folder, paths, results.as_json)
    if not results.as_json:
        common.tell_open(levels, "box")


def _search_level(result: "search.SearchResult") -> dict[str, Any]:
    """Return the result of the search at one level, for run.json, JSON and the table."""
    return {
        "judged": result.judged,
        "active_damping_ns_per_m": result.plan.params.active_damping_ns_per_m,
        "trials": len(result.steps),
        "unstable": len(result.search.unstable),
        "doubt": result.doubt,
        "limits": result.found.limits(),
        "open_ends": result.open_ends,
        "volume": result.found.volume(),
        "miss_ns_per_m": _miss_ns_per_m(result),
        "box": result.plan.box,
    }


def _miss_ns_per_m(result: "search.SearchResult") -> float:
    """Return the median difference of expected and found margins over the last half of
    the trials.
    """
    later = result.steps[len(result.steps) // 2 :]
    missed = [
        abs(step.expected_ns_per_m - step.outcome.margin_ns_per_m) for step in later if step.teaches
    ]
    return float(np.nanmedian(missed)) if np.isfinite(missed).any() else float("nan")


def _table(device: str, levels: list[dict[str, Any]]) -> str:
    rows = [
        (
            level["active_damping_ns_per_m"],
            level["trials"],
            level["unstable"],
            100 * level["doubt"],
            level["limits"].stiffness[1],
            level["limits"].virtual_damping[1],
            1e3 * level["limits"].mass[0],
            level["volume"],
            level["miss_ns_per_m"],
        )
        for level in levels
    ]
    title = f"SIMULATED {device}: the set as the search holds it; extremes over the set"
    return paper.text(paper.table(SEARCH_COLUMNS, rows, title))
