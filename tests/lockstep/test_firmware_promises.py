# ruff: noqa: F401  tests that are collected here a second time
"""The board's half of docs/safety.md, kept by the reference firmware: the very tests that the
simulated board has to pass, once more with the compiled firmware in its place.

Left out is what is about the simulation: boards that cannot be, IN frames that are postponed, a
force that acts whole periods later.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import test_force_path
import test_servo_end
import test_sim_axis
import test_sim_board
from support.firmware_board import FirmwareBoard
from support.firmware_trial import fig7_trial
from support.tree import ROOT
from test_force_path import (
    test_a_restarted_board_is_another_life,
    test_an_emergency_stop_that_no_frame_tells_of_brings_no_force_back_at_once,
    test_authority_that_comes_back_brings_the_force_back_along_the_gain_ramp,
    test_authority_that_stays_away_is_a_fault_and_no_force_comes_back,
    test_enable_is_refused_while_the_board_would_not_grant_torque,
)
from test_servo_end import (
    test_damping_stays_to_the_last_frame_and_the_board_holds_and_releases_it,
    test_force_fades_without_a_step_when_the_process_ends,
)
from test_sim_axis import (
    test_a_silent_host_trips_a_board_that_is_still_read,
    test_bad_frames_do_not_feed_the_watchdog,
    test_dry_fifo_outputs_nothing_and_says_so,
    test_fifo_clear_drops_before_taking,
    test_full_fifo_drops_the_rest,
    test_index_counts_intervals_since_power_up,
    test_mean_velocity_is_distance_over_the_interval,
    test_no_torque_without_enable_though_the_fifo_runs,
    test_samples_play_in_order_one_per_interval,
    test_samples_wait_without_the_play_flag,
    test_sum_of_pairs_is_the_exact_work,
    test_unread_pairs_are_kept_then_lost_from_the_front,
)
from test_sim_board import (
    test_bad_frame_changes_nothing,
    test_board_fault_latches_until_cleared_without_cause,
    test_board_fault_takes_the_torque_away,
    test_each_out_latches_one_in,
    test_emergency_stop_acts_when_it_is_pressed_not_with_the_next_frame,
    test_encoder_wraps_at_32_bits,
    test_every_power_up_is_another_life,
    test_force_acts_on_receipt_and_encoder_is_latched_at_sample_phase,
    test_hello_describes_the_board,
    test_host_sets_the_phase_at_which_frames_are_latched,
    test_no_enable_means_no_torque_but_damping,
    test_nothing_is_latched_before_the_first_out,
    test_power_up_starts_afresh,
    test_sequence_gap_is_flagged_once,
    test_sequence_wraps_without_a_gap,
    test_torque_is_clamped_at_the_boards_own_limit,
    test_two_outs_within_a_tick_latch_two_ins,
    test_unknown_control_request_stalls,
    test_unread_in_is_replaced_and_loses_nothing,
    test_whole_good_frame_is_the_counterexample,
)

from hapticd.sim.board import BoardModel

SAFETY = (ROOT / "docs" / "safety.md").read_text()
# rows of what the board promises, alone or with another
ROW = r"^\| [^|]+ \| [^|]*\bboard \| [^|]+ \| `\w+\.py::(\w+)` \|$"
PROMISED = re.findall(ROW, SAFETY, re.MULTILINE)
SECONDS = 8.0


@pytest.fixture(autouse=True)
def firmware(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every board is run by the compiled firmware."""
    monkeypatch.setattr("hapticd.sim.backend.make_board", FirmwareBoard)
    for module in (test_sim_board, test_sim_axis):
        monkeypatch.setattr(module, "BoardModel", FirmwareBoard)


def test_every_promise_of_the_board_is_asked_of_the_firmware() -> None:
    assert len(PROMISED) >= 3
    assert [test for test in PROMISED if test not in globals()] == []


def test_a_trial_with_the_firmware_is_the_trial_with_the_simulated_board(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = fig7_trial(FirmwareBoard, SECONDS)
    monkeypatch.undo()
    other = fig7_trial(BoardModel, SECONDS)
    assert one.verdict == other.verdict
    assert one.recorded.seconds == SECONDS
    assert np.array_equal(one.recorded.force_n, other.recorded.force_n)
    assert np.array_equal(one.recorded.velocity_m_per_s, other.recorded.velocity_m_per_s)
