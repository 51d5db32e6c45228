"""Access of the wire tests to hapticd_wire.h: its declarations as text, and a C compiler."""

import hashlib
import re
import subprocess
from pathlib import Path
from typing import NamedTuple

from support.programs import compiler
from support.tree import ROOT

FOLDER = ROOT / "firmware_iface"
HEADER = (FOLDER / "hapticd_wire.h").read_text()
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", f"-I{FOLDER}"]
CODES = {
    "uint8_t": "B",
    "uint16_t": "H",
    "int16_t": "h",
    "uint32_t": "I",
    "int32_t": "i",
    "float": "f",
    "char": "s",
}

_PLAIN = re.sub(r"/\*.*?\*/", "", HEADER, flags=re.DOTALL)
CONSTANTS = dict(re.findall(r"^#define (HAPTICD_\w+)[ \t]+(\S+)", _PLAIN, re.MULTILINE))
_STRUCTS = re.findall(r"struct (\w+) \{(.*?)\};", _PLAIN, re.DOTALL)


class Member(NamedTuple):
    """One struct member: C type, name, array dimensions."""

    type: str
    name: str
    shape: tuple[int, ...]


def _members(body: str) -> list[Member]:
    found = re.findall(r"(\w+)\s+(\w+)((?:\[\w+\])*);", body)
    assert len(found) == body.count(";"), (
        "a member is written in a way that this parser does not read"
    )
    return [
        Member(kind, name, tuple(map(_number, re.findall(r"\[(\w+)\]", shape))))
        for kind, name, shape in found
    ]


def _number(text: str) -> int:
    return int(CONSTANTS.get(text, text), 0)


STRUCTS = {name: _members(body) for name, body in _STRUCTS}


def build(source: Path) -> Path:
    """Compile `source` with all warnings as errors; the program is in the same folder."""
    program = source.with_suffix("")
    done = subprocess.run(
        [*compiler(), *FLAGS, str(source), "-o", str(program)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return program


def run(program: Path, text: str = "") -> str:
    """Return the output of `program` for the input `text`."""
    return subprocess.run(
        [str(program)], input=text, capture_output=True, text=True, check=True
    ).stdout


_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_HASH_LINE = re.compile(r"^[ \t]*#[ \t]*define[ \t]+HAPTICD_PROTOCOL_HASH\b[^\n]*$", re.MULTILINE)
_WHITE_SPACE = re.compile(r"[ \t\n\r\v\f]+")


def declarations(text: str) -> str:
    """Return the header `text` without comments, the HAPTICD_PROTOCOL_HASH line and white space, in
    that order: the input of its fingerprint.
    """
    return _WHITE_SPACE.sub("", _HASH_LINE.sub("", _COMMENT.sub("", text)))


def protocol_hash(text: str) -> bytes:
    """Return the first 8 bytes of SHA-256 over the declarations of the header `text`, equal to
    `frames.PROTOCOL_HASH`.
    """
    return hashlib.sha256(declarations(text).encode("ascii")).digest()[:8]
