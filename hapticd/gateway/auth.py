"""Who may connect from where.

Commands are taken on a socket file in the runtime folder: the file system says who. Telemetry is
offered there and on the loopback; on any other address only with CURVE keys (the folder holds
`server.key_secret` and, in `clients`, the public keys of those who may listen), or when the
configuration says `allow_insecure`, and then with a warning.

CURVE is libzmq's. It runs in the relay, an ordinary subscriber on the socket file that passes on
what it receives, in a thread of its own; the gateway's loop never waits for it. Before a peer has
proved its key nothing of it is taken in.
"""

import ipaddress
import os
import re
import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import zmq
import zmq.auth
from zmq.auth.thread import ThreadAuthenticator

from hapticd.errors import ConfigError
from hapticd.gateway.peers import PROBE_S, SILENCE_S
from hapticd.params import GatewayParams

SERVER = "server"
SERVER_KEY = "server.key_secret"
CLIENTS = "clients"
RELAYED_QUEUED = 100  # messages per subscriber: 2 s
LONGEST_RELAYED = 1 << 22  # bytes of a part of a message
LONGEST_SUBSCRIPTION = 1024


def is_loopback(host: str) -> bool:
    """Whether `host` is an address of this machine alone.

    Names other than localhost are not trusted to be.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def warning(params: GatewayParams) -> str | None:
    """What to warn of, None if nothing.

    ConfigError if telemetry would leave the machine in the clear without leave.
    """
    host = params.tcp_host
    if is_loopback(host) or params.curve_keys is not None:
        return None
    if not params.allow_insecure:
        raise ConfigError(
            f"gateway.tcp_host = {host!r}: beyond this machine telemetry needs keys; set"
            " gateway.curve_keys, or gateway.allow_insecure = true if everyone on that network may"
            " listen, or use 127.0.0.1"
        )
    return (
        f"INSECURE: telemetry is offered on {host} to everyone, without keys or encryption; set"
        " gateway.curve_keys"
    )


def needs_keys(params: GatewayParams) -> bool:
    """Whether TCP is for those with a key."""
    return params.curve_keys is not None and not is_loopback(params.tcp_host)


class Relay:
    """Passes the telemetry of endpoint `inside` on to those with a key who connect to `listener`,
    whose endpoint is `outside`.

    ConfigError: the keys are incomplete, or the server's is readable by others.
    """

    def __init__(
        self, inside: str, listener: socket.socket, outside: str, params: GatewayParams
    ) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._guard: ThreadAuthenticator | None = None
        self._thread: threading.Thread | None = None
        try:
            source = self._socket(zmq.XSUB, LONGEST_RELAYED)
            offer = self._socket(zmq.XPUB, LONGEST_SUBSCRIPTION)
            # every subscription is passed on, not the first alone: late joiners get `state`
            offer.setsockopt(zmq.XPUB_VERBOSE, 1)
            self._guard = _authenticator(self._context, params)
            _encrypt(offer, params)
            offer.setsockopt(zmq.USE_FD, listener.detach())
            offer.bind(outside)
            source.connect(inside)
        except BaseException:
            listener.close()
            self.close()
            raise
        # a socket belongs to one thread at a time: from here on to this one
        self._thread = threading.Thread(target=_pass_on, args=(source, offer))
        self._thread.start()

    def _socket(self, kind: int, longest: int) -> "zmq.Socket[bytes]":
        relayed = self._context.socket(kind)
        options = {
            zmq.LINGER: 0,
            zmq.MAXMSGSIZE: longest,
            zmq.SNDHWM: RELAYED_QUEUED,
            zmq.TCP_KEEPALIVE: 1,
            zmq.TCP_KEEPALIVE_IDLE: PROBE_S,
            zmq.TCP_KEEPALIVE_INTVL: PROBE_S,
            zmq.TCP_KEEPALIVE_CNT: SILENCE_S // PROBE_S,
            # never held back, and no heartbeats: a peer that dies while its input is held back
            # makes libzmq abort (its issue 4364)
            zmq.RCVHWM: 0,
        }
        for option, value in options.items():
            relayed.setsockopt(option, value)
        return relayed

    def close(self) -> None:
        """End the relay."""
        if self._guard:
            # its thread has a socket of this context, which could not end before it
            self._guard.stop()
        if self._thread is None:
            self._context.destroy(linger=0)
        else:
            self._context.term()
            self._thread.join()


def _pass_on(source: "zmq.Socket[bytes]", offer: "zmq.Socket[bytes]") -> None:
    try:
        zmq.proxy(source, offer)
    except zmq.ContextTerminated:
        pass
    finally:
        source.close()
        offer.close()


def _authenticator(
    context: "zmq.Context[zmq.Socket[bytes]]", params: GatewayParams
) -> ThreadAuthenticator:
    """A running check of client keys, to be stopped at the end. ConfigError: folder incomplete."""
    clients = Path(params.curve_keys or "") / CLIENTS
    if not clients.is_dir():
        raise ConfigError(
            f"gateway.curve_keys: {clients} is missing; make it and put the public keys of allowed"
            " clients there"
        )
    guard = ThreadAuthenticator(context)
    guard.start()
    guard.configure_curve(domain="*", location=str(clients))
    return guard


def _encrypt(socket: "zmq.Socket[bytes]", params: GatewayParams) -> None:
    """Make what `socket` binds from now on demand CURVE.

    ConfigError if the server's key is missing or readable by others.
    """
    path = Path(params.curve_keys or "") / SERVER_KEY
    if not path.is_file():
        raise ConfigError(
            f"gateway.curve_keys: {path} is missing; make it with `hapticd keys server"
            f" {path.parent}`"
        )
    if path.stat().st_mode & 0o077:
        raise ConfigError(f"gateway.curve_keys: {path} is readable by others; chmod 600 it")
    socket.curve_publickey, socket.curve_secretkey = zmq.auth.load_certificate(path)
    socket.curve_server = True


def make_keys(folder: Path) -> tuple[Path, Path]:
    """A server key pair and an empty folder for clients in `folder`; (public, secret).

    The secret is readable by its owner alone. ConfigError where there is a pair already, or nothing
    can be written.
    """
    public = folder / f"{SERVER}.key"
    secret = folder / SERVER_KEY
    _free(public, secret)
    with _private(folder):
        (folder / CLIENTS).mkdir(parents=True, exist_ok=True)
        zmq.auth.create_certificates(folder, SERVER)
    return public, secret


def make_client(folder: Path, name: str, out: Path) -> tuple[Path, Path]:
    """A listener's pair: the public key in the clients of `folder`, the secret in `out`; (public,
    secret). ConfigError as `make_keys`, for a folder without a server's pair, and for a name that
    is no name of a file.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise ConfigError(
            f"{name!r}: a client is named by letters, digits, dots, dashes and underscores"
        )
    if not (folder / SERVER_KEY).is_file():
        raise ConfigError(
            f"{folder}: no {SERVER_KEY} in it; make it with `hapticd keys server {folder}`"
        )
    public = folder / CLIENTS / f"{name}.key"
    secret = out / f"{name}.key_secret"
    _free(public, secret)
    with _private(out), TemporaryDirectory() as made:
        out.mkdir(parents=True, exist_ok=True)
        (folder / CLIENTS).mkdir(exist_ok=True)
        files = zmq.auth.create_certificates(made, name)
        for file, target in zip(files, (public, secret), strict=True):
            shutil.move(file, target)
    return public, secret


def _free(*files: Path) -> None:
    """ConfigError if one of `files` is there: whoever has its other half would be locked out."""
    for file in files:
        if file.exists():
            raise ConfigError(
                f"{file} exists; a key is not made again: remove both halves yourself, or choose"
                " another name"
            )


@contextmanager
def _private(folder: Path) -> Iterator[None]:
    """What is written meanwhile is its owner's alone: pyzmq writes a key as the umask allows."""
    before = os.umask(0o077)
    try:
        yield
    except OSError as error:
        raise ConfigError(
            f"{folder}: {error.strerror}; name a folder that you may write to"
        ) from error
    finally:
        os.umask(before)
