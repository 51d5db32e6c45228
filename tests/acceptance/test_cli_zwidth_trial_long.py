"""`hapticd zwidth trial` and `import`: multisines, windows, admittance, live devices, and what
is said of a result.
"""

import json
import re
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from support.cli_zwidth_trial import LINEAR, MULTISINE, run
from support.spectral_trials import mass_damper, record

from hapticd.cli import change
from hapticd.model.params import InjectionParams
from hapticd.run.lockstep import LockStepClient
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped


def test_run_of_multisines_is_drawn_again_with_its_admittance(tmp_path, capsys):
    run(["trial", *LINEAR, *MULTISINE, "--out", str(tmp_path), "--plot"], capsys)
    names = {"trial.png", "trial_admittance.png"}
    drawn = (tmp_path / "trial.svg").read_text()
    assert "predicted" in drawn
    for name in (*names, "trial.svg"):
        (tmp_path / name).unlink()
    assert run(["report", str(tmp_path)], capsys)[0] == 0
    assert names <= {path.name for path in tmp_path.iterdir()}
    assert "predicted" in (tmp_path / "trial.svg").read_text()


@pytest.mark.parametrize("virtual", ["-B", "--viscous"])
def test_damping_is_electrical_and_viscous_is_virtual(virtual, tmp_path, capsys):
    """As in `map` and in `hapticd damping`."""
    record = np.random.default_rng(1).normal(0.0, 0.2, (2, 40_000))
    np.savez(tmp_path / "a.npz", force=record[0], velocity=record[1], fs=4000.0)
    for words in (
        ["trial", "--seconds", "8", "-K", "0", "-M", "0"],
        ["import", str(tmp_path / "a.npz")],
    ):
        code, out, _ = run(
            [*words, virtual, "3", "--active-damping", "1.74", "--out", str(tmp_path / words[0])],
            capsys,
        )
        assert code == 0
        assert "K 0 N/m, B 3 N s/m, M 0 kg, active damping 1.74 N s/m\n" in out


@pytest.fixture
def daemon(monkeypatch):
    """The shipped configuration's daemon, on virtual time."""
    settings = load(shipped("config") / "hapticd.toml")

    @contextmanager
    def connected(instance, timeout_s=2.0):
        with LockStepClient(servo_params(settings, instance), board_params(settings)) as bench:
            yield bench

    monkeypatch.setattr(change, "connect", connected)


def test_live_trial_names_the_daemons_device_before_it_moves(daemon, tmp_path, capsys):
    code, out, err = run(
        [
            "trial",
            "live",
            "-K",
            "50",
            "-B",
            "0.5",
            "--seconds",
            "8",
            "--out",
            str(tmp_path),
            "--plot",
        ],
        capsys,
    )
    assert code == 0
    who = "daemon 'default', device 'simulated display'"
    assert out.startswith(f"SIMULATED {who}: K 50 N/m, B 0.5 N s/m, M 0 kg")
    assert (
        "enables the device 'simulated display' of daemon 'default' (simulated) in K 50 N/m, B 0.5"
        " N s/m, M 0 kg, active damping 0 N s/m, and perturbs it; Ctrl-C ends the trial and"
        " switches the force off" in err
    )
    assert "with K = 0" not in err
    told = json.loads((tmp_path / "run.json").read_text())
    assert told["origin"] == who
    assert told["scene"] == "simulated"
    assert "stable as far as seen" in out
    for _ in ("drawn with the trial", "drawn again"):
        assert "predicted" in (tmp_path / "trial.svg").read_text()
        (tmp_path / "trial.svg").unlink()
        run(["report", str(tmp_path)], capsys)


def test_multisine_trial_runs_by_the_whole_stack(tmp_path, capsys):
    words = [
        "trial",
        "lockstep",
        *LINEAR,
        *MULTISINE,
        "--realisations",
        "3",
        "--out",
        str(tmp_path),
        "--json",
    ]
    code, out, _ = run(words, capsys)
    assert code == 0
    found = json.loads(out)
    assert found["multisine"]["realisations"] == 3
    assert found["flown_again"] == 0
    assert 0.0 < found["max_command_n"] < found["command_limit_n"] == 8.0


