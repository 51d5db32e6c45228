"""Measure, predict, map and draw the Z-width: of a rig, a recorded file, or the simulator."""

from collections.abc import Callable

import typer

from hapticd.cli.zwidth import compare, limits, map, predict, report, search, trial, walls

FORMER = {"added-damping": "damping"}  # names of options that are still taken

app = typer.Typer(no_args_is_help=True, help=__doc__)
VERBS: dict[str, Callable[..., None]] = {
    "predict": predict.command,
    "trial": trial.trial,
    "limits": limits.command,
    "map": map.command,
    "search": search.command,
    "walls": walls.command,
    "import": trial.import_record,
    "report": report.report,
    "compare": compare.command,
    "reproduce": report.reproduce,
}
for name, verb in VERBS.items():
    app.command(
        name, context_settings={"token_normalize_func": lambda option: FORMER.get(option, option)}
    )(verb)
