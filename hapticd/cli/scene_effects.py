"""Which effects a question about a scene needs."""

from enum import StrEnum
from typing import Annotated

import typer

from hapticd.cli import drawing, options, output
from hapticd.cli.progress import progress


class Question(StrEnum):
    """What is asked of the scene."""

    LIMITS = "limits"
    PHASE = "phase"
    PEAK = "peak"


def command(
    scene: drawing.SceneName,
    question: Annotated[
        Question,
        typer.Option("--for", help="limits: passive K, B and M; phase: of Z in the band; peak: of |Z| near 100 Hz, as in Fig. 8."),
    ] = Question.LIMITS,
    tolerance: Annotated[str, typer.Option("--tolerance", metavar="SHARE", help="Change that does not matter: 2% or 0.02.")] = "2%",
    seconds: Annotated[float, typer.Option("--seconds", metavar="S", min=5.0, help="Length of simulated trials.")] = 90.0,
    plot: drawing.Plot = True,
    out: drawing.Out = drawing.HERE,
    as_json: options.Json = False,
) -> None:
    """Leave effects out one at a time, see what the answer does, and propose the cheapest set that is enough."""
    import time

    from hapticd.measure.effects import EffectsParams, plan_effects, run_effects
    from hapticd.measure.store import plain
    from hapticd.report.study import effects_figure, effects_table, effects_words
    from hapticd.report.table import text
    from hapticd.settings.scene import load_scene

    drawing.need_figures(plot)
    loaded = load_scene(scene)
    plan = plan_effects(EffectsParams(loaded, question.value, share(tolerance), seconds))
    with progress(as_json) as tell:
        result = run_effects(plan, time.process_time_ns, tell)
    paths = drawing.keep(effects_figure(result), out, f"{loaded.name}-effects-{question.value}", as_json) if plot else []
    if as_json:
        head = {"ok": True, "simulated": True, "scene": loaded.name, "question": question.value, "tolerance": plan.params.tolerance}
        output.data_json({**head, **plain(result, skip=("plan",)), "figures": paths})
        return
    output.data(f"{loaded.title}: SIMULATED {loaded.device}\n\n{text(effects_table(result))}\n\n{effects_words(result)}")


def share(text: str) -> float:
    """2% or 0.02."""
    number, percent = text.rstrip().removesuffix("%"), text.rstrip().endswith("%")
    try:
        return float(number) / (100.0 if percent else 1.0)
    except ValueError:
        raise typer.BadParameter(f"--tolerance {text!r}: write 2% or 0.02") from None
