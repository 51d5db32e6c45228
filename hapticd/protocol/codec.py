"""Requests and replies: msgpack or JSON, told apart by the first byte, both within hard limits; a
request with its envelope: who sent it, in which encoding, and where its reply goes.

`{` (0x7B) begins every JSON object and no msgpack map, so the test is exact; the reply comes in the
encoding of the request. Nothing is trusted: keys must be text and appear once, arrays and maps are
bounded before they are built, and of a request only its `id` is ever echoed, and only if it is
small and plain. Numbers that are not finite are left to the schema, which names the field: a stop
is a stop whatever else the message holds.
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
    """How a message is written."""

    MSGPACK = "msgpack"
    JSON = "json"


def encoding_of(payload: bytes) -> Encoding:
    """JSON if the first byte is `{`, else msgpack."""
    return Encoding.JSON if payload[:1] == b"{" else Encoding.MSGPACK


def decode(payload: bytes) -> dict[str, Any]:
    """The request map in `payload`. CommandError `malformed` says what is wrong with it."""
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
    """`content` as bytes; numbers that are not finite become null.

    It may hold maps with text keys, lists, numbers, text and None.
    """
    content = finite(content)
    if encoding is Encoding.JSON:
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    return bytes(msgpack.packb(content))


def request_id(value: Any) -> RequestId:
    """`value` if it may be echoed, else ValueError.

    That is an int in [0, 2^53), printable ASCII of at most 64 characters, or None.
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
    """The id to answer with: that of the request, or None when it may not be echoed."""
    try:
        return request_id(request.get("id"))
    except ValueError:
        return None


def shown(value: Any, most: int = SHOWN) -> str:
    """A foreign value in printable ASCII, cut to `most` characters."""
    text = value if isinstance(value, str) else reprlib.repr(value)
    text = text[: 2 * most].encode("ascii", "backslashreplace").decode()
    return text if len(text) <= most else text[:most] + "..."


def malformed(reason: str) -> CommandError:
    """The error for bytes that are no request."""
    return CommandError(
        "malformed",
        f"not a request: {reason}; send one msgpack or JSON map within {MAX_MESSAGE_BYTES} bytes",
    )


def finite(content: Any) -> Any:
    """`content` with every number that is not finite replaced by None."""
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
