"""The boundary of the passive set by few, chosen trials."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.measure.directed import SearchResult


def command(
    scene: common.SceneName = "fig4",
    damping: common.Damping = "0,1.74",
    budget: Annotated[
        int,
        typer.Option("--budget", metavar="N", min=5, help="Trials at most, at each damping level."),
    ] = 40,
    doubt: Annotated[
        float,
        typer.Option(
            "--doubt", help="End when noise leaves this share of the volume open.", min=0.0
        ),
    ] = 0.02,
    together: Annotated[
        int, typer.Option("--together", metavar="N", min=1, max=16, help="Trials chosen at once.")
    ] = 4,
    where: common.Where = "thread",
    seconds: common.Seconds = 90.0,
    seed: common.Seed = 1,
    band: common.Band = (2.0, 500.0),
    out: common.Out = None,
    plot: common.Plot = True,
    as_json: common.JsonOutcomes = False,
) -> None:
    """Find the boundary with few trials: begin from the prediction, learn how Re Z differs from it
    over K, B and M, and try next the point of the boundary that is farthest from all trials.

    Ctrl-C is safe: the same command with the same --out goes on where it ended. With --json each
    new outcome is a line, and the last line is the result.
    """
    from hapticd.measure.directed import SearchParams, plan_search, run_search
    from hapticd.measure.executors import executor
    from hapticd.measure.store import TrialStore, plain, write_run
    from hapticd.report import style
    from hapticd.report.passive_set import search_figure
    from hapticd.report.table import table, text

    conditions = common.conditions(common.scene_of(scene), seconds, seed, band)
    folder = common.folder(out, "search")
    store = TrialStore(folder / "trials.jsonl")
    results = []
    hear = common.follow if as_json else lambda new: None
    with common.keeping(store, folder), executor(where) as pool, progress() as tell:
        for level in common.levels(damping):
            plan = plan_search(SearchParams(conditions, level, budget, together, doubt))
            results.append(run_search(plan, store, tell, pool, hear))
    told = [_told(result) for result in results]
    write_run(
        folder,
        {"kind": "search", "scene": scene, "levels": told, "provenance": common.told(seed=seed)},
    )
    with common.drawing(folder):
        paths = style.save(search_figure(results), folder, "search") if plot else ()
    if as_json:
        terminal.data_json(
            {
                "ok": True,
                "levels": plain(told),
                "folder": str(folder),
                "figures": [str(path) for path in paths],
            }
        )
        return
    columns = (
        "added N s/m",
        "trials",
        "not stable",
        "doubt %",
        "K max N/m",
        "B max N s/m",
        "M min g",
        "volume",
        "miss N s/m",
    )
    rows = [
        (
            row["added_damping_ns_per_m"],
            row["trials"],
            row["unstable"],
            100 * row["doubt"],
            row["limits"].stiffness[1],
            row["limits"].damping[1],
            1e3 * row["limits"].mass[0],
            row["volume"],
            row["miss_ns_per_m"],
        )
        for row in told
    ]
    terminal.data(
        text(
            table(
                columns,
                rows,
                f"SIMULATED {conditions.scene.device}: the set as the search holds it; extremes"
                " over the set",
            )
        )
    )
    terminal.data("; ".join(sorted({result.judged.words for result in results})))
    terminal.data(NOTE)
    common.kept(folder, paths)


NOTE = (
    "not stable: trials that ran away; doubt: share of the volume that noise leaves open; volume of"
    " the set over K, B and M: N/m x N s/m x kg;\nmiss: median difference of expected and found"
    " least Re Z over the last half of the trials"
)


def _told(result: "SearchResult") -> dict[str, Any]:
    """`miss`: median difference of expected and found margins over the last half of the trials."""
    import numpy as np

    from hapticd.analysis.boundary import set_limits, volume

    later = result.steps[len(result.steps) // 2 :]
    missed = [
        abs(step.expected_ns_per_m - step.outcome.margin_ns_per_m) for step in later if step.teaches
    ]
    return {
        "judged": result.judged,
        "added_damping_ns_per_m": result.plan.params.damping_ns_per_m,
        "trials": len(result.steps),
        "unstable": len(result.search.unstable),
        "doubt": result.doubt,
        "limits": set_limits(result.found),
        "volume": volume(result.found),
        "miss_ns_per_m": float(np.nanmedian(missed)) if np.isfinite(missed).any() else float("nan"),
        "box": result.plan.box,
    }
