"""The gateway's side of the relay (`relay`): it starts and restarts the relay, and reports
refusals.

The listening socket stays in the gateway: connections made without a relay wait for the next one,
and the port stays the same. Line and process are those of `worker`, with another program.
"""

import selectors
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticd.core.process import launch
from hapticd.guard.worker import Worker
from hapticd.protocol.journal import EventCode
from hapticd.protocol.keys import server_pair

if TYPE_CHECKING:
    import subprocess

MODULE = "hapticd.gateway.relay"

Events = Iterator[tuple[EventCode, dict[str, Any]]]  # with their fields


class RelaySupervisor:
    """Telemetry of the endpoint `source`, offered by `listener` at `endpoint`, to clients with a
    key in the folder `keys`.

    ConfigError: the keys are incomplete, or the server's key is readable by others.
    """

    def __init__(
        self,
        source: str,
        listener: socket.socket,
        endpoint: str,
        keys: Path,
        selector: selectors.BaseSelector,
    ) -> None:
        self._listener = listener
        self._command = [str(keys), source, endpoint]
        try:
            server_pair(keys)
        except BaseException:
            listener.close()
            raise
        self._relay = Worker(self._start, selector, "")
        self._process: subprocess.Popen[bytes] | None = None
        self._seen: dict[str, Any] = {"connected": 0, "refused": 0, "unreadable": {}}
        self._trouble = ""  # the last reported one

    def _start(self, line: socket.socket) -> "subprocess.Popen[bytes]":
        passed = (line.fileno(), self._listener.fileno())
        ends = ("--line", str(passed[0]), "--listener", str(passed[1]))
        self._process = launch(MODULE, *self._command, *ends, keep=passed)
        return self._process

    def tend(self, now_ns: int) -> Events:
        """Start the relay if due; yield warnings about refused clients, unreadable keys and the end
        of the relay.
        """
        self._relay.tend(now_ns)
        for report in self._relay.answers():
            if "ended" in report:
                yield from self._ended(report["ended"])
            else:
                yield from self._took(report)
        code = self._process.poll() if self._process and self._relay.state == "down" else None
        if code is not None and not self._trouble:
            yield from self._ended(f"the relay ended, exit code {code}")

    def _took(self, report: dict[str, Any]) -> Events:
        """Yield the warnings in a report of a running relay."""
        self._trouble = ""
        known = self._seen["unreadable"]
        self._seen = {name: report[name] for name in self._seen}
        for name, why in self._seen["unreadable"].items():
            if known.get(name) != why:
                yield "key_unreadable", {"path": name, "reason": why}
        for address, why, times in report["news"]:
            often = {"times": times} if times > 1 else {}
            yield "listener_refused", {"address": address, "reason": why, **often}

    def _ended(self, why: str) -> Events:
        """Yield a warning that the relay has ended, once for each reason; it is restarted."""
        if why != self._trouble:
            self._trouble = why
            yield "relay_ended", {"reason": why}

    def summary(self) -> dict[str, Any]:
        """Return the part of `status` about the relay. It has the state of the relay, its trouble,
        its process, connections, refusals so far and unreadable key files.
        """
        pid = self._process.pid if self._process else None
        state = {"relay": self._relay.state, "trouble": self._trouble, "pid": pid}
        return state | self._seen

    def close(self) -> None:
        """End the relay."""
        self._relay.close()
        if self._process:
            self._process.wait()  # it was killed
        self._listener.close()
