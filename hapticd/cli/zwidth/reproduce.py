"""The paper again: its table and its figures, on three simulated devices."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.cli.progress import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.measure.progress import Progress

LINE_S = 10.0
Quick = Annotated[bool, typer.Option("--quick", help="Prediction alone: seconds instead of minutes, without scatter and Fig. 2.")]
Seeds = Annotated[int, typer.Option("--seeds", metavar="N", min=2, max=64, help="Noise realisations behind each limit.")]


def command(quick: Quick = False, seeds: Seeds = 8, out: common.Out = None, as_json: options.Json = False) -> None:
    """Weir, Colgate and Peshkin 2008 on simulated devices: limits, ratios, equations and Figs. 2-4 and 7-11 beside the paper's,
    and what the paper left to future work.

    Writes REPORT.md, the table (JSON, CSV, Markdown) and the figures (PNG, SVG); with --json only if --out names a folder.
    Ctrl-C is safe: the folder holds the files of one run, or none.
    """
    from hapticd.measure.beyond import plan_beyond, run_beyond
    from hapticd.measure.reproduce import plan_reproduce, run_reproduce
    from hapticd.report.future_work import future_sections
    from hapticd.report.paper_page import keep, sections, terminal
    from hapticd.report.paper_table import as_json as table_json

    plan, files = plan_reproduce(quick, seeds), []
    further = plan_beyond(quick)
    with common.interruptible(), watched() as tell:
        found = [*sections(run_reproduce(plan, tell)), *future_sections(run_beyond(further, tell))]
        table = table_json(row for section in found for row in section.rows)
        told: dict[str, Any] = {"quick": quick, "seeds": len(plan.seeds), "table": table, "provenance": common.told()}
        if out is not None or not as_json:
            files = keep(found, common.folder(out, "reproduce"), told, tell)
    if as_json:
        output.data_json(told | ({"files": [str(file) for file in files]} if files else {}))
        return
    output.data(terminal(found))
    output.data("\n".join(["", "kept", *(f"  {file}" for file in files)]))


@contextmanager
def watched() -> "Iterator[Progress]":
    """The bar; where stderr is no terminal, a line every ten seconds, so that no log is silent for minutes."""
    last_s = -inf

    def line(what: str, done: int, total: int) -> None:
        nonlocal last_s
        if monotonic() >= last_s + LINE_S:
            last_s = monotonic()
            output.talk(f"{what}, {done} of {total}")

    if not sys.stderr.isatty():
        yield line
        return
    with progress() as tell:
        yield tell
