"""The verbs of `hapticd rig`: their options, and the steps of `hapticd.rig` that they call.

Two measurements of the motor at once are refused.
"""

from datetime import datetime
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.rig import steps
from hapticd.core.errors import AnalysisError, ConfigError

with terminal.deferred_imports():
    from hapticd.client import client as clients
    from hapticd.rig import certificate, experiment
    from hapticd.rig import result as results
    from hapticd.rig.steps import damping as damping_step
    from hapticd.rig.steps import delivery, probe_fits
    from hapticd.rig.steps import encoder as encoder_step
    from hapticd.rig.steps import identify as identify_step
    from hapticd.rig.steps import motor as motor_step
    from hapticd.rig.steps import probe as probe_step
    from hapticd.rig.steps import verify as verify_step
    from hapticd.rig.steps import winding as winding_step
    from hapticd.settings import load

LOOK_S = 0.1
Lowest = Annotated[
    float,
    typer.Option("--lowest", metavar="HZ", min=0.1, help="Lowest judged frequency."),
]
Length = Annotated[
    float, typer.Option("--seconds", metavar="S", min=5.0, help="Length of each trial.")
]


def encoder(
    distance: Annotated[
        float,
        typer.Option(
            "--distance", metavar="M", min=1e-4, help="Distance from position A to B, in m."
        ),
    ],
    tolerance: Annotated[
        float,
        typer.Option(
            "--tolerance", metavar="M", min=0.0, help="Uncertainty of that distance (95 %), in m."
        ),
    ] = 10e-6,
    *,
    options: steps.StepOptions,
) -> None:
    """Measure sign, scale and noise of the encoder by hand, without force.

    Move the handle to positive x, then between two positions a stated distance apart, and last to
    the place of x = 0. Writes the table `position` of the device file.
    """
    apart = encoder_step.Distance(distance, tolerance)
    steps.run(options, lambda client, ask: encoder_step.measure(client, ask, apart))


