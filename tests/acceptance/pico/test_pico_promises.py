# ruff: noqa: F401  tests that are collected here once more
"""The board's half of docs/safety.md, kept by the image in the emulator of its chip: tests that the
simulated board has to pass, once more with the image in its place.

Each test that the compiled firmware has to pass on the PC (test_firmware_promises.py) is run here,
or stands in LEFT_OUT with what it needs and this board has not. Where a check of `pico_checks` asks
the same of the image, it is named.
"""

import re
from collections.abc import Iterator
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import pytest
import test_firmware_promises
import test_force_path
import test_servo_end
import test_sim_axis
import test_sim_board
from support.pico_board import PicoBoard, told_nothing_of_pairs
from support.pico_checks import CHECKS
from support.tree import ROOT
from test_force_path import (
    test_an_emergency_stop_that_no_frame_tells_of_brings_no_force_back_at_once,
    test_enable_is_refused_while_the_board_would_not_grant_torque,
)
from test_sim_axis import (
    test_a_silent_host_trips_a_board_that_is_still_read,
    test_bad_frames_do_not_feed_the_watchdog,
    test_fifo_clear_drops_before_taking,
    test_full_fifo_drops_the_rest,
)
from test_sim_board import (
    test_each_out_latches_one_in,
    test_emergency_stop_acts_when_it_is_pressed_not_with_the_next_frame,
    test_nothing_is_latched_before_the_first_out,
    test_sequence_gap_is_flagged_once,
    test_sequence_wraps_without_a_gap,
    test_torque_is_clamped_at_the_boards_own_limit,
    test_unknown_control_request_stalls,
)

from hapticd.core.units import NS_PER_US
from hapticd.sim.board import VENDOR_OUT
from hapticd.usb import codec
from hapticd.usb.frames import Request

SAFETY = (ROOT / "docs" / "safety.md").read_text()
# rows of what the board promises, alone or with another
ROW = r"^\| [^|]+ \| [^|]*\bboard \| [^|]+ \| `\w+\.py::(\w+)` \|$"
PROMISED = re.findall(ROW, SAFETY, re.MULTILINE)
PATIENCE_NS = 160 * NS_PER_US  # an IN that is read as soon as it is latched
PHASE_US = 700  # of a board in lock-step: an IN is in the host when the next tick begins
EARLY_NS = 110 * NS_PER_US  # by which its host asks for an IN before that


class Need(Enum):
    """What a test asks for and this board has not."""

    PROBE = "pairs of torque and velocity, or a perturbation that pushes"
    MEASURED = "current, voltage, back-EMF velocity"
    FAULT = "a fault with a cause of its own that lasts: no pin reports one"
    CLOCK = "times to the microsecond from the first OUT: on the chip an OUT takes 31 us"
    START = "firmware that starts anew without leaving the bus, or with a chosen life"
    EDGES = "2^31 edges of the encoder within a millisecond"
    HELLO = "the statements of the simulated board"
    MODEL = "a counter of refused frames, which no frame carries"


class Left(NamedTuple):
    """Why a test is left out, and the check that asks the same of the image, if there is one."""

    need: Need
    check: str = ""


