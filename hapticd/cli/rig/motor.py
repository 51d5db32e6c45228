"""`hapticd rig motor`: which way it pushes, how hard, and what its winding is.

What would break it: two of its measurements asked for at once (refused).
"""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.rig import steps
from hapticd.core.errors import AnalysisError

if TYPE_CHECKING:
    from hapticd.client import Client
    from hapticd.rig.hand import Ask
    from hapticd.rig.result import StepResult

Kilograms = Annotated[
    list[float] | None,
    typer.Option("--mass", metavar="KG", help="A mass that is hung; several, 0 among them."),
]
Side = Annotated[int, typer.Option("--pulls-to", metavar="SIDE", help="Masses pull to x: -1 or 1.")]
Ratio = Annotated[
    float,
    typer.Option(
        "--radius-ratio",
        metavar="R",
        min=1e-3,
        help="Radius of the masses by that of the endpoint.",
    ),
]
SpringOption = Annotated[
    float | None,
    typer.Option("--spring", metavar="N/M", min=1.0, help="Gain by a spring of so many N/m."),
]
SpringTolerance = Annotated[
    float,
    typer.Option("--spring-tolerance", metavar="SHARE", min=0.0, help="Of the spring (95 %)."),
]
Offset = Annotated[bool, typer.Option("--offset", help="The count of no force alone.")]
WindingOption = Annotated[
    bool, typer.Option("--winding", help="Force per ampere, ohm and back-EMF.")
]
Lever = Annotated[
    float | None,
    typer.Option(
        "--lever-m", metavar="M", min=1e-4, help="Radius from torque to endpoint force, in m."
    ),
]


def motor(
    mass: Kilograms = None,
    pulls_to: Side = -1,
    radius_ratio: Ratio = 1.0,
    spring: SpringOption = None,
    spring_tolerance: SpringTolerance = 0.01,
    offset: Offset = False,
    winding: WindingOption = False,
    lever_m: Lever = None,
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """By itself the sign of the force, by pushes of 20 ms with at most a tenth of it: verifies the
    signs. With --mass gain and offset, by masses that hang from the handle; with --spring the gain,
    by a spring between handle and frame; with --offset the count of no force; with --winding what
    an ampere makes, what the winding resists and what a motion induces.

    Writes the tables `force`, `commissioning`, `motor` and `emf_velocity` of the device file.
    """
    from hapticd.rig.steps import motor
    from hapticd.rig.steps import spring as springs
    from hapticd.rig.steps import winding as windings
    from hapticd.settings.load import load

    _one_of(bool(mass), spring is not None, offset, winding)
    if lever_m is not None and not winding:
        raise AnalysisError("--lever-m is written with what --winding finds; add that")
    if pulls_to not in (-1, 1):
        raise AnalysisError(f"--pulls-to {pulls_to}: name the side to which masses pull, -1 or 1")

    def step(client: "Client") -> "StepResult":
        ask: Ask = steps.asking(yes)
        if mass:
            masses = motor.Masses(tuple(mass), pulls_to, radius_ratio)
            return motor.measure_gain(client, ask, masses)
        if spring is not None:
            return springs.measure(client, ask, springs.Spring(spring, spring_tolerance))
        if offset:
            return springs.measure_offset(client, ask)
        if winding:
            return windings.measure(client, ask, lever_m)
        return motor.measure_sign(client, ask)

    steps.show(steps.perform(instance, load(config), step, yes), as_json)


def _one_of(*chosen: bool) -> None:
    """AnalysisError where more than one measurement was asked for."""
    if sum(chosen) > 1:
        raise AnalysisError("--mass, --spring, --offset and --winding are measured one at a time")
