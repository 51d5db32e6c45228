"""Measure, predict, map and draw the Z-width: of a rig, a recorded file, or the simulator."""

import typer

from hapticd.cli.zwidth import compare, import_, limits, map, predict, report, reproduce, search, trial, walls

FORMER = {"added-damping": "damping"}  # names of options that are still taken

app = typer.Typer(no_args_is_help=True, help=__doc__)
for name, verb in {
    "predict": predict,
    "trial": trial,
    "limits": limits,
    "map": map,
    "search": search,
    "walls": walls,
    "import": import_,
    "report": report,
    "compare": compare,
    "reproduce": reproduce,
}.items():
    app.command(name, context_settings={"token_normalize_func": lambda option: FORMER.get(option, option)})(verb.command)
