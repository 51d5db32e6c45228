"""The reference firmware (firmware_iface/reference): what it takes and refuses, and that it does
frame by frame what the simulated board does, whatever a host does to both.
"""

import random

from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from support.firmware_board import FirmwareBoard
from support.firmware_reference import CASE_BYTES
from support.hostile import Tally, compare_boards

from hapticd.usb.frames import StatusBit

CASES = 60


def test_firmware_does_what_the_simulated_board_does() -> None:
    tally = Tally()
    for seed in range(CASES):
        compare_boards(random.Random(seed).randbytes(CASE_BYTES), FirmwareBoard, tally)
    assert tally.frames > 10_000
    assert tally.refused > 1_000
    # the simulated encoder has no index mark
    assert set(StatusBit(tally.statuses)) == set(StatusBit) - {StatusBit.INDEX}


# not made smaller: that takes minutes, and the same bytes come again
@settings(max_examples=40, derandomize=True, deadline=None, database=None, phases=[Phase.generate])
@given(st.binary(min_size=1000, max_size=2000))
def test_no_host_tells_the_firmware_from_the_simulated_board(data: bytes) -> None:
    compare_boards(data, FirmwareBoard, Tally())
