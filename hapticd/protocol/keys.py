"""CURVE keys: their files, and the events of connections that use them.

Files (`make_keys`, `make_client`, `server_pair`). A gateway reads them in this layout:

    server.key, server.key_secret   the gateway's pair; clients need the public key
    clients/NAME.key                public keys of allowed subscribers
    NAME.key_secret                 on the subscriber's computer only

A secret key that another account may read is refused. Existing keys are never overwritten, because
their other half is in use elsewhere.

Events (`taken`). libzmq's monitor reports them about a socket's connections, for both ends of a
line with keys (`relay`, `client.listener`). pyzmq also has a reader of these messages, but it loads
asyncio, which takes too much memory for the relay. A monitor socket must have one reader.
"""

import os
import re
import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import zmq
import zmq.auth

from hapticd.core.errors import ConfigError

__all__ = [
    "SERVER_PUBLIC",
    "Clients",
    "make_client",
    "make_keys",
    "public_key",
    "secret_pair",
    "server_pair",
    "take",
    "taken",
]

# --- files ----------------------------------------------------------------------------------------

SERVER = "server"
SERVER_PUBLIC = "server.key"
SERVER_KEY = "server.key_secret"
CLIENTS = "clients"
KEY_NAME = re.compile(r"[^.].*\.key")  # unfinished files start with a dot


def server_pair(folder: Path) -> tuple[bytes, bytes]:
    """Return the gateway's own pair: (public, secret), 40 characters of Z85 each.

    ConfigError: the folder is incomplete, a key is invalid, or others may read the secret.
    """
    clients = folder / CLIENTS
    if not clients.is_dir():
        raise ConfigError(
            f"gateway.curve_keys: {clients} is missing; make it and put the public keys of allowed"
            " clients there"
        )
    path = folder / SERVER_KEY
    if not path.is_file():
        raise ConfigError(
            f"gateway.curve_keys: {path} is missing; make it with `hapticd keys server {folder}`"
        )
    return secret_pair(path)


def secret_pair(path: Path) -> tuple[bytes, bytes]:
    """Return the pair in a file with a secret key: (public, secret).

    ConfigError: others may read it, or the file does not exist.
    """
    try:
        if path.stat().st_mode & 0o077:
            raise ConfigError(f"{path} is readable by others; chmod 600 it")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; name a file NAME.key_secret") from error
    public, secret = _loaded(path)
    if secret is None:
        raise ConfigError(f"{path} holds no secret key; it is made by `hapticd keys`")
    return public, secret


def public_key(path: Path) -> bytes:
    """Return the public key in a file. ConfigError: it contains none."""
    return _loaded(path)[0]


def _loaded(path: Path) -> tuple[bytes, bytes | None]:
    try:
        return zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: no key ({error}); keys are made by `hapticd keys`") from error


class Clients:
    """Names of allowed subscribers by public key; changed files are read again."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / CLIENTS
        self._content: dict[Path, bytes | str] = {}
        self._names: dict[bytes, str] = {}
        self.unreadable: dict[str, str] = {}  # reason by name of each unusable file

    def name(self, key: bytes) -> str:
        """Return the name for `key` (Z85); empty if it is unknown."""
        self.look()
        return self._names.get(key, "")

    def look(self) -> None:
        """Read changed files again."""
        content = _contents(self._folder)
        if content == self._content:
            return
        self._content = content
        self._names = {}
        self.unreadable = {}
        for path, data in content.items():
            try:
                if isinstance(data, str):
                    raise ConfigError(f"{path}: {data}; let the gateway's account read it")
                self._names[public_key(path)] = path.stem
            except ConfigError as error:
                self.unreadable[path.name] = str(error)


def _contents(folder: Path) -> dict[Path, bytes | str]:
    """Return the content of each key file in `folder`, or the reason why it, or the folder, cannot
    be read.
    """
    found: dict[Path, bytes | str] = {}
    try:
        paths = [folder / name for name in sorted(os.listdir(folder)) if KEY_NAME.fullmatch(name)]
    except OSError as error:
        return {folder: error.strerror or str(error)}
    for path in paths:
        try:
            found[path] = path.read_bytes()
        except OSError as error:
            found[path] = error.strerror or str(error)
    return found


def make_keys(folder: Path) -> tuple[Path, Path]:
    """Create a server key pair and an empty folder for clients in `folder`; return (public,
    secret).

    Only its owner may read the secret. ConfigError if a pair exists, or on a write error.
    """
    public = folder / SERVER_PUBLIC
    secret = folder / SERVER_KEY
    _free(public, secret)
    with _private(folder):
        (folder / CLIENTS).mkdir(parents=True, exist_ok=True)
        zmq.auth.create_certificates(folder, SERVER)
    return public, secret


def make_client(folder: Path, name: str, out: Path) -> tuple[Path, Path]:
    """Create a subscriber's pair: the public key in the clients of `folder`, the secret in `out`.

    Return (public, secret). ConfigError as `make_keys`, for a folder without a server's pair, and
    for an invalid file name.
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
            # rename complete files: the gateway reads a key as soon as it appears
            unfinished = target.with_name(f".{target.name}.new")
            shutil.move(file, unfinished)
            os.replace(unfinished, target)
    return public, secret


def _free(*files: Path) -> None:
    """Raise ConfigError if one of `files` exists: the owner of its other half would be
    locked out.
    """
    for file in files:
        if file.exists():
            raise ConfigError(
                f"{file} exists; a key is not made again: remove both halves yourself, or choose"
                " another name"
            )


@contextmanager
def _private(folder: Path) -> Iterator[None]:
    """Let only the owner access new files: pyzmq creates key files with the default umask."""
    before = os.umask(0o077)
    try:
        yield
    except OSError as error:
        raise ConfigError(
            f"{folder}: {error.strerror}; name a folder that you may write to"
        ) from error
    finally:
        os.umask(before)


# --- events ---------------------------------------------------------------------------------------

LAYOUT = struct.Struct("=Hi")  # event, value: zmq_socket_monitor(3)


class Event(NamedTuple):
    """One event of a monitor."""

    kind: int  # zmq.EVENT_...
    value: int  # a descriptor, or the error of a failed handshake


def take(monitor: "zmq.Socket[bytes]") -> Event:
    """Return the next event; zmq.Again without one."""
    data, _endpoint = monitor.recv_multipart(zmq.NOBLOCK)
    return Event(*LAYOUT.unpack(data))


def taken(monitor: "zmq.Socket[bytes]") -> Iterator[Event]:
    """Yield all waiting events."""
    while True:
        try:
            yield take(monitor)
        except zmq.Again:
            return
