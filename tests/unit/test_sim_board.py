"""The fake firmware by itself: no host code, only bytes in, bytes out and a time."""

from math import floor, inf, nan

import pytest
from support.boards import ENABLE, LATCH_NS, PERTURB, TICK_NS, board_params, exchange, out_packet

from hapticd.core.errors import ConfigError
from hapticd.model.step import held_force_response
from hapticd.sim.board import BoardModel, hello
from hapticd.usb import codec
from hapticd.usb.frames import OUT_BYTES, PROTOCOL_HASH, Capability, OutFlag, Request, StatusBit

BOARD = board_params()
ALWAYS = int(StatusBit.SIMULATED | StatusBit.AMPLIFIER_READY)
ENABLED = int(StatusBit.ENABLED)
COUNT_N = BOARD.force_n_per_count


def coast(position_m, velocity, force_n, damping, duration_s):
    """Closed form of the plant over one held interval."""
    decay, gain, reach, push = held_force_response(
        BOARD.mass_kg, BOARD.viscous_ns_per_m + damping, duration_s
    )
    return position_m + reach * velocity + push * force_n, decay * velocity + gain * force_n


def counts(value, per_count):
    return floor(value / per_count + 0.5)


# --- one tick -------------------------------------------------------------------------------------
def test_force_acts_on_receipt_and_encoder_is_latched_at_sample_phase():
    board = BoardModel(BOARD)
    state = (0.0, 0.0)
    torques = (4000, -9000, 0, 12345)
    for tick, torque in enumerate(torques):
        state = coast(*state, torque * COUNT_N, 0.0, 0.875e-3)
        frame = exchange(board, tick, flags=ENABLE, torque=torque)
        assert frame.encoder == counts(state[0], BOARD.position_m_per_count)
        assert frame.emf_velocity == counts(state[1], BOARD.emf_velocity_m_per_s_per_count)
        state = coast(*state, torque * COUNT_N, 0.0, 0.125e-3)  # until the next OUT: the delay d


@pytest.mark.parametrize("sample_phase", [0.0, 0.5, 1.0])
def test_sample_phase_moves_the_latch(sample_phase):
    board = BoardModel(board_params(sample_phase=sample_phase))
    board.on_out(out_packet(0, flags=ENABLE, torque=20000), 0)
    latch_ns = round(sample_phase * TICK_NS)
    assert board.next_in_ns() == latch_ns
    assert board.poll_in(latch_ns - 1) is None
    frame = codec.decode_in(board.poll_in(latch_ns))
    position_m, _ = coast(0.0, 0.0, 20000 * COUNT_N, 0.0, sample_phase * 1e-3)
    assert frame.encoder == counts(position_m, BOARD.position_m_per_count)
    assert frame.board_time_us == latch_ns // 1000


def test_frame_says_who_when_and_simulated():
    board = BoardModel(BOARD)
    frames = [exchange(board, tick, flags=ENABLE) for tick in range(70)]
    assert [frame.seq for frame in frames] == list(range(70))
    assert [frame.echo for frame in frames] == list(range(70))
    assert [frame.board_time_us for frame in frames] == [1000 * tick + 875 for tick in range(70)]
    assert {frame.status for frame in frames} == {ALWAYS | ENABLED}
    assert frames[0].temperature == 2200


def test_current_and_voltage_follow_the_motor():
    board = BoardModel(BOARD)
    damping = 20000
    frame = exchange(board, 0, flags=ENABLE, torque=8000, damping=damping)
    level = damping * BOARD.active_damping_ns_per_m_per_count
    _, velocity = coast(0.0, 0.0, 8000 * COUNT_N, level, 0.875e-3)
    current_a = (8000 * COUNT_N - level * velocity) / BOARD.torque_constant_n_per_a
    voltage_v = BOARD.winding_ohm * current_a + BOARD.torque_constant_n_per_a * velocity
    assert frame.current == counts(current_a, BOARD.current_a_per_count)
    assert frame.voltage == counts(voltage_v, BOARD.voltage_v_per_count)


