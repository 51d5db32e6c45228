"""The boundary of the passive set by few, chosen trials."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.zwidth.search import SearchResult

Budget = Annotated[
    int,
    typer.Option(
        "--budget", metavar="N", min=5, help="Trials at most, at each level of active damping."
    ),
]
Doubt = Annotated[
    float,
    typer.Option("--doubt", help="End when noise leaves this share of the volume open.", min=0.0),
]
Together = Annotated[
    int, typer.Option("--together", metavar="N", min=1, max=16, help="Trials chosen at once.")
]
COLUMNS = (
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
NOTE = (
    "not stable: trials that ran away; doubt: share of the volume that noise leaves open; volume of"
    " the set over K, B and M: N/m x N s/m x kg;\nmiss: median difference of expected and found"
    " least Re Z over the last half of the trials"
)


def command(
    scene: common.SceneName = "fig4",
    active_damping: common.Damping = "0,1.74",
    budget: Budget = 40,
    doubt: Doubt = 0.02,
    together: Together = 4,
    *,
    trials: common.TrialsOptions,
    results: common.ResultsOptions,
) -> None:
    """Find the boundary with few trials: begin from the prediction, learn how Re Z differs from it
    over K, B and M, and try next the point of the boundary that is farthest from all trials.

    Ctrl-C is safe: the same command with the same --out goes on where it ended. With --json each
    new outcome is a line, and the last line is the result.
    """
    from hapticd.zwidth.executors import executor
    from hapticd.zwidth.report import style
    from hapticd.zwidth.report.passive_set import search_figure
    from hapticd.zwidth.search import SearchParams, plan_search, run_search
    from hapticd.zwidth.store import TrialStore, to_json

    terminal.need_engine()
    terminal.need_figures(results.plot)
    conditions = common.conditions(common.scene_of(scene), trials.seconds, trials.seed, trials.band)
    folder = common.folder(results.out, "search")
    store = TrialStore(folder / "trials.jsonl")
    found = []
    follow = common.print_outcomes if results.as_json else lambda new: None
    with common.keeping(store, folder), executor(trials.where) as pool, progress() as tell:
        for level in common.levels(active_damping):
            plan = plan_search(SearchParams(conditions, level, budget, together, doubt))
            found.append(run_search(plan, store, tell, pool, follow))
    levels = [_level(result) for result in found]
    about = {"kind": "search", "scene": scene, "levels": levels}
    common.write_summary(folder, about, seed=trials.seed)
    with common.drawing(folder):
        width_mm = results.figure_width
        paths = style.save(search_figure(found, width_mm), folder, "search") if results.plot else ()
    if results.as_json:
        common.print_result({"levels": to_json(levels)}, folder, paths)
        return
    _print(conditions.scene.device, found, levels)
    common.print_kept(folder, paths)


def _level(result: "SearchResult") -> dict[str, Any]:
    """What the search found at one level, for run.json, JSON and the table."""
    from hapticd.signal.passive_set import set_limits, volume

    return {
        "judged": result.judged,
        "active_damping_ns_per_m": result.plan.params.active_damping_ns_per_m,
        "trials": len(result.steps),
        "unstable": len(result.search.unstable),
        "doubt": result.doubt,
        "limits": set_limits(result.found),
        "open_ends": result.open_ends,
        "volume": volume(result.found),
        "miss_ns_per_m": _miss_ns_per_m(result),
        "box": result.plan.box,
    }


def _miss_ns_per_m(result: "SearchResult") -> float:
    """Median difference of expected and found margins over the last half of the trials."""
    import numpy as np

    later = result.steps[len(result.steps) // 2 :]
    missed = [
        abs(step.expected_ns_per_m - step.outcome.margin_ns_per_m) for step in later if step.teaches
    ]
    return float(np.nanmedian(missed)) if np.isfinite(missed).any() else float("nan")


def _print(device: str, found: "list[SearchResult]", levels: list[dict[str, Any]]) -> None:
    from hapticd.zwidth.report.table import table, text

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
    terminal.data(text(table(COLUMNS, rows, title)))
    terminal.data("; ".join(sorted({result.judged.words for result in found})))
    terminal.data(NOTE)
    for level in levels:
        common.tell_open(level, "box")
