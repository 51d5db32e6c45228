"""All verbs under one name, and what becomes of errors.

A verb is imported when it is asked for: `hapticd set` loads neither numpy nor what measures. Only
help and mistakes load all of them.
"""

import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any

import typer

from hapticd import __version__
from hapticd.cli import terminal
from hapticd.errors import GuardWarning, HapticdError

USAGE = 2
VERBS = {  # module of this package, and function
    "run": "daemon.run",
    "set": "daemon.set_parameters",
    "get": "daemon.get_parameters",
    "damping": "daemon.damping",
    "guard": "guard.guard",
    "enable": "daemon.enable",
    "disable": "daemon.disable",
    "stop": "daemon.stop",
    "reset": "daemon.reset",
    "zero": "daemon.zero",
    "home": "daemon.home",
    "status": "daemon.status",
    "monitor": "monitor.monitor",
    "events": "monitor.events",
    "console": "console.console",
    "record": "recording.record",
    "replay": "recording.replay",
    "dump": "daemon.dump",
    "mark": "daemon.mark",
    "doctor": "system.doctor",
    "accuracy": "sim.accuracy",
    "sim-board": "sim_board.sim_board",
    "install-system": "system.install_system",
}
GROUPS = {  # module, and its verbs
    "perturb": "daemon.perturb_app",
    "lease": "lease.lease_app",
    "rec": "recording.rec_app",
    "keys": "keys.app",
    "bridge": "bridge.app",
    "config": "system.config_app",
    "sim": "sim.sim_app",
    "rig": "rig.app",
    "zwidth": "zwidth.app",
}


def command_line(asked: str = "") -> typer.Typer:
    """The whole command line, or only its part `asked` if that is a verb or a group."""
    app = typer.Typer(name="hapticd", no_args_is_help=True, pretty_exceptions_enable=False)
    app.callback()(hapticd)
    whole = asked not in VERBS | GROUPS
    for name, place in VERBS.items():
        if whole or name == asked:
            terminal.verb(app, name)(_loaded(place))
    for name, place in GROUPS.items():
        if whole or name == asked:
            app.add_typer(_loaded(place), name=name)
    return app


def _loaded(place: str) -> Any:
    module, _, name = place.partition(".")
    return getattr(import_module(f"hapticd.cli.{module}"), name)


def _version(asked: bool) -> None:
    if asked:
        terminal.data(f"hapticd {__version__}")
        raise typer.Exit


def hapticd(
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Say which, and end."),
    ] = False,
) -> None:
    """A haptic display's servo daemon: run it, set it, watch it, stop it."""


def main(arguments: Sequence[str]) -> int:
    """Run one command line; the exit code."""
    try:
        with warnings.catch_warnings():
            # the verbs have words of their own for what the guard says
            warnings.simplefilter("ignore", GuardWarning)
            command_line(*arguments[:1])(args=list(arguments), prog_name="hapticd")
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
