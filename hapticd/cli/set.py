"""Change what is rendered: stiffness, damping, mass, filters, wall, electrical damping."""

from typing import Annotated

import typer

from hapticd.cli import options
from hapticd.cli.change import change
from hapticd.cli.numbers import changes

Changes = Annotated[list[str], typer.Argument(metavar="NAME=VALUE", help="K in N/m, B in N s/m, M in kg, damping in N s/m, ...")]
Ramp = Annotated[float | None, typer.Option("--ramp-s", metavar="S", help="Length of the ramp; else as configured.")]
AtTick = Annotated[int | None, typer.Option("--at-tick", metavar="N", help="Servo tick from which it acts; else the next one.")]
IfRev = Annotated[int | None, typer.Option("--if-rev", metavar="N", help="Only if the revision is still N.")]


def command(
    what: Changes,
    ramp_s: Ramp = None,
    at_tick: AtTick = None,
    if_rev: IfRev = None,
    instance: options.Instance = options.INSTANCE,
    as_json: options.Json = False,
) -> None:
    """Change what is rendered, e.g. `hapticd set K=100 B=1 M=0.010 --ramp-s 0.1`. All of it or nothing.

    Also filters.velocity_hz, filters.velocity_zeta, filters.acceleration_hz, filters.acceleration_zeta,
    wall.stiffness_n_per_m, wall.damping_ns_per_m, wall.position_m, wall.side (-1, 0, 1).
    """
    asked = changes(what)
    change(instance, as_json, lambda client: client.set(**asked, ramp_s=ramp_s, at_tick=at_tick, if_rev=if_rev))
