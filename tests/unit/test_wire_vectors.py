"""Golden frames in Python and in C."""

import json
import struct
from array import array
from pathlib import Path
from typing import Any

import pytest
from support import wire_header as header
from support.tree import ROOT

from hapticd.core.errors import FrameError
from hapticd.usb import codec, frames

VECTORS = [json.loads(line) for line in (header.FOLDER / "vectors.jsonl").read_text().splitlines()]
GOOD = [v for v in VECTORS if "fields" in v]
BAD = [v for v in VECTORS if "error" in v]
DECODE = {"out": codec.decode_out, "in": codec.decode_in, "hello": codec.decode_hello}
ENCODE: dict[str, Any] = {
    "out": codec.encode_out,
    "in": codec.encode_in,
    "hello": codec.encode_hello,
}
KINDS: dict[str, Any] = {"out": frames.OutFrame, "in": frames.InFrame, "hello": frames.HelloFrame}


def names(vectors: list[dict[str, Any]]) -> list[str]:
    return [f"{vector['kind']}-{vector['name']}" for vector in vectors]


def plain(frame: Any) -> dict[str, Any]:
    """Fields as JSON has them."""
    return json.loads(json.dumps(frame._asdict(), default=bytes.hex))


def frame_of(vector: dict[str, Any]) -> Any:
    fields = dict(vector["fields"])
    if "protocol_hash" in fields:
        fields["protocol_hash"] = bytes.fromhex(fields["protocol_hash"])
    if "perturbation" in fields:
        fields["perturbation"] = tuple(fields["perturbation"])
    if "pairs" in fields:
        fields["pairs"] = tuple(map(tuple, fields["pairs"]))
    return KINDS[vector["kind"]](**fields)


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What the C program says about every vector."""
    source: Path = tmp_path_factory.mktemp("vectors") / "wire_check.c"
    source.write_text((ROOT / "tests/support/wire_check.c").read_text())
    text = "".join(f"{vector['kind']} {vector['hex']}\n" for vector in VECTORS)
    return [json.loads(line) for line in header.run(header.build(source), text).splitlines()]


@pytest.mark.parametrize("vector", GOOD, ids=names(GOOD))
def test_python_round_trips_vector(vector: dict[str, Any]) -> None:
    frame = DECODE[vector["kind"]](bytes.fromhex(vector["hex"]))
    assert frame == frame_of(vector)
    assert ENCODE[vector["kind"]](frame_of(vector)).hex() == vector["hex"]


@pytest.mark.parametrize("vector", BAD, ids=names(BAD))
def test_python_refuses_bad_vector(vector: dict[str, Any]) -> None:
    with pytest.raises(FrameError, match=rf"\b{vector['error']}\b"):
        DECODE[vector["kind"]](bytes.fromhex(vector["hex"]))


PACKETS = [
    vector
    for vector in VECTORS
    if vector["kind"] == "in" and len(vector["hex"]) == 2 * frames.IN_BYTES
]


@pytest.mark.parametrize("vector", PACKETS, ids=names(PACKETS))
def test_in_parser_takes_only_good_vectors(vector: dict[str, Any]) -> None:
    assert (codec.in_parser(array("B", bytes.fromhex(vector["hex"])))() is None) == (
        "error" in vector
    )


def test_c_agrees_on_every_vector(answers: list[dict[str, Any]]) -> None:
    expected = [
        {key: vector[key] for key in ("fields", "hex", "error") if key in vector}
        for vector in VECTORS
    ]
    for vector in expected:
        if "error" in vector:
            del vector["hex"]
    assert answers == expected


def test_vectors_cover_every_extreme() -> None:
    for kind in ("out", "in"):
        frames_of_kind = [frame_of(vector) for vector in GOOD if vector["kind"] == kind]
        for name in frames_of_kind[0]._fields:
            values = [getattr(frame, name) for frame in frames_of_kind]
            if name not in ("axis", "flags", "status"):
                assert extremes(kind, name) <= set(flat(values)), name


def flat(values: Any) -> Any:
    for value in values:
        yield from flat(value) if isinstance(value, tuple) else (value,)


def extremes(kind: str, name: str) -> set[int]:
    member = next(
        m for m in header.STRUCTS[f"hapticd_{kind}"] if m.name == name.replace("pairs", "pair")
    )
    code = header.CODES[member.type]
    bits = 8 * struct.calcsize("<" + code)
    return {0, (1 << bits) - 1} if code.isupper() else {-(1 << bits - 1), (1 << bits - 1) - 1}


def test_vectors_have_every_error() -> None:
    shared = {"length", "CRC", "count", "axis"}
    found = {kind: {vector["error"] for vector in BAD if vector["kind"] == kind} for kind in KINDS}
    assert found == {"out": shared, "in": shared, "hello": {"length", "serial", "finite"}}


def test_example_hello_has_our_hash() -> None:
    (vector,) = [vector for vector in GOOD if vector["name"] == "example_board"]
    assert vector["fields"]["protocol_hash"] == frames.PROTOCOL_HASH.hex()
