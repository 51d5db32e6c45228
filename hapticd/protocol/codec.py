"""Encode and decode requests and replies in msgpack or JSON, within hard limits.

A request comes with its envelope: sender, encoding and return path. `{` (0x7B) starts every JSON
object and no msgpack map, so the first byte identifies the encoding; the reply has the encoding of
the request. No input is trusted: keys must be text and unique, and arrays and maps are bounded
before they are built. Only the `id` of a request is ever echoed, and only if it is short and plain.
Non-finite numbers are left to the schema, which gives the field in its error: a stop is valid
whatever else the message contains.
"""

import json
import math
import reprlib
from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple

import msgpack

from hapticd.core.errors import CommandError

__all__ = [
    "INTERNAL_REQUEST",
    "MAX_MESSAGE_BYTES",
    "Encoding",
    "RequestMessage",
    "encode",
    "finite",
    "unpacked",
]

MAX_MESSAGE_BYTES = 64 * 1024
MAX_ARRAY = 256
MAX_MAP = 64
MAX_TEXT = 1024
ID_LIMIT = 1 << 53
ID_LENGTH = 64
SHOWN = 48  # characters of a foreign value that a message repeats

RequestId = int | str | None


class Encoding(Enum):
    """The encoding of a message."""

    MSGPACK = "msgpack"
    JSON = "json"


def encoding_of(payload: bytes) -> Encoding:
    """Return JSON if the first byte is `{`, otherwise msgpack."""
    return Encoding.JSON if payload[:1] == b"{" else Encoding.MSGPACK


def decode(payload: bytes) -> dict[str, Any]:
    """Return the request map in `payload`. CommandError `malformed`, with the reason."""
    try:
        if encoding_of(payload) is Encoding.JSON:
            found = json.loads(payload.decode(), object_pairs_hook=_table)
        else:
            found = msgpack.unpackb(
                payload,
                object_pairs_hook=_table,
                strict_map_key=True,
                max_array_len=MAX_ARRAY,
                max_map_len=MAX_MAP,
                max_str_len=MAX_TEXT,
                max_bin_len=MAX_MESSAGE_BYTES,
                max_ext_len=0,
            )
    except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException) as error:
        raise malformed(shown(str(error) or type(error).__name__)) from error
    if not isinstance(found, dict):
        raise malformed(f"a request is a map, this is {type(found).__name__}")
    return found


def encode(encoding: Encoding, content: Any) -> bytes:
    """Return `content` as bytes; non-finite numbers become null.

    It may contain maps with text keys, lists, numbers, text and None.
    """
    content = finite(content)
    if encoding is Encoding.JSON:
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    return bytes(msgpack.packb(content))


def request_id(value: Any) -> RequestId:
    """Return `value` if it may be echoed; ValueError otherwise.

    Valid are an int in [0, 2^53), printable ASCII of at most 64 characters, and None.
    """
    if value is None or (type(value) is int and 0 <= value < ID_LIMIT):
        return value
    if (
        type(value) is str
        and 0 < len(value) <= ID_LENGTH
        and value.isascii()
        and value.isprintable()
    ):
        return value
    raise ValueError(
        f"must be an integer in 0..2^53-1 or 1..{ID_LENGTH} printable ASCII characters"
    )


def echo_id(request: dict[str, Any]) -> RequestId:
    """Return the id for the reply: that of the request, or None if it may not be echoed."""
    try:
        return request_id(request.get("id"))
    except ValueError:
        return None


def shown(value: Any, most: int = SHOWN) -> str:
    """Return a foreign value in printable ASCII, cut to `most` characters."""
    text = value if isinstance(value, str) else reprlib.repr(value)
    text = text[: 2 * most].encode("ascii", "backslashreplace").decode()
    return text if len(text) <= most else text[:most] + "..."


def malformed(reason: str) -> CommandError:
    """Return the error for bytes that are not a request."""
    return CommandError(
        "malformed",
        f"not a request: {reason}; send one msgpack or JSON map within {MAX_MESSAGE_BYTES} bytes",
    )


def finite(content: Any) -> Any:
    """Return `content` with every non-finite number replaced by None."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def _table(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ValueError("a key appears twice")
    if not all(isinstance(key, str) for key in table):
        raise ValueError("a key is not text")
    return table


class RequestMessage(NamedTuple):
    """A request with its envelope, and its error if it is invalid."""

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
        """Return the frames of the reply `content`, with the id added."""
        return [*self.envelope, encode(self.encoding, {"id": self.id} | content)]


def unpacked(frames: Sequence[bytes]) -> RequestMessage:
    """Return the request in `frames`: client identity, delimiter, payload. Never raises.

    The delimiter is empty, and present only if a REQ socket sent the request.
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


# the request of changes by the gateway itself
INTERNAL_REQUEST = RequestMessage((b"",), Encoding.MSGPACK, None, "damping", {}, None)
