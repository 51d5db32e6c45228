"""The frames of a request and of its reply."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hapticd.errors import CommandError
from hapticd.gateway.codec import Encoding, RequestId, decode, echo_id, encode, encoding_of, malformed


class Letter(NamedTuple):
    """A request as it lies on the desk: where the reply goes, how it is written, and what was asked or what is wrong."""

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


def opened(frames: Sequence[bytes]) -> Letter:
    """The letter in `frames`: client identity, an empty delimiter if a REQ socket sent it, payload. Never raises."""
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
    return Letter((identity, *delimiter), encoding_of(payload), echo_id(plain), cmd if isinstance(cmd, str) else "", plain, error)
