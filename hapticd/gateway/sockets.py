"""The gateway's two sockets, and the file that says where they are.

    ROUTER  ipc://<runtime folder>/command     requests and replies
    XPUB    ipc://<runtime folder>/telemetry   topics, for this machine
            tcp://127.0.0.1:9872               the same, where PlotJuggler looks for it

The socket files are for user and group only; the folder decides further. A client that stops reading fills its own queue
(SNDHWM) and loses messages, one that sends too much at once is cut off (MAXMSGSIZE), one that is silent is dropped after
three missed heartbeats. Only the default instance claims port 9872; where it is taken, any free one serves.
"""

import json
import os
from pathlib import Path

import zmq
from zmq.auth.thread import ThreadAuthenticator

from hapticd.errors import ConfigError, MailboxError
from hapticd.gateway import auth
from hapticd.gateway.codec import MAX_MESSAGE_BYTES
from hapticd.mailbox.files import COMMAND_SOCKET, DEFAULT_INSTANCE, ENDPOINTS, TELEMETRY_SOCKET, remove, write_whole
from hapticd.params import GatewayParams, GatewaySetup

LONGEST_PATH = 107  # of a socket file
REQUESTS_QUEUED, REPLIES_QUEUED = 200, 200
MESSAGES_QUEUED = 100  # per subscriber: 2 s
MAX_SUBSCRIPTION_BYTES = 1024  # libzmq keeps some 50 bytes for each; handshakes with keys need several 100
HEARTBEAT_MS, SILENCE_MS, HANDSHAKE_MS = 2000, 6000, 3000
SOCKET_UMASK = 0o117

Context = zmq.Context[zmq.Socket[bytes]]


class Sockets:
    """Both sockets, bound. `endpoints` is {command, telemetry: [..], pid}; `warning` is set when telemetry is in the clear."""

    def __init__(self, folder: Path, setup: GatewaySetup) -> None:
        self._folder, params = folder, setup.gateway
        self.warning = auth.warning(params)
        self.context: Context = zmq.Context()
        self._guard: ThreadAuthenticator | None = None
        try:
            self.command = self._socket(zmq.ROUTER, {zmq.RCVHWM: REQUESTS_QUEUED, zmq.SNDHWM: REPLIES_QUEUED})
            spoken: dict[int, int] = {zmq.SNDHWM: MESSAGES_QUEUED, zmq.XPUB_VERBOSE: 1, zmq.MAXMSGSIZE: MAX_SUBSCRIPTION_BYTES}
            self.telemetry = self._socket(zmq.XPUB, spoken)
            self._guard = auth.authenticator(self.context, params)
            self.endpoints = self._bound(params, setup.servo.instance)
        except BaseException:
            self.close()
            raise

    def _socket(self, kind: int, options: dict[int, int]) -> "zmq.Socket[bytes]":
        socket = self.context.socket(kind)
        common = {
            zmq.LINGER: 0,
            zmq.MAXMSGSIZE: MAX_MESSAGE_BYTES,
            zmq.HEARTBEAT_IVL: HEARTBEAT_MS,
            zmq.HEARTBEAT_TIMEOUT: SILENCE_MS,
            zmq.HANDSHAKE_IVL: HANDSHAKE_MS,
        }
        for option, value in (common | options).items():
            socket.setsockopt(option, value)
        return socket

    def _bound(self, params: GatewayParams, instance: str) -> dict[str, object]:
        before = os.umask(SOCKET_UMASK)
        try:
            command, telemetry = (
                bind_file(self.command, self._folder / COMMAND_SOCKET),
                bind_file(self.telemetry, self._folder / TELEMETRY_SOCKET),
            )
        finally:
            os.umask(before)
        if self._guard:
            auth.encrypt(self.telemetry, params)
        tcp = bind_tcp(self.telemetry, params.tcp_host, port_for(params, instance))
        endpoints = {"command": command, "telemetry": [telemetry, tcp], "pid": os.getpid()}
        write_whole(self._folder / ENDPOINTS, json.dumps(endpoints))
        return endpoints

    def close(self) -> None:
        """Close both sockets and remove what says where they were."""
        if self._guard:
            self._guard.stop()
        self.context.destroy(linger=0)
        remove(self._folder, ENDPOINTS, COMMAND_SOCKET, TELEMETRY_SOCKET)


def bind_file(socket: "zmq.Socket[bytes]", path: Path) -> str:
    """Bind to a socket file; its endpoint. ConfigError when the path is too long for one, MailboxError when it cannot be made."""
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ConfigError(f"{path}: {len(os.fsencode(path))} bytes, a socket file has at most {LONGEST_PATH}; use a shorter folder")
    try:
        socket.bind(f"ipc://{path}")
    except zmq.ZMQError as error:
        raise MailboxError(f"{path}: {error.strerror}; make room, correct its rights or remove what is in the way") from error
    return f"ipc://{path}"


def port_for(params: GatewayParams, instance: str) -> int:
    """The port to try first; 0 (any free one) for other instances, which must not take the default one's."""
    usual = params.telemetry_port == GatewayParams().telemetry_port
    return 0 if usual and instance != DEFAULT_INSTANCE else params.telemetry_port


def bind_tcp(socket: "zmq.Socket[bytes]", host: str, port: int) -> str:
    """Bind to `port`, or to any free one if it is taken; the endpoint. ConfigError if the address is not ours."""
    address = f"tcp://[{host}]" if ":" in host else f"tcp://{host}"
    try:
        socket.bind(f"{address}:{port or '*'}")
    except zmq.ZMQError as error:
        if error.errno != zmq.EADDRINUSE or port == 0:
            raise ConfigError(f"gateway.tcp_host = {host!r}: {error}; name an address of this machine") from error
        return bind_tcp(socket, host, 0)
    return socket.getsockopt_string(zmq.LAST_ENDPOINT)
