"""`rig motor --spring` and `--offset` at rigs whose gain and offset are others than the file's."""

import pytest
from support.blind_rig import BlindRig
from support.models import COUNT_N
from support.rig_hand import Hand
from support.rig_spring import SPRING

from hapticd.model.params import TouchParams
from hapticd.rig.steps import encoder, motor
from hapticd.rig.steps.motor import Spring, measure_offset, measure_spring

FRICTION = TouchParams(coulomb_n=0.03, static_n=0.03)
FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5}


def test_gain_lies_in_its_interval_whatever_the_friction_and_the_offset():
    """A spring of 300 N/m between the handle and a frame, slack at 1 mm."""
    with Hand(touch=FRICTION, viscous_ns_per_m=2.0, **FREE) as hand:
        hand.gain = 1.2
        hand.offset_n = 0.05
        free = hand.axis.plant.step

        def step(state, force_n, torque_n, damping, count):
            hand.pull_n = -300.0 * (hand.position_m - 1e-3)
            return free(state, force_n, torque_n, damping, count)

        def ask(request):
            if request.action == "spring":
                hand.axis.plant = hand.axis.plant._replace(step=step)
            else:
                hand.axis.plant = hand.axis.plant._replace(step=free)
            hand.settle()

        result = measure_spring(hand.bench, ask, SPRING)
        assert hand.bench.status().state == "disabled"
    (gain, _) = result.values
    assert gain.low <= 1.2 * 32767 * COUNT_N <= gain.high
    assert gain.high - gain.low < 0.02 * gain.value
    assert result.settled


@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_offset_alone_lies_in_its_interval(gain):
    with Hand(touch=FRICTION, viscous_ns_per_m=2.0, **FREE) as hand:
        hand.gain = gain
        hand.offset_n = 0.02
        result = measure_offset(hand.bench, lambda request: hand.settle())
    (offset,) = result.values
    assert offset.low <= -0.02 / gain / COUNT_N <= offset.high
    assert [one.key for one in result.changes] == ["offset_count"]


@pytest.mark.slow
def test_a_blind_rig_is_measured_by_a_spring():
    with BlindRig(31) as rig:
        distance = encoder.Distance(0.01)
        rig.write(encoder.measure(rig.bench, rig.ask, distance))
        rig.restart()
        rig.write(motor.measure_sign(rig.bench, rig.ask))
        rig.restart()
        result = measure_spring(rig.bench, rig.ask, Spring(400.0, 0.005))
        (gain, _) = result.values
        assert result.settled
        assert gain.low <= rig.true("force.full_scale_n") <= gain.high
