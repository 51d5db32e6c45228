"""The short way to a stop: `hapticd stop` runs this before anything large is loaded.

Every live daemon of this user and the service is pressed, or with `--instance` the one of that
name: whoever says stop need not know which of them moves. All stop words are pressed before anybody
is asked anything, so that nothing that hangs delays a stop; then the gateways are asked at once for
the state that their servos are in, and given 40 ms together. It takes less than 100 ms, the
interpreter included.

What a daemon that was killed has left behind counts for nothing, and a folder that is not believed
(`mailbox.daemons`) is named and left alone. Standard library and pyzmq only, the latter loaded
last. What would break it: an import at the top that costs milliseconds, an open that waits.
"""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from hapticd.errors import DaemonDown, HapticdError, MailboxError
from hapticd.mailbox import daemons, files
from hapticd.mailbox.daemons import Place
from hapticd.mailbox.files import COMMAND_SOCKET
from hapticd.mailbox.stop_word import press_stop, servo_lives, stop_taken
from hapticd.units import NS_PER_MS

REPLY_TIMEOUT_MS = 40  # of all gateways together
CONFIRMED = ("stopped", "fault")  # states without force


class Stopped(NamedTuple):
    """One daemon that was pressed."""

    folder: str
    instance: str
    device: str  # as its servo reports; empty if that cannot be read
    simulated: bool | None  # None: unknown
    state: str  # as its gateway says, else "taken" by the servo, else "pressed"


class Outcome(NamedTuple):
    """What came of a stop."""

    daemons: list[Stopped]
    left_alone: list[str]  # why folders were not believed
    failed: list[str]  # why living daemons could not be pressed


def main(instance: str | None, as_json: bool) -> int:
    """Stop `instance`, None: all there are, and say so; the exit code."""
    try:
        found = stop(instance)
    except HapticdError as error:
        sys.stderr.write(f"hapticd: {error}\n")
        if as_json:
            import json

            failure = {"code": type(error).__name__, "message": str(error), "detail": None}
            sys.stdout.write(json.dumps({"ok": False, "error": failure}) + "\n")
        return error.exit_code
    for reason in found.left_alone:
        sys.stderr.write(f"hapticd: left alone: {reason}\n")
    for reason in found.failed:
        sys.stderr.write(f"hapticd: NOT STOPPED: {reason}\n")
    sys.stdout.write(_json(found) if as_json else "".join(map(_line, found.daemons)))
    return HapticdError.exit_code if found.failed else 0


def stop(instance: str | None) -> Outcome:
    """Stop the daemons of that name, None: all of this user and the service.

    DaemonDown: there is none.
    """
    pressed: list[Place] = []
    left_alone: list[str] = []
    failed: list[str] = []
    for place in daemons.places(instance):
        try:
            daemons.believe(place.folder)
        except MailboxError as error:
            left_alone.append(str(error))
            continue
        try:
            press_stop(place.folder)
            pressed.append(place)
        except MailboxError as error:
            if servo_lives(place.folder):
                failed.append(str(error))
    if not pressed and not failed:
        reasons = "".join(f"; left alone: {reason}" for reason in left_alone)
        raise DaemonDown(f"no daemon runs there; start it with `hapticd run`{reasons}")
    states = _states([place.folder for place in pressed])
    stopped = [_stopped(place, states.get(place.folder)) for place in pressed]
    return Outcome(stopped, left_alone, failed)


def _states(folders: list[Path]) -> dict[Path, str]:
    """What the gateways of `folders` say that their servos are in now; those that answer in
    time.
    """
    listening = [folder for folder in folders if daemons.gateway_lives(folder)]
    if not listening:
        return {}
    import json

    import zmq

    states: dict[Path, str] = {}
    with zmq.Context() as context:
        lines = {_asked(context, folder): folder for folder in listening}
        poller = zmq.Poller()
        for line in lines:
            poller.register(line, zmq.POLLIN)
        deadline_ns = time.monotonic_ns() + REPLY_TIMEOUT_MS * NS_PER_MS
        while len(states) < len(lines) and (left_ns := deadline_ns - time.monotonic_ns()) > 0:
            for line, _ in poller.poll(left_ns // NS_PER_MS + 1):
                reply = json.loads(line.recv())
                if reply.get("id") == 1 and reply.get("ok"):
                    states[lines[line]] = reply["state"]
        for line in lines:
            line.close()
    return states


def _asked(context: Any, folder: Path) -> Any:
    """A socket on which the gateway of `folder` was asked to stop as well."""
    import zmq

    line = context.socket(zmq.DEALER)
    line.setsockopt(zmq.LINGER, 0)
    line.connect(f"ipc://{folder / COMMAND_SOCKET}")
    line.send(b'{"cmd":"hello","name":"hapticd stop"}')
    line.send(b'{"cmd":"stop","id":1}')
    return line


def _stopped(place: Place, state: str | None) -> Stopped:
    report = daemons.read_report(place.folder)
    word = "taken" if stop_taken(place.folder) else "pressed"
    device = report.get("device", "")
    simulated = report.get("simulated")
    return Stopped(str(place.folder), place.instance, device, simulated, state or word)


def _json(found: Outcome) -> str:
    import json

    states = {one.state for one in found.daemons}
    told = {
        "ok": not found.failed,
        "state": states.pop() if len(states) == 1 else "mixed",
        "daemons": [one._asdict() for one in found.daemons],
        "left_alone": found.left_alone,
        "failed": found.failed,
    }
    return json.dumps(told) + "\n"


def _line(one: Stopped) -> str:
    real = {True: ", SIMULATED", False: ", REAL BOARD", None: ""}[one.simulated]
    name = "service" if one.folder == str(files.SERVICE_FOLDER) else one.instance
    who = f"{name} ({one.device or 'device unknown'}{real})"
    if one.state in CONFIRMED:
        return f"{who}: {one.state}: force off; `hapticd reset` when it is safe\n"
    if one.state == "taken":
        return f"{who}: the servo took the stop; the gateway did not answer, see `hapticd status`\n"
    if one.state == "pressed":
        return f"{who}: pressed; the servo has not taken it yet, see `hapticd status`\n"
    return f"{who}: pressed, state {one.state}; see `hapticd status`\n"
