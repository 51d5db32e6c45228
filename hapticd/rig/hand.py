"""What a step asks of a person at the rig: in words, and as an action with its amount.

A terminal shows the words. A program (a positioning stage, a scripted hand at a simulated rig) does
the action; both answer once it is done, or, for what goes on while a step measures, once it begins.
Positions of a hand are metres to positive x from A, the place that the person chooses first.

A program listens at a Unix socket (`asked_at`). Each request is a connection with one line of JSON,
{"action", "amount", "text"}; the answer is one line, {"done": true} or {"error": "why not"}.

All actions are named here, so that steps understand them alike. A program must not answer before it
is done.
"""

import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

from hapticd.core.errors import AnalysisError, DaemonDown

__all__ = ["Ask", "Request", "asked_at"]

PATIENCE_S = 120.0
Action = Literal[
    "let go",  # of the handle, and take off everything that was attached
    "move",  # slowly by about `amount` m, and hold: from now on, within a few seconds
    "hold",  # the handle `amount` m to positive x of A
    "origin",  # hold the handle where x = 0 shall be
    "hang",  # masses of `amount` kg from the handle, and let go of it
    "attach",  # `amount` kg firmly to the handle, so that they move with it, and let go of it
    "spring",  # of `amount` N/m between handle and frame, and let go
    "draw",  # the handle aside by `amount` m, and let go at once: it moves freely
    "shake",  # the handle to and fro by some mm, for `amount` s from now on
    "warm",  # the winding to `amount` degC, and hold it there
    "one signal",  # into both probe channels, for `amount` s from now on
]


class Request(NamedTuple):
    """What is to be done, and the same in words."""

    action: Action
    text: str
    amount: float = 0.0  # in the unit of the action


Ask = Callable[[Request], None]


def asked_at(path: Path) -> Ask:
    """What asks the program at the socket `path`. DaemonDown if nobody listens there, AnalysisError
    if it cannot do what is asked.
    """

    def ask(request: Request) -> None:
        with socket.socket(socket.AF_UNIX) as line:
            line.settimeout(PATIENCE_S)
            try:
                line.connect(str(path))
                line.sendall(json.dumps(request._asdict()).encode() + b"\n")
                answer = json.loads(line.makefile("rb").readline())
            except (OSError, ValueError) as error:
                raise DaemonDown(
                    f"no hand answers at {path}: {error}; start its program, or unset HAPTICD_HAND"
                ) from error
        if not answer.get("done"):
            raise AnalysisError(f"the hand cannot {request.action}: {answer.get('error')}")

    return ask
