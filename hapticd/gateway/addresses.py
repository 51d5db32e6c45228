"""Where the gateway listens: two socket files in the runtime folder and one TCP port.

    ROUTER  ipc://<runtime folder>/command     requests and replies
    XPUB    ipc://<runtime folder>/telemetry   topics, for this machine
            tcp://127.0.0.1:9872               the same, where PlotJuggler looks for it

The socket files are for user and group only; the folder decides further. Only the default instance
claims port 9872; where it is taken, any free one serves. With keys the port is the relay's
(`relay`), which alone speaks CURVE: `RelaySupervisor` starts it, starts it again, and hears whom it
refused. The listening socket stays here: what connects while there is no relay waits for the next
one, and the port is the same. The line and the process are those of `worker`, with another program.
"""

import errno
import json
import os
import selectors
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hapticd.core.errors import ConfigError, MailboxError
from hapticd.core.params import GatewayParams, GatewaySetup
from hapticd.gateway.peers import Port
from hapticd.guard.worker import Worker
from hapticd.mailbox.files import (
    COMMAND_SOCKET,
    DEFAULT_INSTANCE,
    ENDPOINTS,
    TELEMETRY_SOCKET,
    remove,
    write_whole,
)
from hapticd.protocol import auth
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

# Linux has 108 bytes for it, the last of which is 0
LONGEST_PATH = 107  # of a socket file
REPLIES_QUEUED = 200
MESSAGES_QUEUED = 100  # per subscriber: 2 s
MAX_SUBSCRIPTION_BYTES = 1024
# `bind` makes the socket file; this leaves it read and write for user and group
SOCKET_UMASK = 0o117
RELAY = "hapticd.gateway.relay"


class Sockets:
    """Both kinds of socket, bound, watched by `selector`.

    `endpoints` is {command, telemetry: [..], pid}; `warning` is set when telemetry is in the clear;
    `left` is told of clients of the commands, `gone` of subscribers, whose connections have ended.
    """

    def __init__(
        self,
        folder: Path,
        setup: GatewaySetup,
        selector: selectors.BaseSelector,
        left: Callable[[bytes], None],
        gone: Callable[[bytes], None],
    ) -> None:
        self._folder = folder
        self._selector = selector
        params = setup.gateway
        self.warning = auth.warning(params)
        self.command = Port(b"ROUTER", MAX_MESSAGE_BYTES, REPLIES_QUEUED, selector, left)
        self.telemetry = Port(b"XPUB", MAX_SUBSCRIPTION_BYTES, MESSAGES_QUEUED, selector, gone)
        self.relay: RelaySupervisor | None = None
        try:
            self.endpoints = self._bound(params, setup.servo.instance)
        except BaseException:
            self.close()
            raise

    def _bound(self, params: GatewayParams, instance: str) -> dict[str, object]:
        before = os.umask(SOCKET_UMASK)
        try:
            command = listen_at(self.command, self._folder / COMMAND_SOCKET)
            telemetry = listen_at(self.telemetry, self._folder / TELEMETRY_SOCKET)
        finally:
            os.umask(before)
        port = port_for(params, instance)
        listener = bound_tcp(params.tcp_host, port)
        tcp = endpoint_of(listener)
        taken = bool(port) and listener.getsockname()[1] != port
        self.elsewhere = f"port {port} is taken, telemetry is at {tcp} instead" if taken else ""
        if auth.needs_keys(params):
            keys = Path(params.curve_keys or "")
            self.relay = RelaySupervisor(telemetry, listener, tcp, keys, self._selector)
        else:
            self.telemetry.listen(listener)
        endpoints = {"command": command, "telemetry": [telemetry, tcp], "pid": os.getpid()}
        endpoints |= {"elsewhere": self.elsewhere} if taken else {}
        # last: whoever finds this file may connect
        write_whole(self._folder / ENDPOINTS, json.dumps(endpoints))
        return endpoints

    def tend(self, now_ns: int) -> Iterator[dict[str, Any]]:
        """End what is due to; warnings of whom the relay refused."""
        self.command.tend(now_ns)
        self.telemetry.tend(now_ns)
        if self.relay:
            yield from self.relay.tend(now_ns)

    def close(self) -> None:
        """Close all sockets and remove what says where they were."""
        if self.relay:
            self.relay.close()
        self.command.close()
        self.telemetry.close()
        remove(self._folder, ENDPOINTS, COMMAND_SOCKET, TELEMETRY_SOCKET)


