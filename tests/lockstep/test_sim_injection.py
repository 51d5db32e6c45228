"""Every injected fault, seen from the cable."""

import errno
from pathlib import Path

import pytest
from support.boards import ENABLE, LATCH_NS, TICK_NS, board_params, out_packet

from hapticd.core.errors import ConfigError, FrameError
from hapticd.model.params import InjectionParams
from hapticd.sim.board import BoardModel
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS, Injector, TransferFault, with_injections
from hapticd.usb import codec
from hapticd.usb.frames import StatusBit

STRUCK = 2  # the tick that the tests strike


def injected(*injections, **changes):
    params = board_params(injections=injections, **changes)
    return with_injections(BoardModel(params), params)


def one(kind, value=0.0, count=1):
    return injected(InjectionParams(kind, tick=STRUCK, value=value, count=count))


def tick_of(port, tick, **fields):
    """OUT at the tick, and the IN packet that a read until just before the next tick gets."""
    port.on_out(out_packet(tick, flags=ENABLE, **fields), tick * TICK_NS)
    return port.poll_in((tick + 1) * TICK_NS - 1)


def healthy(port, *ticks):
    for tick in ticks:
        assert codec.decode_in(tick_of(port, tick)).echo == tick


def test_no_injection_is_no_injector():
    params = board_params()
    board = BoardModel(params)
    assert with_injections(board, params) is board


def test_unknown_kind_is_refused_by_name():
    with pytest.raises(
        ConfigError,
        match=r"injection kind 'gremlin' is unknown; use one of active_damping_gain, ampl",
    ):
        injected(InjectionParams("gremlin"))


def test_dropped_out_reaches_no_board():
    port = one("drop_out")
    healthy(port, 0, 1)
    assert tick_of(port, STRUCK) is None
    assert codec.decode_in(tick_of(port, 3)).status & StatusBit.SEQ_GAP


def test_corrupt_out_is_refused_by_the_board():
    port = one("corrupt_out")
    healthy(port, 0, 1)
    assert tick_of(port, STRUCK) is None
    assert port.board.out_refused == 1
    assert codec.decode_in(tick_of(port, 3)).status & StatusBit.BAD_FRAME


@pytest.mark.parametrize(
    ("kind", "number", "away_s"),
    [("stall_out", errno.EPIPE, None), ("io_error", errno.EIO, None), ("unplug", errno.EIO, 0.7)],
)
def test_failed_out_raises_what_the_bus_reports(kind, number, away_s):
    port = one(kind, value=0.7)
    healthy(port, 0, 1)
    with pytest.raises(TransferFault) as caught:
        tick_of(port, STRUCK)
    assert (caught.value.number, caught.value.away_s) == (number, away_s)
    assert tick_of(port, 3) is not None


def test_late_in_is_latched_late():
    port = one("late", value=100e-6)
    healthy(port, 0, 1)
    port.on_out(out_packet(STRUCK), STRUCK * TICK_NS)
    due_ns = STRUCK * TICK_NS + LATCH_NS + 125_000  # to the nearest sub-step
    assert port.next_in_ns() == due_ns
    assert codec.decode_in(port.poll_in(due_ns)).board_time_us == due_ns // 1000
    healthy(port, 3)


@pytest.mark.parametrize("late_s", [0.0012, 0.003, 0.008])
def test_in_that_is_later_than_a_period_keeps_the_order(late_s):
    """What follows waits behind it, and no torque is younger than the frame that tells of it."""
    port = one("late", value=late_s, count=3)
    frames = [tick_of(port, tick, torque=100 + tick % 2) for tick in range(40)]
    found = [codec.decode_in(frame) for frame in frames if frame is not None]
    times_us = [frame.board_time_us for frame in found]
    assert times_us == sorted(times_us)
    assert [frame.echo for frame in found] == sorted({frame.echo for frame in found})
    assert all(frame.torque_age_us <= 1000 for frame in found)
    assert found[-1].echo == 39


@pytest.mark.parametrize("kind", ["amplifier_fault", "encoder_fault", "over_temperature"])
def test_board_fault_has_a_cause_for_a_while(kind):
    bit = StatusBit[kind.upper()]
    port = one(kind, value=0.002)
    healthy(port, 0, 1)
    for tick, cleared in ((STRUCK, False), (3, False), (4, True), (5, True)):
        frame = codec.decode_in(tick_of(port, tick))
        assert bool(frame.status & bit) is (tick < 5)
        assert bool(frame.status & StatusBit.ENABLED) is (tick == 5)
        port.control(0x40, 0x02, 0, 0)
        assert bool(port.board._axis.faults) is not cleared


def test_dropped_in_is_lost_for_good():
    port = one("drop_in")
    healthy(port, 0, 1)
    assert tick_of(port, STRUCK) is None
    assert port.next_in_ns() is None
    frame = codec.decode_in(tick_of(port, 3))
    assert (frame.echo, frame.probe_index) == (3, 11)  # and its pairs with it: 7..10 are missing


