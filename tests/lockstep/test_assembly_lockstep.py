"""The whole stack on virtual time: the paper's settings, every injected fault, receipts,
energy, memory.
"""

import dis
from contextlib import suppress
from types import FunctionType

import numpy as np
import pytest
from support.boards import board_params
from support.models import COUNT_M, COUNT_NS_PER_M, device_params, servo_params

from hapticd.core.errors import LinkLost, MailboxError
from hapticd.core.faults import BY_CODE
from hapticd.core.params import HomeParams
from hapticd.mailbox import layout
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.loop import ServoLoop
from hapticd.servo.safety import State
from hapticd.usb import codec
from hapticd.usb.frames import OutFlag, StatusBit

FIG_4 = {Value.STIFFNESS: 100.0, Value.VIRTUAL_DAMPING: 1.0, Value.MASS: 0.010, Value.RAMP_S: 0.0}
FREE = {Value.STIFFNESS: 0.0, Value.RAMP_S: 0.0}
FIG_7 = {Value.STIFFNESS: 50.0, Value.VIRTUAL_DAMPING: 2.0, Value.MASS: 0.0, Value.RAMP_S: 0.0}
FAULTS = [
    ("drop_out", 1, 0.0),
    ("drop_out", 3, 0.0),
    ("drop_in", 1, 0.0),
    ("drop_in", 5, 0.0),
    ("delay_in", 1, 0.003),
    ("duplicate_in", 4, 0.0),
    ("corrupt_in", 2, 0.0),
    ("corrupt_out", 2, 0.0),
    ("stall_in", 1, 0.0),
    ("stall_out", 1, 0.0),
    ("babble", 1, 0.0),
    ("short_in", 2, 0.0),
    ("late", 3, 0.0004),
]


def perturbed(stack, amplitude=3000, seed=3):
    """White noise into the probe motor, for ever."""
    stack.load_waveform(
        np.random.default_rng(seed).integers(-amplitude, amplitude + 1, 8000).tolist()
    )
    assert (
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0}).result
        is Result.APPLIED
    )


def enable(stack, settings):
    stack.run(5)
    assert stack.do(Command.SET, settings).result is Result.APPLIED
    assert stack.do(Command.ENABLE).result is Result.APPLIED
    stack.run(520)


def test_free_decay_shows_the_damping_that_was_commanded():
    """After a push the velocity decays with m / (b + b_el): measured within 1 %, no virtual
    environment.
    """
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FREE)
        stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 2.0, Value.ACTIVE_DAMPING_ON: 1.0})
        stack.run(300)
        stack.load_waveform([16000] * 80)
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 80.0, Value.LOOP: 0.0})
        flown = as_records(stack.run(60))
    moved = np.diff(flown["position_m"])
    tail = moved[25:33]
    rate = -np.polyfit(np.arange(8) * 1e-3, np.log(tail), 1)[0]
    assert rate == pytest.approx((0.36 + 2.0) / 0.008, rel=0.01)


@pytest.mark.parametrize(("phase", "lag"), [(0.875, 0), (0.5, 0), (0.125, 0), (0.875, 1), (0.5, 2)])
def test_delay_from_sample_to_force_is_measured_every_tick(phase, lag):
    """A period less the phase at which the board samples, and periods it holds torque back."""
    board = board_params(sample_phase=phase, lag_periods=lag)
    with LockStep(servo_params(), board) as stack:
        enable(stack, FIG_4)
        flown = as_records(stack.run(600))
    assert set(flown["delay_us"]) == {1000 * lag + round(1000 * (1.0 - phase))}
    assert set(flown["frame_age_us"]) == {-1 if lag else round(1000 * (1.0 - phase))}
    assert set(flown["delay_spread_us"][-256:]) == {0}


