"""The verbs of `hapticd zwidth`: measure, predict, map and draw the Z-width."""

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import limits, map, predict, report, search, trial, walls

app = typer.Typer(
    no_args_is_help=True,
    help="Measure, predict, map and draw the Z-width: of a rig, a recorded file, or the simulator.",
)
VERBS: dict[str, terminal.Verb] = {
    "predict": predict.command,
    "trial": trial.trial,
    "limits": limits.command,
    "map": map.command,
    "search": search.command,
    "walls": walls.command,
    "import": trial.import_record,
    "export": report.export,
    "report": report.report,
    "compare": report.compare,
}

for name, verb in VERBS.items():
    terminal.verb(app, name)(verb)
