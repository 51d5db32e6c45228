"""The verbs of `hapticd rig`: from a bare board to measured values in its device file."""

import typer

from hapticd.cli import terminal
from hapticd.cli.rig import damping, guided, sensors, steps
from hapticd.cli.rig.identify import identify
from hapticd.cli.rig.motor import motor
from hapticd.cli.rig.verify import verify

app = typer.Typer(
    invoke_without_command=True,
    help="First day at the rig: measure the device step by step, and write its device file.",
)
VERBS: dict[str, terminal.Verb] = {
    "link": steps.link,
    "encoder": steps.encoder,
    "motor": motor,
    "damping": damping.damping,
    "trim": damping.trim,
    "audit": damping.audit,
    "probe": sensors.probe,
    "temperature": sensors.temperature,
    "identify": identify,
    "verify": verify,
}
app.callback()(guided.guided)
for name, verb in VERBS.items():
    terminal.verb(app, name)(verb)