def test_delay_is_unknown_until_a_force_has_its_sample_and_while_frames_are_missing():
    faults = (InjectionParams("drop_in", tick=50, count=3),)
    with LockStep(servo_params(), board_params(injections=faults)) as stack:
        flown = as_records(stack.run(200))
    unknown = np.flatnonzero(flown["delay_us"] < 0).tolist()
    assert unknown == [0, *np.flatnonzero(flown["arrival"] < 0).tolist()]
    assert np.count_nonzero(flown["arrival"] < 0) == 3
    assert (flown["frame_age_us"][unknown] == -1).all()


def test_spread_of_the_delay_shows_a_frame_that_was_latched_late():
    """Its force is sent as soon as it is read: 125 us earlier after the sample than others."""
    late = (InjectionParams("late", tick=400, value=0.0003),)
    with LockStep(servo_params(), board_params(injections=late)) as stack:
        flown = as_records(stack.run(1100))
    # before: the first frame had waited for the first tick
    assert set(flown["delay_spread_us"][257:513]) == {2500}
    assert set(flown["delay_spread_us"][513:769]) == {125}
    assert set(flown["delay_spread_us"][769:]) == {0}


def test_damping_in_effect_is_what_the_board_says():
    with LockStep(servo_params(), board_params()) as stack:
        stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
        flown = as_records(stack.run(300))
    assert flown["active_damping_effect_ns_per_m"][-1] == pytest.approx(1.74, abs=COUNT_NS_PER_M)
    asked = flown["active_damping_ns_per_m"]
    assert flown["active_damping_effect_ns_per_m"][1:] == pytest.approx(asked[:-1], abs=1e-6)


@pytest.mark.parametrize(("kind", "count", "value"), FAULTS)
def test_link_fault_is_survived_without_a_jump(kind, count, value):
    injections = (InjectionParams(kind, tick=1000, count=count, value=value),)
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        enable(stack, FIG_4)
        perturbed(stack)
        flown = as_records(stack.run(1500))
        counts = stack.device.counts
    assert flown["state"][-1] == State.ENABLED
    assert kind == "late" or any(counts.values())
    assert not flown["flags"][-100:].any()
    ordinary = np.abs(np.diff(flown["force_n"][:400])).max()
    assert np.abs(np.diff(flown["force_n"])).max() < 4 * ordinary


@pytest.mark.parametrize(("kind", "count", "value"), FAULTS)
def test_probe_stream_says_what_it_lost(kind, count, value):
    injections = (InjectionParams(kind, tick=800, count=count, value=value),)
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        enable(stack, FIG_7)
        perturbed(stack)
        flown = as_records(stack.run(600))
    fresh = flown[(flown["flags"] & (Flag.MISSING_IN)) == 0]
    frames = [codec.decode_in(bytes(frame)) for frame in fresh["in_frame"]]
    indices = [frame.probe_index + n for frame in frames for n in range(len(frame.pairs))]
    assert indices == sorted(set(indices))
    assert indices[-1] - indices[0] >= 4 * 590


def test_packets_of_zero_length_behind_every_frame_change_nothing():
    flown = []
    for count in (0, 1000):
        injections = (InjectionParams("zero_length_in", tick=600, count=count),) if count else ()
        with LockStep(servo_params(), board_params(injections=injections)) as stack:
            enable(stack, FIG_4)
            perturbed(stack)
            flown.append(as_records(stack.run(1000)))
            counted = stack.device.counts["empty"]
    plain, odd = flown
    assert counted > 900
    for name in ("flags", "position_m", "force_n", "board_us", "state"):
        assert np.array_equal(plain[name], odd[name]), name


def test_replug_seeds_at_rest_and_comes_up_without_torque():
    injections = (InjectionParams("unplug", tick=1000, value=0.3),)
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        enable(stack, FIG_4)
        perturbed(stack)
        flown = as_records(stack.run(3000))
        counters = stack.gateway.counters()
    seeded = np.flatnonzero(flown["flags"] & Flag.SEEDED)
    assert len(seeded) == 1
    assert flown["velocity_m_per_s"][seeded[0]] == 0.0
    assert not flown["force_n"][seeded[0] :].any()
    assert counters["reconnects"] == 1


