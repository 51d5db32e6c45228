"""Trials of the whole product in lock-step on the emulated board and on the simulated one: the same
verdicts, and the same damping delivered.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from support.pico_chip import Verb
from support.pico_trial import chip_in_lock_step, display, fault_on_chip, record_on_chip

from hapticd.core.errors import AnalysisError
from hapticd.run.lockstep import LockStepClient
from hapticd.settings.scene import load_scene
from hapticd.signal.verdict import Verdict
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.trial import TrialParams, TrialResult, judged, plan_trial, run_trial

ENVIRONMENT = (500.0, 2.0, 0.0)
ON, MORE = 1.74, 3.48  # N s/m
SECONDS = 8.0
BAND_HZ = (5.0, 100.0)
SLOPE = 0.02


class Pair(NamedTuple):
    """A trial on both boards."""

    simulated: TrialResult
    chip: TrialResult


@cache
def trials(active_damping: float) -> Pair:
    trial = Trial(ENVIRONMENT, active_damping, seconds=SECONDS)
    plan = plan_trial(TrialParams(trial, load_scene("fig7")))
    with LockStepClient(*display()) as bench:
        simulated = run_trial(plan, daemon_source(bench))
    return Pair(simulated, judged(plan, record_on_chip(trial)))


def told(verdict: Verdict) -> tuple[object, ...]:
    return verdict.answer, verdict.stability, verdict.within_90_deg


def real_part(result: TrialResult) -> float:
    """The mean of Re Z over the band [N s/m]."""
    z = result.measured
    inside = (z.frequency_hz >= BAND_HZ[0]) & (z.frequency_hz <= BAND_HZ[1])
    return float(np.real(z.impedance_ns_per_m[inside]).mean())


def test_verdict_with_damping_is_that_of_the_simulated_board() -> None:
    pair = trials(ON)
    assert told(pair.chip.verdict) == told(pair.simulated.verdict)


def test_environment_without_damping_runs_away_on_both() -> None:
    trial = Trial(ENVIRONMENT, 0.0, seconds=SECONDS)
    plan = plan_trial(TrialParams(trial, load_scene("fig7")))
    with LockStepClient(*display()) as bench:
        with pytest.raises(AnalysisError):
            run_trial(plan, daemon_source(bench))
        fault = bench.status().fault
    assert fault_on_chip(trial) == fault


def test_damping_delivered_has_the_slope_of_the_simulated_board() -> None:
    pairs = trials(ON), trials(MORE)
    simulated, chip = (
        real_part(pairs[1][board]) - real_part(pairs[0][board]) for board in range(2)
    )
    assert chip / simulated == pytest.approx(1.0, abs=SLOPE)


def test_servo_of_a_board_that_hangs_comes_back_disabled() -> None:
    """The chip's watchdog resets it: the link is lost, the board is found in another life, and no
    force comes back.
    """
    with chip_in_lock_step(display()) as (bench, rig):
        bench.set(K=100.0, B=2.0)
        bench.enable()
        bench.run(50)
        assert rig.chip.state.amplifier == 1
        rig.chip.tell(Verb.HANG)
        bench.run(50)
        assert bench.status().state == "fault"
        assert rig.chip.state.amplifier == 0
        bench.run(2000)
        bench.reset()
        bench.run(50)
        assert bench.status().state == "disabled"
        assert bench.stack.device.counts["lives"] == 1
        assert rig.chip.state.amplifier == 0
