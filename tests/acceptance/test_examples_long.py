"""Examples run as they stand; those that need a daemon are in the process tests."""

import importlib.util
import itertools

import numpy as np
import pytest
from support.examples import EXAMPLES, virtual


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_envelope_example_draws_what_passed(tmp_path):
    pytest.importorskip("matplotlib")
    passed = loaded("envelope").main(tmp_path, trials=40, seconds=15.0)
    assert 0 < passed < 40
    assert (tmp_path / "envelope.png").stat().st_size > 10_000


def test_sweep_moves_less_under_stiffer_springs_without_a_daemon(tmp_path):
    moved = [float(line.split(":")[1].split()[0]) for line in virtual("sweep", tmp_path)]
    assert len(moved) == 4
    assert moved[0] > moved[-1] > 0.0


def test_toggle_moves_less_with_damping_without_a_daemon(tmp_path):
    lines = virtual("toggle", tmp_path)
    speeds = [float(line.split(":")[1].split()[0]) for line in lines]
    assert max(speeds[0], speeds[2]) < min(speeds[1], speeds[3])


def test_wall_is_stiffer_with_damping_without_a_daemon(tmp_path):
    without, damped = (float(line.split()[-2]) for line in virtual("wall", tmp_path))
    assert 0.0 < 2.0 * without < damped


def test_mass_behind_a_coupling_is_felt_as_computed_without_a_daemon(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    alone, coupled, *lines = virtual("virtual_coupling", tmp_path)
    assert 5.0 < float(alone.split()[-4]) < 50.0  # g
    assert coupled.endswith("held: False")
    example = loaded("virtual_coupling")
    for line in lines:
        frequency_hz = float(line.split()[0])
        mass = 2j * np.pi * frequency_hz * example.MASS_KG + example.FRICTION_NS_PER_M
        spring = example.STIFFNESS_N_PER_M / (2j * np.pi * frequency_hz)
        exact = abs(mass * spring / (mass + spring) + example.ACTIVE_NS_PER_M)
        assert float(line.split("felt")[1].split()[0]) == pytest.approx(exact, rel=0.2)


def test_jnd_finds_what_the_observer_notices_without_a_daemon(tmp_path):
    (line,) = virtual("jnd", tmp_path, "--simulated", "--pause", "0.05")
    assert 4.0 < float(line.split()[2]) < 36.0  # of 12 %, by eight reversals
    assert len((tmp_path / "jnd.csv").read_text().splitlines()) > 20


def test_steps_act_at_their_ticks_without_a_daemon(tmp_path):
    ticks = [int(line.split()[1].rstrip(",")) for line in virtual("steps", tmp_path)]
    assert [after - before for before, after in itertools.pairwise(ticks)][2:5] == [500] * 3
