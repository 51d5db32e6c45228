"""The verbs of `hapticd zwidth`: measure, predict, map and draw the Z-width."""

from collections.abc import Callable

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import compare, limits, map, predict, report, search, trial, walls

FORMER = {"added-damping": "damping"}  # former names of options, which are still taken
FORMER_OF_VERB = {"limits": {"levels": "amplitudes"}}  # levels are those of damping everywhere else

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
    "report": report.report,
    "compare": compare.command,
    "reproduce": report.reproduce,
}


def _present_names(verb: str) -> Callable[[str], str]:
    """The name that an option of `verb` has today, by any name that it ever had."""
    former = FORMER | FORMER_OF_VERB.get(verb, {})
    return lambda option: former.get(option, option)


for name, verb in VERBS.items():
    terminal.verb(app, name, context_settings={"token_normalize_func": _present_names(name)})(verb)