def listen_at(port: Port, path: Path) -> str:
    """Have `port` listen at a socket file; its endpoint.

    ConfigError when the path is too long for one, MailboxError when it cannot be made.
    """
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ConfigError(
            f"{path}: {len(os.fsencode(path))} bytes, a socket file has at most {LONGEST_PATH}; use"
            " a shorter folder"
        )
    listener = socket.socket(socket.AF_UNIX)
    try:
        path.unlink(missing_ok=True)
        listener.bind(os.fspath(path))
    except OSError as error:
        listener.close()
        raise MailboxError(
            f"{path}: {error.strerror}; make room, correct its rights or remove what is in the way"
        ) from error
    port.listen(listener)
    return f"ipc://{path}"


def port_for(params: GatewayParams, instance: str) -> int:
    """The port to try first; 0 (any free one) for other instances than the default one."""
    usual = params.telemetry_port == GatewayParams().telemetry_port
    return 0 if usual and instance != DEFAULT_INSTANCE else params.telemetry_port


def bound_tcp(host: str, port: int) -> socket.socket:
    """A socket that listens at `port` of `host`, or at any free one if that is taken.

    ConfigError if the address is not ours.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, _, _, _, address = found[0]
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        if error.errno != errno.EADDRINUSE or port == 0:
            raise ConfigError(
                f"gateway.tcp_host = {host!r}: {error.strerror}; name an address of this machine"
            ) from error
        return bound_tcp(host, 0)


def endpoint_of(listener: socket.socket) -> str:
    """The endpoint of a TCP socket as ZeroMQ writes it."""
    host, port, *_ = listener.getsockname()
    # ZeroMQ wants brackets around an IPv6 address
    return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"


class RelaySupervisor:
    """Telemetry of the endpoint `source`, offered by `listener` at `endpoint`, for those with a key
    that the folder `keys` knows.

    ConfigError: the keys are incomplete, or the server's is readable by others.
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
        from hapticd.protocol.keys import server_pair  # libzmq, for the relay alone

        try:
            server_pair(keys)
        except BaseException:
            listener.close()
            raise
        self._relay = Worker(self._start, selector, "")
        self._process: subprocess.Popen[bytes] | None = None
        self._seen: dict[str, Any] = {"connected": 0, "refused": 0, "unreadable": {}}
        self._trouble = ""  # of the relay, that was told

    def _start(self, line: socket.socket) -> "subprocess.Popen[bytes]":
        passed = (line.fileno(), self._listener.fileno())
        python = [sys.executable, *(["-I"] if sys.flags.isolated else ["-P"]), "-X", "utf8", "-m"]
        ends = ["--line", str(passed[0]), "--listener", str(passed[1])]
        self._process = subprocess.Popen(
            [*python, RELAY, *self._command, *ends],
            stdin=subprocess.DEVNULL,
            stdout=2,
            pass_fds=passed,
            process_group=0,
        )
        return self._process

    def tend(self, now_ns: int) -> Iterator[dict[str, Any]]:
        """Start the relay if it is due; warnings of whom it refused, of keys that it cannot read,
        and of its end, as the journal has them.
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

    def _took(self, report: dict[str, Any]) -> Iterator[dict[str, Any]]:
        """Warnings of what a relay that serves has said."""
        self._trouble = ""
        known = self._seen["unreadable"]
        self._seen = {name: report[name] for name in self._seen}
        for name, why in self._seen["unreadable"].items():
            if known.get(name) != why:
                yield {"text": f"{name} lets nobody listen: {why}"}
        for address, why, times in report["news"]:
            yield {"text": refusal(address, why, times), "address": address, "times": times}

    def _ended(self, why: str) -> Iterator[dict[str, Any]]:
        """That the relay has ended, once for each reason; it is started again."""
        if why != self._trouble:
            self._trouble = why
            yield {"text": f"no telemetry for other computers: {why}"}

    def summary(self) -> dict[str, Any]:
        """For `status`: whether the relay is up, why not, its process, connections, refusals so
        far, files of keys that it cannot read.
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


def refusal(address: str, why: str, times: int) -> str:
    """What is said of somebody who was not let in."""
    often = f", {times} times" if times > 1 else ""
    return (
        f"telemetry refused to {address or 'somebody'}: {why}{often}; who may listen is made known"
        " by `hapticd keys client`"
    )
