"""`rig motor` on a board whose true sign, gain and offset are others than its device file's."""

import numpy as np
import pytest
from support.models import COUNT_N
from support.rig_hand import Hand
from support.rig_motor import FREE, FRICTION, HUNG, nothing

from hapticd.core.errors import AnalysisError, HapticdError
from hapticd.core.params import ScaleParams
from hapticd.model.params import TouchParams
from hapticd.protocol.view import as_records
from hapticd.rig.result import line
from hapticd.rig.steps.motor import (
    measure_gain,
    measure_sign,
)
from hapticd.settings.device import signs_hash


def test_a_board_without_authority_is_refused_by_name():
    """The amplifier does nothing though the board says that it is ready."""
    with Hand({"commissioning": True}, touch=TouchParams(coulomb_n=5.0, static_n=5.0)) as hand:
        result = measure_sign(hand.bench, nothing)
    assert not result.settled
    assert not result.changes
    assert "authority" in result.findings[0].remedy


def hanging(hand):
    """A person who hangs what is asked."""

    def ask(request):
        hand.pull_n = -9.80665 * request.amount
        hand.settle(2.0)

    return ask


def test_gain_and_offset_lie_in_their_intervals():
    """A motor of 20 % more than the file says, and one that pushes with 10 mN at a count of 0."""
    with Hand(touch=FRICTION, viscous_ns_per_m=2.0, **FREE) as hand:
        hand.gain = 1.2
        hand.offset_n = 0.01
        result = measure_gain(hand.bench, hanging(hand), HUNG)
    values = {one.name: one for one in result.values}
    gain = values["force.full_scale_n"]
    assert gain.low <= 1.2 * 32767 * COUNT_N <= gain.high
    assert gain.high - gain.low < 0.02 * gain.value
    offset = values["force.offset_count"]
    assert offset.low <= -0.01 / 1.2 / COUNT_N <= offset.high
    assert result.settled
    assert hand.bench.status().state == "disabled"


def test_a_cable_that_is_pulled_ends_the_step_and_can_be_plugged_again():
    with Hand({"commissioning": True}, touch=FRICTION, **FREE) as hand:
        board = hand.bench.stack.backend

        def out(cmd, **fields):
            if cmd == "set" and fields.get("at_tick"):
                board.unplug()
            return type(hand.bench).call(hand.bench, cmd, **fields)

        hand.bench.call = out
        with pytest.raises(HapticdError):
            measure_sign(hand.bench, nothing)
        records = as_records(hand.bench.run(50))
        assert not records["force_n"].any()
        assert hand.bench.status().state in ("fault", "disabled")
        del hand.bench.call
        board.plug()
        hand.bench.run(3000)
        hand.bench.reset()
        hand.bench.zero()
        assert measure_sign(hand.bench, nothing).settled


LIMIT_N = 0.8


@pytest.mark.parametrize("sign", [1, -1])
def test_the_sign_is_found_and_the_force_stays_below_a_tenth(sign):
    file = {"force": ScaleParams(COUNT_N, sign), "commissioning": True}
    with Hand(file, touch=FRICTION, **FREE) as hand:
        result = measure_sign(hand.bench, nothing)
        assert result.settled
        assert {(one.table, one.key): one.value for one in result.changes} == {
            ("force", "sign"): 1,
            ("commissioning", "signs_verified"): True,
            ("commissioning", "serial"): "SIM0001",
            ("commissioning", "firmware"): "1.0",
            ("commissioning", "signs"): signs_hash("SIM0001", "1.0", 1, 1),
            ("commissioning", "life"): hand.life,
        }
        worst_n = max(np.abs(result.arrays[f"force_n_{one}"]).max() for one in (0, 1))
        assert 0.0 < worst_n <= LIMIT_N + COUNT_N
        assert hand.bench.status().state == "disabled"


def test_a_handle_that_goes_the_same_way_both_times_is_refused():
    """A hand on it pushes down with 0.2 N whenever it feels something."""
    with Hand({"commissioning": True}, touch=FRICTION, **FREE) as hand:
        hand.reflex_n = -0.2
        result = measure_sign(hand.bench, nothing)
        assert not result.settled
        assert not result.changes
        assert "same way" in result.findings[-1].what


def test_a_handle_that_is_moved_is_not_pushed():
    with Hand({"commissioning": True}) as hand:
        hand.pull_n = 0.001
        with pytest.raises(AnalysisError, match="take your hand off"):
            measure_sign(hand.bench, nothing)
        assert hand.bench.status().state == "disabled"


def test_intervals_of_a_line_hold_nineteen_times_in_twenty():
    random = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 5)
    slopes = intercepts = 0
    for _ in range(1000):
        found = line(x, 2.0 * x + 0.5 + 0.01 * random.standard_normal(5))
        inside = np.abs(found.values - (2.0, 0.5)) <= found.halves
        slopes += inside[0]
        intercepts += inside[1]
    assert 930 <= slopes <= 970
    assert 930 <= intercepts <= 970
