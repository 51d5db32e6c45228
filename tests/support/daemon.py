"""A daemon in separate processes, and its observable state."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from conftest import fresh_runtime

from hapticd.cli.app import main
from hapticd.client import Client, CommandError
from hapticd.mailbox import layout

DEADLINE_S = 60.0
QUIET = "[realtime]\nmode = 'off'\nspin_us = 0.0\n"  # tests share the machine


def until(condition: Callable[[], Any], what: str) -> Any:
    """The first true value of `condition`."""
    deadline = time.monotonic() + DEADLINE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.02)
    return found


class Daemon:
    """`hapticd run` of a separate instance, and its observable state."""

    def __init__(
        self,
        runtime: Path,
        ignore_interrupt: bool = False,
        settings: str = QUIET,
        console: bool = False,
        name: str = "",
    ) -> None:
        self.instance = f"test-{os.getpid()}{name}"
        self.folder = runtime / "hapticd" / f"instance-{self.instance}"
        config = runtime / f"hapticd{name}.toml"
        config.write_text(settings)
        self.log = runtime / f"log{name}"
        self.seen: set[int] = set()
        command = [
            sys.executable,
            "-m",
            "hapticd",
            "run",
            "--instance",
            self.instance,
            "--config",
            str(config),
            "--json",
            *([] if console else ["--no-console"]),
        ]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=(
                    (lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
                    if ignore_interrupt
                    else None
                ),
            )

    def __enter__(self) -> Self:
        try:
            until(lambda: self.events().count("ready") == 1, "ready")
            self.children()
        except BaseException:
            self.process.kill()
            self.process.wait(DEADLINE_S)
            raise
        return self

    def events(self) -> list[str]:
        assert self.process.poll() is None, self.log.read_text()
        return self.told()

    def told(self) -> list[str]:
        lines = self.log.read_text().splitlines()
        return [
            json.loads(line)["event"]
            for line in lines
            if line.startswith("{") and line.endswith("}")
        ]

    def children(self) -> dict[str, int]:
        """Process ids of servo and gateway."""
        pid = self.process.pid
        found = {}
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
                found |= {
                    name: int(child)
                    for name in ("servo", "gateway")
                    if f"hapticd.run.{name}_main".encode() in words
                }
        self.seen |= set(found.values())
        return found

    def cli(self, *words: str) -> int:
        return main([*words, "--instance", self.instance])

    def __exit__(self, *_: object) -> None:
        """Terminate all processes, whatever the result of the test."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            self.process.wait(DEADLINE_S)
        for pid in self.seen:
            with contextlib.suppress(OSError):
                if (
                    str(self.folder).encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
                ):  # the number may have been reused
                    os.kill(pid, signal.SIGKILL)


def zeroed(client: Client) -> None:
    """Set the origin at the handle. This needs a position in the tick of the command, so it may
    take several attempts on a busy machine.
    """

    def accepted() -> bool:
        with contextlib.suppress(CommandError):
            client.zero()
            return True
        return False

    until(accepted, "zero")


def last_record(ring: Path) -> Any:
    """The newest record of a telemetry ring."""
    content = ring.read_bytes()
    head = int.from_bytes(
        content[8 * layout.TELEMETRY_HEAD_WORD : 8 * layout.TELEMETRY_HEAD_WORD + 8], "little"
    )
    dtype = np.dtype([tuple(field) for field in layout.TELEMETRY])
    records = np.frombuffer(content, dtype, layout.RING_RECORDS, layout.TELEMETRY_OFFSET)
    return records[(head - 1) % layout.RING_RECORDS]


@contextlib.contextmanager
def shared_daemon(**options: Any) -> Iterator[Daemon]:
    """Yield a daemon in a separate runtime folder, for a fixture of any scope; options
    of `Daemon`.
    """
    with pytest.MonkeyPatch.context() as patch:
        for folder in fresh_runtime(patch):
            with Daemon(folder, **options) as daemon:
                yield daemon


def asking(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Return a function that runs a verb on `daemon` and returns the object printed with --json."""

    def ask(*words: str, code: int = 0) -> Any:
        capsys.readouterr()
        assert daemon.cli(*words, "--json") == code
        return json.loads(capsys.readouterr().out)

    return ask
