"""Simulate scenes: run them, explain them, their effects, their damping, their accuracy."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress

if TYPE_CHECKING:
    from hapticd.model.scene import Scene
    from hapticd.studies.scene import SceneResult, SceneTrial

QUESTIONS = (
    "limits: passive K, B, M; phase: of Z in the band; peak: of |Z| near 100 Hz, as in Fig. 8."
)
Tolerance = Annotated[
    str,
    typer.Option("--tolerance", metavar="SHARE", help="Change that does not matter: 2% or 0.02."),
]
TrialSeconds = Annotated[
    float, typer.Option("--seconds", metavar="S", min=5.0, help="Length of simulated trials.")
]
SceneSeconds = Annotated[
    float | None,
    typer.Option("--seconds", metavar="S", min=0.001, help="Length in place of the scene's."),
]
Quick = Annotated[
    bool, typer.Option("--quick", help="A coarse look: shorter trials, fewer settings.")
]


class EffectsQuestion(StrEnum):
    """What is asked of the scene."""

    LIMITS = "limits"
    PHASE = "phase"
    PEAK = "peak"


sim_app = typer.Typer(
    no_args_is_help=True,
    help="Simulate scenes: run, explain, find the effects they need and the damping they bear.",
)


@terminal.verb(sim_app, "run")
def sim_run(
    scene: terminal.SceneName,
    plot: terminal.Plot = False,
    figure_width: terminal.FigureWidth = None,
    seconds: SceneSeconds = None,
    out: terminal.Out = terminal.HERE,
    as_json: terminal.Json = False,
) -> None:
    """Simulate a scene with and without its active damping: traces, and impedance and
    verdict where noise moves it.
    """
    from hapticd.settings.scene import load_scene
    from hapticd.studies.report import scene_figure, scene_table
    from hapticd.studies.scene import plan_scene, run_scene
    from hapticd.zwidth.report.table import text

    terminal.need_engine()
    terminal.need_figures(plot)
    plan = plan_scene(load_scene(scene), seconds)
    with progress(as_json) as tell:
        result = run_scene(plan, tell)
    paths = []
    if plot:
        figure = scene_figure(result, figure_width)
        paths = terminal.save_figure(figure, out, plan.scene.name, as_json)
    if as_json:
        terminal.data_json({**_result_json(result), "figures": paths})
        return
    terminal.data(f"{plan.scene.title}: {plan.seconds:g} s, SIMULATED {plan.scene.device}\n")
    terminal.data(text(scene_table(result)))
    for trial in result.trials:
        if trial.judged is not None:
            terminal.data(f"\n{trial.case.name}: {trial.judged.verdict}")


def _result_json(result: "SceneResult") -> dict[str, Any]:
    trials = [_trial_json(trial) for trial in result.trials]
    return {**_about(result.plan.scene), "seconds": result.plan.seconds, "trials": trials}


def _about(scene: "Scene") -> dict[str, Any]:
    return {
        "ok": True,
        "simulated": True,
        "scene": scene.name,
        "title": scene.title,
        "device": scene.device,
    }


def _trial_json(trial: "SceneTrial") -> dict[str, Any]:
    from hapticd.studies.report import impedance_rows
    from hapticd.zwidth.store import to_json

    found = {
        "leg": trial.case,
        **trial.numbers,
        "verdict": trial.judged and trial.judged.verdict,
        "winding_c": trial.winding_c,
        "impedance": impedance_rows(trial),
    }
    return {name: to_json(value) for name, value in found.items()}


@terminal.verb(sim_app, "explain")
def sim_explain(scene: terminal.SceneName, as_json: terminal.Json = False) -> None:
    """Say what a scene simulates: states, nonlinearities, time constants, step, why
    each is there, and its measured cost.
    """
    import time

    from hapticd.model.compose import compose
    from hapticd.model.stability import explain
    from hapticd.settings.scene import load_scene
    from hapticd.studies import report as words
    from hapticd.studies.accuracy import cost
    from hapticd.zwidth.report.table import text
    from hapticd.zwidth.scenes import SUBSTEPS
    from hapticd.zwidth.store import to_json

    loaded = load_scene(scene)
    found = explain(
        compose(loaded), sorted({step.level_ns_per_m for step in loaded.active_damping})
    )
    spent = cost(loaded, scene, time.process_time_ns)
    if as_json:
        costs = {"cost": to_json(spent), "substeps": SUBSTEPS}
        terminal.data_json({**_about(loaded), **to_json(found), **costs})
        return
    size = f"{len(found.states)} states, {len(found.nonlinearities)} nonlinearities"
    terminal.data(f"{loaded.title}: SIMULATED {loaded.device}, {size}")
    for part in words.explained(found):
        terminal.data(f"\n{text(part)}")
    terminal.data("")
    for line in (*words.step_words(found, loaded, SUBSTEPS), *words.cost_words(spent)):
        terminal.data(line)


@terminal.verb(sim_app, "effects")
def sim_effects(
    scene: terminal.SceneName,
    question: Annotated[
        EffectsQuestion, typer.Option("--for", help=QUESTIONS)
    ] = EffectsQuestion.LIMITS,
    tolerance: Tolerance = "2%",
    seconds: TrialSeconds = 90.0,
    plot: terminal.Plot = True,
    figure_width: terminal.FigureWidth = None,
    out: terminal.Out = terminal.HERE,
    as_json: terminal.Json = False,
) -> None:
    """Leave effects out one at a time, see what the answer does, and propose the
    cheapest set that is enough.
    """
    import time

    from hapticd.settings.scene import load_scene
    from hapticd.studies.effects import EffectsParams, plan_effects, run_effects
    from hapticd.studies.report import effects_figure, effects_table, effects_words
    from hapticd.zwidth.report.table import text
    from hapticd.zwidth.store import to_json

    terminal.need_engine()
    terminal.need_figures(plot)
    loaded = load_scene(scene)
    plan = plan_effects(EffectsParams(loaded, question.value, share(tolerance), seconds))
    with progress(as_json) as tell:
        result = run_effects(plan, time.process_time_ns, tell)
    paths = []
    if plot:
        name = f"{loaded.name}-effects-{question.value}"
        figure = effects_figure(result, figure_width)
        paths = terminal.save_figure(figure, out, name, as_json)
    if as_json:
        about = {"ok": True, "simulated": True, "scene": loaded.name}
        asked = {"question": question.value, "tolerance": plan.params.tolerance}
        found = to_json(result, skip=("plan",))
        terminal.data_json({**about, **asked, **found, "figures": paths})
        return
    terminal.data(f"{loaded.title}: SIMULATED {loaded.device}\n\n{text(effects_table(result))}\n")
    terminal.data(effects_words(result))


def share(text: str) -> float:
    """2% or 0.02."""
    number = text.rstrip().removesuffix("%")
    percent = text.rstrip().endswith("%")
    try:
        return float(number) / (100.0 if percent else 1.0)
    except ValueError:
        raise typer.BadParameter(f"--tolerance {text!r}: write 2% or 0.02") from None


@terminal.verb(sim_app, "ceiling")
def sim_ceiling(scene: terminal.SceneName, as_json: terminal.Json = False) -> None:
    """Say the largest stable active damping: of the device alone, with the scene's
    environment, and hot or cold.
    """
    from hapticd.settings.scene import load_scene
    from hapticd.studies.report import ceiling_table, ceiling_words
    from hapticd.studies.scene import ceiling
    from hapticd.zwidth.report.table import text
    from hapticd.zwidth.store import to_json

    loaded = load_scene(scene)
    found = ceiling(loaded)
    if as_json:
        about = {"ok": True, "simulated": True, "scene": loaded.name, "unit": "N s/m"}
        terminal.data_json({**about, **to_json(found)})
        return
    terminal.data(f"{loaded.title}: SIMULATED {loaded.device}\n")
    for line in ceiling_words(found):
        terminal.data(line)
    if found.warmer:
        terminal.data(f"\n{text(ceiling_table(found))}")


def accuracy(
    scene: terminal.SceneName,
    quick: Quick = False,
    plot: terminal.Plot = True,
    figure_width: terminal.FigureWidth = None,
    out: terminal.Out = terminal.HERE,
    as_json: terminal.Json = False,
) -> None:
    """Measure error against time: ways to simulate, sub-steps, precision, length, window, and each
    effect left out.

    The first run of a scene also compiles its kernels, which are kept.
    """
    import time

    from hapticd.settings.scene import load_scene
    from hapticd.studies.accuracy import plan_accuracy, run_accuracy
    from hapticd.studies.report import (
        accuracy_figure,
        accuracy_table,
        accuracy_words,
        integrators_figure,
    )
    from hapticd.studies.scene import compare_integrators
    from hapticd.zwidth.report.table import text
    from hapticd.zwidth.store import to_json

    terminal.need_engine()
    terminal.need_figures(plot)
    loaded = load_scene(scene)
    explicit = compare_integrators(loaded)
    with progress(as_json) as tell:
        result = run_accuracy(plan_accuracy(loaded, scene, quick), time.process_time_ns, tell)
    paths = []
    if plot:
        figures = {
            "accuracy": accuracy_figure(result, figure_width),
            "integrators": integrators_figure(explicit, loaded.title, figure_width),
        }
        for name, figure in figures.items():
            named = f"{loaded.name}-{name}"
            paths += terminal.save_figure(figure, out, named, as_json)
    if as_json:
        about = {"ok": True, "simulated": True, "scene": loaded.name, "title": loaded.title}
        found = {**to_json(result, skip=("plan",)), "integrators": to_json(explicit)}
        terminal.data_json({**about, "quick": quick, **found, "figures": paths})
        return
    terminal.data(f"{loaded.title}: SIMULATED {loaded.device}\n\n{text(accuracy_table(result))}\n")
    for line in accuracy_words(result):
        terminal.data(line)
