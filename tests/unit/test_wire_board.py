"""The simulated board speaks the protocol of the golden frames: it takes what it must and
refuses what it must.
"""

import json
from typing import Any

import pytest
from support import wire_header as header

from hapticd.model.params import BoardParams
from hapticd.sim.board import BoardModel
from hapticd.usb import codec, frames
from hapticd.usb.frames import Request, StatusBit

VECTORS = [json.loads(line) for line in (header.FOLDER / "vectors.jsonl").read_text().splitlines()]
OUT_VECTORS = [vector for vector in VECTORS if vector["kind"] == "out"]
PERIOD_NS = 1_000_000
VENDOR_IN = 0xC0


def board() -> BoardModel:
    params = BoardParams(
        serial="HD-0001",
        rate_hz=1000.0,
        position_m_per_count=5e-7,
        force_n_per_count=8.0 / 32767,
        active_damping_ns_per_m_per_count=10.0 / 65535,
        probe_torque_n_per_count=2.0 / 32767,
        probe_velocity_m_per_s_per_count=0.5 / 32767,
        current_a_per_count=4.0 / 32767,
        voltage_v_per_count=24.0 / 32767,
        force_limit_n=8.0,
        mass_kg=0.008,
        viscous_ns_per_m=0.36,
        lower_stop_m=-0.02,
        upper_stop_m=0.02,
        torque_constant_n_per_a=2.0,
        winding_ohm=8.0,
        ambient_c=20.0,
    )
    return BoardModel(params)


@pytest.mark.parametrize("vector", OUT_VECTORS, ids=[vector["name"] for vector in OUT_VECTORS])
def test_board_takes_or_refuses_vector(vector: dict[str, Any]) -> None:
    model = board()
    model.on_out(memoryview(bytes.fromhex(vector["hex"])), 0)
    reply = model.poll_in(PERIOD_NS)
    assert (reply is None) == ("error" in vector)
    if reply is not None:
        frame = codec.decode_in(reply)
        assert (frame.echo, frame.status & StatusBit.BAD_FRAME) == (vector["fields"]["seq"], 0)


def test_board_says_bad_frame_once() -> None:
    model = board()
    statuses = []
    for tick, damaged in enumerate((False, True, False, False)):
        data = bytearray(codec.encode_out(frames.OutFrame(tick)))
        data[4] ^= damaged
        model.on_out(memoryview(data), tick * PERIOD_NS)
        reply = model.poll_in((tick + 1) * PERIOD_NS)
        statuses.append(
            None
            if reply is None
            else codec.decode_in(reply).status & (StatusBit.BAD_FRAME | StatusBit.SEQ_GAP)
        )
    assert statuses == [0, None, StatusBit.BAD_FRAME | StatusBit.SEQ_GAP, 0]


def test_board_is_greeted() -> None:
    reply = board().control(VENDOR_IN, Request.HELLO, 0, frames.HELLO_BYTES)
    assert reply is not None
    assert codec.greet(reply).serial == "HD-0001"
