"""A board is looked at before it may make force: does it say what its device file says, and does
its bus leave time for a tick?
"""

import dataclasses
import json
import math

import pytest
from support.boards import board_params
from support.models import COUNT_M, COUNT_N, device_params, servo_params

from hapticd.core.params import HomeParams, RealtimeParams, ScaleParams, UsbParams
from hapticd.mailbox import files
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import DEVICE_DIFFERS
from hapticd.servo.safety import State
from hapticd.sim.board import hello
from hapticd.usb import codec
from hapticd.usb.device import SEED
from hapticd.usb.search import differences


def report(stack):
    return json.loads((stack.mailbox.folder / files.REPORT).read_text())


def flown(servo, board, ticks=5):
    """What enabling says to this servo with this board, and the records of `ticks` ticks."""
    with LockStep(servo, board) as stack:
        stack.run(5)
        answer = stack.do(Command.ENABLE)
        return answer.result, stack.loop.connection.check.report(), as_records(stack.run(ticks))


# --- the hello against the device file ------------------------------------------------------------

OTHER_BOARDS = {
    "force full scale": {"force_n_per_count": 80.0 / 32767},
    "damping full scale": {"active_damping_ns_per_m_per_count": 5.0 / 65535},
    "probe torque full scale": {"probe_torque_n_per_count": 0.2 / 32767},
    "probe velocity full scale": {"probe_velocity_m_per_s_per_count": 20.0 / 32767},
    "current full scale": {"current_a_per_count": 1.0 / 32767},
    "voltage full scale": {"voltage_v_per_count": 300.0 / 32767},
    "position": {"position_m_per_count": 2.0 * COUNT_M},
    "force limit": {"force_limit_n": 80.0},
    "serial": {"hello_serial": "SIM0002"},
    "capability temperature": {"lacks": ("temperature",)},
    "capability probe": {"lacks": ("probe",)},
}


@pytest.mark.parametrize("name", OTHER_BOARDS)
def test_hello_that_contradicts_the_device_file_bars_force_by_name(name):
    device = device_params(relies_on=("probe", "temperature"))
    servo = servo_params(device=device)
    result, said, ticks = flown(servo, board_params(**OTHER_BOARDS[name]))
    assert result is Result.REFUSED_DEVICE
    assert set(ticks["state"]) == {State.DISABLED}
    assert [line.partition(":")[0] for line in said["differences"]] == [name]


def test_every_difference_is_named_at_once():
    changes = {key: value for item in OTHER_BOARDS.values() for key, value in item.items()}
    changes["lacks"] = ("probe", "temperature")
    device = device_params(relies_on=("probe", "temperature"))
    _, said, _ = flown(servo_params(device=device), board_params(**changes))
    assert sorted(line.partition(":")[0] for line in said["differences"]) == sorted(OTHER_BOARDS)


def test_both_numbers_are_said_with_their_unit():
    board = board_params(force_n_per_count=80.0 / 32767)
    _, said, _ = flown(servo_params(), board)
    assert said["differences"] == [
        "force full scale: the board says 80 N, the device file 8 N",
    ]


@pytest.mark.parametrize(("factor", "agrees"), [(1.09, True), (0.91, True), (1.11, False)])
def test_a_calibration_may_correct_a_scale_by_a_tenth(factor, agrees):
    force = ScaleParams(COUNT_N)
    board = board_params(force_n_per_count=COUNT_N * factor)
    result, _, _ = flown(servo_params(device=device_params(force=force)), board)
    assert result is (Result.APPLIED if agrees else Result.REFUSED_DEVICE)


MEASURED = ScaleParams(COUNT_N, measured_by="rig motor")


@pytest.mark.parametrize(
    ("factor", "agrees"), [(1.25, True), (1 / 1.25, True), (2.0, False), (0.5, False), (10, False)]
)
def test_a_measured_scale_may_differ_by_half_as_much_again_and_never_by_a_unit(factor, agrees):
    """The motor makes 1 / factor of what the board's firmware says; its limit was lowered too."""
    device = device_params(force=MEASURED, force_limit_n=8.0)
    said = hello(board_params())._replace(
        force_full_scale_n=8.0 * factor, force_limit_n=8.0 * max(1.0, factor)
    )
    assert (differences(said, device) == ()) is agrees


def test_what_is_typed_may_not_differ_as_what_is_measured():
    said = hello(board_params())._replace(force_full_scale_n=10.0)
    (found,) = differences(said, device_params())
    assert found.startswith("force full scale")


