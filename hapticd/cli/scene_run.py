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
    from hapticd.measure.scene_run import SceneRunParams, plan_scene, run_scene
    from hapticd.report.study import scene_figure, scene_table
    from hapticd.report.table import text
    from hapticd.settings.scene import load_scene

    drawing.need_figures(plot)
    plan = plan_scene(SceneRunParams(load_scene(scene), seconds))
    with progress(as_json) as tell:
        result = run_scene(plan, tell)
    paths = drawing.keep(scene_figure(result), out, result.scene.name, as_json) if plot else []
    if as_json:
        output.data_json({**_plain(result), "figures": paths})
        return
    output.data(f"{result.scene.title}: {plan.seconds:g} s, SIMULATED {result.scene.device}\n")
    output.data(text(scene_table(result)))
    for trial in result.trials:
        if trial.verdict is not None:
            output.data(f"\n{trial.leg.name}: {trial.verdict}")


def _plain(result: "SceneResult") -> dict[str, Any]:
    scene, trials = result.scene, [_trial(result, trial) for trial in result.trials]
    head = {"ok": True, "simulated": True, "scene": scene.name, "title": scene.title, "device": scene.device}
    return {**head, "seconds": result.plan.seconds, "trials": trials}


def _trial(result: "SceneResult", trial: "Trial") -> dict[str, Any]:
    from hapticd.measure.store import plain
    from hapticd.report.study import impedance_rows

    arrays = ("position_m", "force_n", "torque_n", "velocity_m_per_s", "measured", "predicted")
    return {**plain(trial, skip=arrays), "impedance": plain(impedance_rows(result, trial))}