def test_missing_frames_beyond_the_limit_are_a_fault():
    injections = (InjectionParams("drop_in", tick=1000, count=30),)
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        enable(stack, FIG_4)
        flown = as_records(stack.run(1500))
    assert flown["fault"][-1] == BY_CODE["frames_lost"].number


def test_lost_gateway_heartbeat_faults_within_a_second():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        stack.gateway_alive = False
        flown = as_records(stack.run(1500))
    first = int(np.argmax(flown["state"] == State.FAULT))
    assert flown["fault"][first] == BY_CODE["gateway_lost"].number
    assert 700 <= first <= 1001


def test_gateway_is_alive_exactly_as_long_as_its_last_beat_is_young():
    """However rarely its word is read: from one second before the beat until one after it."""
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        beat_ns = stack.clock.now_ns() + 400_000_000
        stack.gateway.beat(beat_ns)  # of a clock that is 0.4 s ahead
        stack.loop.run(1800)
        flown = as_records(stack.gateway.records(stack.loop.tick - 1800, 1800)[0])
    alive = (flown["host"] & 2) > 0
    assert np.array_equal(alive, np.abs(flown["time_ns"] - beat_ns) < 1_000_000_000)
    assert 1300 < alive.sum() < 1500


def test_loop_that_is_entered_once_is_specialised():
    """As in the daemon; `replace` makes its code as new as in a process that has just begun."""
    fresh = FunctionType(ServoLoop.run.__code__.replace(), ServoLoop.run.__globals__)
    with LockStep(servo_params(), board_params()) as stack:
        fresh(stack.loop, 200)
    found = {one.opname for one in dis.get_instructions(fresh, adaptive=True)}
    assert {"LOAD_ATTR_INSTANCE_VALUE", "STORE_ATTR_INSTANCE_VALUE"} <= found


def test_stop_word_latches_without_a_gateway_and_reset_clears_it():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        press_stop(stack.mailbox.folder)
        flown = as_records(stack.run(50))
        assert flown["state"][-1] == State.STOPPED
        assert flown["actor"][-1] == 2
        stack.run(1000)  # for which nobody else resets it
        assert stack.do(Command.RESET).result is Result.APPLIED
        assert as_records(stack.run(10))["state"][-1] == State.DISABLED


def test_homing_against_the_simulated_stop_finds_its_position():
    home = HomeParams(
        method="stop",
        required=True,
        direction=-1,
        speed_m_per_s=0.05,
        force_n=0.5,
        position_m=-0.01,
    )
    params = servo_params(device=device_params(home=home))
    with LockStep(params, board_params(lower_stop_m=-0.004, upper_stop_m=0.016)) as stack:
        stack.run(5)
        assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED
        assert stack.do(Command.HOME).result is Result.APPLIED
        flown = as_records(stack.run(2500))
        assert flown["state"][-1] == State.DISABLED
        assert flown["homed"][-1] == 1
        assert np.abs(flown["force_n"]).max() <= 0.5 + 8.0 / 32767
        assert flown["position_m"][-1] == pytest.approx(-0.01, abs=2 * COUNT_M)
        assert stack.do(Command.ENABLE).result is Result.APPLIED


def test_perturbation_arrives_whole_and_keeps_the_fifo_level():
    wave = np.random.default_rng(5).integers(-3000, 3001, 4000)
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FREE)
        stack.load_waveform(wave.tolist())
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 4000.0, Value.LOOP: 0.0})
        flown = as_records(stack.run(1100))
    frames = [codec.decode_in(bytes(frame)) for frame in flown["in_frame"]]
    torque = np.array([pair[0] for frame in frames for pair in frame.pairs])
    start = int(np.argmax(torque != 0))
    begin = int(np.argmax(wave != 0))
    assert np.array_equal(torque[start : start + 4000 - begin], wave[begin:])
    assert not torque[start + 4000 - begin :].any()
    assert flown["perturbing"][-1] == 0
    levels = [frame.fifo_level for frame in frames[20:900]]
    assert min(levels) >= 2
    assert max(levels) <= 12
    assert not any(
        frame.status & (StatusBit.FIFO_UNDERRUN | StatusBit.FIFO_OVERFLOW)
        for frame in frames[20:900]
    )


