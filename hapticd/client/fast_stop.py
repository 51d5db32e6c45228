"""The short path to a stop: `hapticd stop` runs this before it loads any large module.

It presses every live daemon of this user and the service, or with `--instance` the named one: the
operator need not know which of them moves. All stop words are pressed before any wait, so that a
hanging daemon delays no stop. Then the servos have 50 ms together to clear their words, which each
does once no force acts (`mailbox.daemons`). No gateway takes part, for it may be flooded, and no
socket, whose library takes longer to load than the whole stop. It takes less than 100 ms, including
the interpreter.

Remains of a killed daemon are ignored, and an untrusted folder (`mailbox.daemons`) is reported and
left alone. Standard library only. No import at the top may cost milliseconds, and no open may wait.
"""

import sys
import time
from typing import NamedTuple

from hapticd.core.errors import DaemonDown, HapticdError, MailboxError
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox import daemons, files
from hapticd.mailbox.daemons import (
    ACTOR_STOP_WORD,
    RuntimeFolder,
    press_stop,
    servo_lives,
    stop_taken,
)

__all__ = ["main", "stop"]

TAKEN_MS = 50  # for all servos together: the stop ramp of 20 ms, transmission, and some waiting
LOOK_S = 0.001
STOPPED = "stopped"  # its servo accepted the stop, and no force acts
PRESSED = "pressed"  # not yet


class Stopped(NamedTuple):
    """One pressed daemon."""

    folder: str
    instance: str
    device: str  # as reported by its servo; empty if that cannot be read
    simulated: bool | None  # None: unknown
    state: str  # STOPPED or PRESSED


class Outcome(NamedTuple):
    """Result of a stop."""

    daemons: list[Stopped]
    left_alone: list[str]  # reasons why folders were not trusted
    failed: list[str]  # reasons why living daemons could not be pressed


def main(instance: str | None, as_json: bool) -> int:
    """Stop `instance` (None: all daemons), print the result, and return the exit code."""
    try:
        found = stop(instance)
    except HapticdError as error:
        sys.stderr.write(f"hapticd: {error}\n")
        if as_json:
            import json

            detail = error.plain() if isinstance(error, DaemonDown) else None
            failure = {"code": type(error).__name__, "message": str(error), "detail": detail}
            sys.stdout.write(json.dumps({"ok": False, "error": failure}) + "\n")
        return error.exit_code
    for reason in found.left_alone:
        sys.stderr.write(f"hapticd: left alone: {reason}\n")
    for reason in found.failed:
        sys.stderr.write(f"hapticd: NOT STOPPED: {reason}\n")
    sys.stdout.write(_json(found) if as_json else "".join(map(_line, found.daemons)))
    return HapticdError.exit_code if found.failed else 0


def stop(instance: str | None, actor: int = ACTOR_STOP_WORD) -> Outcome:
    """Stop the daemons of that name (None: all of this user and the service). It counts as pressed
    by client `actor` of the gateway, who may then reset it at once.

    DaemonDown if there is none.
    """
    pressed: list[RuntimeFolder] = []
    left_alone: list[str] = []
    failed: list[str] = []
    for place in daemons.runtime_folders(instance):
        try:
            daemons.require_trusted(place.folder)
        except MailboxError as error:
            left_alone.append(str(error))
            continue
        try:
            press_stop(place.folder, actor)
            pressed.append(place)
        except MailboxError as error:
            if servo_lives(place.folder):
                failed.append(str(error))
    if not pressed and not failed:
        reasons = "".join(f"; left alone: {reason}" for reason in left_alone)
        raise daemons.down("", instance, reasons)
    taken = _taken(pressed)
    return Outcome([_stopped(place, place in taken) for place in pressed], left_alone, failed)


def _taken(pressed: list[RuntimeFolder]) -> list[RuntimeFolder]:
    """Return those of `pressed` whose servos accept the stop in time."""
    deadline_ns = time.monotonic_ns() + TAKEN_MS * NS_PER_MS
    while True:
        taken = [place for place in pressed if stop_taken(place.folder)]
        if len(taken) == len(pressed) or time.monotonic_ns() >= deadline_ns:
            return taken
        time.sleep(LOOK_S)


def _stopped(place: RuntimeFolder, taken: bool) -> Stopped:
    report = daemons.read_report(place.folder)
    return Stopped(
        str(place.folder),
        place.instance,
        report.get("device", ""),
        report.get("simulated"),
        STOPPED if taken else PRESSED,
    )


def _json(found: Outcome) -> str:
    import json

    states = {one.state for one in found.daemons}
    content = {
        "ok": not found.failed,
        "state": states.pop() if len(states) == 1 else "mixed",
        "daemons": [one._asdict() for one in found.daemons],
        "left_alone": found.left_alone,
        "failed": found.failed,
    }
    return json.dumps(content) + "\n"


def _line(one: Stopped) -> str:
    real = {True: ", SIMULATED", False: ", REAL BOARD", None: ""}[one.simulated]
    name = "service" if one.folder == str(files.SERVICE_FOLDER) else one.instance
    who = f"{name} ({one.device or 'device unknown'}{real})"
    if one.state == STOPPED:
        return f"{who}: stopped: force off; `hapticd reset` when it is safe\n"
    return f"{who}: pressed; the servo has not taken it yet, see `hapticd status`\n"
