"""Read-only telemetry of a daemon on another computer.

    with Listener("tcp://rig:9872", keys="rig-keys") as rig:
        records, lost = rig.record(5.0)

The folder of keys contains server.key, the gateway's, and this listener's own NAME.key_secret
(`hapticd keys`). A refused connection looks like silence to a ZeroMQ socket, so its monitor is
read: when no message arrives within the time-out, the error gives the reason.

A folder with the secrets of several listeners is refused, and the error lists them.
"""

from pathlib import Path

import zmq

from hapticd.client.telemetry import Subscription, TelemetryReader
from hapticd.core.errors import CommandError, ConfigError, DaemonDown, HapticdError
from hapticd.protocol.keys import SERVER_PUBLIC, public_key, secret_pair, taken

EVENTS = (
    zmq.EVENT_CONNECTED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
)


class RemoteSubscription(Subscription):
    """Subscriptions at a TCP endpoint, with the keys of a folder.

    ConfigError if the endpoint is invalid, the folder is incomplete, or its secret readable by
    others.
    """

    def __init__(self, endpoint: str, keys: Path | None) -> None:
        if not endpoint.startswith("tcp://"):
            raise ConfigError(
                f"{endpoint!r} is not an endpoint; `hapticd status` shows tcp://HOST:PORT"
            )
        self._place = endpoint
        self._keys = keys
        self._name = ""
        if keys is not None:
            secret = own_secret(keys)
            self._name = secret.stem
            self._pair = secret_pair(secret)
            self._server = public_key(keys / SERVER_PUBLIC)
        self._monitor: zmq.Socket[bytes] | None = None
        super().__init__()

    def _endpoint(self) -> str:
        return self._place

    def _prepare(self, socket: "zmq.Socket[bytes]") -> None:
        if self._keys is not None:
            socket.curve_publickey, socket.curve_secretkey = self._pair
            socket.curve_serverkey = self._server
        self._monitor = socket.get_monitor_socket(EVENTS)

    def _release(self, socket: "zmq.Socket[bytes]") -> None:
        socket.disable_monitor()
        if self._monitor is not None:
            self._monitor.close(linger=0)
        self._monitor = None

    def _quiet(self, topic: str, timeout_s: float) -> HapticdError:
        seen = {event.kind for event in taken(self._monitor)} if self._monitor else set()
        return why_quiet(seen, f"{topic}: {self._place}", self._name, timeout_s)


def own_secret(keys: Path) -> Path:
    """Return the only secret file in `keys`. ConfigError for none, or several."""
    found = sorted(keys.glob("*.key_secret"))
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise ConfigError(
            f"{keys}: one NAME.key_secret is needed, {names} found; bring it and server.key from"
            " the gateway's computer (`hapticd keys client`)"
        )
    return found[0]


def why_quiet(seen: set[int], place: str, name: str, timeout_s: float) -> HapticdError:
    """Return the error for `timeout_s` without a message, from the events of the socket's monitor;
    `name` is that of the key, empty without one.
    """
    if zmq.EVENT_HANDSHAKE_SUCCEEDED in seen:
        return DaemonDown(f"{place}: connected, and nothing came for {timeout_s} s")
    if zmq.EVENT_CONNECTED not in seen:
        return DaemonDown(f"{place}: no gateway listens there; see `hapticd status` on the rig")
    if zmq.EVENT_HANDSHAKE_FAILED_AUTH in seen:
        remedy = f"make it known there: `hapticd keys client FOLDER {name}`"
        return CommandError("refused", f"{place} does not know the key of {name}; {remedy}")
    if not name:
        return CommandError("refused", f"{place} wants a key; name the folder that holds yours")
    if zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL in seen:
        return CommandError("refused", f"{place} has no keys; listen to it without")
    remedy = "bring server.key from its folder of keys again"
    return CommandError(
        "refused", f"{place} does not go on; is server.key that gateway's? {remedy}"
    )


class Listener(TelemetryReader):
    """The telemetry at `endpoint`, best used as a context manager.

    `keys` is the folder of this listener's keys, None for a gateway without keys. Calls end after
    silence for `timeout_s`: CommandError `refused` or DaemonDown give the reason.
    """

    def __init__(
        self, endpoint: str, keys: Path | str | None = None, timeout_s: float = 2.0
    ) -> None:
        self._connection = RemoteSubscription(endpoint, None if keys is None else Path(keys))
        self._timeout_s = timeout_s
