"""The fail-safe of the fake firmware, in sub-steps of 62.5 us (16 to a tick of 1 ms)."""

from itertools import pairwise

import pytest
from boards import ENABLE, PERTURB, TICK_NS, board_params, exchange

from hapticd.sim.axis import Axis
from hapticd.sim.board import BoardModel
from hapticd.wire.frames import FIFO_DEPTH, Status

WATCHDOG_SUBSTEPS = 250 * 16
HOLD_SUBSTEPS = 2000 * 16
RELEASE_SUBSTEPS = 500 * 16


def enabled_axis(torque=1000, damping=65535, samples=()):
    axis = Axis(board_params())
    axis.obey(ENABLE | PERTURB, torque, damping, samples)
    return axis


def test_force_is_held_until_the_watchdog():
    axis = enabled_axis()
    axis.run_to(WATCHDOG_SUBSTEPS - 1)
    assert axis.force_n == 1000 * 8.0 / 32767
    assert not axis.status & Status.WATCHDOG
    axis.run_to(WATCHDOG_SUBSTEPS)
    assert (axis.force_n, axis.live) == (0.0, False)
    assert axis.status == Status.WATCHDOG


def test_watchdog_flushes_the_fifo():
    axis = enabled_axis(samples=(7,) * FIFO_DEPTH)
    axis.probe.fifo.extend([7] * 2000)
    axis.run_to(WATCHDOG_SUBSTEPS)
    assert not axis.probe.fifo
    assert (axis.probe.torque_n, axis.probe.playing) == (0.0, False)


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        (0, 10.0),
        (HOLD_SUBSTEPS - 1, 10.0),
        (HOLD_SUBSTEPS + RELEASE_SUBSTEPS // 4, 7.5),
        (HOLD_SUBSTEPS + RELEASE_SUBSTEPS // 2, 5.0),
        (HOLD_SUBSTEPS + RELEASE_SUBSTEPS, 0.0),
        (HOLD_SUBSTEPS + 2 * RELEASE_SUBSTEPS, 0.0),
    ],
)
def test_damping_is_held_then_released_linearly(after, expected):
    axis = enabled_axis()
    axis.run_to(WATCHDOG_SUBSTEPS + after)
    assert axis.damping_n == pytest.approx(expected, abs=1e-3)


def test_release_never_rises():
    axis = enabled_axis()
    levels = []
    for substep in range(
        WATCHDOG_SUBSTEPS + HOLD_SUBSTEPS,
        WATCHDOG_SUBSTEPS + HOLD_SUBSTEPS + RELEASE_SUBSTEPS + 8,
        4,
    ):
        axis.run_to(substep)
        levels.append(axis.damping_n)
    assert levels == sorted(levels, reverse=True)
    assert max(a - b for a, b in pairwise(levels)) <= 10.0 / 2000 + 2e-4


def test_watchdog_stays_until_an_out_without_enable():
    axis = enabled_axis()
    axis.run_to(WATCHDOG_SUBSTEPS)
    axis.obey(ENABLE, 2000, 0, ())
    assert (axis.status, axis.force_n, axis.damping_n) == (
        Status.WATCHDOG,
        0.0,
        pytest.approx(10.0),
    )
    axis.obey(0, 2000, 0, ())
    assert (axis.status, axis.force_n, axis.damping_n) == (0, 0.0, 0.0)
    axis.obey(ENABLE, 2000, 0, ())
    assert axis.status == Status.ENABLED
    assert axis.force_n == 2000 * 8.0 / 32767


def test_watchdog_runs_again_after_recovery():
    axis = enabled_axis()
    axis.run_to(WATCHDOG_SUBSTEPS)
    axis.obey(0, 0, 0, ())
    axis.obey(ENABLE, 500, 0, ())
    axis.run_to(2 * WATCHDOG_SUBSTEPS - 1)
    assert axis.status == Status.ENABLED
    axis.run_to(2 * WATCHDOG_SUBSTEPS)
    assert axis.status == Status.WATCHDOG


def test_bad_frames_do_not_feed_the_watchdog():
    board = BoardModel(board_params(watchdog_ms=10.0))
    exchange(board, 0, flags=ENABLE, torque=1000)
    for tick in range(1, 12):
        board.on_out(memoryview(b"nonsense"), tick * TICK_NS)
    frame = exchange(board, 12, flags=ENABLE)
    assert frame.status == Status.SIMULATED | Status.WATCHDOG | Status.BAD_FRAME | Status.SEQ_GAP


def test_a_silent_host_trips_a_board_that_is_still_read():
    board = BoardModel(board_params())
    exchange(board, 0, flags=ENABLE, torque=1000)
    for tick in range(1, 252):
        board.poll_in(tick * TICK_NS)
    assert exchange(board, 252, flags=ENABLE).status & Status.WATCHDOG
    assert board.sim_slip_ns == 0


def test_disable_silences_a_playing_perturbation():
    axis = enabled_axis(samples=(100,) * 8)
    axis.run_to(6)  # in the middle of the second interval, which plays the first sample
    assert axis.probe.torque_n > 0.0
    axis.obey(PERTURB, 0, 0, ())
    assert axis.probe.torque_n == 0.0
    axis.run_to(8)
    assert axis.probe.pairs[0::2] == [0, 50]