def test_delayed_in_comes_after_its_time():
    port = one("delay_in", value=0.0005)
    healthy(port, 0, 1)
    assert tick_of(port, STRUCK) is None
    due_ns = STRUCK * TICK_NS + LATCH_NS + 500_000
    assert port.next_in_ns() == due_ns
    port.on_out(out_packet(3), 3 * TICK_NS)
    assert codec.decode_in(port.poll_in(due_ns)).echo == STRUCK
    assert codec.decode_in(port.poll_in(4 * TICK_NS)).echo == 3


def test_duplicate_in_comes_twice():
    port = one("duplicate_in")
    healthy(port, 0, 1)
    assert tick_of(port, STRUCK) == port.poll_in(3 * TICK_NS)
    healthy(port, 3)


def test_corrupt_in_fails_its_crc():
    port = one("corrupt_in")
    healthy(port, 0, 1)
    with pytest.raises(FrameError, match="CRC"):
        codec.decode_in(tick_of(port, STRUCK))


def test_stalled_in_raises_at_the_read():
    port = one("stall_in")
    healthy(port, 0, 1)
    with pytest.raises(TransferFault) as caught:
        tick_of(port, STRUCK)
    assert caught.value.number == errno.EPIPE
    healthy(port, 3)


@pytest.mark.parametrize(
    ("kind", "value", "length"),
    [("babble", 0, 65), ("babble", 9, 73), ("short_in", 0, 31), ("short_in", 63, 63)],
)
def test_packet_of_a_wrong_length(kind, value, length):
    port = one(kind, value=value)
    healthy(port, 0, 1)
    assert len(tick_of(port, STRUCK)) == length


def test_encoder_jumps_inside_a_valid_frame():
    port = one("encoder_jump", value=-(2.0**31) + 5)
    healthy(port, 0, 1)
    assert codec.decode_in(tick_of(port, STRUCK)).encoder == -(2**31) + 5
    assert codec.decode_in(tick_of(port, 3)).encoder == 0


def test_encoder_jump_wraps_as_32_bits_do():
    assert codec.decode_in(
        tick_of(injected(InjectionParams("encoder_jump", tick=0, value=2.0**31)), 0)
    ).encoder == -(2**31)
    assert (
        codec.decode_in(tick_of(injected(InjectionParams("encoder_jump", tick=0)), 0)).encoder
        == 1_000_000
    )


@pytest.mark.parametrize(("value", "count"), [(0.0, 32767), (-32768.0, -32768)])
def test_sensors_read_an_impossible_extreme(value, count):
    port = one("sensor_extreme", value=value)
    healthy(port, 0, 1)
    frame = codec.decode_in(tick_of(port, STRUCK))
    assert frame[6:10] == (count, count, count, count)


def test_count_strikes_ticks_on_end():
    port = one("drop_out", count=3)
    assert [tick for tick in range(8) if tick_of(port, tick) is None] == [2, 3, 4]


def missing(seed):
    port = injected(InjectionParams("drop_in", probability=0.1), seed=seed)
    return [tick for tick in range(2000) if tick_of(port, tick) is None]


def test_same_seed_strikes_the_same_ticks():
    assert missing(1) == missing(1)
    assert missing(1) != missing(2)
    assert 140 <= len(missing(1)) <= 260


def test_probability_with_count_is_a_burst():
    port = injected(InjectionParams("drop_out", probability=0.02, count=5))
    lost = [tick for tick in range(1000) if tick_of(port, tick) is None]
    starts = [tick for tick in lost if tick - 1 not in lost]
    assert all(tick + k in lost or tick + k >= 1000 for tick in starts for k in range(5))


def test_event_code_is_at_the_pins_from_its_out_on():
    port = one("event_code", value=258.0, count=3)
    healthy(port, 0, 1)
    frames = [codec.decode_in(tick_of(port, tick)) for tick in range(STRUCK, STRUCK + 5)]
    assert {(frame.event_code, frame.event_seq) for frame in frames} == {(258, 1)}
    ages = [frame.board_time_us - frame.event_age_us for frame in frames]
    assert set(ages) == {1000 * STRUCK}


def test_every_kind_is_tested_here():
    text = Path(__file__).read_text()
    assert all(f'"{kind}"' in text for kind in (*OUT_FAULTS, *IN_FAULTS))


def test_power_up_forgets_what_was_held():
    port = one("delay_in", value=10.0)
    healthy(port, 0, 1)
    tick_of(port, STRUCK)
    port.power_up()
    assert port.next_in_ns() is None
    assert isinstance(port, Injector)
    healthy(port, 3)


