"""A slow processor on virtual time: which rates it holds, and what the servo says of it."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params
from support.processor import TICK_US, Processor

from hapticd.core.arrays import Records
from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.gateway.tick_times import room_of
from hapticd.mailbox.layout import STAGES, Command, LateCause
from hapticd.protocol.answers import Room
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep

RATES_HZ = (1000.0, 2000.0, 4000.0, 8000.0)
TICKS = 1200
SETTLED = 200
LEFT = 0.25  # of a period, that a tick shall leave
RARE = 0.01  # share of ticks whose costs add up by chance


def ticked(rate_hz: float, slowness: float, in_flight: bool = False) -> Records:
    """Records of an enabled servo on a processor that is `slowness` times slower."""
    realtime = RealtimeParams(mode="off", rate_hz=rate_hz, grace_s=0.0)
    servo = servo_params(realtime=realtime, usb=UsbParams(in_flight=in_flight))
    safety = replace(servo.safety, lost_slots_limit=10_000, missing_frames_limit=100)
    servo = replace(servo, safety=safety)
    with LockStep(servo, board_params(rate_hz=rate_hz, sample_phase=0.25)) as stack:
        Processor(stack, slowness)
        stack.run(5)
        stack.do(Command.ENABLE)
        return as_records(stack.run(TICKS))[SETTLED:]


def causes(records: Records) -> Counter[LateCause]:
    return Counter(LateCause(cause) for cause in records["late_cause"].tolist() if cause)


def room(records: Records, rate_hz: float) -> Room:
    stages = {
        stage: {"count": len(records), "p50_us": float(np.median(records[f"{stage}_ns"])) / 1000.0}
        for stage in STAGES
    }
    return room_of(stages, rate_hz)


@pytest.mark.parametrize("in_flight", [True, False])
@pytest.mark.parametrize("slowness", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_ticks_are_late_only_where_one_takes_longer_than_its_period(
    rate_hz: float, slowness: float, in_flight: bool
) -> None:
    """An unoptimised build, a small board's processor, and one that cannot hold 8 kHz."""
    found = causes(ticked(rate_hz, slowness, in_flight))
    if slowness * TICK_US < 1e6 / rate_hz:
        assert not found
    else:
        assert found.total() > 0.9 * (TICKS - SETTLED)
        assert found[LateCause.STEP] > 0.9 * found.total()


@pytest.mark.parametrize("slowness", [1.0, 3.0, 8.0])
def test_rate_that_the_servo_names_leaves_a_quarter_of_the_period(slowness: float) -> None:
    """Measured at 1 kHz, then run at that rate, at most 12 kHz."""
    named = room(ticked(1000.0, slowness), 1000.0)
    assert named.tick_us == pytest.approx(slowness * TICK_US, rel=0.1)
    assert not named.short
    rate_hz = min(named.highest_rate_hz, 12_000.0)
    records = ticked(rate_hz, slowness)
    assert causes(records).total() <= RARE * len(records)
    taken_us = sum(records[f"{stage}_ns"] for stage in STAGES[1:]) / 1000.0
    assert np.median(taken_us) <= (1.0 - LEFT) * 1.02e6 / rate_hz
