"""The boards that tests simulate: the default simulated device, with the changes of a test."""

from dataclasses import replace
from math import inf
from typing import Any

from hapticd.model.params import BoardParams
from hapticd.usb import codec
from hapticd.usb.frames import InFrame, OutFlag, OutFrame

BOARD = BoardParams(
    serial="SIM0001",
    rate_hz=1000.0,
    position_m_per_count=0.5e-6,
    force_n_per_count=8.0 / 32767,
    active_damping_ns_per_m_per_count=10.0 / 65535,
    probe_torque_n_per_count=2.0 / 32767,
    probe_velocity_m_per_s_per_count=2.0 / 32767,
    current_a_per_count=10.0 / 32767,
    voltage_v_per_count=30.0 / 32767,
    force_limit_n=8.0,
    mass_kg=0.008,
    viscous_ns_per_m=0.36,
    lower_stop_m=-inf,
    upper_stop_m=inf,
    torque_constant_n_per_a=1.65,
    winding_ohm=1.6,
    ambient_c=22.0,
)
TICK_NS = 1_000_000
LATCH_NS = 875_000
ENABLE = int(OutFlag.ENABLE)
PERTURB = int(OutFlag.PERTURB)


def board_params(**changes: Any) -> BoardParams:
    """The default board with `changes`."""
    return replace(BOARD, **changes)


def out_packet(seq: int, **fields: Any) -> memoryview:
    """An OUT frame as the board receives it."""
    return memoryview(codec.encode_out(OutFrame(seq, **fields)))


def exchange(board: Any, tick: int, **fields: Any) -> InFrame:
    """One tick of a good host: OUT at the tick, its IN as soon as it is latched."""
    board.on_out(out_packet(tick & 0xFFFF, **fields), tick * TICK_NS)
    packet = board.poll_in(tick * TICK_NS + LATCH_NS)
    assert packet is not None
    return codec.decode_in(packet)
