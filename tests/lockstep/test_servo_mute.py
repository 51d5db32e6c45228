"""A perturbation that is asked for while nobody knows whether the board grants torque is refused:
it would play blindly, and at the release of an emergency stop that no frame told of.
"""

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.params import RealtimeParams
from hapticd.mailbox.layout import Command, Result, Value, values_of
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State
from hapticd.sim.axis import Probe
from hapticd.usb import codec
from hapticd.usb.frames import OutFlag

pytestmark = pytest.mark.usefixtures("either_way")


WAVE = {Value.SAMPLES: 4000.0, Value.LOOP: 1.0}


def asked_at(tick, *injections):
    """What is said to a perturbation in that tick, and the records from there on."""
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        stack.run(5)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        stack.load_waveform([2000] * 4000)
        stack.run(tick - stack.loop.tick)
        result = stack.do(Command.PERTURB_START, WAVE).result
        stack.run(60)
        flown = as_records(b"".join(stack.blocks))
    return result, flown[flown["tick"] >= tick]


def playing(flown):
    """Ticks whose OUT frame plays the perturbation."""
    sent = [codec.decode_out(bytes(one)) for one in flown["out_frame"]]
    return [bool(one.flags & OutFlag.PERTURB) for one in sent]


@pytest.mark.parametrize("press_s", [0.0, 0.004])
@pytest.mark.parametrize("late", [3, 4, 5, 6])
def test_no_perturbation_begins_while_frames_are_lost(late, press_s):
    lost = InjectionParams("drop_in", tick=700, count=7)
    press = InjectionParams("emergency_stop", tick=700, value=press_s)
    result, flown = asked_at(700 + late, lost, *((press,) if press_s else ()))
    assert result is Result.REFUSED_CAUSE
    assert flown["state"][-1] == State.ENABLED
    assert not any(playing(flown))


@pytest.mark.parametrize("late", [1, 2, 3])
def test_no_perturbation_begins_while_the_board_withholds_torque(late):
    press = InjectionParams("emergency_stop", tick=700, value=0.004)
    result, flown = asked_at(700 + late, press)
    assert result is Result.REFUSED_NO_AUTHORITY
    assert flown["state"][-1] == State.ENABLED
    assert not any(playing(flown))


def test_a_perturbation_begins_behind_a_single_lost_frame():
    lost = InjectionParams("drop_in", tick=700, count=1)
    result, flown = asked_at(700, lost)
    assert result is Result.APPLIED
    assert all(playing(flown)[1:])


@pytest.fixture
def played(monkeypatch):
    """Torques [N] of the board's perturbation, one for each of its intervals with any."""
    found = []
    end_interval = Probe.end_interval

    def heard(probe, *motion):
        if probe.torque_n:
            found.append(probe.torque_n)
        end_interval(probe, *motion)

    monkeypatch.setattr(Probe, "end_interval", heard)
    return found


@pytest.mark.parametrize("late", [3, 4, 5, 6, 7])
def test_enable_and_a_perturbation_together_move_nothing_while_frames_are_lost(late, played):
    """The enable is obeyed and withholds nothing yet in its tick. At 500 Hz a lost frame costs no
    slot, so that the board would play what this tick sends.
    """
    lost = InjectionParams("drop_in", tick=700, count=7)
    slow = RealtimeParams(mode="off", rate_hz=500.0)
    board = board_params(rate_hz=500.0, injections=(lost,))
    with LockStep(servo_params(realtime=slow), board) as stack:
        stack.run(5)
        stack.load_waveform([2000] * 4000)
        stack.run(700 + late - stack.loop.tick)
        stack.gateway.post(Command.ENABLE, 1, 0, values_of({}))
        stack.gateway.post(Command.PERTURB_START, 1, 0, values_of(WAVE))
        stack.run(20)
        said = [one.result for one in stack.gateway.answers()][-2:]
    heard = late == 7  # frames come again
    assert said == [Result.APPLIED, Result.APPLIED if heard else Result.REFUSED_CAUSE]
    assert bool(played) == heard
