"""`rig probe`: closed forms on made-up motions, and the simulated board with other gains and signs
than its device file's.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.rig_hand import Hand
from support.rig_probe import FREE, FRICTION, MASS, N, motion, told

from hapticd.core.errors import AnalysisError
from hapticd.core.params import ScaleParams
from hapticd.rig.excitation import LINES_HZ, lines, sine_run
from hapticd.rig.steps.probe import (
    force_gain,
    measure,
)
from hapticd.rig.steps.probe_fits import fit_added_mass, fit_velocity_channel


def holds(value, truth):
    return value.low <= truth <= value.high


def test_force_and_velocity_gain_lie_in_their_intervals_nineteen_times_in_twenty():
    """Without what masses and encoder add, which made-up data do not err by."""
    exact = replace(MASS, tolerance=0.0)
    level = -2.0 * np.pi * LINES_HZ * 0.2 / 4000.0  # a skew
    force = velocity = 0
    for seed in range(0, 80, 2):
        bare = motion(0.008, seed)
        of_velocity = fit_velocity_channel(lines(bare))
        found = fit_added_mass(bare, motion(0.028, seed + 1), of_velocity, level)
        gain = force_gain(found, exact, 0.0)
        force += abs(gain.per_count / N - 1.0) <= gain.relative_half
        velocity += abs(of_velocity.counts * N - 1.0) <= of_velocity.relative_half
    assert force >= 37
    assert velocity >= 37


def test_the_probe_of_another_truth_is_found_and_nothing_is_left_on():
    """Both signs are the other ones, and its full scales are 8 % more and 6 % less."""
    file = {
        "probe_torque": ScaleParams(N, -1),
        "probe_velocity": ScaleParams(N, -1),
    }
    board = {
        "probe_torque_n_per_count": 1.08 * N,
        "probe_velocity_m_per_s_per_count": 0.94 * N,
    }
    with Hand(file, touch=FRICTION, **board, **FREE) as hand:
        result = measure(hand.bench, hand.ask, MASS, with_one_signal=False)
        assert hand.bench.status().state == "disabled"
        assert not hand.bench.newest["perturbing"]
    values = told(result)
    assert holds(values["probe_torque.full_scale_n"], 2.16)
    assert holds(values["probe_velocity.full_scale_m_per_s"], 1.88)
    half = values["probe_torque.full_scale_n"].high / values["probe_torque.full_scale_n"].value - 1
    assert half < 0.01
    changes = {(one.table, one.key): one.value for one in result.changes}
    assert changes["probe_torque", "sign"] == 1
    assert changes["probe_velocity", "sign"] == 1


def test_what_shakes_is_kept_by_a_lease():
    """So a process that hangs or dies ends it."""
    leased = []
    with Hand(touch=FRICTION, **FREE) as hand:

        def noted(cmd, **fields):
            if fields.get("action") == "start":
                leased.append(dict(hand.bench.status().leases))
            return type(hand.bench).call(hand.bench, cmd, **fields)

        hand.bench.call = noted
        sine_run(hand.bench)
        assert not hand.bench.status().leases
    assert leased
    assert all("measuring" in one for one in leased)


def test_a_board_without_a_probe_is_told_so():
    with Hand(lacks=("probe",)) as hand, pytest.raises(AnalysisError, match="no probe inputs"):
        measure(hand.bench, hand.ask, MASS)


def test_ctrl_c_ends_perturbation_and_force():
    with Hand(touch=FRICTION, **FREE) as hand:

        def interrupted(topics, look_s=0.05):
            if hand.bench.newest["perturbing"]:
                raise KeyboardInterrupt
            return type(hand.bench).messages(hand.bench, topics, look_s)

        hand.bench.messages = interrupted
        with pytest.raises(KeyboardInterrupt):
            measure(hand.bench, hand.ask, MASS)
        hand.bench.run(5)
        assert hand.bench.status().state == "disabled"
        assert not hand.bench.newest["perturbing"]


def test_authority_that_is_lost_ends_the_step():
    with Hand(touch=FRICTION, **FREE) as hand:

        def pressed(cmd, **fields):
            answer = type(hand.bench).call(hand.bench, cmd, **fields)
            if fields.get("action") == "start":
                hand.axis.press_stop(True)
            return answer

        hand.bench.call = pressed
        with pytest.raises(AnalysisError, match="force ended meanwhile"):
            sine_run(hand.bench)
        assert hand.bench.status().state == "fault"
        assert not hand.bench.newest["perturbing"]


def test_a_handle_that_wanders_off_is_let_go():
    with Hand(touch=FRICTION, **FREE) as hand:

        def pulled(cmd, **fields):
            hand.pull_n = 0.3 if fields.get("action") == "start" else hand.pull_n
            return type(hand.bench).call(hand.bench, cmd, **fields)

        hand.bench.call = pulled
        with pytest.raises(AnalysisError, match="beyond"):
            sine_run(hand.bench)
        assert hand.bench.status().state == "disabled"
