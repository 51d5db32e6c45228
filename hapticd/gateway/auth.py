"""Who may connect from where.

Commands are taken on a socket file in the runtime folder: the file system says who. Telemetry is offered there and on the
loopback; on any other address only with CURVE keys (the folder holds `server.key_secret` and, in `clients`, the public keys
of those who may listen), or when the configuration says `allow_insecure`, and then with a warning.
"""

import ipaddress
import os
from pathlib import Path

import zmq
import zmq.auth
from zmq.auth.thread import ThreadAuthenticator

from hapticd.errors import ConfigError
from hapticd.params import GatewayParams

SERVER_KEY, CLIENTS = "server.key_secret", "clients"


def is_loopback(host: str) -> bool:
    """Whether `host` is an address of this machine alone. Names other than localhost are not trusted to be."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def warning(params: GatewayParams) -> str | None:
    """What to warn of, None if nothing. ConfigError if telemetry would leave the machine in the clear without leave."""
    host = params.tcp_host
    if is_loopback(host) or params.curve_keys is not None:
        return None
    if not params.allow_insecure:
        raise ConfigError(
            f"gateway.tcp_host = {host!r}: beyond this machine telemetry needs keys; set gateway.curve_keys, "
            f"or gateway.allow_insecure = true if everyone on that network may listen, or use 127.0.0.1"
        )
    return f"INSECURE: telemetry is offered on {host} to everyone, without keys or encryption; set gateway.curve_keys"


def authenticator(context: "zmq.Context[zmq.Socket[bytes]]", params: GatewayParams) -> ThreadAuthenticator | None:
    """A running check of client keys, to be stopped at the end; None where no keys are needed. ConfigError: folder incomplete."""
    if params.curve_keys is None or is_loopback(params.tcp_host):
        return None
    clients = Path(params.curve_keys) / CLIENTS
    if not clients.is_dir():
        raise ConfigError(f"gateway.curve_keys: {clients} is missing; make it and put the public keys of allowed clients there")
    guard = ThreadAuthenticator(context)
    guard.start()
    guard.configure_curve(domain="*", location=str(clients))
    return guard


def encrypt(socket: "zmq.Socket[bytes]", params: GatewayParams) -> None:
    """Make what `socket` binds from now on demand CURVE. ConfigError if the server's key is missing or readable by others."""
    path = Path(params.curve_keys or "") / SERVER_KEY
    if not path.is_file():
        raise ConfigError(f"gateway.curve_keys: {path} is missing; make it with hapticd.gateway.auth.make_keys")
    if path.stat().st_mode & 0o077:
        raise ConfigError(f"gateway.curve_keys: {path} is readable by others; chmod 600 it")
    socket.curve_publickey, socket.curve_secretkey = zmq.auth.load_certificate(path)
    socket.curve_server = True


def make_keys(folder: Path) -> None:
    """A server key pair and an empty folder for clients in `folder`; the secret is readable by its owner alone."""
    before = os.umask(0o077)  # pyzmq writes the secret key with whatever the umask allows
    try:
        (folder / CLIENTS).mkdir(parents=True)
        zmq.auth.create_certificates(folder, "server")
    finally:
        os.umask(before)
