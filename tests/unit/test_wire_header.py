"""The compiled C header against hapticd.usb.frames: every size, offset, type and constant."""

import json
import re
import struct
from math import prod
from pathlib import Path
from typing import Any

import pytest
from support import wire_header as header
from support.wire_header import protocol_hash

from hapticd.usb import frames

ENUMS = {
    "REQUEST": frames.Request,
    "FLAG": frames.OutFlag,
    "STATUS": frames.StatusBit,
    "CAPABILITY": frames.Capability,
}
LAYOUTS = {"hapticd_out": frames.OUT, "hapticd_in": frames.IN, "hapticd_hello": frames.HELLO}
VALUES = {
    "hapticd_out": frames.OutFrame,
    "hapticd_in": frames.InFrame,
    "hapticd_hello": frames.HelloFrame,
}
CASES = [(name, member) for name, members in header.STRUCTS.items() for member in members]


def probe_source() -> str:
    """A C program that prints, as JSON, everything that the header declares."""
    lines = ['#include <stdio.h>\n#include <stddef.h>\n#include "hapticd_wire.h"\nint main(void) {']
    for name, members in header.STRUCTS.items():
        lines.append(f'printf("{{\\"{name}\\": [%zu, 0]}}\\n", sizeof(struct {name}));')
        for item in members:
            size = f"sizeof(((struct {name} *)0)->{item.name})"
            offset = f"offsetof(struct {name}, {item.name})"
            lines.append(
                f'printf("{{\\"{name}.{item.name}\\": [%zu, %zu]}}\\n", {size}, {offset});'
            )
    for name in header.CONSTANTS:
        lines.append(f'printf("{{\\"{name}\\": %llu}}\\n", (unsigned long long){name});')
    return "\n".join([*lines, "return 0; }\n"])


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    source: Path = tmp_path_factory.mktemp("header") / "probe.c"
    source.write_text(probe_source())
    found: dict[str, Any] = {}
    for line in header.run(header.build(source)).splitlines():
        found |= json.loads(line)
    return found


def code(member: header.Member) -> str:
    """The struct code that Python has to use for a member; byte arrays are strings of bytes."""
    count = prod(member.shape)
    kind = "s" if member.shape and member.type == "uint8_t" else header.CODES[member.type]
    return f"{count}{kind}" if member.shape else kind


def test_parser_finds_whole_header() -> None:
    assert list(header.STRUCTS) == list(LAYOUTS)
    assert len(header.CONSTANTS) == len(
        re.findall(r"^#define HAPTICD_\w+[ \t]", header.HEADER, re.MULTILINE)
    )
    assert [len(members) for members in header.STRUCTS.values()] == [11, 23, 16]


@pytest.mark.parametrize("name", LAYOUTS)
def test_struct_format_equals_declaration(name: str) -> None:
    joined = "".join(code(member) for member in header.STRUCTS[name])
    joined = re.sub(r"f{2,}", lambda run: f"{len(run[0])}f", joined)
    assert LAYOUTS[name].format == "<" + joined


@pytest.mark.parametrize("name", LAYOUTS)
def test_struct_size_equals_compiled(name: str, compiled: dict[str, Any]) -> None:
    assert compiled[name] == [LAYOUTS[name].size, 0]


@pytest.mark.parametrize(
    ("name", "member"), CASES, ids=[f"{name}.{member.name}" for name, member in CASES]
)
def test_member_offset_equals_compiled(
    name: str, member: header.Member, compiled: dict[str, Any]
) -> None:
    members = header.STRUCTS[name]
    before = "<" + "".join(code(item) for item in members[: members.index(member)])
    assert compiled[f"{name}.{member.name}"] == [
        struct.calcsize("<" + code(member)),
        struct.calcsize(before),
    ]


@pytest.mark.parametrize(
    ("name", "offsets"),
    [("hapticd_out", frames.OUT_OFFSETS), ("hapticd_in", frames.IN_OFFSETS)],
)
def test_named_offsets_equal_compiled(
    name: str, offsets: dict[str, int], compiled: dict[str, Any]
) -> None:
    assert offsets == {member: compiled[f"{name}.{member}"][1] for member in offsets}


