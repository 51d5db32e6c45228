"""A peer that speaks ZMTP by hand, so that it can violate the protocol as no library does."""

import contextlib
import socket
from typing import Self

from hapticd.gateway.peers import GREETING
from support.gateway_rig import PATIENCE, GatewayRig

# ZMTP 3.1, as libzmq greets
HELLO = GREETING[:11] + b"\x01" + GREETING[12:]


def short(body: bytes, flags: int = 0) -> bytes:
    """A frame of less than 256 bytes."""
    return bytes((flags, len(body))) + body


def ready(kind: bytes) -> bytes:
    """The command READY of a socket of `kind`."""
    return short(b"\5READY\x0bSocket-Type" + len(kind).to_bytes(4, "big") + kind, 4)


PING = short(b"\4PING\0\0hi", 4)


class RawPeer:
    """A socket of `kind`, connected to `endpoint`; its sends never block."""

    def __init__(
        self, rig: GatewayRig, endpoint: str, kind: bytes = b"DEALER", introduced: bool = True
    ) -> None:
        self.rig = rig
        scheme, _, address = endpoint.partition("://")
        host, _, port = address.rpartition(":")
        tcp = scheme == "tcp"
        self.socket = socket.socket(socket.AF_INET if tcp else socket.AF_UNIX)
        self.socket.connect((host, int(port)) if tcp else address)
        self.socket.setblocking(False)
        if introduced:
            self.send(HELLO + ready(kind))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, data: bytes) -> int:
        """Send the part of `data` that the kernel accepts; return its length. The gateway does not
        run.
        """
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while sent < len(data):
                sent += self.socket.send(data[sent : sent + 65536])
        return sent

    def read(self) -> bytes | None:
        """Return the received data; None once the gateway has closed the connection."""
        try:
            return self.socket.recv(1 << 20) or None
        except BlockingIOError:
            return b""
        except ConnectionError:
            return None

    def cut_off(self) -> bool:
        """Whether the gateway ends the connection within a few passes."""
        for _ in range(20):
            self.rig.step(1)
            if self.read() is None:
                return True
        return False

    def await_bytes(self, wanted: bytes) -> None:
        """Step until `wanted` came."""
        found = b""
        for _ in range(PATIENCE):
            self.rig.step(1)
            found += self.read() or b""
            if wanted in found:
                return
        raise AssertionError(f"{wanted!r} did not come")