def test_sensors_saturate_instead_of_wrapping():
    board = BoardModel(board_params(current_a_per_count=1e-6, voltage_v_per_count=1e-6))
    assert exchange(board, 0, flags=ENABLE, torque=-20000)[6:8] == (-32768, -32768)


def test_encoder_wraps_at_32_bits():
    scale = 1e-14
    board = BoardModel(board_params(position_m_per_count=scale))
    encoder = exchange(board, 0, flags=ENABLE, torque=32000).encoder
    whole = counts(coast(0.0, 0.0, 32000 * COUNT_N, 0.0, 0.875e-3)[0], scale)
    assert whole > 2**31
    assert encoder == (whole + 2**31) % 2**32 - 2**31


def test_torque_is_clamped_at_the_boards_own_limit():
    board = BoardModel(board_params(force_limit_n=2.0))
    free = BoardModel(BOARD)
    limit = int(2.0 / COUNT_N)
    clamped = exchange(board, 0, flags=ENABLE, torque=-32768)
    assert clamped.status & StatusBit.FORCE_CLAMPED
    assert clamped.encoder == exchange(free, 0, flags=ENABLE, torque=-limit).encoder
    assert not exchange(board, 1, flags=ENABLE, torque=limit).status & StatusBit.FORCE_CLAMPED


def test_no_enable_means_no_torque_but_damping():
    board = BoardModel(BOARD)
    exchange(board, 0, flags=ENABLE, torque=30000)
    first = exchange(board, 1, torque=30000, damping=65535)
    second = exchange(board, 2, torque=30000, damping=65535)
    assert not first.status & StatusBit.ENABLED
    _, expected = coast(
        0.0, first.emf_velocity * BOARD.emf_velocity_m_per_s_per_count, 0.0, 10.0, 1e-3
    )
    assert second.emf_velocity == pytest.approx(
        counts(expected, BOARD.emf_velocity_m_per_s_per_count), abs=1
    )


# --- what is refused ------------------------------------------------------------------------------
def resealed(offset, value):
    """A frame with one byte changed and a CRC that fits."""
    packet = bytearray(out_packet(1, flags=ENABLE, torque=30000, damping=30000))
    packet[offset] = value
    packet[-2:] = codec.crc16(bytes(packet[:-2])).to_bytes(2, "little")
    return bytes(packet)


GOOD = bytes(out_packet(1, flags=ENABLE, torque=30000, damping=30000))
BAD_PACKETS = {
    "empty": b"",
    "short": GOOD[:-1],
    "long": GOOD + b"\0",
    "crc": GOOD[:-1] + bytes((GOOD[-1] ^ 1,)),
    "axis": resealed(2, 1),
    "flag": resealed(3, 0x08),
    "count": resealed(10, 7),
    "reserved": resealed(11, 1),
    "tail": resealed(29, 1),
}


@pytest.mark.parametrize("name", BAD_PACKETS)
def test_bad_frame_changes_nothing(name):
    board = BoardModel(BOARD)
    twin = BoardModel(BOARD)
    for model in (board, twin):
        exchange(model, 0, flags=ENABLE, torque=500)
    board.on_out(memoryview(BAD_PACKETS[name]), TICK_NS)
    assert board.poll_in(2 * TICK_NS - 1) is None
    assert (board.out_refused, twin.out_refused) == (1, 0)
    after = [exchange(model, 2, flags=ENABLE, torque=500) for model in (board, twin)]
    assert after[0].status == ALWAYS | ENABLED | StatusBit.BAD_FRAME | StatusBit.SEQ_GAP
    assert after[0]._replace(status=0) == after[1]._replace(status=0)
    assert exchange(board, 3, flags=ENABLE, torque=500).status == ALWAYS | ENABLED


def test_whole_good_frame_is_the_counterexample():
    board = BoardModel(BOARD)
    board.on_out(memoryview(GOOD), 0)
    assert board.out_refused == 0
    assert len(GOOD) == OUT_BYTES