LEFT_OUT = {
    # test_force_path
    "test_a_restarted_board_is_another_life": Left(Need.START, "hang"),
    "test_authority_that_comes_back_brings_the_force_back_along_the_gain_ramp": Left(Need.MEASURED),
    "test_authority_that_stays_away_is_a_fault_and_no_force_comes_back": Left(
        Need.MEASURED, "stop"
    ),
    # test_servo_end
    "test_damping_stays_to_the_last_frame_and_the_board_holds_and_releases_it": Left(
        Need.PROBE, "silence"
    ),
    "test_force_fades_without_a_step_when_the_process_ends": Left(Need.PROBE),
    # test_sim_axis
    "test_dry_fifo_outputs_nothing_and_says_so": Left(Need.PROBE),
    "test_index_counts_intervals_since_power_up": Left(Need.PROBE),
    "test_mean_velocity_is_distance_over_the_interval": Left(Need.PROBE),
    "test_no_torque_without_enable_though_the_fifo_runs": Left(Need.PROBE),
    "test_samples_play_in_order_one_per_interval": Left(Need.PROBE),
    "test_samples_wait_without_the_play_flag": Left(Need.PROBE),
    "test_sum_of_pairs_is_the_exact_work": Left(Need.PROBE),
    "test_unread_pairs_are_kept_then_lost_from_the_front": Left(Need.PROBE),
    # test_sim_board
    "test_bad_frame_changes_nothing": Left(Need.MODEL, "burst"),
    "test_whole_good_frame_is_the_counterexample": Left(Need.MODEL, "exchange"),
    "test_board_fault_latches_until_cleared_without_cause": Left(Need.FAULT, "skip"),
    "test_board_fault_takes_the_torque_away": Left(Need.FAULT, "skip"),
    "test_encoder_wraps_at_32_bits": Left(Need.EDGES),
    "test_every_power_up_is_another_life": Left(Need.START, "hang"),
    "test_force_acts_on_receipt_and_encoder_is_latched_at_sample_phase": Left(
        Need.MEASURED, "encoder"
    ),
    "test_hello_describes_the_board": Left(Need.HELLO, "descriptors"),
    "test_host_sets_the_phase_at_which_frames_are_latched": Left(Need.CLOCK),
    "test_no_enable_means_no_torque_but_damping": Left(Need.MEASURED),
    "test_power_up_starts_afresh": Left(Need.PROBE),
    "test_two_outs_within_a_tick_latch_two_ins": Left(Need.CLOCK),
    "test_unread_in_is_replaced_and_loses_nothing": Left(Need.PROBE, "replaced"),
}
SHARED = (test_force_path, test_servo_end, test_sim_axis, test_sim_board)


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


class LockStepped(Promising):
    """The same for a servo in lock-step, whose device file names another board."""

    read_ns = -EARLY_NS

    def power_up(self) -> None:
        super().power_up()
        assert super().control(VENDOR_OUT, Request.SAMPLE_PHASE, PHASE_US, 0) == b""

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        reply = super().control(request_type, request, value, length)
        if request != Request.HELLO or reply is None:
            return reply
        told = codec.decode_hello(reply)
        return bytes(codec.encode_hello(told._replace(serial=self.params.serial)))


@pytest.fixture(autouse=True)
def image(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every board is run by the image, and its chip has nothing to complain of."""
    for module in (test_sim_board, test_sim_axis):
        monkeypatch.setattr(module, "BoardModel", Promising)
    monkeypatch.setattr("hapticd.sim.backend.make_board", LockStepped)
    yield
    boards = [Promising.made.pop() for _ in list(Promising.made)]
    complaints = [board.chip.complaints() for board in boards]
    for board in boards:
        board.chip.close()
    assert complaints == [[] for _ in boards]


def shared() -> set[str]:
    """The tests of the simulated board that the compiled firmware has to pass."""
    homes = {module.__name__ for module in SHARED}
    names = vars(test_firmware_promises).items()
    return {
        name
        for name, one in names
        if name.startswith("test_") and getattr(one, "__module__", "") in homes
    }


def test_every_test_of_the_firmware_is_run_on_the_chip_or_left_out_for_a_need() -> None:
    run = {name for name in shared() if name in globals()}
    assert len(run) == 13
    assert not run & set(LEFT_OUT)
    assert run | set(LEFT_OUT) == shared()
    assert {left.check for left in LEFT_OUT.values()} <= {*CHECKS, ""}


def test_every_promise_of_the_board_is_asked_of_the_image() -> None:
    assert len(PROMISED) >= 3
    left = {name: LEFT_OUT[name].check for name in PROMISED if name not in globals()}
    assert [name for name, check in left.items() if not check] == []
