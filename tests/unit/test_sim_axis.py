"""The fail-safe of the fake firmware, in sub-steps of 62.5 us (16 to a tick of 1 ms); its
perturbation FIFO and the interval-mean pairs of the 4 kHz clock.
"""

from itertools import pairwise

import pytest
from support.boards import ENABLE, PERTURB, TICK_NS, board_params, exchange, out_packet

from hapticd.model.step import held_force_response
from hapticd.sim.axis import PAIRS_MAX, Axis, i16_count
from hapticd.sim.board import BoardModel
from hapticd.usb import codec
from hapticd.usb.frames import FIFO_DEPTH, OutFlag, StatusBit

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
    assert not axis.status & StatusBit.WATCHDOG
    axis.run_to(WATCHDOG_SUBSTEPS)
    assert (axis.force_n, axis.live) == (0.0, False)
    assert axis.status == StatusBit.WATCHDOG


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
        StatusBit.WATCHDOG,
        0.0,
        pytest.approx(10.0),
    )
    axis.obey(0, 2000, 0, ())
    assert (axis.status, axis.force_n, axis.damping_n) == (0, 0.0, 0.0)
    axis.obey(ENABLE, 2000, 0, ())
    assert axis.status == StatusBit.ENABLED
    assert axis.force_n == 2000 * 8.0 / 32767


def test_watchdog_runs_again_after_recovery():
    axis = enabled_axis()
    axis.run_to(WATCHDOG_SUBSTEPS)
    axis.obey(0, 0, 0, ())
    axis.obey(ENABLE, 500, 0, ())
    axis.run_to(2 * WATCHDOG_SUBSTEPS - 1)
    assert axis.status == StatusBit.ENABLED
    axis.run_to(2 * WATCHDOG_SUBSTEPS)
    assert axis.status == StatusBit.WATCHDOG


def test_bad_frames_do_not_feed_the_watchdog():
    board = BoardModel(board_params(watchdog_ms=10.0))
    exchange(board, 0, flags=ENABLE, torque=1000)
    for tick in range(1, 12):
        board.on_out(memoryview(b"nonsense"), tick * TICK_NS)
    frame = exchange(board, 12, flags=ENABLE)
    assert (
        frame.status
        == StatusBit.SIMULATED
        | StatusBit.AMPLIFIER_READY
        | StatusBit.WATCHDOG
        | StatusBit.BAD_FRAME
        | StatusBit.SEQ_GAP
    )


def test_a_silent_host_trips_a_board_that_is_still_read():
    board = BoardModel(board_params())
    exchange(board, 0, flags=ENABLE, torque=1000)
    for tick in range(1, 252):
        board.poll_in(tick * TICK_NS)
    assert exchange(board, 252, flags=ENABLE).status & StatusBit.WATCHDOG
    assert board.sim_slip_ns == 0


def test_disable_silences_a_playing_perturbation():
    axis = enabled_axis(samples=(100,) * 8)
    axis.run_to(6)  # in the middle of the second interval, which plays the first sample
    assert axis.probe.torque_n > 0.0
    axis.obey(PERTURB, 0, 0, ())
    assert axis.probe.torque_n == 0.0
    axis.run_to(8)
    assert axis.probe.pairs[0::2] == [0, 50]


def test_half_a_count_of_a_silenced_sample_is_rounded_up():
    """45 for seven tenths of an interval are 31.5 counts, which 45 * 0.7 is not."""
    axis = Axis(board_params(rate_hz=2500.0))
    axis.obey(ENABLE | PERTURB, 0, 0, (45,))
    axis.run_to(17)
    axis.obey(PERTURB, 0, 0, ())
    axis.run_to(20)
    assert axis.probe.pairs[0::2] == [0, 32]


PLAY = ENABLE | PERTURB
UNDERRUN = StatusBit.FIFO_UNDERRUN
OVERFLOW = StatusBit.FIFO_OVERFLOW
LOST = StatusBit.PROBE_OVERFLOW