def test_probe_pairs_give_the_exact_work_of_the_perturbation():
    """sum(F v T) over the pairs = kinetic energy gained + heat lost; here against the motion of
    a free mass.
    """
    with LockStep(servo_params(), board_params(viscous_ns_per_m=0.0)) as stack:
        enable(stack, FREE)
        stack.load_waveform([8000] * 40)
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 40.0, Value.LOOP: 0.0})
        flown = as_records(stack.run(40))
    frames = [codec.decode_in(bytes(frame)) for frame in flown["in_frame"]]
    board = board_params()
    pairs = np.array([pair for frame in frames for pair in frame.pairs], float)
    force = pairs[:, 0] * board.probe_torque_n_per_count
    velocity = pairs[:, 1] * board.probe_velocity_m_per_s_per_count
    work = float(np.sum(force * velocity) * 250e-6)
    speed = 8000 * board.probe_torque_n_per_count * 40 * 250e-6 / 0.008
    assert work == pytest.approx(0.5 * 0.008 * speed**2, rel=2e-3)


def test_end_of_the_process_is_recorded_as_a_stop_without_force():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        stack.loop.finish()
        last = as_records(stack.gateway.records(stack.loop.tick - 1, 1)[0])[0]
    assert (last["state"], last["actor"]) == (State.STOPPED, 0)
    assert last["force_n"] == 0.0


def test_stop_page_survives_a_reset_in_the_same_tick():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        stack.command(Command.RESET)  # refused while enabled
        press_stop(stack.mailbox.folder)
        assert as_records(stack.run(50))["state"][-1] == State.STOPPED
        stack.gateway.answers()
        stack.command(Command.RESET)
        press_stop(stack.mailbox.folder)
        assert as_records(stack.run(50))["state"][-1] == State.STOPPED
        stack.gateway.answers()
        stack.run(1000)
        assert stack.do(Command.RESET).result is Result.APPLIED


@pytest.mark.parametrize("page", [True, False])
def test_stop_is_not_undone_by_a_reset_that_waits_for_the_board(page):
    injections = (InjectionParams("amplifier_fault", tick=700, value=0.05),)
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        enable(stack, FIG_4)
        stack.run(300)
        stack.command(Command.RESET)
        stack.run(1)
        if page:
            press_stop(stack.mailbox.folder)
        else:
            stack.command(Command.STOP)
        flown = as_records(stack.run(50))
        results = {answer.seq: answer.result for answer in stack.gateway.answers()}
    assert flown["state"][-1] in (State.STOPPED, State.FAULT)
    assert len(results) == 1 + (not page)  # each has its answer


@pytest.mark.parametrize("pause_s", [3, 500, 5_000_000])
def test_pause_beyond_what_a_record_holds_is_survived(pause_s):
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        stack.clock.time_ns += pause_s * 10**9
        flown = as_records(stack.run(100))
        lost = stack.gateway.counters()["lost_slots"]
    assert flown["wake_ns"].max() == 2**31 - 1
    assert lost == pytest.approx(pause_s * 1000, abs=5)
    assert flown["lost_slots"][-1] == lost % 2**32


