"""The reference firmware (firmware_iface/reference): what it takes and refuses, and that it does
frame by frame what the simulated board does, whatever a host does to both.
"""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from support import wire_header
from support.boards import TICK_NS, board_params, out_packet
from support.firmware_board import FirmwareBoard
from support.firmware_build import REFERENCE, WARNINGS, sources
from support.programs import compiler

from hapticd.sim.board import hello
from hapticd.usb import codec
from hapticd.usb.frames import OutFlag, Request, StatusBit

VECTORS = [
    json.loads(line) for line in (wire_header.FOLDER / "vectors.jsonl").read_text().splitlines()
]
OUT_VECTORS = [vector for vector in VECTORS if vector["kind"] == "out"]
VENDOR_IN = 0xC0


@pytest.mark.parametrize("source", sources(REFERENCE), ids=lambda one: one.name)
def test_source_is_strict_c99_without_a_library(source: Path) -> None:
    """No warning, and no header but those that a compiler has without libc, and string.h."""
    command = [*compiler(), *WARNINGS, "-ffreestanding", "-fsyntax-only"]
    includes = [f"-I{REFERENCE}", f"-I{wire_header.FOLDER}"]
    done = subprocess.run([*command, *includes, str(source)], capture_output=True, text=True)
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
    assert codec.greet(reply) == codec.decode_hello(codec.encode_hello(hello(params)))


@pytest.mark.parametrize(("sample", "mean"), [(45, 32), (-45, -31), (100, 70), (-32768, -22938)])
def test_mean_of_a_silenced_sample_is_rounded_up_at_the_half(sample: int, mean: int) -> None:
    """Output for seven tenths of the second interval: 31.5 counts of 45."""
    board = FirmwareBoard(board_params(rate_hz=2500.0))
    play = OutFlag.ENABLE | OutFlag.PERTURB
    board.on_out(out_packet(0, flags=int(play), perturbation=(sample,)), 0)
    board.poll_in(350_000)
    board.on_out(out_packet(1), 425_000)
    packet = board.poll_in(775_000)
    assert packet is not None
    assert codec.decode_in(packet).pairs[0][0] == mean
