"""The reference firmware (firmware_iface/reference): what it takes and refuses, and that it does
frame by frame what the simulated board does, whatever a host does to both.
"""

import json
import random
import subprocess
from typing import Any

import pytest
import wire_header
from boards import TICK_NS, board_params
from firmware_board import REFERENCE, SOURCES, WARNINGS, FirmwareBoard
from hostile import Tally, compare_boards
from hypothesis import given, settings
from hypothesis import strategies as st
from programs import compiler

from hapticd.sim.board import hello
from hapticd.wire import codec, session
from hapticd.wire.frames import Request, StatusBit

VECTORS = [
    json.loads(line) for line in (wire_header.FOLDER / "vectors.jsonl").read_text().splitlines()
]
OUT_VECTORS = [vector for vector in VECTORS if vector["kind"] == "out"]
VENDOR_IN = 0xC0
CASE_BYTES = 4000  # about 210 frames
CASES = 60


@pytest.mark.parametrize("name", SOURCES)
def test_source_is_strict_c99_without_a_library(name: str) -> None:
    """No warning, and no header but those that a compiler has without libc, and string.h."""
    command = [*compiler(), *WARNINGS, "-ffreestanding", "-fsyntax-only"]
    includes = [f"-I{REFERENCE}", f"-I{wire_header.FOLDER}"]
    done = subprocess.run(
        [*command, *includes, str(REFERENCE / name)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    texts = [path.read_text() for path in REFERENCE.glob("*.[ch]")]
    included = {
        line.split("<")[1].rstrip(">")
        for text in texts
        for line in text.splitlines()
        if line.startswith("#include <")
    }
    assert included == {"stdbool.h", "stddef.h", "stdint.h", "string.h"}


@pytest.mark.parametrize("vector", OUT_VECTORS, ids=[vector["name"] for vector in OUT_VECTORS])
def test_firmware_takes_or_refuses_vector(vector: dict[str, Any]) -> None:
    board = FirmwareBoard(board_params())
    board.on_out(memoryview(bytes.fromhex(vector["hex"])), 0)
    reply = board.poll_in(TICK_NS)
    assert (reply is None) == ("error" in vector)
    if reply is not None:
        frame = codec.decode_in(reply)
        assert (frame.echo, frame.status & StatusBit.BAD_FRAME) == (vector["fields"]["seq"], 0)


def test_firmware_is_greeted() -> None:
    params = board_params()
    reply = FirmwareBoard(params).control(VENDOR_IN, Request.HELLO, 0, 80)
    assert reply is not None
    assert session.greet(reply) == codec.decode_hello(codec.encode_hello(hello(params)))


def test_firmware_does_what_the_simulated_board_does() -> None:
    tally = Tally()
    for seed in range(CASES):
        compare_boards(random.Random(seed).randbytes(CASE_BYTES), FirmwareBoard, tally)
    assert tally.frames > 10_000
    assert tally.refused > 1_000
    # the simulated encoder has no index mark
    assert set(StatusBit(tally.statuses)) == set(StatusBit) - {StatusBit.INDEX}


@settings(max_examples=40, derandomize=True, deadline=None, database=None)
@given(st.binary(min_size=1000, max_size=2000))
def test_no_host_tells_the_firmware_from_the_simulated_board(data: bytes) -> None:
    compare_boards(data, FirmwareBoard, Tally())
