"""K, B and M limits along their axes: predicted, then by simulated trials."""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.zwidth.limits import AxisLimit, LimitsResult, Scan
    from hapticd.zwidth.outcomes import Conditions, Outcome
    from hapticd.zwidth.report.table import Table

Amplitudes = Annotated[
    int,
    typer.Option(
        "--amplitudes",
        metavar="N",
        min=1,
        max=9,
        help="Perturbation amplitudes, each twice the last.",
    ),
]
Axis = Annotated[str, typer.Option("--axis", metavar="KBM", help="Which of K, B, M.")]
Seeds = Annotated[
    int,
    typer.Option("--seeds", metavar="N", min=1, help="Repeat with other noise, for the scatter."),
]
UNITS = {"K": ("N/m", 1.0), "B": ("N s/m", 1.0), "M": ("g", 1e3)}  # printed unit, units per SI unit
COLUMNS = (
    "limit",
    "active N s/m",
    "N^2/Hz",
    "predicted",
    "trials say",
    "passive up to",
    "not passive from",
    "worst Hz",
    "v rms mm/s",
    "trials",
)
NOTE = (
    "predicted to not passive from: in the unit of the limit; trials say: the last that passed"
    " before the first that failed; passive up to, not passive from: by the interval;\nworst Hz:"
    " where the first that failed has its least Re Z; v rms: of the last that passed"
)


def command(
    scene: common.SceneName = "fig4",
    active_damping: common.Damping = "0,1.74",
    amplitudes: Amplitudes = 1,
    axis: Axis = "KBM",
    seeds: Seeds = 1,
    *,
    trials: common.TrialsOptions,
    confidence: common.Confidence = 0.95,
    results: common.ResultsOptions,
) -> None:
    """How far K, B and M each go alone before the display is not passive: predicted, then by
    simulated trials.

    With --amplitudes 3 also at 2 and 4 times the perturbation's force: with friction a limit is one
    of its amplitude.

    Ctrl-C is safe: the same command with the same --out goes on where it ended. With --json each
    new outcome is a line, with its limit, amplitude and seed, and the last line is the result.
    """
    from hapticd.signal.passive_set import AXES
    from hapticd.zwidth.executors import executor
    from hapticd.zwidth.limits import LimitsParams, plan_limits, run_limits
    from hapticd.zwidth.report import style
    from hapticd.zwidth.report.passive_set import limits_figure
    from hapticd.zwidth.store import TrialStore

    terminal.need_engine()
    terminal.need_figures(results.plot)
    if not axis or set(axis) - set(AXES):
        raise typer.BadParameter(f"--axis {axis!r}: use one or more of the letters K, B, M")
    conditions = common.conditions(
        common.scene_of(scene), trials.seconds, trials.seed, trials.band, confidence
    )
    factors = tuple(2.0**doubling for doubling in range(amplitudes))
    wanted = tuple(AXES.index(name) for name in axis)
    params = LimitsParams(conditions, common.levels(active_damping), factors, wanted, seeds)
    folder = common.folder(results.out, "limits")
    store = TrialStore(folder / "trials.jsonl")

    def follow(scan: "Scan", given: "Conditions", new: "list[Outcome]") -> None:
        if results.as_json:
            seed = given.excitation.seed
            common.print_outcomes(new, limit=AXES[scan.axis], amplitude=scan.amplitude, seed=seed)

    with common.keeping(store, folder), executor(trials.where) as pool, progress() as tell:
        result = run_limits(plan_limits(params), store, tell, pool, follow)
    rows = _rows_json(result)
    about = {"kind": "limits", "scene": scene, "seconds": trials.seconds, "limits": rows}
    common.write_summary(folder, about, seed=trials.seed)
    with common.drawing(folder):
        width_mm = results.figure_width
        paths = (
            style.save(limits_figure(result, width_mm), folder, "limits") if results.plot else ()
        )
    if results.as_json:
        common.print_result({"made": result.made, "limits": rows}, folder, paths)
        return
    _print(result)
    common.print_kept(folder, paths)


def _rows_json(result: "LimitsResult") -> list[dict[str, object]]:
    from hapticd.zwidth.store import to_json

    return [{"name": limit.name, **to_json(limit)} for limit in result.limits]


def _print(result: "LimitsResult") -> None:
    from hapticd.zwidth.report.table import text

    terminal.data(text(_table(result)))
    terminal.data(NOTE)
    terminal.data("; ".join(sorted({limit.judged.words for limit in result.limits})))
    terminal.data(f"{result.made} trials made")


def _table(result: "LimitsResult") -> "Table":
    from hapticd.zwidth.report.table import table

    params = result.plan.params
    scattered = params.seeds > 1
    rows = [_row(limit, scattered) for limit in result.limits]
    device = params.conditions.scene.device
    title = f"SIMULATED {device}: axis limits, the other two being 0"
    return table((*COLUMNS, "scatter") if scattered else COLUMNS, rows, title)


def _row(limit: "AxisLimit", scattered: bool) -> tuple[str | float, ...]:
    unit, factor = UNITS[limit.name]
    found = (limit.scan.predicted, limit.value, limit.lower, limit.upper)
    return (
        f"{limit.name} {unit}",
        limit.scan.active_damping_ns_per_m,
        f"{limit.perturbation_psd:.2g}",
        *(factor * value for value in found),
        limit.worst_hz,
        1e3 * limit.velocity_sd,
        limit.trials,
        *((factor * limit.sd,) if scattered else ()),
    )