@pytest.fixture
def early(tmp_path):
    """A passive device whose velocity is sampled half a sample early."""
    force, velocity = record(
        lambda f: mass_damper(0.008, 4.0)(f) * np.exp(2j * np.pi * f * 125e-6), 5, 120_000
    )
    np.savez(tmp_path / "early.npz", force_n=force, velocity_m_per_s=velocity, rate_hz=4000.0)
    return str(tmp_path / "early.npz")


def test_known_high_pass_is_taken_out_of_a_record(tmp_path, capsys):
    force, velocity = record(
        lambda f: mass_damper(0.008, 1.0, 100.0)(f) * (1.0 + 0.5 / (1j * f)), 7
    )
    np.savez(tmp_path / "ac.npz", force_n=force, velocity_m_per_s=velocity, rate_hz=4000.0)
    words = ["trial", str(tmp_path / "ac.npz"), "--estimator", "h_force"]
    _, out, _ = run([*words, "--out", str(tmp_path / "a")], capsys)
    assert re.search(r"take a corner that is known out with --high-pass 0\.[45]\d*,", out)
    _, out, _ = run([*words, "--high-pass", "0.5", "--out", str(tmp_path / "b")], capsys)
    assert "high-pass" not in out
    assert out.splitlines()[1].startswith("passive in band")


@pytest.mark.parametrize(("typed", "taken_out_s"), [([], 4.45e-5), (["--skew", "0"], 0.0)])
def test_live_trial_takes_out_the_skew_of_the_device_file(
    monkeypatch, tmp_path, capsys, typed, taken_out_s
):
    settings = load(shipped("config") / "hapticd.toml")
    servo = servo_params(settings, "default")
    servo = replace(servo, device=replace(servo.device, probe_skew_us=44.5))

    @contextmanager
    def connected(instance, timeout_s=2.0):
        with LockStepClient(servo, board_params(settings)) as bench:
            yield bench

    monkeypatch.setattr(change, "connect", connected)
    words = ["trial", "live", "-K", "50", "-B", "0.5", "--seconds", "5", "--psd", "1e-5"]
    code, _, err = run([*words, *typed, "--out", str(tmp_path)], capsys)
    assert code == 0
    kept = json.loads((tmp_path / "run.json").read_text())
    assert kept["skew_taken_out_s"] == pytest.approx(taken_out_s)
    assert "lags its force by 44.5 us" in err
    assert f"{1e6 * taken_out_s:.3g} us are corrected" in err


def test_live_trial_that_leaves_the_device_in_fault_ends_with_5(monkeypatch, tmp_path, capsys):
    settings = load(shipped("config") / "hapticd.toml")
    board = replace(
        board_params(settings), injections=(InjectionParams("unplug", tick=14000, value=0.3),)
    )

    @contextmanager
    def connected(instance, timeout_s=2.0):
        with LockStepClient(servo_params(settings, "default"), board) as bench:
            yield bench

    monkeypatch.setattr(change, "connect", connected)
    words = ["trial", "live", "-K", "50", "-B", "0.5", "--seconds", "20", "--out", str(tmp_path)]
    code, out, err = run(words, capsys)
    assert "ended early: fault: " in out, err
    assert code == 5


def test_live_trial_without_stiffness_ends_at_the_stop(daemon, tmp_path, capsys):
    code, _, err = run(["trial", "live", "--out", str(tmp_path)], capsys)
    assert "in K 0 N/m, B 0 N s/m, M 0 kg" in err
    assert "with K = 0 no force keeps the device within its travel; use -K 20" in err
    assert "travel: the device stands at" in err
    assert code == 65


def test_live_trial_of_a_scene_of_another_device_says_so(daemon, tmp_path, capsys):
    words = [
        "trial",
        "live",
        "--scene",
        "fig4",
        "-M",
        "0",
        "--seconds",
        "8",
        "--out",
        str(tmp_path),
    ]
    code, out, err = run(words, capsys)
    assert code == 0
    assert (
        "scene 'fig4' is of the device 'weir2008', not of the daemon's: the scene's environment is"
        " rendered on 'simulated display'" in err
    )
    assert "device 'simulated display': K 100 N/m, B 1 N s/m, M 0 kg" in out
