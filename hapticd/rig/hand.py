"""Requests of a step to a person at the rig: as text, and as an action with its amount.

A terminal shows the text. A program (a positioning stage, a scripted hand on a simulated rig)
performs the action. Both answer when the action is complete, or when it begins if it continues
while the step measures. Positions of a hand are metres in the direction of positive x from A, the
place that the person chooses first.

The program listens on a Unix socket (`asked_at`). Each request is one connection with one line of
JSON, {"action", "amount", "text"}; the answer is one line, {"done": true} or {"error": "why not"}.

All actions are defined here, so that all steps use the same set. A program must not answer before
the action is complete.
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
    "let go",  # of the handle, and remove all attached parts
    "move",  # by about `amount` m, slowly, and hold: from now on, within a few seconds
    "hold",  # the handle `amount` m from A in the direction of positive x
    "origin",  # hold the handle where x = 0 is to be
    "hang",  # masses of `amount` kg from the handle, and let go of it
    "attach",  # `amount` kg firmly to the handle, so that they move with it, and let go of it
    "spring",  # of `amount` N/m between handle and frame, and let go
    "draw",  # the handle aside by `amount` m, and let go at once: it moves freely
    "shake",  # the handle back and forth by a few mm, for `amount` s from now on
    "warm",  # the winding to `amount` degC, and hold it there
    "one signal",  # into both probe channels, for `amount` s from now on
]


class Request(NamedTuple):
    """A requested action, and the same as text."""

    action: Action
    text: str
    amount: float = 0.0  # in the unit of the action


Ask = Callable[[Request], None]


def asked_at(path: Path) -> Ask:
    """Return a function that sends requests to the program at the socket `path`. DaemonDown if no
    program listens there, AnalysisError if it cannot perform the action.
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