@pytest.mark.parametrize(("following", "gap"), [(5, False), (6, True), (4, True), (3, True)])
def test_sequence_gap_is_flagged_once(following, gap):
    board = BoardModel(BOARD)
    board.on_out(out_packet(4), 0)
    board.poll_in(LATCH_NS)
    board.on_out(out_packet(following), TICK_NS)
    frame = codec.decode_in(board.poll_in(2 * TICK_NS))
    assert bool(frame.status & StatusBit.SEQ_GAP) is gap
    assert frame.echo == following


def test_sequence_wraps_without_a_gap():
    board = BoardModel(BOARD)
    board.on_out(out_packet(0xFFFF), 0)
    board.on_out(out_packet(0), TICK_NS)
    assert not codec.decode_in(board.poll_in(2 * TICK_NS)).status & StatusBit.SEQ_GAP


# --- one OUT, one IN ------------------------------------------------------------------------------
def test_nothing_is_latched_before_the_first_out():
    board = BoardModel(BOARD)
    assert board.next_in_ns() is None
    assert board.poll_in(10**12) is None
    assert board.sim_slip_ns == 0


def test_each_out_latches_one_in():
    board = BoardModel(BOARD)
    exchange(board, 0)
    assert board.next_in_ns() is None
    assert board.poll_in(5 * TICK_NS) is None


def test_unread_in_is_replaced_and_loses_nothing():
    board = BoardModel(BOARD)
    board.on_out(out_packet(0), 0)
    board.on_out(out_packet(9), TICK_NS)  # latches the IN of OUT 0, which is not read
    board.on_out(
        out_packet(10), 2 * TICK_NS
    )  # replaces it; SEQ_GAP was reported in an IN that nobody read
    frame = codec.decode_in(board.poll_in(3 * TICK_NS))
    assert board.in_replaced == 2
    assert (frame.seq, frame.echo) == (2, 10)
    assert frame.status & StatusBit.SEQ_GAP
    assert (frame.probe_index, len(frame.pairs)) == (0, 5)
    assert exchange(board, 11).probe_index == 5


@pytest.mark.parametrize("lost", ["OUT", "IN"])
@pytest.mark.parametrize("rate_hz", [1000.0, 2000.0, 4000.0, 8000.0])
def test_one_lost_frame_loses_no_sample_of_the_probe(rate_hz, lost):
    """At each rate of the protocol, whatever the phase: the frames after it carry all pairs."""
    period_ns = round(1e9 / rate_hz)
    for phase in range(17):
        board = BoardModel(board_params(rate_hz=rate_hz, sample_phase=phase / 16))
        indices = []
        for tick in range(60):
            if (tick, lost) != (20, "OUT"):
                board.on_out(out_packet(tick), tick * period_ns)
            # at a phase of a whole period the next OUT comes at the latch: read just after it
            packet = None if (tick, lost) == (20, "IN") else board.poll_in((tick + 1) * period_ns)
            if packet is not None:
                frame = codec.decode_in(packet)
                indices += range(frame.probe_index, frame.probe_index + len(frame.pairs))
                assert not frame.status & StatusBit.PROBE_OVERFLOW
        assert indices == list(range(len(indices)))
        ended = floor((59 + phase / 16) * 4000.0 / rate_hz)
        assert len(indices) == ended  # caught up


def test_two_outs_within_a_tick_latch_two_ins():
    board = BoardModel(BOARD)
    board.on_out(out_packet(0), 0)
    board.on_out(out_packet(1), 500_000)
    first, second = (codec.decode_in(board.poll_in(t_ns)) for t_ns in (875_000, 1_375_000))
    assert (first.board_time_us, second.board_time_us) == (875, 1375)
    assert (first.seq, second.seq, second.echo) == (0, 1, 1)


def test_postponed_in_comes_late():
    board = BoardModel(BOARD)
    board.on_out(out_packet(0), 0)
    board.postpone_in(250_000)
    assert board.next_in_ns() == 1_125_000
    assert codec.decode_in(board.poll_in(1_125_000)).board_time_us == 1125


