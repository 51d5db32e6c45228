"""K, B and M limits along their axes: predicted, then by simulated trials."""

from functools import partial
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

with deferred_imports():
    from hapticd.signal import passive_set
    from hapticd.zwidth import executors, limits, outcomes, store
    from hapticd.zwidth.report import paper
    from hapticd.zwidth.report import passive_set as figures


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
    amplitudes: Annotated[
        int,
        typer.Option(
            "--amplitudes",
            metavar="N",
            min=1,
            max=9,
            help="Number of perturbation amplitudes, each twice the one before.",
        ),
    ] = 1,
    axis: Annotated[
        str, typer.Option("--axis", metavar="KBM", help="Parameters to search: K, B, M.")
    ] = "KBM",
    seeds: Annotated[
        int,
        typer.Option("--seeds", metavar="N", min=1, help="Number of noise seeds, for the scatter."),
    ] = 1,
    *,
    trials: common.TrialsOptions,
    confidence: common.Confidence = 0.95,
    results: common.ResultsOptions,
) -> None:
    """Find how far K, B and M each go alone before the display is not passive: by prediction, then
    by simulated trials.

    With --amplitudes 3 also at 2 and 4 times the perturbation's force: with friction, a limit
    depends on the amplitude.

    Ctrl-C is safe: the same command with the same --out continues where it ended. With --json each
    new outcome is a line, with its limit, amplitude and seed, and the last line is the result.
    """
    terminal.need_engine(results.plot)
    if not axis or set(axis) - set(passive_set.AXES):
        raise typer.BadParameter(f"--axis {axis!r}: use one or more of the letters K, B, M")
    conditions = common.conditions(
        common.scene_of(scene), trials.seconds, trials.seed, trials.band, confidence
    )
    factors = tuple(2.0**doubling for doubling in range(amplitudes))
    wanted = tuple(passive_set.AXES.index(name) for name in axis)
    params = limits.LimitsParams(conditions, common.levels(active_damping), factors, wanted, seeds)
    folder = common.folder(results.out, "limits")
    kept = store.TrialStore(folder / "trials.jsonl")

    def follow(
        scan: "limits.Scan", given: "outcomes.Conditions", new: "list[outcomes.Outcome]"
    ) -> None:
        if results.as_json:
            limit = passive_set.AXES[scan.axis]
            seed = given.excitation.seed
            common.print_outcomes(new, limit=limit, amplitude=scan.amplitude, seed=seed)

    with common.keeping(kept, folder), executors.executor(trials.where) as pool, progress() as tell:
        result = limits.run_limits(limits.plan_limits(params), kept, tell, pool, follow)
    rows = [{"name": limit.name, **store.to_json(limit)} for limit in result.limits]
    about = {"kind": "limits", "scene": scene, "seconds": trials.seconds, "limits": rows}
    common.write_summary(folder, about, seed=trials.seed)
    figure = partial(figures.limits_figure, result, results.figure_width)
    paths = common.drawn(folder, "limits", figure, results.plot)
    judged = "; ".join(sorted({limit.judged.words for limit in result.limits}))
    lines = [paper.text(_table(result)), NOTE, judged, f"{result.made} trials made"]
    common.show_result({"made": result.made, "limits": rows}, lines, folder, paths, results.as_json)


def _table(result: "limits.LimitsResult") -> "paper.Table":
    params = result.plan.params
    scattered = params.seeds > 1
    rows = [_row(limit, scattered) for limit in result.limits]
    device = params.conditions.scene.device
    title = f"SIMULATED {device}: axis limits, the other two being 0"
    return paper.table((*COLUMNS, "scatter") if scattered else COLUMNS, rows, title)


def _row(limit: "limits.AxisLimit", scattered: bool) -> tuple[str | float, ...]:
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
