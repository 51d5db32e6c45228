"""Bring in a record: of any other system, or one that hapticd wrote itself."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import options
from hapticd.cli.zwidth import common, trial

File = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help=".csv, .npz, .mat or .h5 with force in N and velocity in m/s; a recording, its export, a run folder."
    ),
]


def command(
    file: File,
    stiffness: Annotated[float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="What was rendered.")] = None,
    viscous: Annotated[float | None, typer.Option("-B", "--viscous", metavar="NS/M", help="What was rendered.")] = None,
    mass: Annotated[float | None, typer.Option("-M", "--mass", metavar="KG", help="What was rendered.")] = None,
    damping: Annotated[float | None, typer.Option("--damping", metavar="NS/M", help="Electrical damping.", min=0)] = None,
    force: Annotated[str, typer.Option("--force-column", metavar="NAME", help="Of FILE.")] = "",
    velocity: Annotated[str, typer.Option("--velocity-column", metavar="NAME", help="Of FILE.")] = "",
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", metavar="HZ", help="Where FILE does not say.")] = None,
    skew: Annotated[float, typer.Option("--skew", metavar="S", help="Known delay of the velocity channel, taken out.")] = 0.0,
    high_pass: Annotated[
        float, typer.Option("--high-pass", metavar="HZ", help="Known corner of an AC-coupled velocity channel, taken out.", min=0)
    ] = 0.0,
    band: common.Band = (2.0, 500.0),
    out: common.Out = None,
    plot: common.Plot = False,
    as_json: options.Json = False,
) -> None:
    """Bring in a record of any other system: a run folder with the record, its verdict and summary (run.json) and impedance.csv,
    as `trial` makes them. A recording, its exports and a run folder say themselves what was rendered.
    """
    trial.command(
        source=str(file), stiffness=stiffness, viscous=viscous, mass=mass, damping=damping, force=force, velocity=velocity,
        rate_hz=rate_hz, skew=skew, high_pass=high_pass, band=band, out=out, plot=plot, as_json=as_json,
    )  # fmt: skip