@pytest.mark.parametrize("name", VALUES)
def test_value_fields_follow_members(name: str) -> None:
    kept = [
        m.name
        for m in header.STRUCTS[name]
        if m.name not in ("probe_count", "crc") and "reserved" not in m.name
    ]
    assert list(VALUES[name]._fields) == ["pairs" if item == "pair" else item for item in kept]


@pytest.mark.parametrize("name", header.CONSTANTS)
def test_constant_equals_compiled(name: str, compiled: dict[str, Any]) -> None:
    short = name.removeprefix("HAPTICD_")
    family, _, rest = short.partition("_")
    if short == "PROTOCOL_HASH":
        assert compiled[name].to_bytes(8, "big") == frames.PROTOCOL_HASH
    elif family in ENUMS:
        assert compiled[name] == ENUMS[family][rest]
    else:
        assert compiled[name] == getattr(frames, short)


def test_python_has_no_extra_constant() -> None:
    plain = {
        name for name, value in vars(frames).items() if name.isupper() and isinstance(value, int)
    }
    members = {f"{family}_{item.name}" for family, kind in ENUMS.items() for item in kind}
    assert {f"HAPTICD_{name}" for name in plain | members | {"PROTOCOL_HASH"}} == set(
        header.CONSTANTS
    )


def test_frames_fit_one_packet() -> None:
    assert frames.OUT.size <= frames.IN.size == frames.PACKET_BYTES
    assert frames.IN.format.startswith(frames.IN_HEAD.format)
    assert frames.IN_HEAD.size == struct.calcsize("<HHBBHIihhhhBBhI")
    assert frames.IN_PAIRS.size == 4 * frames.PAIR_MAX


@pytest.mark.parametrize("kind", ENUMS.values())
def test_bits_do_not_overlap(kind: type[Any]) -> None:
    values = [item.value for item in kind]
    assert len(set(values)) == len(values)
    assert kind is frames.Request or all(value & (value - 1) == 0 for value in values)


def test_hash_equals_header() -> None:
    found = protocol_hash(header.HEADER)
    assert found == frames.PROTOCOL_HASH, (
        f"declarations changed: put {found.hex()} where {frames.PROTOCOL_HASH.hex()} is"
    )


DECLARED = [
    m[0].strip()
    for m in re.finditer(r"^( {4}\w+ \w+.*?;|#define HAPTICD_\w+ \S+)", header.HEADER, re.MULTILINE)
]


@pytest.mark.parametrize("line", [line for line in DECLARED if "PROTOCOL_HASH" not in line])
def test_changed_declaration_changes_hash(line: str) -> None:
    other = (
        line.replace("_t ", "_t x", 1)
        if line.endswith(";") and "_t " in line
        else line[:-1] + "1" + line[-1]
    )
    assert other != line
    assert protocol_hash(header.HEADER.replace(line, other, 1)) != frames.PROTOCOL_HASH


def test_swapped_fields_change_hash() -> None:
    swapped = header.HEADER.replace("int16_t current;", "@").replace(
        "int16_t voltage;", "int16_t current;"
    )
    assert protocol_hash(swapped.replace("@", "int16_t voltage;")) != frames.PROTOCOL_HASH


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("/* torque command DAC */", "/* another word */"),
        lambda text: re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL),
        lambda text: text.replace(
            "uint16_t seq; ", "uint16_t seq; // a comment of the other form\n"
        ),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("    ", "\t\v\f"),
        lambda text: re.sub(r"0x[0-9a-f]{16}ULL", "0xffffffffffffffffULL /* stale */", text),
        lambda text: re.sub(r"#define HAPTICD_PROTOCOL_HASH.*\n", "", text),
    ],
    ids=["word", "none", "slashes", "crlf", "tabs", "hash value", "hash line"],
)
def test_changed_comment_keeps_hash(change: Any) -> None:
    changed = change(header.HEADER)
    assert changed != header.HEADER
    assert protocol_hash(changed) == frames.PROTOCOL_HASH


def test_hash_of_known_text() -> None:
    text = "/* no */ #define A 1 // no\n  #define HAPTICD_PROTOCOL_HASH 0x1ULL\nint x;\n"
    assert (
        protocol_hash(text).hex() == "343f9659a58aa6c0"
    )  # first 8 bytes of sha256sum of `#defineA1intx;`
