"""All verbs under one name, and what becomes of errors."""

from collections.abc import Sequence
from typing import Annotated

import typer

from hapticd import __version__
from hapticd.cli import (
    bridge,
    console,
    daemon,
    guard,
    keys,
    lease,
    monitor,
    recording,
    rig,
    sim,
    system,
    terminal,
    zwidth,
)
from hapticd.errors import HapticdError

USAGE = 2

app = typer.Typer(
    name="hapticd",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _version(asked: bool) -> None:
    if asked:
        terminal.data(f"hapticd {__version__}")
        raise typer.Exit


@app.callback()
def hapticd(
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Say which, and end."),
    ] = False,
) -> None:
    """A haptic display's servo daemon: run it, set it, watch it, stop it."""


VERBS: dict[str, terminal.Verb] = {
    "run": daemon.run,
    "set": daemon.set_parameters,
    "get": daemon.get_parameters,
    "damping": daemon.damping,
    "guard": guard.guard,
    "enable": daemon.enable,
    "disable": daemon.disable,
    "stop": daemon.stop,
    "reset": daemon.reset,
    "zero": daemon.zero,
    "home": daemon.home,
    "status": daemon.status,
    "monitor": monitor.monitor,
    "events": monitor.events,
    "console": console.console,
    "record": recording.record,
    "replay": recording.replay,
    "dump": daemon.dump,
    "doctor": system.doctor,
    "accuracy": sim.accuracy,
    "install-system": system.install_system,
}
for name, verb in VERBS.items():
    terminal.verb(app, name)(verb)
app.add_typer(daemon.perturb_app, name="perturb")
app.add_typer(lease.lease_app, name="lease")
app.add_typer(recording.rec_app, name="rec")
app.add_typer(keys.app, name="keys")
app.add_typer(bridge.app, name="bridge")
app.add_typer(system.config_app, name="config")
app.add_typer(sim.sim_app, name="sim")
app.add_typer(rig.app, name="rig")
app.add_typer(zwidth.app, name="zwidth")


def main(arguments: Sequence[str]) -> int:
    """Run one command line; the exit code."""
    try:
        app(args=list(arguments), prog_name="hapticd")
    except HapticdError as error:
        terminal.complain(error, as_json="--json" in arguments)
        return error.exit_code
    except SystemExit as ending:
        return _told(ending, "--json" in arguments)
    return 0


def _told(ending: SystemExit, as_json: bool) -> int:
    code = ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    if code == USAGE and as_json:
        terminal.data_json(
            {"ok": False, "error": {"code": "usage", "message": "see stderr", "detail": None}}
        )
    return code
