"""The short way to a stop: `hapticd stop` runs this before anything large is loaded.

It takes less than 90 ms, the interpreter included.

It asks the gateway, whose reply names the state that the servo is in then; without a reply within
40 ms, or without a gateway, it presses the stop page, which the servo reads in every tick. Standard
library and pyzmq only, the latter loaded last. What would break it: an import at the top that costs
milliseconds.
"""

import json
import sys
from pathlib import Path
from typing import Any

from hapticd.errors import DaemonDown, HapticdError, MailboxError
from hapticd.mailbox.files import COMMAND_SOCKET, daemon_folder
from hapticd.mailbox.stop_word import press_stop

REPLY_TIMEOUT_MS = 40


def main(instance: str, as_json: bool) -> int:
    """Stop `instance` and say so; the exit code."""
    try:
        reply = stop(daemon_folder(instance))
    except HapticdError as error:
        sys.stderr.write(f"hapticd: {error}\n")
        if as_json:
            failure = {"code": type(error).__name__, "message": str(error), "detail": None}
            sys.stdout.write(json.dumps({"ok": False, "error": failure}) + "\n")
        return error.exit_code
    sys.stdout.write((json.dumps(reply) if as_json else _text(reply)) + "\n")
    return 0


def stop(folder: Path) -> dict[str, Any]:
    """Stop the servo of runtime folder `folder`; the reply, or that the stop page was pressed.

    DaemonDown: neither a gateway nor a servo is there.
    """
    reply = _asked(folder / COMMAND_SOCKET)
    if reply.get("ok"):
        return reply
    try:
        press_stop(folder)
    except MailboxError as error:
        raise DaemonDown(f"{folder}: no daemon runs there; start it with `hapticd run`") from error
    return {"ok": True, "state": "", "receipt": {"result": "pressed"}}


def _asked(path: Path) -> dict[str, Any]:
    """The gateway's reply; empty if none came."""
    if not path.exists():
        return {}
    import zmq

    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(f"ipc://{path}")
        socket.send(b'{"cmd":"hello","name":"hapticd stop"}')
        socket.send(b'{"cmd":"stop","id":1}')
        reply: dict[str, Any] = {}
        while reply.get("id") != 1:
            if not socket.poll(REPLY_TIMEOUT_MS):
                return {}
            reply = json.loads(socket.recv())
        return reply


def _text(reply: dict[str, Any]) -> str:
    if reply["receipt"]["result"] == "pressed":
        return "stop page pressed; the gateway did not answer, see `hapticd status`"
    return f"{reply['state']}: force off; `hapticd reset` when it is safe"