@pytest.mark.parametrize("damage", ["babble", "short_in", "corrupt_in"])
@pytest.mark.parametrize("first", [True, False])
def test_sensor_fault_comes_before_damage_on_the_way(damage, first):
    """A board that reads wrongly sends a valid packet; what the cable does to it comes after,
    in whatever order they are named.
    """
    both = [InjectionParams(kind, tick=STRUCK, value=0.0) for kind in (damage, "encoder_jump")]
    port = injected(*(both if first else both[::-1]))
    healthy(port, 0, 1)
    packet = tick_of(port, STRUCK)
    with pytest.raises(FrameError):
        codec.decode_in(packet)


def test_packets_that_piled_up_come_all_together_in_order():
    strikes = (("burst_in", STRUCK, 0.003), ("drop_in", 7, 0.0))
    port = injected(
        *(InjectionParams(kind, tick=tick, value=value) for kind, tick, value in strikes)
    )
    healthy(port, 0, 1)
    for tick in (STRUCK, 3, 4):
        assert tick_of(port, tick) is None
    due_ns = STRUCK * TICK_NS + LATCH_NS + 3_000_000
    assert port.next_in_ns() == due_ns
    port.on_out(out_packet(5), 5 * TICK_NS)
    echoes = [codec.decode_in(port.poll_in(due_ns)).echo for _ in range(4)]
    assert echoes == [STRUCK, 3, 4, 5]
    healthy(port, 6)
    assert tick_of(port, 7) is None


def test_nothing_of_zero_length_comes_behind_the_packet():
    port = one("zero_length_in")
    healthy(port, 0, 1)
    assert codec.decode_in(tick_of(port, STRUCK)).echo == STRUCK
    assert port.poll_in(3 * TICK_NS) == b""
    healthy(port, 3)


def test_encoder_burst_scatters_within_its_counts():
    port = one("encoder_burst", value=9.0, count=50)
    healthy(port, 0, 1)
    counts = [codec.decode_in(tick_of(port, tick)).encoder for tick in range(STRUCK, 60)]
    assert len(set(counts[:50])) > 10
    assert max(map(abs, counts)) == 9
    assert not any(counts[50:])


def test_stuck_encoder_reads_its_first_count_though_the_device_moves():
    port = one("encoder_stuck", count=5)
    pushed = [codec.decode_in(tick_of(port, tick, torque=20_000)).encoder for tick in range(9)]
    free = [codec.decode_in(tick_of(injected(), 0)).encoder]
    assert free == [0]
    assert pushed[STRUCK : STRUCK + 5] == [pushed[STRUCK]] * 5
    assert sorted(set(pushed)) == [*pushed[: STRUCK + 1], *pushed[STRUCK + 5 :]]


def forces_of(kind, value, torque, ticks=6):
    port = one(kind, value=value, count=2)
    forces = []
    for tick in range(ticks):
        port.on_out(out_packet(tick, flags=ENABLE, torque=torque), tick * TICK_NS)
        forces.append(port.board._axis.force_n)
        port.poll_in((tick + 1) * TICK_NS - 1)
    return forces


@pytest.mark.parametrize(
    ("kind", "value", "force_n"),
    [
        ("amplifier_stuck", -3.0, -3.0),
        ("amplifier_limited", 0.5, 0.5),
        ("amplifier_gain", 1.5, 3.0),
        ("amplifier_gain", -1.0, -2.0),
    ],
)
def test_amplifier_makes_another_force_of_the_command(kind, value, force_n):
    torque = round(2.0 * 32767 / 8.0)
    right_n = torque * 8.0 / 32767
    scale = right_n / 2.0 if kind == "amplifier_gain" else 1.0
    expected = [right_n] * 2 + [pytest.approx(force_n * scale)] * 2 + [right_n] * 2
    assert forces_of(kind, value, torque) == expected


def test_damping_circuit_delivers_another_damping_and_reports_what_was_commanded():
    port = one("active_damping_gain", value=0.3)
    count = 10_000
    told = []
    levels = []
    for tick in range(6):
        port.on_out(out_packet(tick, damping=count), tick * TICK_NS)
        levels.append(port.board._axis.damping_n)
        told.append(codec.decode_in(port.poll_in((tick + 1) * TICK_NS - 1)).damping_effect)
    right = count * board_params().active_damping_ns_per_m_per_count
    assert levels == pytest.approx([right] * 2 + [0.3 * right] + [right] * 3)
    assert told == [count] * 6


def test_stuck_amplifier_obeys_its_authority():
    port = one("amplifier_stuck", value=3.0, count=5)
    healthy(port, 0, 1)
    port.on_out(out_packet(STRUCK), STRUCK * TICK_NS)
    assert port.board._axis.force_n == 0.0


