"""`hapticd rig motor`: which way it pushes, how hard, and what its winding is.

What would break it: two of its measurements asked for at once (refused).
"""

from typing import Annotated

import typer

from hapticd.cli.deferred import deferred_imports
from hapticd.cli.rig import steps
from hapticd.core.errors import AnalysisError

with deferred_imports():
    from hapticd.client import client as clients
    from hapticd.rig import hand as hands
    from hapticd.rig import result as results
    from hapticd.rig.steps import motor as motor_step
    from hapticd.rig.steps import spring as spring_step
    from hapticd.rig.steps import winding as winding_step


def motor(
    mass: Annotated[
        list[float] | None,
        typer.Option("--mass", metavar="KG", help="A mass that is hung; several, 0 among them."),
    ] = None,
    pulls_to: Annotated[
        int, typer.Option("--pulls-to", metavar="SIDE", help="Masses pull to x: -1 or 1.")
    ] = -1,
    radius_ratio: Annotated[
        float,
        typer.Option(
            "--radius-ratio",
            metavar="R",
            min=1e-3,
            help="Radius of the masses by that of the endpoint.",
        ),
    ] = 1.0,
    spring: Annotated[
        float | None,
        typer.Option("--spring", metavar="N/M", min=1.0, help="Gain by a spring of so many N/m."),
    ] = None,
    spring_tolerance: Annotated[
        float,
        typer.Option("--spring-tolerance", metavar="SHARE", min=0.0, help="Of the spring (95 %)."),
    ] = 0.01,
    offset: Annotated[bool, typer.Option("--offset", help="The count of no force alone.")] = False,
    winding: Annotated[
        bool, typer.Option("--winding", help="Force per ampere, ohm and back-EMF.")
    ] = False,
    lever_m: Annotated[
        float | None,
        typer.Option(
            "--lever-m", metavar="M", min=1e-4, help="Radius from torque to endpoint force, in m."
        ),
    ] = None,
    *,
    options: steps.StepOptions,
) -> None:
    """By itself the sign of the force, by pushes of 20 ms with at most a tenth of it: verifies the
    signs. With --mass gain and offset, by masses that hang from the handle; with --spring the gain,
    by a spring between handle and frame; with --offset the count of no force; with --winding what
    an ampere makes, what the winding resists and what a motion induces.

    Writes the tables `force`, `commissioning`, `motor` and `emf_velocity` of the device file.
    """
    _one_of(bool(mass), spring is not None, offset, winding)
    if lever_m is not None and not winding:
        raise AnalysisError("--lever-m is written with what --winding finds; add that")
    if pulls_to not in (-1, 1):
        raise AnalysisError(f"--pulls-to {pulls_to}: name the side to which masses pull, -1 or 1")

    def measure(client: "clients.Client", ask: "hands.Ask") -> "results.StepResult":
        if mass:
            masses = motor_step.Masses(tuple(mass), pulls_to, radius_ratio)
            return motor_step.measure_gain(client, ask, masses)
        if spring is not None:
            known = spring_step.Spring(spring, spring_tolerance)
            return spring_step.measure(client, ask, known)
        if offset:
            return spring_step.measure_offset(client, ask)
        if winding:
            return winding_step.measure(client, ask, lever_m)
        return motor_step.measure_sign(client, ask)

    steps.run(options, measure)


def _one_of(*chosen: bool) -> None:
    """AnalysisError where more than one measurement was asked for."""
    if sum(chosen) > 1:
        raise AnalysisError("--mass, --spring, --offset and --winding are measured one at a time")
