"""Bring in a record of any other system."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import options
from hapticd.cli.zwidth import common, trial

File = Annotated[Path, typer.Argument(metavar="FILE", help=".csv, .npz, .mat or .h5 with force [N] and velocity [m/s].")]


def command(
    file: File,
    stiffness: Annotated[float, typer.Option("-K", "--stiffness", metavar="N/M", help="What was rendered.")] = 0.0,
    damping: Annotated[float, typer.Option("-B", "--damping", metavar="NS/M", help="What was rendered.")] = 0.0,
    mass: Annotated[float, typer.Option("-M", "--mass", metavar="KG", help="What was rendered.")] = 0.0,
    added: Annotated[float, typer.Option("--added-damping", metavar="NS/M", help="Electrical damping.", min=0)] = 0.0,
    force: Annotated[str, typer.Option("--force-column", metavar="NAME", help="Of FILE.")] = "",
    velocity: Annotated[str, typer.Option("--velocity-column", metavar="NAME", help="Of FILE.")] = "",
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", metavar="HZ", help="Where FILE does not say.")] = None,
    band: common.Band = (2.0, 500.0),
    out: common.Out = None,
    plot: common.Plot = False,
    as_json: options.Json = False,
) -> None:
    """Bring in a record of any other system: a run folder with record, verdict and summary, as `trial` makes them."""
    trial.command(
        source=str(file), stiffness=stiffness, damping=damping, mass=mass, added=added, force=force, velocity=velocity,
        rate_hz=rate_hz, band=band, out=out, plot=plot, as_json=as_json,
    )  # fmt: skip
