"""`rig encoder` on a board whose true sign and scale are others than its device file's."""

import numpy as np
import pytest
from support.models import COUNT_M
from support.rig_hand import Hand
from test_rig_encoder import DISTANCE, FREE

from hapticd.core.params import ScaleParams
from hapticd.rig.steps.encoder import Distance, measure, scale_of


def person(hand, random, towards=1.0):
    """Somebody who does what is asked, places the handle within some um, and whose positive x is
    the simulated plant's.
    """

    def ask(request):
        if request.action == "let go":
            hand.let_go()
        elif request.action == "move":
            start = hand.position_m
            hand.hold(start + 1e-6)
            hand.moving = towards * 2e-6
            original = hand.bench.run

            def run(ticks):
                data = b""
                for _ in range(ticks):
                    hand.held_m += hand.moving
                    data += original(1)
                return data

            hand.bench.run = run
        else:
            hand.moving = 0.0
            if request.action == "hold":
                placed_m = 0.002 + 2e-6 * random.standard_normal()
                hand.held_m = placed_m + towards * request.amount
            hand.bench.stack.run(20)

    return ask


@pytest.mark.parametrize("sign", [1, -1])
def test_sign_and_scale_are_found_though_the_file_is_wrong(sign):
    """The file says 20 % too little, and both signs are tried."""
    with Hand({"position": ScaleParams(COUNT_M / 1.2, sign)}, **FREE) as hand:
        result = measure(hand.bench, person(hand, np.random.default_rng(5)), DISTANCE)
        changes = {one.key: one.value for one in result.changes}
        (scale,) = [one for one in result.values if one.name == "position.m_per_count"]
        assert result.settled
        assert changes["sign"] == 1
        assert scale.low <= COUNT_M <= scale.high
        assert hand.bench.status().state == "disabled"


@pytest.mark.parametrize(("sign", "doubted"), [(1, False), (-1, True)])
def test_another_sign_of_position_takes_the_verified_signs_back(sign, doubted):
    """Which way the motor pushes was seen by the sign before."""
    with Hand({"position": ScaleParams(COUNT_M, sign)}, **FREE) as hand:
        result = measure(hand.bench, person(hand, np.random.default_rng(5)), DISTANCE)
    changes = {(one.table, one.key): one.value for one in result.changes}
    assert changes["position", "sign"] == 1
    assert (changes.get(("commissioning", "signs_verified")) is False) == doubted


def test_the_scale_lies_in_its_interval_nineteen_times_in_twenty():
    random = np.random.default_rng(11)
    inside = 0
    for _ in range(1000):
        steps = (0.01 + 5e-6 * random.standard_normal(3)) / COUNT_M
        scale = scale_of(steps, Distance(0.01, 1e-12))
        inside += scale.low <= COUNT_M <= scale.high
    assert 930 <= inside <= 970
