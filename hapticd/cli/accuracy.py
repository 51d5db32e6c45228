"""What accuracy costs in time, measured now."""

from typing import Annotated

import typer

from hapticd.cli import drawing, options, output
from hapticd.cli.progress import progress


def command(
    scene: drawing.SceneName,
    quick: Annotated[bool, typer.Option("--quick", help="A coarse look: shorter trials, fewer settings.")] = False,
    plot: drawing.Plot = True,
    out: drawing.Out = drawing.HERE,
    as_json: options.Json = False,
) -> None:
    """Measure error against time: ways to simulate, sub-steps, precision, length, window, and each effect left out.

    The first run of a scene also compiles its kernels, which are kept.
    """
    import time

    from hapticd.measure.accuracy import plan_accuracy, run_accuracy
    from hapticd.measure.scene_run import compare_integrators
    from hapticd.measure.store import plain
    from hapticd.report.study import accuracy_figure, accuracy_table, accuracy_words, integrators_figure
    from hapticd.report.table import text
    from hapticd.settings.scene import load_scene

    drawing.need_figures(plot)
    loaded = load_scene(scene)
    explicit = compare_integrators(loaded)
    with progress(as_json) as tell:
        result = run_accuracy(plan_accuracy(loaded, scene, quick), time.process_time_ns, tell)
    paths = []
    if plot:
        paths += drawing.keep(accuracy_figure(result), out, f"{loaded.name}-accuracy", as_json)
        paths += drawing.keep(integrators_figure(explicit, loaded.title), out, f"{loaded.name}-integrators", as_json)
    if as_json:
        head = {"ok": True, "simulated": True, "scene": loaded.name, "title": loaded.title, "quick": quick}
        output.data_json({**head, **plain(result, skip=("plan",)), "integrators": plain(explicit), "figures": paths})
        return
    output.data(f"{loaded.title}: SIMULATED {loaded.device}\n\n{text(accuracy_table(result))}\n")
    for line in accuracy_words(result):
        output.data(line)
