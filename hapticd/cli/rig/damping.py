"""Verbs of `hapticd rig` about active damping: measured, trimmed and looked at while it works.

What would break it: as in `steps`.
"""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.rig import steps

if TYPE_CHECKING:
    from hapticd.client import Client
    from hapticd.rig.result import StepResult

Level = Annotated[
    float | None,
    typer.Option("--level", metavar="NS_PER_M", min=0.0, help="Of active damping; else half."),
]
AuditSeconds = Annotated[
    float, typer.Option("--seconds", min=6.0, max=60.0, help="For which the handle is moved.")
]
TrimSeconds = Annotated[
    float, typer.Option("--seconds", min=3.0, max=600.0, help="For which it is shown.")
]


def damping(
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Polarity of the active damping, N s/m per count, physical damping, and what the compensation
    leaves of the winding's resistance, by pushes and free glides with a tenth of the force.

    Let go of the handle. Writes the table `damping` and `limits.physical_damping_ns_per_m` of the
    device file.
    """
    from hapticd.rig.steps.damping import measure
    from hapticd.settings.load import load

    step = steps.perform(
        instance, load(config), lambda client: measure(client, steps.asking(yes)), yes
    )
    steps.show(step, as_json)


def trim(
    seconds: TrimSeconds = 20.0,
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Live: what the resistance compensation leaves of the back-EMF, the loop gain that it makes at
    the limit of the active damping, and the greatest damping that is allowed.

    Move the handle to and fro against a weak spring meanwhile; active damping is off. Below a loop
    gain of -0.5 it warns, below -0.9 it ends and refuses (exit 4).
    """
    from hapticd.rig.steps.delivery import measure_residual
    from hapticd.settings.load import load

    def step(client: "Client") -> "StepResult":
        return measure_residual(client, steps.asking(yes), seconds, terminal.talk)

    steps.show(steps.perform(instance, load(config), step, yes), as_json)


def audit(
    level: Level = None,
    seconds: AuditSeconds = 6.0,
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """What is commanded against what is delivered, of active damping and force, while a hand moves
    the handle to and fro against a weak spring. Writes nothing into the device file.
    """
    from hapticd.rig.steps.delivery import measure_delivery
    from hapticd.settings.load import load

    def step(client: "Client") -> "StepResult":
        return measure_delivery(client, steps.asking(yes), level, seconds)

    steps.show(steps.perform(instance, load(config), step, yes), as_json)
