"""All verbs under one name, and what becomes of errors."""

from collections.abc import Sequence

import typer

from hapticd.cli import (
    accuracy,
    config,
    damping,
    disable,
    doctor,
    dump,
    enable,
    get,
    home,
    install_system,
    keys,
    monitor,
    output,
    perturb,
    rec,
    record,
    replay,
    reset,
    run,
    sim,
    status,
    stop,
    zero,
    zwidth,
)
from hapticd.cli import set as set_verb
from hapticd.errors import HapticdError

USAGE = 2

app = typer.Typer(
    name="hapticd",
    help="A haptic display's servo daemon: run it, set it, watch it, stop it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for name, verb in {
    "run": run, "set": set_verb, "get": get, "damping": damping, "enable": enable, "disable": disable, "stop": stop,
    "reset": reset, "zero": zero, "home": home, "status": status, "monitor": monitor,
    "record": record, "replay": replay, "dump": dump, "doctor": doctor, "accuracy": accuracy, "install-system": install_system,
}.items():  # fmt: skip
    app.command(name)(verb.command)
app.add_typer(perturb.app, name="perturb")
app.add_typer(rec.app, name="rec")
app.add_typer(keys.app, name="keys")
app.add_typer(config.app, name="config")
app.add_typer(sim.app, name="sim")
app.add_typer(zwidth.app, name="zwidth")


def main(arguments: Sequence[str]) -> int:
    """Run one command line; the exit code."""
    try:
        app(args=list(arguments), prog_name="hapticd")
    except HapticdError as error:
        output.complain(error, as_json="--json" in arguments)
        return error.exit_code
    except SystemExit as ending:
        return _told(ending, "--json" in arguments)
    return 0


def _told(ending: SystemExit, as_json: bool) -> int:
    code = ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    if code == USAGE and as_json:
        output.data_json({"ok": False, "error": {"code": "usage", "message": "see stderr", "detail": None}})
    return code
