"""A request with its envelope: who sent it, in which encoding, and where its reply goes."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hapticd.core.errors import CommandError
from hapticd.protocol.codec import (
    Encoding,
    RequestId,
    decode,
    echo_id,
    encode,
    encoding_of,
    malformed,
)

__all__ = ["INTERNAL_REQUEST", "RequestMessage", "unpacked"]


class RequestMessage(NamedTuple):
    """A request with its envelope, and what is wrong with it if something is."""

    envelope: tuple[bytes, ...]
    encoding: Encoding
    id: RequestId
    cmd: str
    plain: dict[str, Any]
    error: CommandError | None

    @property
    def client(self) -> bytes:
        """Identity of the sender's connection."""
        return self.envelope[0]

    def reply(self, content: dict[str, Any]) -> list[bytes]:
        """Frames of the reply `content`, to which the id is added."""
        return [*self.envelope, encode(self.encoding, {"id": self.id} | content)]


def unpacked(frames: Sequence[bytes]) -> RequestMessage:
    """The request in `frames`: client identity, delimiter, payload. Never raises.

    The delimiter is empty, and is there only if a REQ socket sent the request.
    """
    identity, *rest = frames
    delimiter = tuple(rest[:-1])
    payload = rest[-1] if rest else b""
    plain: dict[str, Any] = {}
    error = None
    try:
        if delimiter not in ((), (b"",)):
            delimiter = ()
            raise malformed(f"{len(rest)} frames")
        plain = decode(payload)
    except CommandError as problem:
        error = problem
    cmd = plain.get("cmd")
    return RequestMessage(
        (identity, *delimiter),
        encoding_of(payload),
        echo_id(plain),
        cmd if isinstance(cmd, str) else "",
        plain,
        error,
    )


# stands for the request of what the gateway does by itself
INTERNAL_REQUEST = RequestMessage((b"",), Encoding.MSGPACK, None, "damping", {}, None)
