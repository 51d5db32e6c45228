"""K, B and M limits along their axes."""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.measure.limits import LimitsResult, Scan
    from hapticd.measure.outcomes import Conditions, Outcome
    from hapticd.report.table import Table


def command(
    scene: common.SceneName = "fig4",
    damping: common.Damping = "0,1.74",
    levels: Annotated[
        int,
        typer.Option(
            "--levels",
            metavar="N",
            min=1,
            max=9,
            help="Perturbation amplitudes, each twice the last.",
        ),
    ] = 1,
    axis: Annotated[str, typer.Option("--axis", metavar="KBM", help="Which of K, B, M.")] = "KBM",
    seeds: Annotated[
        int,
        typer.Option(
            "--seeds", metavar="N", min=1, help="Repeat with other noise, for the scatter."
        ),
    ] = 1,
    where: common.Where = "thread",
    seconds: common.Seconds = 90.0,
    seed: common.Seed = 1,
    band: common.Band = (2.0, 500.0),
    confidence: common.Confidence = 0.95,
    out: common.Out = None,
    plot: common.Plot = True,
    as_json: common.JsonOutcomes = False,
) -> None:
    """How far K, B and M each go alone before the display is not passive: predicted, then by
    simulated trials.

    With --levels 3 also at 2 and 4 times the perturbation's force: with friction a limit is one of
    its amplitude.

    Ctrl-C is safe: the same command with the same --out goes on where it ended. With --json each
    new outcome is a line, with its limit, amplitude and seed, and the last line is the result.
    """
    from hapticd.analysis.boundary import AXES
    from hapticd.measure.executors import executor
    from hapticd.measure.limits import LimitsParams, plan_limits, run_limits
    from hapticd.measure.store import TrialStore, plain, write_run
    from hapticd.report import style
    from hapticd.report.passive_set import limits_figure
    from hapticd.report.table import text

    if not axis or set(axis) - set(AXES):
        raise typer.BadParameter(f"--axis {axis!r}: letters out of KBM")
    conditions = common.conditions(common.scene_of(scene), seconds, seed, band, confidence)
    wanted = tuple(AXES.index(name) for name in axis)
    amplitudes = tuple(2.0**level for level in range(levels))
    params = LimitsParams(conditions, common.levels(damping), amplitudes, wanted, seeds)
    folder = common.folder(out, "limits")
    store = TrialStore(folder / "trials.jsonl")

    def hear(scan: "Scan", given: "Conditions", new: "list[Outcome]") -> None:
        if as_json:
            common.follow(
                new, limit=AXES[scan.axis], amplitude=scan.amplitude, seed=given.excitation.seed
            )

    with common.keeping(store, folder), executor(where) as pool, progress() as tell:
        result = run_limits(plan_limits(params), store, tell, pool, hear)
    rows = [{"name": limit.name, **plain(limit)} for limit in result.limits]
    write_run(
        folder,
        {
            "kind": "limits",
            "scene": scene,
            "seconds": seconds,
            "limits": rows,
            "provenance": common.told(seed=seed),
        },
    )
    with common.drawing(folder):
        paths = style.save(limits_figure(result), folder, "limits") if plot else ()
    if as_json:
        figured = [str(path) for path in paths]
        terminal.data_json(
            {
                "ok": True,
                "made": result.made,
                "limits": rows,
                "folder": str(folder),
                "figures": figured,
            }
        )
        return
    terminal.data(text(_table(result)))
    terminal.data(NOTE)
    terminal.data("; ".join(sorted({limit.judged.words for limit in result.limits})))
    terminal.data(f"{result.made} trials made")
    common.kept(folder, paths)


def _table(result: "LimitsResult") -> "Table":
    from hapticd.report.table import table

    scattered = result.plan.params.seeds > 1
    columns = (
        "limit",
        "added N s/m",
        "N^2/Hz",
        "predicted",
        "trials say",
        "passive up to",
        "not passive from",
        "worst Hz",
        "v rms mm/s",
        "trials",
    )
    rows = [
        (
            f"{limit.name} {UNITS[limit.name][0]}",
            limit.scan.damping_ns_per_m,
            f"{limit.perturbation_psd:.2g}",
            *(
                UNITS[limit.name][1] * value
                for value in (limit.scan.predicted, limit.value, limit.lower, limit.upper)
            ),
            limit.worst_hz,
            1e3 * limit.velocity_sd,
            limit.trials,
            *((UNITS[limit.name][1] * limit.sd,) if scattered else ()),
        )
        for limit in result.limits
    ]
    title = (
        f"SIMULATED {result.plan.params.conditions.scene.device}: axis limits, the other two"
        " being 0"
    )
    return table((*columns, *(("scatter",) if scattered else ())), rows, title)


NOTE = (
    "predicted to not passive from: in the unit of the limit; trials say: the last that passed"
    " before the first that failed; passive up to, not passive from: by the interval;\nworst Hz:"
    " where the first that failed has its least Re Z; v rms: of the last that passed"
)
UNITS = {"K": ("N/m", 1.0), "B": ("N s/m", 1.0), "M": ("g", 1e3)}
