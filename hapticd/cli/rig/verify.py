"""`hapticd rig verify`: known springs, dampers and masses, and the certificate."""

from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.rig.steps import Yes, asking, perform, show
from hapticd.core.errors import ConfigError

if TYPE_CHECKING:
    from hapticd.client import Client
    from hapticd.rig.result import StepResult
    from hapticd.settings.load import Settings

Spring = Annotated[
    float, typer.Option("-K", "--stiffness", metavar="N/M", min=1.0, help="Rendered spring.")
]
Damper = Annotated[
    float, typer.Option("-B", "--viscous", metavar="NS/M", min=0.01, help="Rendered damper.")
]
Mass = Annotated[float, typer.Option("-M", "--mass", metavar="KG", min=1e-4, help="Rendered mass.")]
Attached = Annotated[
    float,
    typer.Option("--attach", metavar="KG", min=0.0, help="Also a mass that a hand fixes to it."),
]
Hooked = Annotated[
    float,
    typer.Option("--spring", metavar="N/M", min=0.0, help="Also a spring that a hand puts on it."),
]
Length = Annotated[
    float, typer.Option("--seconds", metavar="S", min=5.0, help="Length of each trial.")
]


def verify(
    stiffness: Spring = 60.0,
    viscous: Damper = 1.0,
    mass: Mass = 0.004,
    attach: Attached = 0.0,
    spring: Hooked = 0.0,
    seconds: Length = 20.0,
    yes: Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Render a known spring, damper and mass, attach known ones if asked, and see whether the probe
    finds them within what the calibrations leave; with theory, spectra, wire and timing.

    Writes a certificate beside the device file, as JSON and as a page to print. Recordings and
    trials name it, and say when the device file has changed since. Exit 4 if something is not as
    it should be: the certificate then says so.
    """
    from hapticd.rig.certificate import Subject, content, write
    from hapticd.rig.experiment import collect, identity_of
    from hapticd.rig.steps.verify import KnownParts, measure
    from hapticd.settings.load import load

    settings = load(config)
    known = KnownParts(stiffness, viscous, mass, attach, spring, seconds)
    subjects: list[Subject] = []

    def step(client: "Client") -> "StepResult":
        servo = client.hello().servo
        refuse_another_file(servo["device_file_sha256"], settings)
        board = identity_of(client, collect(client, LOOK_S).records)
        rights = client.status().servo.get("realtime", {})
        file = settings.device_file
        subjects.append(Subject(servo, file, settings.device_file_sha256, board, rights))
        return measure(client, asking(yes), known)

    result = perform(instance, settings, step, yes)
    said = content(result, subjects[0], datetime.now().astimezone())
    for path in write(said, settings.device_file):
        terminal.talk(f"written: {path}")
    show(result, as_json)


LOOK_S = 0.1


def refuse_another_file(sha256: str, settings: "Settings") -> None:
    """ConfigError unless the daemon was started with the device file of `settings`."""
    if sha256 != settings.device_file_sha256:
        raise ConfigError(
            f"{settings.device_file} has changed since the daemon was started; start it again, then"
            " verify"
        )
