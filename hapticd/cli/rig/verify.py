"""`hapticd rig verify`: known springs, dampers and masses, and the certificate."""

from datetime import datetime
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.rig import steps
from hapticd.core.errors import ConfigError
from hapticd.core.params import to_plain

with deferred_imports():
    from hapticd.client import client as clients
    from hapticd.rig import certificate, experiment
    from hapticd.rig import hand as hands
    from hapticd.rig import result as results
    from hapticd.rig.steps import verify as verify_step
    from hapticd.settings import load


Length = Annotated[
    float, typer.Option("--seconds", metavar="S", min=5.0, help="Length of each trial.")
]


def verify(
    stiffness: Annotated[
        float, typer.Option("-K", "--stiffness", metavar="N/M", min=1.0, help="Rendered spring.")
    ] = 60.0,
    viscous: Annotated[
        float, typer.Option("-B", "--viscous", metavar="NS/M", min=0.01, help="Rendered damper.")
    ] = 1.0,
    mass: Annotated[
        float, typer.Option("-M", "--mass", metavar="KG", min=1e-4, help="Rendered mass.")
    ] = 0.004,
    attach: Annotated[
        float,
        typer.Option(
            "--attach", metavar="KG", min=0.0, help="Also a mass that a hand fixes to it."
        ),
    ] = 0.0,
    spring: Annotated[
        float,
        typer.Option(
            "--spring", metavar="N/M", min=0.0, help="Also a spring that a hand puts on it."
        ),
    ] = 0.0,
    seconds: Length = 20.0,
    *,
    options: steps.StepOptions,
) -> None:
    """Render a known spring, damper and mass, attach known ones if asked, and see whether the probe
    finds them within what the calibrations leave; with theory, spectra, wire and timing.

    Writes a certificate beside the device file, as JSON and as a page to print. Recordings and
    trials name it, and say when the device file has changed since. Exit 4 if something is not as
    it should be: the certificate then says so.
    """
    settings = load.load(options.config)
    known = verify_step.KnownParts(stiffness, viscous, mass, attach, spring, seconds)
    subjects: list[certificate.Subject] = []

    def measure(client: "clients.Client", ask: "hands.Ask") -> "results.StepResult":
        servo = to_plain(client.hello().servo)
        refuse_another_file(servo["device_file_sha256"], settings)
        board = experiment.identity_of(client, experiment.collect(client, LOOK_S).records)
        rights = client.status().servo.get("realtime", {})
        file = settings.device_file
        subject = certificate.Subject(servo, file, settings.device_file_sha256, board, rights)
        subjects.append(subject)
        return verify_step.measure(client, ask, known)

    result = steps.perform(options, settings, measure)
    said = certificate.content(result, subjects[0], datetime.now().astimezone())
    for path in certificate.write(said, settings.device_file):
        terminal.talk(f"written: {path}")
    steps.show(result, options.as_json)


LOOK_S = 0.1


def refuse_another_file(sha256: str, settings: "load.Settings") -> None:
    """ConfigError unless the daemon was started with the device file of `settings`."""
    if sha256 != settings.device_file_sha256:
        raise ConfigError(
            f"{settings.device_file} has changed since the daemon was started; start it again, then"
            " verify"
        )