# --- host pauses ----------------------------------------------------------------------------------
def test_pause_is_skipped_and_counted():
    slips = []
    board = BoardModel(board_params(watchdog_ms=100.0), on_slip=slips.append)
    exchange(board, 0, flags=ENABLE, torque=1000)
    board.on_out(out_packet(1, flags=ENABLE), 1_000_875_000)
    frame = codec.decode_in(board.poll_in(1_000_875_000 + LATCH_NS))
    assert slips == [980_000_000]
    assert board.sim_slip_ns == 980_000_000
    assert frame.board_time_us == 875 + 20_000 + 875
    assert not frame.status & StatusBit.WATCHDOG


def test_pause_of_20_ms_is_lived_through():
    board = BoardModel(BOARD)
    exchange(board, 0)
    board.on_out(out_packet(1), 20_875_000)
    assert board.sim_slip_ns == 0


# --- faults of the hardware -----------------------------------------------------------------------
@pytest.mark.parametrize(
    "fault", [StatusBit.AMPLIFIER_FAULT, StatusBit.ENCODER_FAULT, StatusBit.OVER_TEMPERATURE]
)
def test_board_fault_latches_until_cleared_without_cause(fault):
    board = BoardModel(BOARD)
    exchange(board, 0, flags=ENABLE, torque=1000)
    board.trip(int(fault))
    assert exchange(board, 1, flags=ENABLE, torque=1000).status == ALWAYS | fault
    assert board.control(0x40, Request.CLEAR_FAULT, 0, 0) == b""
    assert exchange(board, 2, flags=ENABLE, torque=1000).status & fault
    board.heal(int(fault))
    assert exchange(board, 3, flags=ENABLE, torque=1000).status & fault
    board.control(0x40, Request.CLEAR_FAULT, 0, 0)
    assert exchange(board, 4, flags=ENABLE, torque=1000).status == ALWAYS | ENABLED


def test_board_fault_takes_the_torque_away():
    board = BoardModel(BOARD)
    before = exchange(board, 0, flags=ENABLE, torque=30000)
    board.trip(int(StatusBit.AMPLIFIER_FAULT))
    after = exchange(board, 1, flags=ENABLE, torque=30000)
    assert before.current > 0
    assert after.current == 0


def test_power_up_starts_afresh():
    board = BoardModel(BOARD)
    for tick in range(50):
        last = exchange(
            board, tick, flags=ENABLE | PERTURB, torque=20000, damping=100, perturbation=(5,) * 6
        )
    assert last.encoder > 1000
    board.power_up()
    assert board.next_in_ns() is None
    fresh = exchange(board, 100)
    assert fresh.status == ALWAYS
    assert (fresh.seq, fresh.echo, fresh.board_time_us, fresh.encoder) == (0, 100, 875, 0)
    assert (fresh.fifo_level, fresh.probe_index, fresh.pairs) == (0, 0, ((0, 0),) * 3)


def test_every_power_up_is_another_life():
    board = BoardModel(BOARD)
    lives = []
    for _ in range(3):
        lives.append(exchange(board, 0).life)
        board.power_up()
    assert lives == [1, 2, 3]


def test_host_sets_the_phase_at_which_frames_are_latched():
    board = BoardModel(BOARD)
    phase = int(Request.SAMPLE_PHASE)
    assert board.control(0x40, phase, 500, 0) == b""
    assert exchange(board, 0).board_time_us == 500
    assert board.control(0x40, phase, 1001, 0) is None
    board.power_up()
    assert exchange(board, 0).board_time_us == 875


def test_torque_in_effect_is_that_of_its_out_frame_and_has_its_age():
    board = BoardModel(board_params(lag_periods=2))
    found = [exchange(board, tick, flags=ENABLE, torque=tick) for tick in range(5)]
    assert [frame.torque_seq for frame in found] == [0, 0, 0, 1, 2]
    assert [frame.torque_age_us for frame in found[2:]] == [875, 875, 875]
    assert [frame.echo for frame in found] == [0, 1, 2, 3, 4]


