"""Verbs of `hapticd rig` about active damping: measured, trimmed and looked at while it works.

What would break it: as in `steps`.
"""

from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.rig import steps

with deferred_imports():
    from hapticd.rig.steps import damping as damping_step
    from hapticd.rig.steps import delivery


def damping(
    options: steps.StepOptions,
) -> None:
    """Polarity of the active damping, N s/m per count, physical damping, and what the compensation
    leaves of the winding's resistance, by pushes and free glides with a tenth of the force.

    Let go of the handle. Writes the table `active_damping` and `limits.physical_damping_ns_per_m`
    of the device file.
    """
    steps.run(options, damping_step.measure)


def trim(
    seconds: Annotated[
        float, typer.Option("--seconds", min=3.0, max=600.0, help="For which it is shown.")
    ] = 20.0,
    *,
    options: steps.StepOptions,
) -> None:
    """Live: what the resistance compensation leaves of the back-EMF, the loop gain that it makes at
    the limit of the active damping, and the greatest damping that is allowed.

    Move the handle to and fro against a weak spring meanwhile; active damping is off. Below a loop
    gain of -0.5 it warns, below -0.9 it ends and refuses (exit 4).
    """
    steps.run(
        options,
        lambda client, ask: delivery.measure_residual(client, ask, seconds, terminal.talk),
    )


def audit(
    level: Annotated[
        float | None,
        typer.Option("--level", metavar="NS_PER_M", min=0.0, help="Of active damping; else half."),
    ] = None,
    seconds: Annotated[
        float, typer.Option("--seconds", min=6.0, max=60.0, help="For which the handle is moved.")
    ] = 6.0,
    *,
    options: steps.StepOptions,
) -> None:
    """What is commanded against what is delivered, of active damping and force, while a hand moves
    the handle to and fro against a weak spring. Writes nothing into the device file.
    """
    steps.run(options, lambda client, ask: delivery.measure_delivery(client, ask, level, seconds))
