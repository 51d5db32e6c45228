# ruff: noqa: F401  tests that are collected here once more
"""The board's half of docs/safety.md, kept by the image in the emulator of its chip: tests that the
simulated board has to pass, once more with the image in its place.

Left out is what needs what this board cannot: pairs of the probe, current, back-EMF velocity,
faults without a pin. What is left out of the promises is asked by a check of `pico_checks`.
"""

import re
from collections.abc import Iterator
from typing import Any, ClassVar

import pytest
import test_sim_axis
import test_sim_board
from support.pico_board import PicoBoard, told_nothing_of_pairs
from support.pico_checks import CHECKS
from support.tree import ROOT
from test_sim_axis import (
    test_a_silent_host_trips_a_board_that_is_still_read,
    test_bad_frames_do_not_feed_the_watchdog,
)
from test_sim_board import (
    test_emergency_stop_acts_when_it_is_pressed_not_with_the_next_frame,
    test_sequence_gap_is_flagged_once,
    test_sequence_wraps_without_a_gap,
    test_torque_is_clamped_at_the_boards_own_limit,
    test_unknown_control_request_stalls,
)

from hapticd.core.units import NS_PER_US

SAFETY = (ROOT / "docs" / "safety.md").read_text()
# rows of what the board promises, alone or with another
ROW = r"^\| [^|]+ \| [^|]*\bboard \| [^|]+ \| `\w+\.py::(\w+)` \|$"
PROMISED = re.findall(ROW, SAFETY, re.MULTILINE)
# those that a check asks, since the test of the simulated board looks at its current or shakes it
BY_CHECK = {
    "test_authority_that_stays_away_is_a_fault_and_no_force_comes_back": "stop",
    "test_damping_stays_to_the_last_frame_and_the_board_holds_and_releases_it": "silence",
}
PATIENCE_NS = 160 * NS_PER_US  # an IN that is read as soon as it is latched


class Promising(PicoBoard):
    """The image, read as soon as a frame is due."""

    patience_ns = PATIENCE_NS
    made: ClassVar[list[PicoBoard]] = []

    def __init__(self, *words: Any) -> None:
        super().__init__(*words)
        self.made.append(self)

    def poll_in(self, t_ns: int) -> bytes | None:
        packet = super().poll_in(t_ns)
        return None if packet is None else told_nothing_of_pairs(packet)


@pytest.fixture(autouse=True)
def image(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every board is run by the image, and its chip has nothing to complain of."""
    for module in (test_sim_board, test_sim_axis):
        monkeypatch.setattr(module, "BoardModel", Promising)
    yield
    boards = [Promising.made.pop() for _ in list(Promising.made)]
    complaints = [board.chip.complaints() for board in boards]
    for board in boards:
        board.chip.close()
    assert complaints == [[] for _ in boards]


def test_every_promise_of_the_board_is_asked_of_the_image() -> None:
    assert len(PROMISED) >= 3
    asked = {name for name in PROMISED if name in globals() or BY_CHECK.get(name) in CHECKS}
    assert asked == set(PROMISED)
