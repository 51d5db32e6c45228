"""The fingerprint of hapticd_wire.h that host and board compare before anything else.

What counts are declarations: comments, white space and the line that carries the result do not, so
the header can be explained better or formatted anew without forcing anyone to flash a board.
"""

import hashlib
import re

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_HASH_LINE = re.compile(r"^[ \t]*#[ \t]*define[ \t]+HAPTICD_PROTOCOL_HASH\b[^\n]*$", re.MULTILINE)
_WHITE_SPACE = re.compile(r"[ \t\n\r\v\f]+")
HASH_BYTES = 8


def declarations(text: str) -> str:
    """The header `text` without comments, the HAPTICD_PROTOCOL_HASH line and white space, in
    that order.
    """
    return _WHITE_SPACE.sub("", _HASH_LINE.sub("", _COMMENT.sub("", text)))


def protocol_hash(text: str) -> bytes:
    """First 8 bytes of SHA-256 over the declarations of the header `text`; what
    `frames.PROTOCOL_HASH` must be.
    """
    return hashlib.sha256(declarations(text).encode("ascii")).digest()[:HASH_BYTES]