def test_a_limit_beyond_what_a_weak_motor_reaches_contradicts():
    """The board clamps at 8 N of its own scale, with a motor of 0.8 that are 6.4 N; the file still
    says 8.
    """
    weak = dataclasses.replace(MEASURED, per_count=0.8 * COUNT_N)
    said = hello(board_params())
    assert differences(said, device_params(force=weak, force_limit_n=6.4)) == ()
    (found,) = differences(said, device_params(force=weak, force_limit_n=8.0))
    assert found == "force limit: the board says 8 nominal N, the device file 10 nominal N"


@pytest.mark.parametrize("force", [ScaleParams(COUNT_N), MEASURED])
@pytest.mark.parametrize("number", [math.nan, 0.0, -8.0, math.inf])
def test_number_that_is_none_contradicts(number, force):
    said = hello(board_params())._replace(force_full_scale_n=number)
    found = differences(said, device_params(force=force))
    assert found[0].startswith("force full scale: the board says")


def test_signs_that_were_seen_with_another_firmware_bar_force():
    """Whoever flashes a board may have turned a sign: somebody has to look again."""
    seen = device_params(signs_firmware="0.9")
    result, said, ticks = flown(servo_params(device=seen), board_params())
    assert result is Result.REFUSED_DEVICE
    assert set(ticks["state"]) == {State.DISABLED}
    (words,) = said["differences"]
    assert words.startswith("firmware: the board has 1.0, its signs were verified with 0.9")
    assert "signs_verified = false" in words
    assert "hapticd rig motor" in words


@pytest.mark.parametrize("firmware", ["", "1.0"])
def test_signs_of_this_firmware_or_of_any_bar_nothing(firmware):
    device = device_params(signs_firmware=firmware)
    result, said, _ = flown(servo_params(device=device), board_params())
    assert result is Result.APPLIED
    assert (said["board"]["serial"], said["board"]["firmware"]) == ("SIM0001", "1.0")


def test_index_that_homing_needs_has_to_be_there():
    device = device_params(home=HomeParams(method="index"))
    with LockStep(servo_params(device=device), board_params()) as stack:
        stack.run(5)
        assert stack.do(Command.HOME).result is Result.REFUSED_DEVICE
        assert "capability index" in stack.loop.connection.check.report()["differences"][0]


def flashed(stack, place, value):
    """From its next start on the board's hello has the byte `value` at `place`."""
    replies = stack.backend._port.board._replies
    greeting = (0xC0, 1, 0)
    other = bytearray(replies[greeting])
    other[place] = value
    replies[greeting] = bytes(other)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [(8, 7, "firmware: the board has 1.7"), (0, 0, "the board speaks protocol")],
)
def test_a_board_that_was_flashed_while_it_was_there_is_looked_at_again(place, value, said):
    """It starts anew without leaving the bus: the next life has to say who it is."""
    anew = InjectionParams("restart", tick=50)
    servo = servo_params(device=device_params(signs_firmware="1.0"))
    with LockStep(servo, board_params(injections=(anew,))) as stack:
        stack.run(30)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        flashed(stack, place, value)
        ticks = as_records(stack.run(400))
        assert not ticks["host"][0] & DEVICE_DIFFERS
        assert ticks["host"][-1] & DEVICE_DIFFERS
        stack.do(Command.RESET)
        stack.do(Command.ZERO)
        assert stack.do(Command.ENABLE).result is Result.REFUSED_DEVICE
        assert report(stack)["differences"][0].startswith(said)


def test_a_loop_that_never_pauses_bars_a_board_that_was_flashed():
    anew = InjectionParams("restart", tick=50)
    servo = servo_params(device=device_params(signs_firmware="1.0"))
    with LockStep(servo, board_params(injections=(anew,))) as stack:
        stack.run(30)
        flashed(stack, 8, 7)
        stack.loop.run(600)  # as a daemon runs: without an end
        ticks = as_records(b"".join(stack.run(1) for _ in range(4)))
        of_that_run = ticks[(ticks["tick"] >= 300) & (ticks["tick"] < 630)]
        assert len(of_that_run) == 330
        assert (of_that_run["host"] & DEVICE_DIFFERS).all()


def test_a_board_that_only_started_anew_may_make_force_again():
    anew = InjectionParams("restart", tick=50)
    servo = servo_params(device=device_params(signs_firmware="1.0"))
    with LockStep(servo, board_params(injections=(anew,))) as stack:
        stack.run(400)
        stack.do(Command.RESET)
        stack.do(Command.ZERO)
        assert stack.do(Command.ENABLE).result is Result.APPLIED


