"""The gateway process: `python -m hapticd.run.gateway_main FOLDER`.

It serves the servo of runtime folder FOLDER with the parameters in its gateway.json until SIGTERM
or SIGINT. It starts the worker of its guard (`guard.worker`), which ends with it. `--parent PID` is
the supervisor with which it ends. A byte written to the descriptor of `--ready FD` signals that it
serves. Exit code 0: ended by a signal; 1: a hapticd error, printed in one line on stderr; 78: the
configuration is wrong and a restart would not help.

It must not import numba, scipy or pyusb (import-linter and a test check).
"""

import argparse
import os
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hapticd.core.errors import HapticdError
from hapticd.core.params import GatewaySetup, read_params
from hapticd.core.process import die_with_parent, launch, on_stop
from hapticd.core.units import MonotonicClock
from hapticd.gateway import server
from hapticd.mailbox.files import GATEWAY_JSON, GUARD_JSON
from hapticd.run.watchdog import Feeder, notify

if TYPE_CHECKING:
    import subprocess

GUARD_MODULE = "hapticd.guard.worker"


def main(arguments: list[str]) -> int:
    """Run a gateway and return the exit code."""
    parser = argparse.ArgumentParser(prog="gateway_main", allow_abbrev=False)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--parent", type=int)
    parser.add_argument("--ready", type=int)
    asked = parser.parse_args(arguments)
    ending: list[bool] = []
    on_stop(lambda: ending.append(True))
    die_with_parent(asked.parent)
    clock = MonotonicClock()
    watchdog = Feeder(clock)

    def should_stop() -> bool:
        watchdog.feed()
        return bool(ending)

    def read() -> GatewaySetup:
        return read_params(GatewaySetup, asked.folder / GATEWAY_JSON)

    def judge(line: socket.socket) -> "subprocess.Popen[bytes]":
        """Start the guard's worker, which may outlive the gateway by at most one verdict."""
        ends = ("--fd", str(line.fileno()), "--parent", str(os.getpid()))
        return launch(GUARD_MODULE, str(asked.folder), *ends, keep=(line.fileno(),))

    try:
        server.run(
            asked.folder,
            read,
            clock,
            should_stop,
            lambda: _say_ready(asked.ready),
            judge if (asked.folder / GUARD_JSON).exists() else None,
        )
    except HapticdError as error:
        sys.stderr.write(f"hapticd gateway: {error}\n")
        return error.exit_code
    return 0


def _say_ready(descriptor: int | None) -> None:
    notify("READY=1")
    if descriptor is not None:
        os.write(descriptor, b"1")


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
