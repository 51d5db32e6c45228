"""`hapticd rig probe|temperature`: sensors beside the encoder, measured into the device file.

What would break it: as `steps`.
"""

from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.rig import steps

Fixed = Annotated[
    float,
    typer.Option("--mass", metavar="KG", min=1e-4, help="What is fixed to the handle, in kg."),
]
Sure = Annotated[
    float, typer.Option("--tolerance", metavar="R", min=0.0, help="Of that mass (95 %), relative.")
]
Lowest = Annotated[
    float,
    typer.Option("--lowest", metavar="HZ", min=0.1, help="Lowest frequency that is judged."),
]
Stiffness = Annotated[
    float,
    typer.Option("--stiffness", metavar="N/M", min=0.0, help="Of the spring that is judged there."),
]
Celsius = Annotated[
    list[float],
    typer.Option("--at", metavar="C", help="What a thermometer says, in degC; once or twice."),
]
Thermometer = Annotated[
    float, typer.Option("--tolerance", metavar="C", min=0.0, help="Of the thermometer (95 %).")
]
NoShake = Annotated[bool, typer.Option("--no-shake", help="Leave the back-EMF channel out.")]
NoSignal = Annotated[
    bool,
    typer.Option("--no-one-signal", help="There is no signal for both channels: leave skew out."),
]


def probe(
    mass: Fixed,
    tolerance: Sure = 1e-3,
    lowest: Lowest = 2.0,
    stiffness: Stiffness = 600.0,
    no_one_signal: NoSignal = False,
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Gain, sign, offset and noise of both probe channels: the perturbation shakes the free handle
    at 10 to 30 Hz, without and with a known mass. One signal into both channels shows skew and
    unequal high-passes, as the damping that a spring seems to have by them.

    Writes the tables `probe_torque` and `probe_velocity` of the device file.
    """
    from hapticd.rig.steps.probe import AttachedMass, measure
    from hapticd.rig.steps.probe_fits import ReferenceSpring
    from hapticd.settings.load import load

    attached = AttachedMass(mass, tolerance)
    judged = ReferenceSpring(lowest, stiffness)
    found = steps.perform(
        instance,
        load(config),
        lambda client: measure(client, steps.asking(yes), attached, judged, not no_one_signal),
        yes,
    )
    steps.show(found, as_json)


def temperature(
    at: Celsius,
    tolerance: Thermometer = 0.5,
    no_shake: NoShake = False,
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Offset, noise and drift of the winding's temperature at a stated temperature, its scale with
    a second one; then scale and sign of the back-EMF channel, while a hand shakes the handle.

    Makes no force. Writes the tables `temperature` and `emf_velocity` of the device file.
    """
    from hapticd.rig.steps.temperature import KnownTemperatures, measure
    from hapticd.settings.load import load

    stated = KnownTemperatures(tuple(at), tolerance)
    found = steps.perform(
        instance,
        load(config),
        lambda client: measure(client, steps.asking(yes), stated, not no_shake),
        yes,
    )
    steps.show(found, as_json)
