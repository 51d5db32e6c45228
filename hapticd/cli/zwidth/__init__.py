"""The verbs of `hapticd zwidth`: measure, predict, map and draw the Z-width."""

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import limits, map, report, trial

app = typer.Typer(
    no_args_is_help=True,
    help="Measure, predict, map and draw the Z-width: of a rig, a recorded file, or the simulator.",
)
VERBS: dict[str, terminal.Verb] = {
    "predict": limits.predict_command,
    "trial": trial.trial,
    "limits": limits.limits_command,
    "map": map.map_command,
    "search": map.search_command,
    "walls": limits.walls_command,
    "import": trial.import_record,
    "export": report.export,
    "report": report.report,
    "compare": report.compare,
}

for name, verb in VERBS.items():
    terminal.verb(app, name)(verb)
