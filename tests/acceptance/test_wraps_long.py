"""Every counter begins just below its wrap and is flown over it: nothing else may change.

A flight with commands, ramps, damping, a perturbation and lost frames is flown from 0 and from just
below a wrap; all columns but those that count are the same, and those that count differ by what
they began with. The probe's index, which the servo hands on as it is, has its wrap in
`test_gateway_telemetry`, the 16 bits of encoder and index offset in `test_wire_session`.
"""

from typing import Any

import numpy as np
from test_wraps import BEFORE, WORD, Records, flown, same, with_revisions, with_ticks

from hapticd.run.lockstep import LockStep
from hapticd.usb import codec


def pairs(records: Records) -> list[Any]:
    """What the probe measured in each tick."""
    return [codec.decode_in(bytes(one)).pairs for one in records["in_frame"]]


def test_flight_is_the_same_over_the_wrap_of_the_boards_clock() -> None:
    start_us = WORD - 1000 * BEFORE
    here = flown()
    there = flown(board_time_us=start_us)
    same(here, there, "board_us")
    assert np.ptp(there["board_us"] - here["board_us"]) == 0
    assert there["board_us"][0] < WORD < there["board_us"][-1]
    assert pairs(here) == pairs(there)


def with_sequences(stack: LockStep) -> None:
    """Both directions count 65,536 - BEFORE when the flight begins."""
    ports = stack.backend._port  # type: ignore[attr-defined]
    board = getattr(ports, "board", ports)
    board._in_seq = 0x10000 - BEFORE
    send = stack.device.send
    cells = dict(zip(send.__code__.co_freevars, send.__closure__, strict=True))
    cells["sent"].cell_contents = 0x10000 - BEFORE
    board._next_seq = 0x10000 - BEFORE + 1
    stack.run(3)  # a jump of the numbers is told as a gap, once


def test_flight_is_the_same_over_the_wrap_of_both_sequences() -> None:
    here = flown(lambda stack: stack.run(3) and None)
    there = flown(with_sequences)
    same(here, there)
    echoes = [codec.decode_in(bytes(one)).echo for one in there["in_frame"]]
    assert min(echoes) < 10
    assert max(echoes) > 0xFFF0
    assert pairs(here) == pairs(there)


def test_flight_is_the_same_over_the_wrap_of_revisions() -> None:
    here = flown()
    there = flown(with_revisions)
    same(here, there, "revision", "environment_revision")
    for name in ("revision", "environment_revision"):
        behind = there[name].astype(np.int64)
        assert behind.max() == WORD - 1
        assert behind[-1] < 20


def test_flight_is_the_same_where_ticks_need_33_bits() -> None:
    here = flown()
    there = flown(with_ticks)
    same(here, there, "tick", "slot", "tail")
    for name in ("tick", "slot", "tail"):
        assert set(there[name] - here[name]) == {WORD - BEFORE}
    assert there["tick"][0] < WORD < there["tick"][-1]
