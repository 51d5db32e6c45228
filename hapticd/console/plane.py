"""The K-B plane for the page, computed in a separate process and shown while it is valid.

It is the guard's own judgement (`guard.judge`) on the model in the daemon's guard.json. It is
computed again when basis, margin, delay, mass, filters or the level of active damping change. It
takes up to seconds, so it must not run in the process of telemetry and STOP. A separate process
reads the question and writes the answer, at low priority, and ends with its parent: `python -m
hapticd.console.plane GUARD_JSON PARENT`. The page draws the live point.

The worker dies with the console. The configuration is read for each plane, so that it matches the
daemon's.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hapticd.core.params import from_plain
from hapticd.core.process import die_with_parent
from hapticd.mailbox.files import GUARD_JSON
from hapticd.model.params import GuardSetup

MODULE = f"{__package__}.plane"
NICENESS = 10  # of the worker
KEPT = ("M", "filters")  # of the values in force, in addition to the guard's terms and the level
DELAY_STEP = 0.0625  # periods: a smaller change does not request another plane


class Planes:
    """Follows the guard's messages; passes each new plane as text to `publish`."""

    def __init__(self, folder: Callable[[], Path], publish: Callable[[str], None]) -> None:
        self._folder = folder
        self._publish = publish
        self._shown: tuple[Any, ...] = ()
        self._worker: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None

    def close(self) -> None:
        """End the worker."""
        if self._worker is not None:
            self._worker.kill()
        if self._thread is not None:
            self._thread.join()

    def follow(self, guard: dict[str, Any], level_on: float) -> None:
        """Request a plane if `guard` (topic) or the level of `damping on` requires another."""
        given = (guard.get("verdict") or {}).get("given")
        if given is None or (self._thread is not None and self._thread.is_alive()):
            return
        delay = guard["delay_periods"]
        rounded = None if delay is None else DELAY_STEP * round(delay / DELAY_STEP)
        terms = (guard["basis"], guard["margin_ns_per_m"], rounded, level_on)
        asked = (*terms, *(json.dumps(given[name]) for name in KEPT), _reach(given))
        if asked != self._shown:
            self._shown = asked
            request = {
                "ask": "plane",
                "basis": guard["basis"],
                "margin_ns_per_m": guard["margin_ns_per_m"],
                "delay_periods": rounded,
                "target": given,
                "level_on": level_on,
            }
            self._ask(json.dumps(request))

    def _ask(self, request: str) -> None:
        self._worker = subprocess.Popen(
            [sys.executable, "-m", MODULE, str(self._folder() / GUARD_JSON), str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        self._thread = threading.Thread(
            target=self._await_answer, args=(self._worker, request), name="plane", daemon=True
        )
        self._thread.start()

    def _await_answer(self, worker: "subprocess.Popen[str]", request: str) -> None:
        answer, _ = worker.communicate(request)
        if worker.returncode == 0:
            self._publish(answer)


def _reach(given: dict[str, Any]) -> tuple[int, int]:
    """Return the powers of two that K and B are below: a plane has to contain the point."""
    return int(abs(given["K"])).bit_length(), int(4 * abs(given["B"])).bit_length()


def main(path: str, parent: str) -> int:
    """Answer the request on stdin; exit code 0: the answer is on stdout, as a message for pages."""
    from hapticd.guard.judge import Judge

    die_with_parent(int(parent))
    os.nice(NICENESS)
    request = json.load(sys.stdin)
    content = {
        **Judge(from_plain(GuardSetup, json.loads(Path(path).read_text()), path)).answer(request),
        "basis": request["basis"],
        "M": request["target"]["M"],
    }
    json.dump({"kind": "plane", "told": content}, sys.stdout)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
