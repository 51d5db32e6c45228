"""Simulate a scene with and without its added damping."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import drawing, options, output
from hapticd.cli.progress import progress

if TYPE_CHECKING:
    from hapticd.measure.scene_run import SceneResult, Trial


def command(
    scene: drawing.SceneName,
    plot: drawing.Plot = False,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", min=0.001, help="Length in place of the scene's.")
    ] = None,
    out: drawing.Out = drawing.HERE,
    as_json: options.Json = False,
) -> None:
    """Simulate a scene with and without its added damping: traces, and impedance and verdict where noise moves it."""
    from hapticd.measure.scene_run import plan_scene, run_scene
    from hapticd.report.study import scene_figure, scene_table
    from hapticd.report.table import text
    from hapticd.settings.scene import load_scene

    drawing.need_figures(plot)
    plan = plan_scene(load_scene(scene), seconds)
    with progress(as_json) as tell:
        result = run_scene(plan, tell)
    paths = drawing.keep(scene_figure(result), out, plan.scene.name, as_json) if plot else []
    if as_json:
        output.data_json({**_plain(result), "figures": paths})
        return
    output.data(f"{plan.scene.title}: {plan.seconds:g} s, SIMULATED {plan.scene.device}\n")
    output.data(text(scene_table(result)))
    for trial in result.trials:
        if trial.judged is not None:
            output.data(f"\n{trial.leg.name}: {trial.judged.verdict}")


def _plain(result: "SceneResult") -> dict[str, Any]:
    scene, trials = result.plan.scene, [_trial(trial) for trial in result.trials]
    head = {"ok": True, "simulated": True, "scene": scene.name, "title": scene.title, "device": scene.device}
    return {**head, "seconds": result.plan.seconds, "trials": trials}


def _trial(trial: "Trial") -> dict[str, Any]:
    from hapticd.measure.store import plain
    from hapticd.report.study import impedance_rows

    verdict, rows = trial.judged and trial.judged.verdict, impedance_rows(trial)
    told = {"leg": trial.leg, **trial.numbers, "verdict": verdict, "winding_c": trial.winding_c, "impedance": rows}
    return {name: plain(value) for name, value in told.items()}
