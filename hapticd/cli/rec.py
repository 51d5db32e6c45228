"""Finish, look at and convert recordings."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hapticd.cli import options, output
from hapticd.errors import ConfigError

app = typer.Typer(no_args_is_help=True, help=__doc__)
Source = Annotated[Path, typer.Argument(metavar="FILE", help="NAME.h5, NAME.part.h5 or NAME.flight.")]
Target = Annotated[Path | None, typer.Argument(metavar="[OUT]", help="Else beside it, with another ending.", show_default=False)]
Kind = Annotated[Literal["mat", "csv"], typer.Argument(metavar="mat|csv", help="MATLAB 5, or comma-separated values.")]
SHOWN = (
    "started_utc", "device_name", "device_serial", "rate_hz", "winding_c", "hapticd_version", "hapticd_commit", "kernel", "cpu",
    "realtime", "note",
)  # fmt: skip


@app.command()
def recover(file: Source, out: Target = None, as_json: options.Json = False) -> None:
    """Make a finished file of one whose recorder died, or of a flight recording."""
    from hapticd.cli.record import told
    from hapticd.measure.recording.pack import packed

    summary = packed(file, out or _beside(file, ".h5"), recovered=True)
    if as_json:
        output.data_json({"ok": True, **summary})
    else:
        output.data(told("recovered", summary))


@app.command()
def info(file: Source, as_json: options.Json = False) -> None:
    """What is in a recording and where it comes from."""
    from hapticd.measure.recording.file import open_recording
    from hapticd.measure.recording.pack import summary

    with open_recording(file) as recording:
        found = summary(recording)
        attributes = {name: _plain(value) for name, value in recording.attributes.items()}
    if as_json:
        output.data_json({"ok": True, **found, "attributes": attributes})
        return
    badge = output.coloured("SIMULATED  ", output.YELLOW) if found["simulated"] else ""
    probe, missing = found["probe_samples"], found["missing"]
    output.data(f"{badge}{found['seconds']:.3f} s, {found['records']} records, {probe} probe samples, {found['lives']} servo life")
    output.data(f"missing: {missing['servo']} records, {missing['probe']} probe samples")
    for name in SHOWN:
        if attributes.get(name) not in (None, ""):
            output.data(f"{name} = {attributes[name]}")


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


@app.command()
def export(kind: Kind, file: Source, out: Target = None, as_json: options.Json = False) -> None:
    """Convert: `hapticd rec export mat FILE`."""
    from hapticd.measure.recording.file import open_recording
    from hapticd.measure.recording.pack import to_csv, to_mat

    target = out or _beside(file, f".{kind}")
    with open_recording(file) as recording:
        written = [to_mat(recording, target)] if kind == "mat" else to_csv(recording, target)
    if as_json:
        output.data_json({"ok": True, "files": [str(path) for path in written]})
        return
    for path in written:
        output.data(str(path))


def _beside(file: Path, ending: str) -> Path:
    stem = file.name.removesuffix(".part.h5").removesuffix(".h5").removesuffix(".flight")
    target = file.with_name(stem + ending)
    if target.exists():
        raise ConfigError(f"{target} exists; name another file")
    return target
