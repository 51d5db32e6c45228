"""`hapticd rig probe|temperature`: sensors beside the encoder, measured into the device file.

What would break it: as `steps`.
"""

from typing import Annotated

import typer

from hapticd.cli.deferred import deferred_imports
from hapticd.cli.rig import steps

with deferred_imports():
    from hapticd.rig.steps import probe as probe_step
    from hapticd.rig.steps import probe_fits
    from hapticd.rig.steps import temperature as temperature_step

Lowest = Annotated[
    float,
    typer.Option("--lowest", metavar="HZ", min=0.1, help="Lowest frequency that is judged."),
]


def probe(
    mass: Annotated[
        float,
        typer.Option("--mass", metavar="KG", min=1e-4, help="What is fixed to the handle, in kg."),
    ],
    tolerance: Annotated[
        float,
        typer.Option("--tolerance", metavar="R", min=0.0, help="Of that mass (95 %), relative."),
    ] = 1e-3,
    lowest: Lowest = 2.0,
    stiffness: Annotated[
        float,
        typer.Option(
            "--stiffness", metavar="N/M", min=0.0, help="Of the spring that is judged there."
        ),
    ] = 600.0,
    no_one_signal: Annotated[
        bool,
        typer.Option(
            "--no-one-signal", help="There is no signal for both channels: leave skew out."
        ),
    ] = False,
    *,
    options: steps.StepOptions,
) -> None:
    """Gain, sign, offset and noise of both probe channels: the perturbation shakes the free handle
    at 10 to 30 Hz, without and with a known mass. One signal into both channels shows skew and
    unequal high-passes, as the damping that a spring seems to have by them.

    Writes the tables `probe_torque` and `probe_velocity` of the device file.
    """
    attached = probe_step.AttachedMass(mass, tolerance)
    judged = probe_fits.ReferenceSpring(lowest, stiffness)
    steps.run(
        options,
        lambda client, ask: probe_step.measure(client, ask, attached, judged, not no_one_signal),
    )


def temperature(
    at: Annotated[
        list[float],
        typer.Option("--at", metavar="C", help="What a thermometer says, in degC; once or twice."),
    ],
    tolerance: Annotated[
        float, typer.Option("--tolerance", metavar="C", min=0.0, help="Of the thermometer (95 %).")
    ] = 0.5,
    no_shake: Annotated[
        bool, typer.Option("--no-shake", help="Leave the back-EMF channel out.")
    ] = False,
    *,
    options: steps.StepOptions,
) -> None:
    """Offset, noise and drift of the winding's temperature at a stated temperature, its scale with
    a second one; then scale and sign of the back-EMF channel, while a hand shakes the handle.

    Makes no force. Writes the tables `temperature` and `emf_velocity` of the device file.
    """
    stated = temperature_step.KnownTemperatures(tuple(at), tolerance)
    steps.run(
        options,
        lambda client, ask: temperature_step.measure(client, ask, stated, not no_shake),
    )