def motor(
    mass: Annotated[
        list[float] | None,
        typer.Option(
            "--mass", metavar="KG", help="Hanging mass; repeat the option, and include 0."
        ),
    ] = None,
    pulls_to: Annotated[
        int,
        typer.Option(
            "--pulls-to", metavar="SIDE", help="Direction of the masses' pull along x: -1 or 1."
        ),
    ] = -1,
    radius_ratio: Annotated[
        float,
        typer.Option(
            "--radius-ratio",
            metavar="R",
            min=1e-3,
            help="Radius at which the masses hang, over the endpoint's radius.",
        ),
    ] = 1.0,
    spring: Annotated[
        float | None,
        typer.Option(
            "--spring",
            metavar="N/M",
            min=1.0,
            help="Measure the gain with a spring of this stiffness, N/m.",
        ),
    ] = None,
    spring_tolerance: Annotated[
        float,
        typer.Option(
            "--spring-tolerance",
            metavar="SHARE",
            min=0.0,
            help="Uncertainty of the spring (95 %), relative.",
        ),
    ] = 0.01,
    offset: Annotated[
        bool, typer.Option("--offset", help="Measure only the count of zero force.")
    ] = False,
    winding: Annotated[
        bool,
        typer.Option(
            "--winding", help="Measure force per ampere, winding resistance and back-EMF."
        ),
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
    """Verify the sign of the force with pushes of 20 ms at no more than a tenth of it. With --mass,
    measure gain and offset with masses that hang from the handle; with --spring, the gain with a
    spring between handle and frame; with --offset, the count of zero force; with --winding, force
    per ampere, resistance and back-EMF.

    Writes the tables `force`, `commissioning`, `motor` and `emf_velocity` of the device file.
    """
    _one_of(bool(mass), spring is not None, offset, winding)
    if lever_m is not None and not winding:
        raise AnalysisError("--lever-m is written with what --winding finds; add that")
    if pulls_to not in (-1, 1):
        raise AnalysisError(f"--pulls-to {pulls_to}: name the side to which masses pull, -1 or 1")

    def measure(client: "clients.Client", ask: "results.Ask") -> "results.StepResult":
        if mass:
            masses = motor_step.Masses(tuple(mass), pulls_to, radius_ratio)
            return motor_step.measure_gain(client, ask, masses)
        if spring is not None:
            return motor_step.measure_spring(
                client, ask, motor_step.Spring(spring, spring_tolerance)
            )
        if offset:
            return motor_step.measure_offset(client, ask)
        if winding:
            return winding_step.measure(client, ask, lever_m)
        return motor_step.measure_sign(client, ask)

    steps.run(options, measure)


def _one_of(*chosen: bool) -> None:
    """Raise AnalysisError if more than one measurement was requested."""
    if sum(chosen) > 1:
        raise AnalysisError("--mass, --spring, --offset and --winding are measured one at a time")


def damping(options: steps.StepOptions) -> None:
    """Measure polarity and N s/m per count of the active damping, the physical damping, and the
    uncompensated resistance of the winding, by pushes and free glides with a tenth of the force.

    Let go of the handle. Writes the table `active_damping` and `limits.physical_damping_ns_per_m`
    of the device file.
    """
    steps.run(options, damping_step.measure)


def trim(
    seconds: Annotated[
        float, typer.Option("--seconds", min=3.0, max=600.0, help="Display time.")
    ] = 20.0,
    *,
    options: steps.StepOptions,
) -> None:
    """Show live how much of the back-EMF the resistance compensation leaves, the loop gain at the
    limit of the active damping, and the highest permitted active damping.

    Move the handle back and forth against a weak spring meanwhile; active damping is off. A loop
    gain below -0.5 gives a warning; below -0.9 the step ends with a refusal (exit 4).
    """
    steps.run(
        options,
        lambda client, ask: delivery.measure_residual(client, ask, seconds, terminal.talk),
    )


def audit(
    level: Annotated[
        float | None,
        typer.Option(
            "--level",
            metavar="NS_PER_M",
            min=0.0,
            help="Active damping level to test (default: half the maximum).",
        ),
    ] = None,
    seconds: Annotated[
        float,
        typer.Option("--seconds", min=6.0, max=60.0, help="Time for which the handle is moved."),
    ] = 6.0,
    *,
    options: steps.StepOptions,
) -> None:
    """Compare delivered with commanded active damping and force, while a hand moves the handle back
    and forth against a weak spring. Writes nothing into the device file.
    """
    steps.run(options, lambda client, ask: delivery.measure_delivery(client, ask, level, seconds))


def probe(
    mass: Annotated[
        float,
        typer.Option("--mass", metavar="KG", min=1e-4, help="Mass attached to the handle, in kg."),
    ],
    tolerance: Annotated[
        float,
        typer.Option(
            "--tolerance", metavar="R", min=0.0, help="Uncertainty of that mass (95 %), relative."
        ),
    ] = 1e-3,
    lowest: Lowest = 2.0,
    stiffness: Annotated[
        float,
        typer.Option(
            "--stiffness",
            metavar="N/M",
            min=0.0,
            help="Stiffness of the spring at which skew is judged.",
        ),
    ] = 600.0,
    no_one_signal: Annotated[
        bool,
        typer.Option(
            "--no-one-signal",
            help="Skip the skew measurement (no common signal for both channels).",
        ),
    ] = False,
    *,
    options: steps.StepOptions,
) -> None:
    """Measure gain, sign, offset and noise of both probe channels: the perturbation drives the free
    handle at 10 to 30 Hz, without and with a known mass. One signal into both channels shows skew
    and unequal high-pass filters, as the apparent damping of a spring.

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
        typer.Option("--at", metavar="C", help="Thermometer reading, in degC; once or twice."),
    ],
    tolerance: Annotated[
        float,
        typer.Option(
            "--tolerance", metavar="C", min=0.0, help="Uncertainty of the thermometer (95 %)."
        ),
    ] = 0.5,
    no_shake: Annotated[
        bool, typer.Option("--no-shake", help="Skip the back-EMF channel.")
    ] = False,
    *,
    options: steps.StepOptions,
) -> None:
    """Measure offset, noise and drift of the winding's temperature at a stated temperature, and its
    scale with a second one; then scale and sign of the back-EMF channel, while a hand moves the
    handle.

    No force is applied. Writes the tables `temperature` and `emf_velocity` of the device file.
    """
    stated = winding_step.KnownTemperatures(tuple(at), tolerance)
    steps.run(
        options,
        lambda client, ask: winding_step.measure_temperature(client, ask, stated, not no_shake),
    )


def identify(options: steps.StepOptions) -> None:
    """Identify moving mass, viscous and Coulomb friction, delay and smoothing of the force, by
    driving the free handle with the probe for half a minute. Show which assumption the residuals
    contradict.

    Writes the tables `model` of the device file, with which `zwidth predict`, the guard and
    `zwidth search` calculate. Signs have to be verified.
    """
    steps.run(options, identify_step.measure)


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
        typer.Option("--attach", metavar="KG", min=0.0, help="Also attach a known mass by hand."),
    ] = 0.0,
    spring: Annotated[
        float,
        typer.Option(
            "--spring", metavar="N/M", min=0.0, help="Also attach a known spring by hand."
        ),
    ] = 0.0,
    seconds: Length = 20.0,
    *,
    options: steps.StepOptions,
) -> None:
    """Render a known spring, damper and mass, attach known ones on request, and check that the
    probe finds them within the uncertainty of the calibrations; also check theory, spectra, wire
    and timing.

    Writes a certificate next to the device file, as JSON and as a printable page. Recordings and
    trials refer to it, and report if the device file has changed since. Exit 4 if a check failed;
    the certificate then lists it.
    """
    settings = load.load(options.config)
    known = verify_step.KnownParts(stiffness, viscous, mass, attach, spring, seconds)
    about: list[Any] = []

    def measure(client: "clients.Client", ask: "results.Ask") -> "results.StepResult":
        hello = client.hello()
        refuse_another_file(hello.servo.device_file_sha256, settings)
        board = experiment.identity_of(client, experiment.collect(client, LOOK_S).records)
        about.extend((hello, client.status(), board))
        return verify_step.measure(client, ask, known)

    result = steps.perform(options, settings, measure)
    said = certificate.content(result, datetime.now().astimezone(), *about)
    for path in certificate.write_certificate(said, settings.device_file):
        terminal.talk(f"written: {path}")
    steps.show(result, options.as_json)


def refuse_another_file(sha256: str, settings: "load.Settings") -> None:
    """Raise ConfigError unless the daemon was started with the device file of `settings`."""
    if sha256 != settings.device_file_sha256:
        raise ConfigError(
            f"{settings.device_file} has changed since the daemon was started; start it again, then"
            " verify"
        )
