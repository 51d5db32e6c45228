"""`rig encoder` on a board whose true sign and scale are others than its device file's."""

import struct

import numpy as np
import pytest
from support.models import COUNT_M
from support.rig_hand import Hand

from hapticd.core.errors import AnalysisError
from hapticd.rig.steps.encoder import Distance, analyse, measure, passages
from hapticd.usb import frames

DISTANCE = Distance(0.01, 10e-6)
FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5}


def arrays(**changes):
    moving = np.floor(np.linspace(0.0, 5000.0, 5000))
    start = {"rest": np.zeros(2000), "moving": moving, "steps": np.full(3, 20_000.0)}
    return start | changes


def test_an_encoder_that_is_stuck_is_refused_by_name():
    result = analyse(arrays(moving=np.zeros(5000)), DISTANCE, COUNT_M)
    assert not result.settled
    assert not result.changes
    assert any("stuck" in one.remedy for one in result.findings)


def test_a_dead_bit_is_named():
    result = analyse(arrays(moving=arrays()["moving"] // 2 * 2), DISTANCE, COUNT_M)
    assert any("bit 0" in one.what for one in result.findings)


def test_steps_that_go_the_other_way_are_refused():
    result = analyse(arrays(steps=np.array([2e4, -2e4, 2e4])), DISTANCE, COUNT_M)
    assert not result.settled


def test_a_distance_typed_ten_times_wrong_is_refused():
    result = analyse(arrays(steps=np.full(3, 20_000.0)), Distance(0.1), COUNT_M)
    assert not result.settled
    assert not result.changes


def test_an_index_mark_is_found_and_written_where_homing_uses_it():
    """It lies 4000 counts to positive x of x = 0; the encoder counts down as x grows."""
    marks = np.array([-4000.0, -4001.0])
    moving = -arrays()["moving"]
    given = arrays(marks=marks, moving=moving, steps=np.full(3, -20_000.0))
    result = analyse(given, DISTANCE, COUNT_M, "index")
    (mark,) = [one for one in result.values if one.name == "home.position_m"]
    assert mark.low <= 4000.5 * 0.5e-6 <= mark.high
    assert {(one.table, one.key) for one in result.changes} >= {("home", "position_m")}
    by_stop = analyse(given, DISTANCE, COUNT_M, "stop")
    assert not [one for one in by_stop.changes if one.table == "home"]


def test_an_index_mark_that_wanders_is_not_written():
    given = arrays(marks=np.array([4000.0, 4100.0]))
    result = analyse(given, DISTANCE, COUNT_M, "index")
    assert result.settled
    assert not [one for one in result.changes if one.table == "home"]
    assert any("do not home" in one.remedy for one in result.findings)
    unseen = analyse(arrays(marks=np.array([])), DISTANCE, COUNT_M, "index")
    assert any("not passed" in one.what for one in unseen.findings)


def test_a_frame_tells_where_the_mark_was():
    """30 counts before the sample that lies at 1000."""
    frame = bytearray(frames.IN_BYTES)
    struct.pack_into("<h", frame, 26, 30)
    records = np.zeros(3, [("status", "<u4"), ("in_frame", f"V{frames.IN_BYTES}")])
    records["status"][1] = frames.StatusBit.INDEX
    records["in_frame"][1] = np.void(bytes(frame))
    assert passages(records, np.array([0.0, 1000.0, 2000.0])).tolist() == [970.0]


def test_a_distance_in_millimetres_is_refused_before_anything_is_asked():
    asked = []
    with Hand(**FREE) as hand, pytest.raises(AnalysisError, match="is it in millimetres"):
        measure(hand.bench, asked.append, Distance(10.0))
    assert not asked
