"""The paper again: its table and its figures, on three simulated devices."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.measure.reproduce import ReproduceResult

Quick = Annotated[bool, typer.Option("--quick", help="Prediction alone: seconds instead of minutes, without scatter and Fig. 2.")]
Seeds = Annotated[int, typer.Option("--seeds", metavar="N", min=2, max=64, help="Noise realisations behind each limit.")]


def command(quick: Quick = False, seeds: Seeds = 8, out: common.Out = None, as_json: options.Json = False) -> None:
    """Weir, Colgate and Peshkin 2008 on simulated devices: limits, ratios, equations and Figs. 2-4 and 7-11 beside the paper's.

    Figures are drawn as PNG and SVG; with --json only if --out names a folder.
    """
    from hapticd.measure.reproduce import ReproduceParams, plan_reproduce, run_reproduce
    from hapticd.measure.reproduce_table import rows
    from hapticd.report.paper_table import as_json as table_json
    from hapticd.report.paper_table import notes, paper_table
    from hapticd.report.table import text

    with common.progress() as tell:
        result = run_reproduce(plan_reproduce(ReproduceParams(quick, seeds)), tell)
        found = rows(result)
    told: dict[str, Any] = {"quick": quick, "seeds": len(result.plan.seeds), "table": table_json(found)}
    if out is not None or not as_json:
        told["figures"] = _kept(result, common.folder(out, "reproduce"), told)
    if as_json:
        output.data_json(told)
        return
    output.data(text(paper_table(found)))
    output.data("\nnotes")
    for note in notes(found):
        output.data(f"  {note}")
    output.data("\nkept")
    for file in told["figures"]:
        output.data(f"  {file}")


def _kept(result: "ReproduceResult", folder: Path, told: dict[str, Any]) -> list[str]:
    """Figures and the table as JSON, in `folder`."""
    import json

    from hapticd.errors import ConfigError
    from hapticd.report import figures
    from hapticd.report.paper import paper_figures

    kept = [str(file) for name, figure in paper_figures(result) for file in figures.save(figure, folder, name)]
    path = folder / "table.json"
    try:
        path.write_text(json.dumps(told, indent=1) + "\n")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; name a folder that you may write to with --out") from error
    return [*kept, str(path)]
