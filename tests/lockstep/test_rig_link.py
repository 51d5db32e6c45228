"""`rig link` on the simulated board, as it is and with faults that somebody put in."""

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.errors import CommandError
from hapticd.rig.steps.link import drift_of, measure, median_of
from hapticd.run.lockstep import LockStepClient

SECONDS = 2.0


def found(**board):
    with LockStepClient(servo_params(), board_params(**board)) as bench:
        result = measure(bench, SECONDS)
        return (
            {value.name: value for value in result.values},
            {one.what.partition(":")[0]: one for one in result.findings},
        )


def watched(ms=50.0, change=lambda axis: None):
    """What `rig link` finds of a board that states a watchdog of `ms`, with `change` made to it."""
    with LockStepClient(servo_params(), board_params(watchdog_ms=ms)) as bench:
        change(bench.stack.backend._port._axis)
        before = bench.status().counters
        result = measure(bench, SECONDS)
        after = bench.status().counters
        bench.run(10)  # the level that was switched on for it is on its way out
        status = bench.newest
    lost = after["lost_slots"] + after["late_events"] - before["lost_slots"] - before["late_events"]
    return result, status, lost


def test_a_board_whose_watchdog_does_not_work_is_asked_once_and_refused():
    def dead(axis):
        axis._watchdog = 1 << 40

    result, _, _ = watched(change=dead)
    (found,) = [one for one in result.findings if one.what.startswith("watchdog")]
    assert found.verdict == "refused"
    assert "timer" in found.remedy
    assert len(result.arrays["silences"]) == 1
    assert not result.settled


def test_a_watchdog_of_seconds_is_not_waited_for():
    result, _, _ = watched(2000.0)
    (found,) = [one for one in result.findings if one.what.startswith("watchdog")]
    assert found.verdict == "warning"
    assert len(result.arrays["silences"]) == 0


def test_a_device_that_is_enabled_is_left_alone():
    with LockStepClient(servo_params(), board_params()) as bench:
        bench.enable()
        with pytest.raises(CommandError, match="disabled"):
            measure(bench, SECONDS)
        assert bench.status().state == "enabled"


def test_drift_lies_in_its_interval_nineteen_times_in_twenty():
    """50 ppm under the jitter of a host that wakes late by a random time."""
    random = np.random.default_rng(7)
    inside = 0
    for _ in range(200):
        board_us = 1000 * np.arange(4000)
        late_us = random.gamma(2.0, 10.0, 4000)
        host_ns = np.round(1000 * (board_us / (1 + 50e-6) + late_us)).astype(np.int64)
        drift = drift_of(host_ns, board_us)
        inside += drift.low <= 50.0 <= drift.high
    assert 180 <= inside <= 198


def test_the_median_has_the_interval_of_its_order_statistics():
    value = median_of("delay", np.arange(10_000.0), "us")
    assert value.value == pytest.approx(4999.5)
    assert value.high - value.low == pytest.approx(2 * 0.98 * 100, abs=3)