def played(frames):
    return [torque for frame in frames for torque, _ in frame.pairs]


def test_samples_play_in_order_one_per_interval():
    board = BoardModel(board_params())
    samples = list(range(1, 81))
    sent = iter(samples)
    frames = [exchange(board, 0, flags=PLAY, perturbation=tuple(next(sent) for _ in range(6)))]
    frames += [
        exchange(board, tick, flags=PLAY, perturbation=tuple(next(sent) for _ in range(4)))
        for tick in range(1, 18)
    ]
    assert played(frames) == [
        0,
        *samples[: 4 * 18 - 2],
    ]  # 3 + 4 x 17 intervals; interval 0 began before the first sample
    assert all(not frame.status & (UNDERRUN | OVERFLOW | LOST) for frame in frames)


def test_index_counts_intervals_since_power_up():
    board = BoardModel(board_params())
    frames = [exchange(board, tick) for tick in range(10)]
    assert [frame.probe_index for frame in frames] == [0, *range(3, 39, 4)]
    assert [len(frame.pairs) for frame in frames] == [3] + [4] * 9


def test_dry_fifo_outputs_nothing_and_says_so():
    board = BoardModel(board_params())
    first = exchange(board, 0, flags=PLAY, perturbation=(500, 500))
    second = exchange(board, 1, flags=PLAY)
    exchange(board, 2)  # an interval began, dry, at the instant of this OUT, before it was taken
    assert played((first, second)) == [0, 500, 500, 0, 0, 0, 0]
    assert all(frame.status & UNDERRUN for frame in (first, second))
    assert not exchange(board, 3).status & UNDERRUN


def test_samples_wait_without_the_play_flag():
    board = BoardModel(board_params())
    waiting = exchange(board, 0, flags=ENABLE, perturbation=(9, 9, 9))
    assert (waiting.fifo_level, played([waiting])) == (3, [0, 0, 0])
    playing = exchange(board, 1, flags=PLAY)
    assert played([playing]) == [
        0,
        0,
        9,
        9,
    ]  # the interval at the instant of this OUT began before it was taken


def test_full_fifo_drops_the_rest():
    board = BoardModel(board_params())
    levels = [exchange(board, tick, flags=ENABLE, perturbation=(1,) * 6) for tick in range(3)]
    assert [frame.fifo_level for frame in levels] == [6, 12, 16]
    assert [bool(frame.status & OVERFLOW) for frame in levels] == [False, False, True]


def test_fifo_clear_drops_before_taking():
    board = BoardModel(board_params())
    exchange(board, 0, flags=ENABLE, perturbation=(1,) * 6)
    assert (
        exchange(board, 1, flags=ENABLE | OutFlag.FIFO_CLEAR, perturbation=(2, 2)).fifo_level == 2
    )


def test_no_torque_without_enable_though_the_fifo_runs():
    board = BoardModel(board_params())
    frame = exchange(board, 0, flags=PERTURB, perturbation=(9000,) * 6)
    assert (played([frame]), frame.fifo_level, frame.encoder) == ([0, 0, 0], 3, 0)


def test_mean_velocity_is_distance_over_the_interval():
    fine = board_params(probe_velocity_m_per_s_per_count=1e-6, mass_kg=0.8)
    board = BoardModel(fine)
    frame = exchange(board, 0, flags=ENABLE, torque=16000)
    state = (0.0, 0.0)
    expected = []
    decay, gain, reach, push = held_force_response(0.8, 0.36, 250e-6)
    for _ in range(3):
        distance_m = reach * state[1] + push * 16000 * fine.force_n_per_count
        state = state[0] + distance_m, decay * state[1] + gain * 16000 * fine.force_n_per_count
        expected.append(distance_m / 250e-6 / 1e-6)
    assert [velocity for _, velocity in frame.pairs] == pytest.approx(expected, abs=0.5 + 1e-6)


