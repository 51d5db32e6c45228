"""Displays beside each other, by the files that `report` writes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.zwidth.portable import Comparison

Files = Annotated[
    list[Path],
    typer.Argument(metavar="A.zwidth B.zwidth ...", help="As `hapticd zwidth report` writes them."),
]
Allow = Annotated[
    str,
    typer.Option(
        "--allow",
        metavar="NAME[,NAME...]",
        help="Conditions that may be unlike; they are named with the result.",
    ),
]


def command(
    files: Files,
    allow: Allow = "",
    out: common.Out = None,
    plot: common.Plot = True,
    figure_width: terminal.FigureWidth = None,
    as_json: terminal.Json = False,
) -> None:
    """The fair comparison of displays: envelopes and limits as they are, and divided by the mass
    that moves, where a larger display is no better one.

    Files of unlike conditions (band, judged frequencies, perturbation, length of a trial,
    confidence) are refused, the unlike ones named; --allow judged_hz,seconds compares them all the
    same, and says so.
    """
    from hapticd.signal.verdict import Judged
    from hapticd.zwidth.portable import compare
    from hapticd.zwidth.report import style
    from hapticd.zwidth.report.comparison import comparison_figure, comparison_tables
    from hapticd.zwidth.report.table import text

    found = compare(files, [name for name in allow.split(",") if name])
    folder = common.folder(out, "compare")
    with common.drawing(folder):
        paths = (
            style.save(comparison_figure(found, figure_width), folder, "compare") if plot else ()
        )
    if as_json:
        figures = [str(path) for path in paths]
        terminal.data_json({"ok": True, **_comparison_json(found), "figures": figures})
        return
    for display in found.displays:
        terminal.data(f"{display.name}: {Judged(*display.conditions.judged_hz).words}")
    for table in comparison_tables(found):
        terminal.data(text(table))
    if paths:
        common.print_kept(folder, paths)


def _comparison_json(found: "Comparison") -> dict[str, Any]:
    from hapticd.zwidth.store import to_json

    displays = [
        {
            "name": display.name,
            "conditions": to_json(display.conditions),
            "levels": [
                {
                    "active_damping_ns_per_m": one.active_damping_ns_per_m,
                    "limits": to_json(one.limits),
                    "numbers": to_json(dict(one.numbers)),
                }
                for one in display.levels
            ],
        }
        for display in found.displays
    ]
    return {"displays": displays, "unlike": list(found.unlike)}
