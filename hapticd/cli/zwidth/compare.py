"""Displays beside each other, by the files that `report` writes."""

from pathlib import Path
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.zwidth import common

with deferred_imports():
    from hapticd.signal import verdict
    from hapticd.zwidth import portable, store
    from hapticd.zwidth.report import comparison, style, table


Files = Annotated[
    list[Path],
    typer.Argument(metavar="A.zwidth B.zwidth ...", help="As `hapticd zwidth report` writes them."),
]


def command(
    files: Files,
    allow: Annotated[
        str,
        typer.Option(
            "--allow",
            metavar="NAME[,NAME...]",
            help="Conditions that may be unlike; they are named with the result.",
        ),
    ] = "",
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
    found = portable.compare(files, [name for name in allow.split(",") if name])
    folder = common.folder(out, "compare")
    with common.drawing(folder):
        figure = comparison.comparison_figure(found, figure_width) if plot else None
        paths = style.save(figure, folder, "compare") if figure else ()
    drawn = [str(path) for path in paths]
    lines = [
        f"{display.name}: {verdict.Judged(*display.conditions.judged_hz).words}"
        for display in found.displays
    ]
    lines += [table.text(one) for one in comparison.comparison_tables(found)]
    lines += [f"kept in {folder}", *drawn] if drawn else []
    terminal.show({**_comparison_json(found), "figures": drawn}, lines, as_json)


def _comparison_json(found: "portable.Comparison") -> dict[str, Any]:
    displays = [
        {
            "name": display.name,
            "conditions": store.to_json(display.conditions),
            "levels": [
                {
                    "active_damping_ns_per_m": one.active_damping_ns_per_m,
                    "limits": store.to_json(one.limits),
                    "numbers": store.to_json(dict(one.numbers)),
                }
                for one in display.levels
            ],
        }
        for display in found.displays
    ]
    return {"displays": displays, "unlike": list(found.unlike)}
