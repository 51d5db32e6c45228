"""`hapticd rig` without a verb: the steps in order, each offered before it begins.

A completed measurement shows its date and may be skipped, so the path continues where it was left:
after a restart of the daemon, an interruption, or on another day. A step that writes is followed by
a restart, since the daemon reads its device file when it starts; the path waits for that.

The numbers of a step must fit in one line of input.
"""

import datetime
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import isfinite
from typing import NamedTuple

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.rig import steps, verbs
from hapticd.core.errors import DaemonDown, HapticdError
from hapticd.core.params import RIG_STEPS, to_plain

with terminal.deferred_imports():
    from hapticd.recording import provenance
    from hapticd.settings import build, load
    from hapticd.settings import device as device_files


WELCOME = """\
Commissioning: each measurement goes into the device file, with its date and interval.
Each can be left out now and done by itself later (`hapticd rig STEP`). Ctrl-C ends force; the path
goes on from there when it is asked for again. Enter takes the answer in brackets."""
RESTART = (
    "Signs are verified from the next start of the daemon: start it again, then `hapticd rig`."
)
NOT_VERIFIED = "The signs are not verified yet: repeat the refused steps with `hapticd rig`."
DONE = "The path is complete. Continue with `hapticd status`, docs/first-day.md and a trial."


class Step(NamedTuple):
    """A step as offered by the path."""

    name: str
    title: str
    table: str  # of the device file, with its date; "": it writes nothing
    questions: Sequence[str]
    act: Callable[[steps.StepOptions, list[float]], None]


MASSES = [
    f"mass {place} in kg{'; 0 is one of them' if place == 1 else ''}" for place in range(1, 6)
]
FIRST = (
    Step(
        "link",
        "ten seconds of frames without force, and the board's watchdog",
        "",
        (),
        lambda at, _: steps.link(instance=at.instance),
    ),
    Step(
        "encoder",
        "sign, scale and noise, by hand",
        "position",
        ("distance from position A to B in m",),
        lambda at, given: verbs.encoder(given[0], options=at),
    ),
)
SIGN = Step(
    "motor",
    "its sign, by pushes of 20 ms",
    "commissioning",
    (),
    lambda at, _: verbs.motor(options=at),
)
LATER = (
    Step(
        "motor",
        "its gain and offset, by five masses",
        "force",
        MASSES,
        lambda at, given: verbs.motor(given, options=at),
    ),
    Step(
        "damping",
        "its polarity and N s/m per count, by pushes and glides",
        "active_damping",
        (),
        lambda at, _: verbs.damping(at),
    ),
    Step(
        "probe",
        "both channels, by shaking the handle without and with a mass",
        "probe_velocity",
        ("mass that is fixed to the handle in kg",),
        lambda at, given: verbs.probe(given[0], options=at),
    ),
    Step(
        "temperature",
        "the winding's sensor, and the back-EMF by hand",
        "temperature",
        ("temperature of the room in degC",),
        lambda at, given: verbs.temperature(given, options=at),
    ),
    Step(
        "identify",
        "mass, friction and delay, by shaking the free handle",
        "model",
        (),
        lambda at, _: verbs.identify(at),
    ),
    Step(
        "verify",
        "known springs, dampers and masses, and the certificate",
        "",
        (),
        lambda at, _: verbs.verify(options=at),
    ),
)


def guided(
    context: typer.Context,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
) -> None:
    """The guided path, where no verb is named."""
    if context.invoked_subcommand is not None:
        return
    where = steps.StepOptions(instance=instance, config=config)
    terminal.talk(WELCOME)
    for step in FIRST:
        _offer(step, where)
    if _commissioning(where):
        if _offer(SIGN, where):
            terminal.talk(NOT_VERIFIED if build.commissioning(_device(where)) else RESTART)
        return
    for step in LATER:
        _offer(step, where)
    terminal.talk(DONE)


def _offer(step: Step, where: steps.StepOptions) -> bool:
    """Offer `step`; return whether it was accepted and begun."""
    _await_restart(where)
    device = _device(where)
    known = measured(step.table, device)
    doubted = in_doubt(step.table, device) if known else ""
    said = f" ({known}{f'; {doubted}' if doubted else ''})" if known else ""
    terminal.talk(f"\n{step.name}: {step.title}{said}")
    if not steps.agreed("again?" if known else "now?", usual=bool(doubted) or not known):
        return False
    given = [number(question) for question in step.questions]
    _kept_on(lambda: step.act(where, given))
    return True


def measured(table: str, device: "device_files.DeviceFile") -> str:
    """Return the date and age of the measurement of `table` of `device`; "": never."""
    found = getattr(device, table) if table else None
    if table == "model" and found is not None:
        found = found.table("masses")
    if found is None or found.measured_by not in RIG_STEPS or found.measured_on is None:
        return ""
    days = (datetime.date.today() - found.measured_on).days
    return f"measured {found.measured_on.isoformat()}, {f'{days} days ago' if days else 'today'}"


def in_doubt(table: str, device: "device_files.DeviceFile") -> str:
    """Return why the values in `table` of `device` are no longer reliable; "": they are."""
    servo = {"simulated": device.simulated, "device": to_plain(build.device_params(device))}
    found = provenance.doubts(servo, datetime.date.today(), probed=True)
    return "; ".join(one.reason for one in found if one.table == table)


def _device(where: steps.StepOptions) -> "device_files.DeviceFile":
    return load.load(where.config).device


def _await_restart(where: steps.StepOptions) -> None:
    """Wait until the daemon runs and has read the present device file."""
    while reason := _stale(where):
        steps.answer(f"{reason}: start the daemon again, then Enter")


def _stale(where: steps.StepOptions) -> str:
    """Return why no step may begin; "": it may."""
    try:
        with connect(where.instance) as client:
            servo = client.hello().servo
    except DaemonDown:
        return "no daemon runs"
    settings = load.load(where.config)
    if scales := steps.not_read_yet(servo.device, settings.device):
        return f"the device file has a new {', '.join(scales)}"
    read = servo.device_file_sha256
    return "the device file has changed" if read not in ("", settings.device_file_sha256) else ""


def _commissioning(where: steps.StepOptions) -> bool:
    with connect(where.instance) as client:
        return client.hello().servo.device.commissioning


def number(question: str) -> float:
    """Ask the person at the terminal until the answer is a finite number."""
    while True:
        text = steps.answer(question)
        with suppress(ValueError):
            if isfinite(found := float(text)):
                return found
        terminal.talk(f"{text!r} is not a number; write it like 0.05")


def _kept_on(step: terminal.Verb) -> None:
    """Perform `step`; its refusal does not end the path."""
    try:
        step()
    except typer.Exit:
        terminal.talk("this step has to be done again")
    except HapticdError as error:
        terminal.talk(f"{error}\nthis step has to be done again")
