"""All verbs under one name, and the handling of errors.

A verb is imported on demand: `hapticd set` loads neither numpy nor measurement modules. Only help
and mistakes load all of them.
"""

import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any

import typer

from hapticd import __version__
from hapticd.cli import terminal
from hapticd.core.errors import GuardWarning, HapticdError

__all__ = ["main"]

SECTIONS: dict[str, dict[str, str]] = {  # section of the help; module here, and verb or group
    "Daily use": {
        "run": "daemon.run",
        "status": "daemon.status",
        "enable": "daemon.enable",
        "set": "daemon.set_parameters",
        "get": "daemon.get_parameters",
        "damping": "daemon.damping",
        "guard": "change.guard",
        "disable": "daemon.disable",
        "stop": "daemon.stop",
        "reset": "daemon.reset",
        "zero": "daemon.zero",
        "home": "daemon.home",
        "lease": "change.lease_app",
    },
    "Look": {
        "monitor": "monitor.monitor",
        "events": "monitor.events",
        "console": "network.console",
        "help": "app.explain",
    },
    "Record": {
        "record": "recording.record",
        "mark": "daemon.mark",
        "dump": "daemon.dump",
        "replay": "recording.replay",
        "rec": "recording.rec_app",
    },
    "Set up": {
        "doctor": "system.doctor",
        "install-system": "system.install_system",
        "config": "system.config_app",
        "rig": "rig.app",
        "keys": "network.keys_app",
        "bridge": "network.bridge_app",
    },
    "Simulate": {
        "accuracy": "sim.accuracy",
        "sim-board": "sim.sim_board",
        "sim": "sim.sim_app",
        "studies": "sim.studies_app",
    },
    "Measure": {"zwidth": "zwidth.app", "perturb": "daemon.perturb_app"},
}
CLASSES = {"damping": "change.SignedLevel"}  # of verbs with a parser of their own
HELP_NAMES = {"help_option_names": ["-h", "--help"]}
USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]  # Typer's class for a user's mistake
INSTANCE_OPTION = "--instance"


def command_line(asked: str = "") -> typer.Typer:
    """Return the whole command line, or only its part `asked` if that is a verb or a group."""
    app = typer.Typer(
        name="hapticd",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings=HELP_NAMES,
    )
    app.callback()(hapticd)
    whole = not any(asked in names for names in SECTIONS.values())
    for section, names in SECTIONS.items():
        for name in names if whole else names.keys() & {asked}:
            found = _loaded(names[name])
            if isinstance(found, typer.Typer):
                app.add_typer(found, name=name, rich_help_panel=section)
            else:
                kind = _loaded(CLASSES[name]) if name in CLASSES else None
                terminal.verb(app, name, rich_help_panel=section, cls=kind)(found)
    return app


def _loaded(place: str) -> Any:
    module, _, name = place.partition(".")
    return getattr(import_module(f"hapticd.cli.{module}"), name)


def _version(asked: bool) -> None:
    if asked:
        terminal.data(f"hapticd {__version__}")
        raise typer.Exit


def hapticd(
    context: typer.Context,
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
    instance: terminal.InstanceBefore = None,
) -> None:
    """A haptic display's servo daemon: run it, set it, watch it, stop it."""
    verb = context.invoked_subcommand
    group: Any = context.command
    if instance is not None and verb and not _asks(group.commands[verb]):
        raise typer.BadParameter(f"`hapticd {verb}` asks no daemon: leave --instance out")
    context.obj = instance


def _asks(command: Any) -> bool:
    """Return whether `command`, or a verb of that group, takes the name of a daemon."""
    own = any(parameter.name == "instance" for parameter in command.params)
    return own or any(map(_asks, getattr(command, "commands", {}).values()))


def explain(
    verb: Annotated[
        list[str] | None,
        typer.Argument(metavar="[VERB [SUBVERB]]", help="For example `set`, or `rec export`."),
    ] = None,
) -> None:
    """Explain a verb, as its --help does; without a VERB list all of them."""
    words = verb or []
    command_line(*words[:1])(args=[*words, "--help"], prog_name="hapticd", standalone_mode=False)


def main(arguments: Sequence[str]) -> int:
    """Run one command line and return the exit code."""
    as_json = "--json" in arguments
    try:
        with warnings.catch_warnings():
            # the verbs print the guard's warnings themselves
            warnings.simplefilter("ignore", GuardWarning)
            app = command_line(_verb(arguments))
            code = app(args=list(arguments), prog_name="hapticd", standalone_mode=False)
    except HapticdError as error:
        terminal.complain(error, as_json=as_json)
        return error.exit_code
    except USAGE_ERROR as error:
        return terminal.explain(error, as_json)
    except typer.Abort:
        terminal.talk("Aborted.")
        return HapticdError.exit_code
    except SystemExit as ending:
        return _code(ending)
    return int(code or 0)


def _verb(arguments: Sequence[str]) -> str:
    """Return the first argument that is not an option; empty without one."""
    words = iter(arguments)
    for word in words:
        if word == INSTANCE_OPTION:
            next(words, None)
        elif not word.startswith("-"):
            return word
    return ""


def _code(ending: SystemExit) -> int:
    return ending.code if isinstance(ending.code, int) else int(ending.code is not None)
