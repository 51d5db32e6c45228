"""Impacts on virtual walls: maximum stiffness of a wall without oscillation, at each damping."""

from functools import partial
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common
from hapticd.core.errors import AnalysisError

with deferred_imports():
    import numpy as np

    from hapticd.zwidth import store, walls
    from hapticd.zwidth.report import paper, passive_set


Stiffness = Annotated[
    common.Range,
    typer.Option(
        "--stiffness",
        metavar="LOW HIGH N",
        help="Stiffness of the walls, N/m, evenly spaced in ln K.",
    ),
]


def command(
    scene: common.SceneName = "wall",
    active_damping: common.Damping = "0,1.74",
    stiffness: Stiffness = (20.0, 3000.0, 18),
    viscous: Annotated[
        common.Range,
        typer.Option(
            "--viscous", metavar="LOW HIGH N", help="Virtual damping of the walls, N s/m."
        ),
    ] = (0.0, 8.0, 13),
    settle_s: Annotated[
        float, typer.Option("--settle-s", metavar="S", help="Time allowed to come to rest.")
    ] = 1.5,
    still: Annotated[
        float, typer.Option("--still", metavar="M/S", help="Oscillation speed that counts as rest.")
    ] = 2e-3,
    out: common.Out = None,
    plot: common.Plot = True,
    figure_width: terminal.FigureWidth = None,
    as_json: terminal.Json = False,
) -> None:
    """Find how stiff a virtual wall may be at each virtual damping before an impact makes it
    oscillate: the K-B plot of one device.
    """
    terminal.need_engine(plot)
    stiffnesses, dampings = _grid(stiffness, viscous)
    params = walls.WallMapParams(
        common.scene_of(scene),
        stiffnesses,
        dampings,
        common.levels(active_damping),
        settle_s,
        still,
    )
    plan = walls.plan_walls(params)
    with common.interruptible(), progress() as tell:
        result = walls.run_walls(plan, tell)
    folder = common.folder(out, "walls")
    common.write_summary(folder, {"kind": "walls", "scene": scene, "lines": result.lines})
    figure = partial(passive_set.walls_figure, result, width_mm=figure_width)
    paths = common.drawn(folder, "walls", figure, plot)
    found = {"lines": store.to_json(result.lines)}
    common.show_result(found, [paper.text(_table(result, dampings))], folder, paths, as_json)


def _grid(
    stiffness: common.Range, viscous: common.Range
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return stiffnesses [N/m] and dampings [N s/m] of the walls. AnalysisError unless K is above
    0.
    """
    low, high, count = common.ranged("--stiffness", stiffness, 1)
    if low <= 0.0:
        raise AnalysisError("wall stiffnesses: an ascending list above 0 N/m is needed")
    dampings = np.linspace(*common.ranged("--viscous", viscous, 1))
    return tuple(np.geomspace(low, high, count).tolist()), tuple(dampings.tolist())


def _table(result: "walls.WallResult", dampings: tuple[float, ...]) -> "paper.Table":
    """Return a row for each damping of the wall, a column for each level of active damping."""
    params = result.plan.params
    rows: list[tuple[str | float, ...]] = []
    for place, damping in enumerate(dampings):
        lines = result.lines[place :: len(dampings)]
        rows.append(
            (damping, *(f"{'>' if one.open else ''}{one.highest_n_per_m:.3g}" for one in lines))
        )
    columns = ("wall B N s/m", *(f"K N/m at {level:g} N s/m" for level in params.levels))
    title = f"SIMULATED {params.scene.device}: stiffest stable wall, by active damping"
    return paper.table(columns, rows, title)
