"""Check, show and resolve the configuration."""

from pathlib import Path
from typing import Annotated, Any

import typer

from hapticd.cli import options, output

app = typer.Typer(no_args_is_help=True, help=__doc__)
File = Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Same as --config.", show_default=False)]


@app.command()
def check(file: File = None, config: options.ConfigFile = None, as_json: options.Json = False) -> None:
    """Say what is wrong, with file, line, value and limit; exit 78 if anything is."""
    from hapticd.gateway import auth
    from hapticd.settings.build import gateway_params
    from hapticd.settings.load import load

    settings = load(file or config)
    if warning := auth.warning(gateway_params(settings)):
        output.talk(f"hapticd: {settings.origins['gateway.tcp_host']}: {warning}")
    found = {"ok": True, "config": str(settings.config_file), "device": str(settings.device_file), "hash": settings.config_hash}
    if as_json:
        output.data_json(found)
    else:
        output.data(f"{settings.config_file}: good, with device {settings.device.name!r} of {settings.device_file}")


@app.command()
def show(
    file: File = None,
    config: options.ConfigFile = None,
    origin: Annotated[bool, typer.Option("--origin", help="Also where each value comes from.")] = False,
    as_json: options.Json = False,
) -> None:
    """Every value in force with its unit; the device file under `device`."""
    from hapticd.settings.explain import dotted, leaves
    from hapticd.settings.load import load
    from hapticd.units import unit_of

    settings = load(file or config)
    if as_json and not origin:
        output.data_json({**settings.plain(), "config_hash": settings.config_hash})
        return
    rows = [
        (dotted(path), value, unit_of(str(path[-1])), settings.origins.get(dotted(path)))
        for path, value in leaves(settings.plain())
    ]
    if as_json:
        output.data_json({key: {"value": value, "unit": unit, "origin": source} for key, value, unit, source in rows})
        return
    output.data(f"# {settings.config_file}\n# {settings.device_file}")
    for key, value, unit, source in rows:
        output.data(f"{key} = {_shown(value)}{f' {unit}' if unit else ''}" + (f"    # {source}" if origin else ""))


def _shown(value: Any) -> str:
    import json

    return "(not set)" if value is None else json.dumps(value)


@app.command()
def schema(
    device: Annotated[bool, typer.Option("--device", help="Of device files instead.")] = False,
    scene: Annotated[bool, typer.Option("--scene", help="Of scene files instead.")] = False,
) -> None:
    """The JSON schema of hapticd.toml, for editors and checkers."""
    from hapticd.settings import schema

    output.data(schema.text("device" if device else "scene" if scene else "config").rstrip("\n"))


@app.command()
def resolve(
    config: options.ConfigFile = None,
    instance: options.Instance = options.INSTANCE,
    as_json: options.Json = False,
) -> None:
    """Write servo.json, board.json and gateway.json into the runtime folder, as `hapticd run` does."""
    from hapticd.assembly.resolve import write
    from hapticd.mailbox.files import runtime_folder
    from hapticd.settings.load import load

    settings = load(config)
    written = write(runtime_folder(instance), settings, instance)
    if as_json:
        output.data_json({"ok": True, "hash": settings.config_hash, "files": {name: str(path) for name, path in written.items()}})
        return
    for path in written.values():
        output.data(str(path))