@pytest.mark.parametrize("at_us", [0, 2**31 - 2500, 2**31 + 7, 2**32 - 2500])
def test_restart_begins_another_board_time_and_keeps_the_motion(at_us):
    """36 minutes of board time in nobody's time: the trait is the clock's first reading."""
    begun = (InjectionParams("restart", tick=5, value=1.0),)
    port = injected(*begun, board_time_us=at_us)
    frames = [codec.decode_in(tick_of(port, tick, torque=20_000)) for tick in range(9)]
    times = [frame.board_time_us for frame in frames]
    assert times[:5] == [(at_us + tick * 1000 + 875) % 2**32 for tick in range(5)]
    assert times[5:] == [1_000_875 + tick * 1000 for tick in range(4)]
    calm = injected(InjectionParams("drop_in", tick=100))
    counts = [codec.decode_in(tick_of(calm, tick, torque=20_000)).encoder for tick in range(9)]
    here = [frame.encoder for frame in frames]
    # it counts from where the device was, which went on
    assert [count - here[5] for count in here[5:]] == pytest.approx(
        [count - counts[5] for count in counts[5:]], abs=1
    )
    assert here[5] < counts[5] - 1000


def test_power_up_begins_at_the_boards_own_time_again():
    port = injected(InjectionParams("restart", tick=0, value=7.0), board_time_us=5_000)
    tick_of(port, 0)
    port.power_up()
    assert codec.decode_in(tick_of(port, 1)).board_time_us == 5_875


@pytest.mark.parametrize(("kind", "tripped"), [("hang", True), ("hang_unwatched", False)])
def test_hung_board_holds_its_force_until_its_watchdog_acts(kind, tripped):
    port = injected(InjectionParams(kind, tick=STRUCK, value=0.06), watchdog_ms=20.0)
    torque = 4096
    for tick in (0, 1):
        tick_of(port, tick, torque=torque)
    held = []
    for tick in range(STRUCK, STRUCK + 60):
        with pytest.raises(TransferFault) as caught:
            tick_of(port, tick, torque=torque)
        assert caught.value.number == errno.ETIMEDOUT
        port.poll_in((tick + 1) * TICK_NS - 1)
        held.append(port.board._axis.force_n)
    force_n = torque * 8.0 / 32767
    # the newest OUT that was obeyed came at tick 1
    assert held[:18] == [force_n] * 18
    assert held[-1] == (0.0 if tripped else force_n)
    tick_of(port, STRUCK + 60)
    frame = codec.decode_in(tick_of(port, STRUCK + 61))
    assert bool(frame.status & StatusBit.WATCHDOG) is tripped


def pressed(bounce_ms, seed=1):
    """Status and force under 1 N, tick by tick, of an emergency stop pressed from tick 2 to 12."""
    strike = InjectionParams("emergency_stop", tick=STRUCK, value=0.010)
    port = injected(strike, emergency_stop_bounce_ms=bounce_ms, seed=seed)
    rows = []
    for tick in range(20):
        port.on_out(out_packet(tick, flags=ENABLE, torque=4096), tick * TICK_NS)
        frame = codec.decode_in(port.poll_in((tick + 1) * TICK_NS - 1))
        rows.append((frame.status, port.board._axis.force_n))
    return rows


def test_emergency_stop_takes_the_torque_and_gives_it_back():
    rows = pressed(bounce_ms=0.0)
    force_n = 4096 * 8.0 / 32767
    for tick, (status, acting_n) in enumerate(rows):
        away = STRUCK <= tick < STRUCK + 10
        assert bool(status & StatusBit.EMERGENCY_STOP) is away
        assert bool(status & StatusBit.AMPLIFIER_READY) is not away
        assert bool(status & StatusBit.ENABLED) is not away
        assert acting_n == (0.0 if away else force_n)


def test_contact_bounces_and_then_stays():
    rows = pressed(bounce_ms=3.0)
    seen = "".join(str(int(bool(status & StatusBit.EMERGENCY_STOP))) for status, _ in rows)
    assert seen[:2] == "00"
    assert seen[5:12] == "1" * 7
    assert seen[15:] == "0" * 5
    assert rows == pressed(bounce_ms=3.0)
    assert any(
        rows[2:5] + rows[12:15] != (other := pressed(3.0, seed))[2:5] + other[12:15]
        for seed in range(2, 9)
    )


def test_emergency_stop_outlives_a_restart_and_a_re_plug():
    strikes = (
        InjectionParams("emergency_stop", tick=0, value=0.010),
        InjectionParams("restart", tick=2),
    )
    port = injected(*strikes)
    port.power_up()
    for tick in (0, 1, 2, 3):
        assert codec.decode_in(tick_of(port, tick)).status & StatusBit.EMERGENCY_STOP
    port.power_up()
    assert codec.decode_in(tick_of(port, 5)).status & StatusBit.EMERGENCY_STOP
    assert not codec.decode_in(tick_of(port, 11)).status & StatusBit.EMERGENCY_STOP