def test_late_tick_drops_whole_slots_and_never_catches_up():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        before = as_records(stack.run(600))  # the first second is counted apart
        stack.clock.time_ns += 7_400_000
        flown = as_records(stack.run(20))
    since_ns = flown["time_ns"].astype(np.int64) - int(before["time_ns"][-1])
    late_ns, *later_ns = since_ns.tolist()
    assert 7_400_000 <= late_ns < 8_400_000
    first_ns = -(-late_ns // 1_000_000) * 1_000_000
    assert later_ns == [first_ns + n * 1_000_000 for n in range(19)]
    assert flown["lost_slots"][-1] - before["lost_slots"][-1] == first_ns // 1_000_000 - 2


@pytest.mark.parametrize(("lost", "state"), [(10, State.ENABLED), (11, State.FAULT)])
def test_too_many_lost_slots_are_a_fault(lost, state):
    """More than ten within a second, on hardware; with a simulated board no one can be hurt."""
    with LockStep(servo_params(simulated=False), board_params()) as stack:
        enable(stack, FIG_4)
        stack.run(600)  # the first second is not counted
        for _ in range(lost):
            stack.clock.time_ns += 2_300_000
            flown = as_records(stack.run(30))
        assert int(flown["lost_slots"][-1]) == lost
    assert flown["state"][-1] == state
    assert state is State.ENABLED or flown["fault"][-1] == BY_CODE["lost_slots"].number


def test_replug_needs_homing_again():
    """The counter of a board that lost its supply starts anew wherever the device then is."""
    home = HomeParams(method="stop", required=True, direction=-1, speed_m_per_s=0.05, force_n=0.5)
    injections = (InjectionParams("unplug", tick=3000, value=0.2),)
    params = servo_params(device=device_params(home=home))
    with LockStep(
        params, board_params(lower_stop_m=-0.004, upper_stop_m=0.016, injections=injections)
    ) as stack:
        stack.run(5)
        stack.do(Command.HOME)
        assert as_records(stack.run(2500))["homed"][-1] == 1
        flown = as_records(stack.run(1500))
        assert flown["homed"][-1] == 0
        assert stack.do(Command.RESET).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED


def test_replug_without_room_for_the_report_goes_on(monkeypatch):
    def no_room(content):
        raise MailboxError("no room")

    with LockStep(
        servo_params(), board_params(injections=(InjectionParams("unplug", tick=1000, value=0.2),))
    ) as stack:
        stack.run(100)
        monkeypatch.setattr(stack.mailbox, "report", no_room)
        stack.run(2000)
        assert stack.loop.connection.linked
        assert stack.gateway.counters()["reconnects"] == 1


def test_board_is_let_go_even_if_the_last_tick_fails(monkeypatch):
    def broken(*_):
        raise ArithmeticError("a bug")

    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, {**FIG_4, Value.STIFFNESS: 1000.0})
        stack.loop.step = broken
        with pytest.raises(ArithmeticError, match="a bug"):
            stack.loop.finish()
        last = codec.decode_out(bytes(stack.device.out_buffer))
        assert (last.flags, last.torque, last.damping) == (int(OutFlag.FIFO_CLEAR), 0, 0)
        with pytest.raises(LinkLost, match="the link is not open"):
            stack.device.link.read(stack.device.in_buffer)
        monkeypatch.setattr(stack.loop, "finish", lambda: None)


OWN_WORDS = (
    layout.EPOCH_WORD,
    layout.SERVO_BEAT_WORD,
    layout.COMMAND_TAIL_WORD,
    layout.ANSWER_HEAD_WORD,
    layout.JOURNAL_HEAD_WORD,
    layout.CHECKPOINT_HEAD_WORD,
    *range(layout.COUNTER_WORD, layout.COUNTER_WORD + len(layout.COUNTERS)),
)


@pytest.mark.parametrize("garbage", [0, 12345, 2**63, 2**64 - 1])
def test_servo_survives_what_is_written_over_the_mailbox(garbage):
    with LockStep(
        servo_params(), board_params(injections=(InjectionParams("unplug", tick=900, value=0.1),))
    ) as stack:
        enable(stack, FIG_4)
        for word in (*OWN_WORDS, layout.COMMAND_HEAD_WORD, layout.ANSWER_TAIL_WORD):
            stack.gateway.words[word] = garbage
        stack.run(1500)
        for _ in range(2):
            with suppress(MailboxError):  # answers that are skipped
                stack.gateway.answers()
        assert stack.gateway.current
        assert stack.do(Command.RESET).result is Result.APPLIED
        assert stack.do(Command.ZERO).result is Result.APPLIED  # the board was unplugged
        assert stack.do(Command.ENABLE).result is Result.APPLIED