def test_another_board_at_the_plug_is_looked_at_again(monkeypatch):
    """The board that comes back is another one: it is barred, though the first was not."""
    away = InjectionParams("unplug", tick=50, value=0.01)
    reports = []
    write_report = ServoMailbox.report

    def noted(mailbox, content):
        reports.append(content)
        write_report(mailbox, content)

    monkeypatch.setattr(ServoMailbox, "report", noted)
    with LockStep(servo_params(), board_params(injections=(away,))) as stack:
        stack.run(30)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        flashed(stack, 16, ord("X"))  # of its serial number
        assert not as_records(stack.run(1))["host"][0] & DEVICE_DIFFERS
        assert as_records(stack.run(250))["host"][-1] & DEVICE_DIFFERS
        again = next(one for one in reports if "reconnected" in one)
        assert again["differences"]  # already at its first hello
        assert stack.do(Command.RESET).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.REFUSED_DEVICE
        assert report(stack)["differences"][0].startswith("serial: the board says 'XIM0001'")


@pytest.mark.parametrize("sign", [1, -1])
def test_temperature_that_is_not_measured_is_unknown_not_zero(sign):
    """Whatever 0 counts would mean: with this scale of sign -1 they mean 130 degC."""
    scale = ScaleParams(0.01, sign, 13_000.0 if sign < 0 else 0.0)
    device = device_params(temperature=scale, relies_on=("temperature",))
    result, _, ticks = flown(servo_params(device=device), board_params(lacks=("temperature",)))
    assert result is Result.REFUSED_DEVICE
    assert all(math.isnan(value) for value in ticks["winding_c"])
    assert set(ticks["state"]) == {State.DISABLED}


@pytest.mark.parametrize("sign", [1, -1])
def test_device_file_that_does_not_rely_on_temperature_does_without(sign):
    scale = ScaleParams(0.01, sign, 13_000.0 if sign < 0 else 0.0)
    servo = servo_params(device=device_params(temperature=scale))
    result, _, ticks = flown(servo, board_params(lacks=("temperature",)), 600)
    assert result is Result.APPLIED
    assert set(ticks["state"]) == {State.ENABLED}
    assert all(math.isnan(value) for value in ticks["winding_c"])


# --- what the bus costs ---------------------------------------------------------------------------


def far_board(pair_ms, **changes):
    """A board whose pair of transfers takes `pair_ms`, two fifths of it on the way out."""
    pair_us = 1000.0 * pair_ms
    return board_params(out_transport_us=0.4 * pair_us, in_transport_us=0.6 * pair_us, **changes)


IN_TURN, IN_FLIGHT = UsbParams(in_flight=False), UsbParams(in_flight=True)
HELD = {  # way, pair [ms]: phase
    (IN_TURN, 0.3): 0.5,
    (IN_TURN, 0.36): 0.375,
    (IN_TURN, 0.4): 0.3125,
    (IN_FLIGHT, 0.3): 0.625,
    (IN_FLIGHT, 0.36): 0.5,
    (IN_FLIGHT, 0.4): 0.5,
}


@pytest.mark.parametrize("depth", [0, 2])
@pytest.mark.parametrize(("usb", "pair_ms"), HELD)
def test_phase_leaves_room_for_the_measured_pair(usb, pair_ms, depth):
    with LockStep(servo_params(usb=usb), far_board(pair_ms, in_queue_depth=depth)) as stack:
        first, _, *others = as_records(stack.run(5))["arrival"]
        assert (first, *others) == (SEED, 0, 0, 0)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        stack.do(Command.SET, {Value.STIFFNESS: 200.0, Value.VIRTUAL_DAMPING: 3.0})
        ticks = as_records(stack.run(3000))
        found = stack.loop.connection.check.report()["transport"]
    phase = HELD[usb, pair_ms]
    assert ticks["lost_slots"][-1] == 0
    assert set(ticks["state"]) == {State.ENABLED}
    assert not ticks["arrival"][1:].any()
    # in flight the latch is part of what is measured, and the board's grid is 1/16 of a period
    assert found["pair_us"] == pytest.approx(1000 * pair_ms, abs=32 if usb.in_flight else 1e-3)
    assert found["sample_phase"] == phase
    assert found["delay_us"] == 1000 * (1 - phase)
    # and that is the delay that the board's own clock shows
    assert set(ticks["delay_us"][10:]) == {round(1000 * (1 - phase))}


@pytest.mark.parametrize("usb", [IN_TURN, IN_FLIGHT])
def test_without_a_bus_the_phase_stays_and_no_frame_is_sent(usb):
    with LockStep(servo_params(usb=usb), board_params()) as stack:
        ticks = as_records(stack.run(40))
        found = stack.loop.connection.check.report()["transport"]
    assert found == {
        "pair_us": 0.0,
        "sample_phase": 0.875,
        "delay_us": 125.0,
        "rate_hz": 1000.0,
        "in_flight": usb.in_flight,
    }
    assert ticks["board_us"][0] == 875


REFUSED = {  # way, pair [ms]: rate that is held [Hz]
    (IN_TURN, 0.8): 820.0,
    (IN_TURN, 1.3): 510.0,
    (IN_FLIGHT, 1.3): 730.0,
}