def test_sum_of_pairs_is_the_exact_work():
    """Perturbation alone on an undamped mass: sum(F v T) is the kinetic energy gained, to the
    rounding of the counts.
    """
    fine = board_params(viscous_ns_per_m=0.0, mass_kg=0.02, probe_velocity_m_per_s_per_count=1e-5)
    board = BoardModel(fine)
    work_j = 0.0
    samples = [round(8000 * (-1) ** (k // 7)) + 40 * k for k in range(44)]
    for tick in range(11):
        frame = exchange(
            board, tick, flags=PLAY, perturbation=tuple(samples[4 * tick : 4 * tick + 4])
        )
        work_j += sum(t * fine.probe_torque_n_per_count * v * 1e-5 * 250e-6 for t, v in frame.pairs)
    impulse = sum(
        played_sample * fine.probe_torque_n_per_count * 250e-6 for played_sample in samples[:42]
    )
    velocity = impulse / 0.02
    assert frame.probe_index + len(frame.pairs) == 43
    assert work_j == pytest.approx(0.5 * 0.02 * velocity**2, abs=43 * 2.0 * 0.5e-5 * 250e-6)


@pytest.mark.parametrize(
    ("rate_hz", "pairs"), [(2000.0, {2}), (4000.0, {1}), (8000.0, {0, 1}), (900.0, {4, 5})]
)
def test_the_4_khz_clock_is_the_boards_own(rate_hz, pairs):
    board = BoardModel(board_params(rate_hz=rate_hz))
    period_ns = 1e9 / rate_hz
    frames = []
    for tick in range(400):
        board.on_out(out_packet(tick), round(tick * period_ns))
        frames.append(codec.decode_in(board.poll_in(round((tick + 0.99) * period_ns))))
    assert {len(frame.pairs) for frame in frames[1:]} == pairs
    lived_us = frames[-1].board_time_us
    assert frames[-1].probe_index + len(frames[-1].pairs) == pytest.approx(lived_us / 250, abs=1.01)


def test_uneven_intervals_give_even_velocities():
    """900 Hz: an interval is 3 or 4 sub-steps, and a mass that coasts has one velocity in all
    of them.
    """
    fine = board_params(rate_hz=900.0, viscous_ns_per_m=0.0, probe_velocity_m_per_s_per_count=1e-4)
    board = BoardModel(fine)
    velocities = set()
    for tick in range(50):
        board.on_out(
            out_packet(tick, flags=ENABLE, torque=4000 if tick == 0 else 0), round(tick * 1e9 / 900)
        )
        frame = codec.decode_in(board.poll_in(round((tick + 0.99) * 1e9 / 900)))
        if tick > 2:
            velocities |= {velocity for _, velocity in frame.pairs}
    assert max(velocities) - min(velocities) <= 1
    assert min(velocities) > 1000


def test_unread_pairs_are_kept_then_lost_from_the_front():
    board = BoardModel(board_params())
    for tick in range(20):
        board.on_out(out_packet(tick), tick * 1_000_000)
    first = exchange(board, 20)
    assert first.status & LOST
    assert (first.probe_index, len(first.pairs)) == (83 - PAIRS_MAX, 5)
    backlog = [exchange(board, tick) for tick in range(21, 100)]
    index = first.probe_index + 5
    for frame in backlog:
        assert frame.probe_index == index
        index += len(frame.pairs)
    assert len(backlog[-1].pairs) == 4
    assert not backlog[-1].status & LOST


@pytest.mark.parametrize(
    ("value", "count"),
    [
        (0.5, 1),
        (-0.5, 0),
        (1.49, 1),
        (32767.4, 32767),
        (40000.0, 32767),
        (-32768.6, -32768),
        (-1e9, -32768),
    ],
)
def test_counts_round_half_up_and_saturate(value, count):
    assert i16_count(value) == count
