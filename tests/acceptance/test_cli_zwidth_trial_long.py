"""`hapticd zwidth trial` and `import`: multisines, windows, admittance, live devices, and what
is said of a result.
"""

import json
from contextlib import contextmanager

import numpy as np
import pytest
from support.cli_zwidth_trial import LINEAR, MULTISINE, run

from hapticd.cli import change
from hapticd.run.lockstep_client import LockStepClient
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
