"""Write what a service needs: systemd units, udev rule, user, folders, limits. Writes files; applies nothing."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import options, output

Print = Annotated[bool, typer.Option("--print", help="Show the files.")]
Root = Annotated[Path | None, typer.Option("--root", metavar="DIR", help="Write them below DIR; / installs them on this machine.")]


def command(show: Print = False, root: Root = None, config: options.ConfigFile = None, as_json: options.Json = False) -> None:
    """Write systemd units, udev rule, service user, folders and limits below a root, or show them. Applies nothing."""
    from hapticd.assembly.system_files import NEXT_STEPS, hidden_interpreter, system_files, write_below
    from hapticd.settings.build import servo_params
    from hapticd.settings.load import load

    if show == (root is not None):
        raise typer.BadParameter("say one of --print and --root DIR")
    files = system_files(servo_params(load(config), options.INSTANCE).usb)
    if warning := hidden_interpreter():
        output.talk(f"hapticd: warning: {warning}")
    if root is None:
        _show(files, as_json)
        return
    written = write_below(root, files)
    if as_json:
        output.data_json({"ok": True, "files": [str(path) for path in written], "next": NEXT_STEPS})
        return
    for path in written:
        output.data(str(path))
    output.talk("next, as root:\n  " + "\n  ".join(NEXT_STEPS))


def _show(files: dict[str, str], as_json: bool) -> None:
    if as_json:
        output.data_json({"ok": True, "files": files})
        return
    for place, content in files.items():
        output.data(f"# === /{place}\n{content}")
