"""Z(f) of a kept trial as a file of another tool."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.core.errors import ConfigError

with deferred_imports():
    from hapticd.zwidth import interchange, store, trial


def command(
    form: Annotated[
        Literal["npz", "mat", "csv"],
        typer.Argument(
            metavar="npz|mat|csv",
            help="For python-control, for `frd` of MATLAB or Octave, or comma-separated values.",
        ),
    ],
    run: Annotated[
        Path, typer.Argument(metavar="RUN", callback=terminal.there, help="The folder of a trial.")
    ],
    out: Annotated[
        Path | None,
        typer.Argument(
            metavar="[OUT]", help="Else impedance-frd in the folder.", show_default=False
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Write the impedance of a trial with the interval of Re Z for python-control, MATLAB or a
    table: `hapticd zwidth export npz RUN`.

    The least Re Z of the band is the input feedforward passivity index that these tools compute.
    """
    kept = store.read_summary(run)
    if kept["kind"] != "trial":
        raise ConfigError(f"{run}: a run of kind {kept['kind']!r} has no impedance; name a trial's")
    target = out or run / f"impedance-frd.{form}"
    if target.exists():
        raise ConfigError(f"{target} exists; name another file")
    written = interchange.write_response(trial.kept_trial(run, kept, None), target, form)
    if as_json:
        terminal.data_json({"ok": True, "files": [str(written)]})
    else:
        terminal.data(str(written))
