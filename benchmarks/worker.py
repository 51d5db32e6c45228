"""A measuring process on the servo's core that runs one block on each request, and sleeps between.

Protocol, one JSON value per line: the worker reports the granted rights, then answers each request.
It is started once for a part and runs all of its blocks, so that a pair is interleaved without
start-up effects.
"""

import json
import os
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hapticd.core.params import RealtimeParams
from hapticd.core.process import ordinary_scheduling, request_rights

ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = Path(sysconfig.get_path("purelib"))
PRIORITY = RealtimeParams().priority
END_S = 10.0


class BenchError(Exception):
    """A part could not be measured; the message gives the reason and the remedy."""


def environment(*folders: Path) -> dict[str, str]:
    """Return the environment of a child that imports hapticd and benchmarks from this checkout, and
    others from `folders`. Bytecode is kept, as it is in an installation.
    """
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, (ROOT, *folders))),
        "PYTHONDONTWRITEBYTECODE": "",
        "PYTHONHASHSEED": "0",
        "OPENBLAS_NUM_THREADS": "1",
    }


def started(module: str, arguments: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
    """Start module `benchmarks.<module>` as a process that prints one JSON value a line."""
    command = [sys.executable, "-m", f"benchmarks.{module}", *arguments]
    return subprocess.Popen(command, env=environment(), cwd=ROOT, stdout=subprocess.PIPE)


def next_json(process: "subprocess.Popen[bytes]", name: str) -> Any:
    """Return the next output of a process of `started`. BenchError, with `name`, if it has ended
    instead.
    """
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise BenchError(f"{name} ended early with code {process.wait()}")
    return json.loads(line)


def servo_core() -> int:
    """Return the core of the servo: the last one allowed."""
    return max(os.sched_getaffinity(0))


class Worker:
    """Module `benchmarks.<module>` as a process of `python`, with this interpreter's folder of
    libraries; use it as a context manager. BenchError if it dies.
    """

    def __init__(
        self, module: str, arguments: Sequence[str] = (), python: str = sys.executable
    ) -> None:
        self.module = module
        folders = () if python == sys.executable else (LIBRARIES,)
        self.process = subprocess.Popen(
            [python, "-m", f"benchmarks.{module}", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(*folders),
            cwd=ROOT,
        )
        self.granted: dict[str, dict[str, Any]] = self._reply()

    def ask(self, **request: Any) -> Any:
        """Run one block and return its answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        return self._reply()

    @property
    def note(self) -> str:
        """The refused rights; empty if all were granted."""
        return "; ".join(
            f"{name} {one['text']}" for name, one in self.granted.items() if not one["granted"]
        )

    def _reply(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            _, errors = self.process.communicate()
            last = (errors.strip().splitlines() or ["no message"])[-1]
            raise BenchError(
                f"benchmarks.{self.module} ended with code {self.process.returncode}: {last}"
            )
        return json.loads(line)

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self.process.poll() is None:
                self.process.communicate(timeout=END_S)  # closes its stdin, which ends it
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()


def serve(
    answer: Callable[[dict[str, Any]], Any],
    realtime: RealtimeParams,
    begin: Callable[[], None] = lambda: None,
) -> None:
    """Run the worker: take real-time rights, begin, report them, answer until stdin ends."""
    granted = request_rights(realtime)
    begin()
    print(json.dumps({name: one._asdict() for name, one in granted.items()}), flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)
    ordinary_scheduling()