# --- endpoint 0 -----------------------------------------------------------------------------------
def test_hello_describes_the_board():
    hello = codec.decode_hello(BoardModel(BOARD).control(0xC0, Request.HELLO, 0, 80))
    assert hello.protocol_hash == PROTOCOL_HASH
    assert (
        hello.capabilities
        == Capability.PROBE
        | Capability.INTERVAL_MEAN
        | Capability.TEMPERATURE
        | Capability.EMERGENCY_STOP
        | Capability.AMPLIFIER_READY
        | Capability.SAMPLE_PHASE
        | Capability.EVENT
        | Capability.SIMULATED
    )
    assert (hello.serial, hello.axis_count, hello.watchdog_ms) == ("SIM0001", 1, 250)
    assert hello[6:] == pytest.approx((8.0, 10.0, 2.0, 2.0, 10.0, 30.0, 0.5e-6, 8.0), rel=1e-6)


def test_strings_are_usb_string_descriptors():
    board = BoardModel(BOARD)
    assert board.control(0x80, 6, 0x0300, 255) == b"\x04\x03\x09\x04"
    assert board.control(0x80, 6, 0x0303, 255) == b"\x10\x03" + "SIM0001".encode("utf-16-le")
    assert board.control(0x80, 6, 0x0303, 4) == b"\x10\x03S\0"


@pytest.mark.parametrize(
    "setup",
    [(0xC0, 0x77, 0), (0x40, 0x77, 0), (0xC0, 0x01, 1), (0x40, 0x02, 1), (0x80, 6, 0x0309)],
)
def test_unknown_control_request_stalls(setup):
    assert BoardModel(BOARD).control(*setup, 64) is None


# --- what is no board -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate_hz": 100.0}, r"runs at 250\.\.32000 Hz, not at 100 Hz"),
        ({"sample_phase": 0.9}, r"sample_phase 0\.9 must be a multiple of 1/16 in 0\.\.1"),
        ({"sample_phase": 1.0625}, r"sample_phase 1\.0625 must be"),
        ({"sample_phase": nan}, r"sample_phase nan must be"),
        ({"watchdog_ms": 0.5}, r"watchdog_ms 0\.5 ms is outside 1\.\.65535 ms"),
        ({"serial": ""}, r"serial '' must be 1\.\.16 ASCII characters"),
        ({"serial": "S" * 17}, r"must be 1\.\.16 ASCII characters"),
        ({"serial": "Ω"}, r"must be 1\.\.16 ASCII characters"),
        ({"force_n_per_count": 0.0}, r"force_n_per_count 0\.0 must be positive"),
        ({"torque_constant_n_per_a": -1.0}, r"torque_constant_n_per_a -1\.0 must be positive"),
        ({"force_limit_n": inf}, r"force_limit_n inf must be positive"),
        ({"mass_kg": 0.0}, r"plant mass 0\.0 kg must be positive"),
    ],
)
def test_impossible_boards_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        BoardModel(board_params(**changes))


def test_fifo_clear_is_a_known_flag():
    board = BoardModel(BOARD)
    assert exchange(board, 0, flags=int(OutFlag.FIFO_CLEAR)).status == ALWAYS


def test_board_may_lack_what_it_could_measure():
    params = board_params(lacks=("temperature", "probe"), hello_serial="OTHER")
    board = BoardModel(params)
    said = hello(params)
    assert said.serial == "OTHER"
    assert not said.capabilities & (Capability.TEMPERATURE | Capability.PROBE)
    received = [exchange(board, tick) for tick in range(40)]
    assert {frame.temperature for frame in received} == {0}
    assert not any(frame.pairs for frame in received)
    assert not any(frame.status & StatusBit.PROBE_OVERFLOW for frame in received)


def test_emergency_stop_acts_when_it_is_pressed_not_with_the_next_frame():
    """A third of a period of force, then none: the device keeps the speed that it got until then,
    less what its friction takes (below 2 % in 0.6 ms).
    """
    board = BoardModel(board_params())
    board.on_out(out_packet(0, flags=ENABLE, torque=4096), 0)
    board.press_stop(375_000, True)
    assert board._axis.force_n == 0.0
    frame = codec.decode_in(board.poll_in(LATCH_NS))
    assert frame.status & StatusBit.EMERGENCY_STOP
    assert not frame.status & StatusBit.ENABLED
    speed = 4096 * 8.0 / 32767 * 375e-6 / 0.008
    assert board._axis.state[1] == pytest.approx(speed, rel=0.05)
