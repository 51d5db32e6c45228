"""Load, start and stop a perturbation: a force waveform at 4 kHz on top of what is rendered."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import options, output
from hapticd.cli.change import change, connect
from hapticd.errors import ConfigError
from hapticd.units import PROBE_RATE_HZ

app = typer.Typer(no_args_is_help=True, help=__doc__)
File = Annotated[Path, typer.Argument(metavar="FILE", help="Force in N: .npy of shape (n,), or text with one number a line.")]


@app.command()
def load(file: File, instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Load a waveform; it does not start by itself."""
    import warnings

    import numpy as np

    try:
        with warnings.catch_warnings(action="ignore"):  # of an empty file; it is refused below
            samples_n = np.load(file, allow_pickle=False) if file.suffix == ".npy" else np.loadtxt(file, ndmin=1)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: {error}; expected force in N, one number a line or a .npy of shape (n,)") from error
    if samples_n.ndim != 1 or samples_n.dtype.kind not in "fiu" or not samples_n.size:
        raise ConfigError(f"{file}: shape {samples_n.shape} of {samples_n.dtype}; expected numbers of shape (n,)")
    with connect(instance) as client:
        count = client.perturb_load(samples_n)
    if as_json:
        output.data_json({"ok": True, "samples": count, "seconds": count / PROBE_RATE_HZ})
    else:
        output.data(f"{count} samples loaded, {count / PROBE_RATE_HZ:.3f} s")


@app.command()
def start(
    loop: Annotated[bool, typer.Option("--loop", help="Repeat until stopped.")] = False,
    instance: options.Instance = options.INSTANCE,
    as_json: options.Json = False,
) -> None:
    """Play the loaded waveform."""
    change(instance, as_json, lambda client: client.perturb_start(loop=loop))


@app.command()
def stop(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Stop playing."""
    change(instance, as_json, lambda client: client.perturb_stop())
