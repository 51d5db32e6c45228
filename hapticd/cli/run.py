"""Start the daemon in the foreground: servo and gateway, on the simulated board unless configured otherwise."""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import options, output
from hapticd.cli.banner import SIMULATED

if TYPE_CHECKING:
    from hapticd.assembly.supervisor import Event
    from hapticd.settings.load import Settings


def command(
    config: options.ConfigFile = None,
    instance: options.Instance = options.INSTANCE,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", metavar="HZ", help="Servo rate in place of the file's.")] = None,
    as_json: options.JsonLines = False,
) -> None:
    """Start the daemon in the foreground. Ctrl-C ends it: force to 0, disabled. A second Ctrl-C kills it."""
    from hapticd.assembly.process import on_stop
    from hapticd.assembly.supervisor import Supervisor
    from hapticd.clock import MonotonicClock
    from hapticd.mailbox.files import runtime_folder
    from hapticd.settings.load import Override, load

    overrides = () if rate_hz is None else (Override(("realtime", "rate_hz"), rate_hz, "--rate-hz"),)
    settings = load(config, overrides)

    def tell(event: "Event") -> None:
        try:
            if as_json:
                output.data_json({"event": event.kind, "process": event.process, "text": event.text})
            elif event.kind == "ready":
                output.data(_ready_text(settings, instance))
            else:
                output.talk(f"hapticd: {event.text}")
        except BrokenPipeError:  # whoever read us has left: end as if asked
            output.hush()
            supervisor.stop()

    supervisor = Supervisor(runtime_folder(instance), settings, instance, MonotonicClock(), tell)
    on_stop(supervisor.stop)
    supervisor.run()


def _ready_text(settings: "Settings", instance: str) -> str:
    device, config = settings.device, settings.config
    which = "" if instance == options.INSTANCE else f" --instance {instance}"
    if device.simulated:
        head = output.coloured(SIMULATED, output.YELLOW) + "\n\nSIMULATED board: no force leaves this computer."
    else:
        head = output.coloured(f"REAL BOARD {device.serial}: {device.name}, up to {device.limits.force_n} N.", output.RED)
    return f"""
{head}
hapticd is ready, disabled, at {config.realtime.rate_hz:g} Hz. Try in another terminal:

  hapticd set K=100 B=1 M=0.010{which}     stiffness N/m, damping N s/m, mass kg
  hapticd enable{which}                    force on; the gain ramps up in {config.safety.enable_ramp_s:g} s
  hapticd damping on{which}                electrical damping, {config.added_damping_ns_per_m:g} N s/m; also off, or a level
  hapticd monitor{which}                   watch it
  hapticd stop{which}                      force off, latched; then: hapticd reset
  hapticd status{which}

Ctrl-C here ends it.
"""
