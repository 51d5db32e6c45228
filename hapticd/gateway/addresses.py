"""The sockets of the gateway: two socket files in the runtime folder and one TCP port.

    ROUTER  ipc://<runtime folder>/command     requests and replies
    XPUB    ipc://<runtime folder>/telemetry   topics, for this machine
            tcp://127.0.0.1:9872               the same, at the default address of PlotJuggler

The socket files are accessible to user and group only; the folder may restrict access further. Only
the default instance claims port 9872; if it is in use, any free port is used. With keys the relay
(`relay`), the only part with CURVE, serves the port.
"""

import errno
import json
import os
import selectors
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticd.core.errors import ConfigError, MailboxError
from hapticd.core.params import GatewayParams, GatewaySetup
from hapticd.gateway.peers import Port
from hapticd.mailbox.files import (
    COMMAND_SOCKET,
    DEFAULT_INSTANCE,
    ENDPOINTS,
    TELEMETRY_SOCKET,
    remove,
    write_whole,
)
from hapticd.protocol import leases
from hapticd.protocol.codec import MAX_MESSAGE_BYTES
from hapticd.protocol.journal import EventCode, sentence

if TYPE_CHECKING:
    from hapticd.gateway.relay_supervisor import RelaySupervisor

# Linux reserves 108 bytes, the last of which is 0
LONGEST_PATH = 107  # of a socket file
REPLIES_QUEUED = 200
MESSAGES_QUEUED = 100  # per subscriber: 2 s
MAX_SUBSCRIPTION_BYTES = 1024
# `bind` creates the socket file; this mask leaves read and write access for user and group
SOCKET_UMASK = 0o117


class Sockets:
    """Both kinds of socket, bound, watched by `selector`.

    `endpoints` is {command, telemetry: [..], pid}; `warnings` are events with their fields;
    `left` and `gone` are called with the identity of a command client or a subscriber whose
    connection has ended.
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
        self.warnings: list[tuple[EventCode, dict[str, Any]]] = []
        if leases.in_the_clear(params):
            self.warnings.append(("telemetry_open", {"address": params.tcp_host}))
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
        if leases.needs_keys(params):
            self.relay = self._guarded(telemetry, listener, tcp, params)
        else:
            self.telemetry.listen(listener)
        endpoints = {"command": command, "telemetry": [telemetry, tcp], "pid": os.getpid()}
        if port and listener.getsockname()[1] != port:
            taken = {"port": port, "address": tcp}
            self.warnings.append(("port_taken", taken))
            endpoints["elsewhere"] = sentence("port_taken", **taken)
        # last: this file announces that clients can connect
        write_whole(self._folder / ENDPOINTS, json.dumps(endpoints))
        return endpoints

    def _guarded(
        self, source: str, listener: socket.socket, endpoint: str, params: GatewayParams
    ) -> "RelaySupervisor":
        from hapticd.gateway.relay_supervisor import RelaySupervisor  # libzmq, for it alone

        return RelaySupervisor(
            source, listener, endpoint, Path(params.curve_keys or ""), self._selector
        )

    def tend(self, now_ns: int) -> Iterator[tuple[EventCode, dict[str, Any]]]:
        """End connections that are due to end; yield warnings about refused connections."""
        self.command.tend(now_ns)
        self.telemetry.tend(now_ns)
        if self.relay:
            yield from self.relay.tend(now_ns)

    def close(self) -> None:
        """Close all sockets and remove their files."""
        if self.relay:
            self.relay.close()
        self.command.close()
        self.telemetry.close()
        remove(self._folder, ENDPOINTS, COMMAND_SOCKET, TELEMETRY_SOCKET)


def listen_at(port: Port, path: Path) -> str:
    """Let `port` listen at a socket file; return its endpoint.

    ConfigError: the path is too long for a socket. MailboxError: the file cannot be created.
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
            f"{path}: {error.strerror}; free some space, correct its permissions"
            " or remove the obstacle"
        ) from error
    port.listen(listener)
    return f"ipc://{path}"


def port_for(params: GatewayParams, instance: str) -> int:
    """Return the port to try first; 0 (any free one) for instances other than the default one."""
    usual = params.telemetry_port == GatewayParams().telemetry_port
    return 0 if usual and instance != DEFAULT_INSTANCE else params.telemetry_port


def bound_tcp(host: str, port: int) -> socket.socket:
    """Return a socket that listens at `port` of `host`, or at any free port if that is in use.

    ConfigError: the address does not belong to this machine.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        if error.errno != errno.EADDRINUSE or port == 0:
            raise ConfigError(
                f"gateway.tcp_host = {host!r}: {error.strerror}; name an address of this machine"
            ) from error
        return bound_tcp(host, 0)


def endpoint_of(listener: socket.socket) -> str:
    """Return the endpoint of a TCP socket in the notation of ZeroMQ."""
    host, port, *_ = listener.getsockname()
    # ZeroMQ wants brackets around an IPv6 address
    return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"
