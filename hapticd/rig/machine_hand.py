"""A hand that is a program: a positioning stage that hangs masses, or the practice rig.

It listens at a Unix socket. Each request is a connection with one line of JSON, {"action",
"amount", "text"}, as `rig.hand` names them; the answer is one line, {"done": true} once it is done
(or, for what goes on while a step measures, has begun) or {"error": "why not"}.

What would break it: a program that answers before it is done.
"""

import json
import socket
from pathlib import Path

from hapticd.core.errors import AnalysisError, DaemonDown
from hapticd.rig.hand import Ask, Request

__all__ = ["asked_at"]

PATIENCE_S = 120.0


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
