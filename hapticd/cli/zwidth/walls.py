"""Impacts on virtual walls."""

from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common


def command(
    scene: common.SceneName = "wall",
    damping: common.Damping = "0,1.74",
    stiffness: Annotated[
        common.Range,
        typer.Option(
            "--stiffness", metavar="LOW HIGH N", help="Of the walls, N/m, evenly in ln K."
        ),
    ] = (
        20.0,
        3000.0,
        18,
    ),
    viscous: Annotated[
        common.Range,
        typer.Option("--viscous", metavar="LOW HIGH N", help="Damping of the walls, N s/m."),
    ] = (
        0.0,
        8.0,
        13,
    ),
    settle_s: Annotated[
        float, typer.Option("--settle-s", metavar="S", help="Time to come to rest.")
    ] = 1.5,
    still: Annotated[
        float, typer.Option("--still", metavar="M/S", help="Speed to and fro that counts as rest.")
    ] = 2e-3,
    out: common.Out = None,
    plot: common.Plot = True,
    as_json: terminal.Json = False,
) -> None:
    """How stiff a virtual wall may be at each damping before an impact sets it
    oscillating: the K-B plot of one device.
    """
    import numpy as np

    from hapticd.errors import AnalysisError
    from hapticd.measure.store import plain, write_run
    from hapticd.measure.walls import WallParams, plan_walls, run_walls
    from hapticd.report import style
    from hapticd.report.passive_set import walls_figure
    from hapticd.report.table import table, text

    loaded = common.scene_of(scene)
    low, high, count = common.ranged("--stiffness", stiffness, 1)
    if low <= 0.0:
        raise AnalysisError("wall stiffnesses: an ascending list above 0 N/m is needed")
    walls = tuple(np.geomspace(low, high, count).tolist())
    dampings = tuple(np.linspace(*common.ranged("--viscous", viscous, 1)).tolist())
    plan = plan_walls(WallParams(loaded, walls, dampings, common.levels(damping), settle_s, still))
    with common.interruptible(), progress() as tell:
        result = run_walls(plan, tell)
    folder = common.folder(out, "walls")
    write_run(
        folder,
        {"kind": "walls", "scene": scene, "lines": result.lines, "provenance": common.told()},
    )
    with common.drawing(folder):
        paths = style.save(walls_figure(result), folder, "walls") if plot else ()
    if as_json:
        lines = plain(result.lines)
        terminal.data_json(
            {
                "ok": True,
                "lines": lines,
                "folder": str(folder),
                "figures": [str(path) for path in paths],
            }
        )
        return
    rows: list[tuple[str | float, ...]] = [
        (
            dampings[place],
            *(
                f"{'>' if line.open else ''}{line.highest_n_per_m:.3g}"
                for line in result.lines[place :: len(dampings)]
            ),
        )
        for place in range(len(dampings))
    ]
    columns = ("wall B N s/m", *(f"K N/m at {level:g} N s/m" for level in plan.params.levels))
    terminal.data(
        text(
            table(
                columns, rows, f"SIMULATED {loaded.device}: stiffest stable wall, by added damping"
            )
        )
    )
    common.kept(folder, paths)
