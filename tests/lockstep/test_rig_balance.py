"""The balance of forces: its closed forms, and made-up records of a handle whose truth is known."""

import numpy as np
import pytest

from hapticd.core.errors import AnalysisError
from hapticd.rig.experiment import PerturbationRun
from hapticd.rig.steps.force_balance import fit_rigid_mass
from hapticd.rig.steps.force_terms import Clock, Handle, commanded, friction


def staircase(force_n, at_us):
    """A run with commands alone: a tick each millisecond."""
    ticks = np.arange(force_n.size)
    torque = np.zeros(4 * force_n.size)
    return PerturbationRun(
        1000.0 * ticks, 0.0 * ticks, force_n, -1.0 + 0.0 * ticks, at_us, 0.0, torque, torque
    )


@pytest.mark.parametrize(("lag_us", "smooth_us"), [(0.0, 0.0), (330.0, 0.0), (930.0, 800.0)])
def test_a_command_is_delayed_and_smoothed_exactly(lag_us, smooth_us):
    """Against sums over steps of 1 us."""
    force = np.random.default_rng(1).standard_normal(40)
    run = staircase(force, np.zeros(40))
    found = commanded(run, Clock(0.0, 1.0, 0.0, 0.0), lag_us, smooth_us**2)
    time = np.arange(40_000) + 0.5 - (lag_us - smooth_us)
    held = force[np.clip(np.floor(time / 1000.0), 0, 39).astype(int)]
    smooth = np.empty(held.size)
    level = force[0]
    keep = np.exp(-1.0 / smooth_us) if smooth_us else 0.0
    for n, target in enumerate(held):
        # mean over the step of an exponential approach
        after = target + (level - target) * keep
        smooth[n] = target + (level - target) * smooth_us * (1.0 - keep) if smooth_us else target
        level = after
    triangle = np.concatenate((np.arange(250) + 0.5, 249.5 - np.arange(250))) / 250.0**2
    means = np.correlate(smooth, triangle, "valid")[::250]
    np.testing.assert_allclose(found[8:150], means[8:150], atol=2e-6)


@pytest.mark.parametrize("push_n", [-0.04, -0.01, 0.0, 0.03])
def test_friction_that_holds_is_as_much_as_pushes(push_n):
    handle = Handle(0.01, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0)
    found = friction(np.full(5, push_n), np.zeros(5), handle)
    np.testing.assert_allclose(found, push_n / 0.05, atol=1e-12)


def test_friction_turns_where_the_velocity_does():
    """From -2 mm/s with 20 m/s^2 more than friction: at rest after a fifth of the interval."""
    handle = Handle(0.01, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0)
    push = np.full(5, 0.35)
    slope = (0.35 + 0.05) / 0.01
    before = -0.002 + slope * 250e-6 * (np.arange(5) - 2)
    mean = before + 0.5 * slope * 250e-6
    stop = 0.002 / slope
    rest = 250e-6 - stop
    mean[2] = (-0.5 * 0.002 * stop + 0.5 * (0.3 / 0.01) * rest**2) / 250e-6
    found = friction(push, mean, handle)
    assert found[1] == -1.0
    assert found[2] == pytest.approx(1.0 - 2.0 * stop / 250e-6, abs=0.05)


def test_nothing_moves_is_said():
    still = staircase(np.zeros(12_000), np.zeros(12_000))
    with pytest.raises(AnalysisError, match="nothing moved"):
        fit_rigid_mass([still])
