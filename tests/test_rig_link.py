"""`rig link` on the simulated board, as it is and with faults that somebody put in."""

import dataclasses

import numpy as np
import pytest
from models import board_params, servo_params

from hapticd.errors import CommandError
from hapticd.params import InjectionParams
from hapticd.rig.link import drift_of, measure, median_of
from hapticd.zwidth.lockstep import LockStepBench

SECONDS = 2.0


def found(**board):
    with LockStepBench(servo_params(), board_params(**board)) as bench:
        result = measure(bench, SECONDS)
        return (
            {value.name: value for value in result.values},
            {one.what.partition(":")[0]: one for one in result.findings},
        )


def test_a_good_board_has_its_delay_and_no_complaint():
    """Sampled 0.875 periods after the command: 125 us from sample to force."""
    values, findings = found()
    assert values["delay"].value == pytest.approx(125.0, abs=2.0)
    assert values["clock drift"].value == pytest.approx(0.0, abs=1.0)
    assert {one.verdict for one in findings.values()} == {"ok", "not done"}
    assert findings["watchdog of the board"].verdict == "not done"


def test_missing_frames_are_counted_and_refused_with_a_remedy():
    lost = InjectionParams("drop_in", probability=0.01)
    _, findings = found(injections=(lost,))
    assert findings["missing_in"].verdict == "refused"
    assert "cable" in findings["missing_in"].remedy
    assert findings["write_errors"].verdict == "ok"


def test_a_device_that_is_enabled_is_left_alone():
    with LockStepBench(servo_params(), board_params()) as bench:
        bench.enable()
        with pytest.raises(CommandError, match="disabled"):
            measure(bench, SECONDS)
        assert bench.status()["state"] == "enabled"


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


def test_missing_features_are_named():
    servo = servo_params()
    lacking = dataclasses.replace(servo.device, relies_on=("probe", "temperature"))
    with LockStepBench(
        dataclasses.replace(servo, device=lacking), board_params(lacks=("temperature",))
    ) as bench:
        result = measure(bench, SECONDS)
    assert any("temperature" in one.what and one.verdict == "refused" for one in result.findings)