@pytest.mark.parametrize(("usb", "pair_ms"), REFUSED)
def test_bus_that_is_too_slow_bars_force_and_names_the_rate(usb, pair_ms):
    result, said, ticks = flown(servo_params(usb=usb), far_board(pair_ms), 50)
    assert result is Result.REFUSED_RATE
    assert set(ticks["state"]) == {State.DISABLED}
    assert said["transport"]["rate_hz"] == REFUSED[usb, pair_ms]


@pytest.mark.parametrize(("usb", "pair_ms"), REFUSED)
def test_the_rate_that_is_named_is_held(usb, pair_ms):
    rate_hz = REFUSED[usb, pair_ms]
    servo = servo_params(usb=usb, realtime=RealtimeParams(mode="off", rate_hz=rate_hz))
    result, _, ticks = flown(servo, far_board(pair_ms, rate_hz=rate_hz), 3000)
    assert result is Result.APPLIED
    assert ticks["lost_slots"][-1] == 0
    assert set(ticks["state"]) == {State.ENABLED}


def test_board_that_cannot_set_its_phase_keeps_seven_eighths():
    """Then 0.3 ms is too much at 1 kHz, and a quarter of the rate is not."""
    fixed = far_board(0.3, lacks=("sample_phase",))
    result, said, _ = flown(servo_params(usb=IN_TURN), fixed)
    assert result is Result.REFUSED_RATE
    assert said["transport"]["sample_phase"] == 0.875
    slow = said["transport"]["rate_hz"]
    servo = servo_params(usb=IN_TURN, realtime=RealtimeParams(mode="off", rate_hz=slow))
    result, _, ticks = flown(servo, dataclasses.replace(fixed, rate_hz=slow), 500)
    assert result is Result.APPLIED
    assert ticks["lost_slots"][-1] == 0


@pytest.mark.parametrize(("rate_hz", "lost"), [(800.0, 0.0), (500.0, 0.375)])
def test_samples_of_the_probe_that_are_lost_at_a_low_rate_are_told(rate_hz, lost):
    """At 500 Hz three eighths of them, as the indices of those that came show."""
    servo = servo_params(realtime=RealtimeParams(mode="off", rate_hz=rate_hz))
    with LockStep(servo, board_params(rate_hz=rate_hz)) as stack:
        told = stack.loop.connection.check.report()["unsampled"]
        frames = [
            codec.decode_in(bytes(one)) for one in as_records(stack.run(400))["in_frame"][20:]
        ]
    came = sum(len(frame.pairs) for frame in frames[:-1])
    made = frames[-1].probe_index - frames[0].probe_index
    assert 1.0 - came / made == pytest.approx(lost, abs=0.01)
    assert ("a frame carries 5 of 8 samples" in told) == (lost > 0.0)


@pytest.mark.parametrize(("usb", "delay_us"), [(IN_TURN, 688), (IN_FLIGHT, 500)])
def test_board_that_starts_anew_is_given_its_phase_again(usb, delay_us):
    begun = (InjectionParams("restart", tick=200),)
    with LockStep(servo_params(usb=usb), far_board(0.4, injections=begun)) as stack:
        ticks = as_records(stack.run(2000))
    assert ticks["lost_slots"][-1] == ticks["lost_slots"][700]
    assert set(ticks["delay_us"][-500:]) == {delay_us}


def test_phase_is_asked_for_again_before_the_first_command_is_obeyed():
    """Not only with the tally, every 256 ticks: slots would be lost under force until then."""
    begun = (InjectionParams("restart", tick=1334),)  # 34 frames measured: tick 1300 of the loop
    with LockStep(servo_params(usb=IN_TURN), far_board(0.4, injections=begun)) as stack:
        stack.run(1320)  # past the grace of the start, in which lost slots are counted apart
        assert stack.do(Command.RESET).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        ticks = as_records(stack.run(150))
        assert stack.loop.tick < 6 * 256
    assert ticks["lost_slots"][-1] == ticks["lost_slots"][2]


@pytest.mark.parametrize(("usb", "phase"), [(IN_TURN, 0.3125), (IN_FLIGHT, 0.5)])
def test_board_that_comes_back_is_measured_again(usb, phase):
    away = (InjectionParams("unplug", tick=200, value=0.05),)
    with LockStep(servo_params(usb=usb), far_board(0.4, injections=away)) as stack:
        stack.run(1000)
        stack.do(Command.RESET)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        lost = as_records(stack.run(1))["lost_slots"][-1]
        assert as_records(stack.run(1000))["lost_slots"][-1] == lost
        assert report(stack)["transport"]["sample_phase"] == phase
