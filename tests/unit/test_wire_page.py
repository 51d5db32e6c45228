"""PROTOCOL.md against the header and the golden frames: every offset, type, bit, byte and value
that it states.
"""

import json
import re
import struct
from math import prod

import pytest
from support import wire_header as header
from support.tree import ROOT

from hapticd.usb import codec

PAGE = (header.FOLDER / "PROTOCOL.md").read_text()
LINES = map(json.loads, (header.FOLDER / "vectors.jsonl").read_text().splitlines())
EXAMPLE = {
    line["kind"]: bytes.fromhex(line["hex"])
    for line in LINES
    if line["name"] == "decoded_in_protocol_md"
}
TITLES = {"out": "One OUT frame, byte by byte", "in": "One IN frame, byte by byte"}


def section(title: str) -> str:
    return PAGE.partition(f"## {title}")[2].partition("\n## ")[0]


def rows(title: str) -> list[list[str]]:
    """Cells of every table row of a section, heads and rules left out."""
    lines = [line for line in section(title).splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [
        row
        for row in cells
        if row[0] not in ("offset", "flag", "status", "capability", "field", "what")
    ]


def member_bytes(kind: str) -> dict[str, tuple[int, str]]:
    """Offset and struct code of every element of a frame, arrays of numbers taken apart."""
    found = {}
    offset = 0
    for member in header.STRUCTS[f"hapticd_{kind}"]:
        code = header.CODES[member.type]
        whole = not member.shape or member.type == "uint8_t"
        for index in range(1 if whole else prod(member.shape)):
            places = (
                (index,)
                if len(member.shape) == 1
                else divmod(index, member.shape[-1] if member.shape else 1)
            )
            name = member.name if whole else member.name + "".join(f"[{place}]" for place in places)
            size = f"{prod(member.shape)}s" if whole and member.shape else code
            found[name] = offset, size
            offset += struct.calcsize("<" + size)
    return found


def scale_of(name: str) -> float | None:
    scales = {row[0]: float(row[3].split()[0]) for row in rows("An example device")}
    if name.startswith("pair"):
        return scales["pair velocity" if name.endswith("[1]") else "pair torque"]
    return scales.get(name.partition("[")[0])


@pytest.mark.parametrize("kind", TITLES)
def test_page_shows_bytes_of_vector(kind: str) -> None:
    shown = section(TITLES[kind]).split("```")[1]
    assert bytes.fromhex(shown) == EXAMPLE[kind]


@pytest.mark.parametrize("kind", TITLES)
def test_page_decodes_every_byte(kind: str) -> None:
    places = member_bytes(kind)
    table = rows(TITLES[kind])
    assert [row[2] for row in table] == list(places)
    for offset, shown, name, count, value in table:
        start, code = places[name]
        size = struct.calcsize("<" + code)
        assert (int(offset), bytes.fromhex(shown.strip("`"))) == (
            start,
            EXAMPLE[kind][start : start + size],
        ), name
        raw = struct.unpack_from("<" + code, EXAMPLE[kind], start)[0]
        assert int(count, 0) == (raw if isinstance(raw, int) else int.from_bytes(raw, "little")), (
            name
        )
        scale = scale_of(name)
        if scale is not None and not value.startswith("- "):
            assert float(value.split()[0]) == pytest.approx(raw * scale, rel=5e-6), name


def test_page_scales_are_full_scale_over_counts() -> None:
    for name, full_scale, counts, per_count in rows("An example device"):
        if counts != "-":
            assert float(per_count.split()[0]) == pytest.approx(
                float(full_scale.split()[0]) / int(counts), rel=1e-6
            ), name


def test_page_work_is_sum_over_pairs() -> None:
    torque, velocity = (scale_of(f"pair[0][{place}]") for place in (0, 1))
    work_j = sum(
        t * torque * v * velocity * 250e-6 for t, v in codec.decode_in(EXAMPLE["in"]).pairs
    )
    shown = re.search(r"sum\(F v T\) = (\S+) J", PAGE)
    assert shown is not None
    assert float(shown[1]) == pytest.approx(work_j, rel=1e-5)


@pytest.mark.parametrize(
    ("kind", "title"),
    [
        ("out", "OUT: host to board"),
        ("in", "IN: board to host"),
        ("hello", "HELLO: the properties of the board"),
    ],
)
def test_page_explains_every_member(kind: str, title: str) -> None:
    described = [row[:3] for row in rows(title) if row[0].isdigit()]
    offset = 0
    declared = []
    for member in header.STRUCTS[f"hapticd_{kind}"]:
        declared.append(
            [str(offset), member.name, member.type + "".join(f"[{size}]" for size in member.shape)]
        )
        offset += prod(member.shape) * struct.calcsize(
            "<" + header.CODES[member.type].replace("s", "B")
        )
    assert described == declared


@pytest.mark.parametrize(
    "name",
    [n for n in header.CONSTANTS if re.match("HAPTICD_(REQUEST|FLAG|STATUS|CAPABILITY)_", n)],
)
def test_page_explains_every_bit(name: str) -> None:
    assert re.search(rf"^\|[^|]*{name}\b[^|]*(\| )?{header.CONSTANTS[name]}\b", PAGE, re.MULTILINE)


def test_page_shows_the_tested_crc() -> None:
    snippet = section("CRC").split("```c\n")[1].split("```")[0]
    assert snippet in (ROOT / "tests/support/wire_check.c").read_text()
