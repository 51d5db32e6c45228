"""Steps of `hapticd rig` as verbs: their questions, their output, and their changes.

A step that is interrupted (Ctrl-C, a cable, a fault) leaves the force off and the device file
unchanged; it can be repeated alone. With --yes there are no questions: each action of a hand is
announced, followed by a pause of some seconds.

Every exit from a step must leave the device disabled.
"""

import datetime
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.zwidth.common import signals_end_with_force_off
from hapticd.core.errors import ConfigError
from hapticd.core.params import DeviceParams, ScaleParams

with terminal.deferred_imports():
    from hapticd.client import client as clients
    from hapticd.rig import certificate
    from hapticd.rig import result as results
    from hapticd.rig.steps import link as link_step
    from hapticd.settings import build, load
    from hapticd.settings import device as device_files


REFUSED = 4  # exit code of a step with a refused finding
HAND = "HAPTICD_HAND"  # environment variable: the socket of a program that acts as the hand
PAUSE_S = 5.0  # for an action of a hand, with --yes
COLOURS = {"ok": terminal.GREEN, "warning": terminal.YELLOW, "refused": terminal.RED}


@dataclass(frozen=True, kw_only=True)
class StepOptions:
    """Whether to ask a person, and the daemon and its configuration."""

    yes: Annotated[
        bool,
        typer.Option("--yes", help="Do not ask: announce each action, wait 5 s, then write."),
    ] = False
    config: terminal.ConfigFile = None
    instance: terminal.Instance = terminal.INSTANCE
    as_json: terminal.Json = False


def run(
    options: StepOptions, measure: "Callable[[clients.Client, results.Ask], results.StepResult]"
) -> None:
    """Perform a step on the daemon, keep and write its results, and show them."""
    show(perform(options, load.load(options.config), measure), options.as_json)


def show(result: "results.StepResult", as_json: bool) -> None:
    """Show the results; exit with 4 if a finding is refused."""
    if as_json:
        terminal.data_json(result.plain())
    else:
        for line in lines(result):
            terminal.data(line)
    if not result.settled:
        raise typer.Exit(REFUSED)


def lines(result: "results.StepResult") -> list[str]:
    """Return `result` as text, one line per item."""
    found = [f"  {value}" for value in result.values]
    for one in result.findings:
        word = terminal.coloured(one.verdict, COLOURS.get(one.verdict, terminal.BOLD))
        found.append(f"  {word}: {one.what}{f'; {one.remedy}' if one.remedy else ''}")
    found += [f"  device file: {one.table}.{one.key} = {one.value}" for one in result.changes]
    return [f"rig {result.step}", *found]


def asking(yes: bool) -> "results.Ask":
    """Return a function that asks a person; with --yes it announces the action and waits. If
    HAPTICD_HAND is a socket, the program there acts as the hand.
    """
    machine = os.environ.get(HAND)
    done = results.asked_at(Path(machine)) if machine else None

    def ask(request: "results.Request") -> None:
        terminal.talk(f"> {request.text}")
        if done:
            done(request)
        elif yes:
            time.sleep(PAUSE_S)
        else:
            answer("  Enter when it is done")

    return ask


def answer(question: str) -> str:
    """Return a line from the person at the terminal. ConfigError if there is none."""
    terminal.talk(question)
    try:
        return input().strip()
    except EOFError as error:
        raise ConfigError("stdin is not a terminal; use --yes to run without prompts") from error


def agreed(question: str, usual: bool = True) -> bool:
    """Return whether the person at the terminal answers yes; Enter means `usual`."""
    while True:
        said = answer(f"{question} yes or no [{'yes' if usual else 'no'}]").lower()
        if said in ("", "y", "yes", "n", "no"):
            return said[0] == "y" if said else usual
        terminal.talk(f"{said!r}: answer yes or no")


def perform(
    options: StepOptions,
    settings: "load.Settings",
    measure: "Callable[[clients.Client, results.Ask], results.StepResult]",
) -> "results.StepResult":
    """Perform a step with `measure`, keep its records, and write its results into the device file.

    ConfigError if the daemon runs another device than `settings`, or the file cannot be written.
    """
    certificate.refuse_shipped(settings.device_file)
    with ExitStack() as stack:
        stack.enter_context(signals_end_with_force_off())
        client = stack.enter_context(connect(options.instance))
        _refuse_another(client.hello().servo.device, settings)
        try:
            result = measure(client, asking(options.yes))
        except KeyboardInterrupt:
            terminal.talk(f"interrupted: force is off, {settings.device_file} is as it was")
            raise
    return _written(result, settings, options.yes)


def _refuse_another(running: DeviceParams, settings: "load.Settings") -> None:
    """Raise ConfigError if the daemon does not run the device file of `settings`: each step depends
    on the changes of the one before, such as the sign of the position.
    """
    if running.serial != settings.device.serial:
        raise ConfigError(
            f"the daemon runs the device {running.serial!r}, {settings.device_file} is of"
            f" {settings.device.serial!r}; name its configuration with --config"
        )
    if scales := not_read_yet(running, settings.device):
        raise ConfigError(
            f"{settings.device_file} has another {', '.join(scales)} than the daemon, which reads"
            " it when it starts; start it again, then repeat this step"
        )


def not_read_yet(running: DeviceParams, device: "device_files.DeviceFile") -> list[str]:
    """Return the scales of `device` that differ from those of a running servo with the parameters
    `running`.
    """
    written = build.device_params(device)
    names = [one.name for one in fields(written)]
    pairs = [(name, getattr(written, name), getattr(running, name)) for name in names]
    scales = [pair for pair in pairs if hasattr(pair[1], "per_count")]
    return [name for name, ours, theirs in scales if _meaning(ours) != _meaning(theirs)]


def _meaning(scale: ScaleParams) -> tuple[Any, ...]:
    return scale.sign, scale.per_count, scale.offset_count


def _written(
    result: "results.StepResult", settings: "load.Settings", yes: bool
) -> "results.StepResult":
    day = datetime.date.today()
    path = settings.device_file
    kept = certificate.keep(path, result.step, day, result.arrays)
    if not result.settled or not result.changes:
        return result
    if not yes:
        for line in lines(result):
            terminal.talk(line)
        if not agreed(f"write this into {path}?"):
            terminal.talk(f"not written: {path} is as it was")
            return replace(result, changes=())
    words = "; ".join(str(value) for value in result.values) or "signs seen"
    certificate.write_changes(path, result.changes, f"rig {result.step}", day, f"{words}; {kept}")
    terminal.talk(f"written: {path}; it counts from the next start of the daemon")
    return result


def link(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Judge the link from ten seconds of frames without force: delay, jitter, age, damaged and
    missing frames, and the board's clock, each with a remedy. Exit 4 if one is unacceptable.
    """
    with connect(instance) as client:
        show(link_step.measure(client), as_json)
