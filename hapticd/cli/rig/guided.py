"""`hapticd rig` without a verb: the steps in their order, each asked for before it begins.

What would break it: a step whose numbers cannot be asked for in one line.
"""

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.rig import damping, sensors, steps
from hapticd.cli.rig.identify import identify
from hapticd.cli.rig.motor import motor
from hapticd.errors import ConfigError

WELCOME = """\
First day at the rig: what is measured goes into the device file, with its date and interval.
Each can be left out now and done by itself later (`hapticd rig STEP`). Ctrl-C ends force."""
RESTART = (
    "Signs are verified from the next start of the daemon: start it again, then `hapticd rig`."
)


def guided(context: typer.Context) -> None:
    """The guided path, where no verb is named."""
    if context.invoked_subcommand is not None:
        return
    terminal.talk(WELCOME)
    if _wanted("link: ten seconds of frames without force"):
        _kept_on(lambda: steps.link())
    if _wanted("encoder: sign, scale and noise, by hand"):
        distance_m = number("distance from position A to B in m")
        _kept_on(lambda: steps.encoder(distance_m))
    if _commissioning():
        if _wanted("motor: its sign, by pushes of 20 ms"):
            _kept_on(lambda: motor())
            terminal.talk(RESTART)
        return
    if _wanted("motor: its gain, by hanging masses"):
        masses = [number(f"mass {place} in kg") for place in range(1, 6)]
        _kept_on(lambda: motor(masses))
    if _wanted("damping: its polarity and N s/m per count, by pushes and glides"):
        _kept_on(lambda: damping.damping())
    if _wanted("probe: both channels, by shaking the handle without and with a mass"):
        fixed_kg = number("mass that is fixed to the handle in kg")
        _kept_on(lambda: sensors.probe(fixed_kg))
    if _wanted("temperature: the winding's sensor, and the back-EMF by hand"):
        at_c = number("temperature of the room in degC")
        _kept_on(lambda: sensors.temperature([at_c]))
    if _wanted("identify: mass, friction and delay, by shaking the free handle"):
        _kept_on(lambda: identify())


def _wanted(what: str) -> bool:
    return steps.answer(f"{what}: now? yes or no") in ("y", "yes")


def _commissioning() -> bool:
    with connect(terminal.INSTANCE) as client:
        return bool(client.hello()["servo"]["device"]["commissioning"])


def number(question: str) -> float:
    """A number from the person at the terminal. ConfigError for anything else."""
    text = steps.answer(question)
    try:
        return float(text)
    except ValueError as error:
        raise ConfigError(f"{question}: {text!r} is no number; write it like 0.05") from error


def _kept_on(step: terminal.Verb) -> None:
    """Do `step`; what it refuses does not end the path."""
    try:
        step()
    except typer.Exit:
        terminal.talk("this step has to be done again")
