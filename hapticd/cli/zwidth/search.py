"""The boundary of the passive set from few, selected trials."""

from functools import partial
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

with deferred_imports():
    import numpy as np

    from hapticd.signal import passive_set
    from hapticd.zwidth import executors, search, store
    from hapticd.zwidth.report import paper
    from hapticd.zwidth.report import passive_set as figures


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
    with common.keeping(kept, folder), executors.executor(trials.where) as pool, progress() as tell:
        for level in common.levels(active_damping):
            params = search.SearchParams(conditions, level, budget, together, doubt)
            found.append(search.run_search(search.plan_search(params), kept, tell, pool, follow))
    levels = [_level(result) for result in found]
    about = {"kind": "search", "scene": scene, "levels": levels}
    common.write_summary(folder, about, seed=trials.seed)
    figure = partial(figures.search_figure, found, results.figure_width)
    paths = common.drawn(folder, "search", figure, results.plot)
    judged = "; ".join(sorted({result.judged.words for result in found}))
    lines = [_table(conditions.scene.device, levels), judged, NOTE]
    common.show_result({"levels": store.to_json(levels)}, lines, folder, paths, results.as_json)
    if not results.as_json:
        common.tell_open(levels, "box")


def _level(result: "search.SearchResult") -> dict[str, Any]:
    """Return the result of the search at one level, for run.json, JSON and the table."""
    return {
        "judged": result.judged,
        "active_damping_ns_per_m": result.plan.params.active_damping_ns_per_m,
        "trials": len(result.steps),
        "unstable": len(result.search.unstable),
        "doubt": result.doubt,
        "limits": passive_set.set_limits(result.found),
        "open_ends": result.open_ends,
        "volume": passive_set.volume(result.found),
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
    return paper.text(paper.table(COLUMNS, rows, title))
