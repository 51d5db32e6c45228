"""The reference firmware (firmware_iface/reference): what it takes and refuses, and that it does
frame by frame what the simulated board does, whatever a host does to both.
"""

import random
from pathlib import Path

from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from support.firmware_board import FirmwareBoard
from support.firmware_build import COVERED, SANITIZED, fuzz, reached
from support.firmware_reference import CASE_BYTES
from support.hostile import Tally, compare_boards

from hapticd.settings.build import board_params as simulated
from hapticd.settings.load import load
from hapticd.sim.board import compensates
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


def test_firmware_sets_the_trim_of_a_winding_as_the_simulated_board_does(tmp_path: Path) -> None:
    (tmp_path / "hapticd.toml").write_text('device = "warming"\n')
    params = simulated(load(tmp_path / "hapticd.toml"))
    assert params is not None
    assert compensates(params)
    compare_boards(random.Random(1).randbytes(4 * CASE_BYTES), FirmwareBoard, Tally(), params)


FUZZ_STEPS = 100_000


# a machine that is not little-endian, and a compiler that computes another CRC
NEVER_TAKEN = {"hapticd_board.c": 2, "hapticd_event.c": 0, "hapticd_probe.c": 0}


def test_fuzzed_firmware_keeps_its_promises(tmp_path: Path) -> None:
    """Whatever hardware, host and clock do, beyond what the simulated board can: no broken promise,
    no access out of bounds, no undefined behaviour.
    """
    fuzz(tmp_path, FUZZ_STEPS, SANITIZED)


def test_fuzzer_reaches_every_line_of_the_firmware(tmp_path: Path) -> None:
    fuzz(tmp_path, FUZZ_STEPS, COVERED)
    for source, found in reached(tmp_path).items():
        assert (found.lines_percent, found.missed) == (100.0, NEVER_TAKEN[source])
