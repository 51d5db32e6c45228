"""The verbs of `hapticd rig`: from a bare board to measured values in its device file."""

import typer

from hapticd.cli import terminal
from hapticd.cli.rig import guided, steps, verbs

app = typer.Typer(
    invoke_without_command=True,
    help="Commission a device: measure it step by step, and write its device file.",
)
app.callback()(guided.guided)
for verb in (
    steps.link,
    verbs.encoder,
    verbs.motor,
    verbs.damping,
    verbs.trim,
    verbs.audit,
    verbs.probe,
    verbs.temperature,
    verbs.identify,
    verbs.verify,
):
    terminal.verb(app, verb.__name__)(verb)
