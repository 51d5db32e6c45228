"""What `hapticd zwidth trial` says: what would decide, which device is moved, what a sine is, which faults are taken out."""

import json
import re
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from spectral_trials import exact_trial, mass_damper, record

from hapticd.analysis.diagnostics import Finding
from hapticd.analysis.impedance import impedance
from hapticd.analysis.passivity import judge
from hapticd.analysis.verdict import two_digits
from hapticd.cli import change
from hapticd.cli.app import main
from hapticd.cli.zwidth.trial_words import compared, needed
from hapticd.measure.lockstep import LockStepBench
from hapticd.measure.referee import Referee
from hapticd.measure.scenes import device_scene, scene_of_device
from hapticd.measure.sources import Trial
from hapticd.measure.trial import Layout, TrialParams
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.resources import shipped


def run(arguments, capsys):
    """(exit code, stdout, stderr)"""
    code = main(["zwidth", *arguments])
    told = capsys.readouterr()
    return code, told.out, told.err


def judged_as(layout, seconds_needed, *findings):
    """A result that is not decided."""
    verdict = replace(judge(exact_trial(mass_damper(), 0.99), channels=False), answer="undecided", findings=findings)
    verdict = replace(verdict, seconds=90.0, seconds_needed=seconds_needed)
    return SimpleNamespace(verdict=verdict, plan=SimpleNamespace(params=TrialParams(Trial(), multisine=layout)))


@pytest.mark.parametrize(
    ("layout", "seconds_needed", "findings", "said"),
    [
        (None, 123.4, (), "a record like it of some 120 s would decide"),
        (None, 901.0, (), "a record more than 10 times as long would be needed: the margin is not told from 0"),
        (None, float("inf"), (), "a record more than 10 times as long would be needed: the margin is not told from 0"),
        (Layout(8), 123.4, (), "some 11 realisations would decide"),
        (Layout(8), 123.4, (Finding("distortion", "x"),), "some 11 realisations would decide; where friction distorts, noise"),
        (Layout(8), 9e4, (), "many more than 8 realisations would be needed; use noise (--excitation noise)"),
        (
            None,
            0.0,
            (Finding("lost_slots", "x", voids=True), Finding("line", "y")),
            "no length of a record decides with lost_slots",
        ),
    ],
)
def test_what_would_decide_is_said_as_far_as_it_is_known(layout, seconds_needed, findings, said):
    assert needed(judged_as(layout, seconds_needed, *findings)).startswith(said)


def test_length_that_decides_is_never_0():
    assert two_digits(0.001) == "1"


def test_stepped_sine_is_compared_in_words():
    z = exact_trial(mass_damper(), 0.99)
    result = SimpleNamespace(verdict=judge(z, channels=False), measured=impedance(z))
    said = compared(result, Referee(np.array([3.0, 5.0]), np.array([1.0 + 1j, np.nan]), 0.2, np.array([0.0123, np.nan])))
    assert "the sines move the device at 12.3 to 12.3 mm/s rms, the noise at" in said
    assert "dry friction is another damping at each amplitude" in said
    assert said.endswith("the verdict is the noise's")


def test_stepped_sine_says_how_fast_it_moved(tmp_path, capsys):
    """A sine of 0.2 N rms on mass m and damping b at f: v = F / |Z|, as long as nothing but f moves."""
    words = ["trial", "--scene", "theory", "-K", "0", "--seconds", "8", "--stepped-sine", "--out", str(tmp_path)]
    code, out, _ = run(words, capsys)
    assert code == 0
    assert "another damping at each amplitude" in out
    told = json.loads((tmp_path / "run.json").read_text())["stepped_sine"]
    moved, f = np.array(told["velocity_rms_m_per_s"]), np.array(told["frequency_hz"])
    size = np.abs([complex(*pair) for pair in told["impedance_ns_per_m"]])
    assert moved[2:8] == pytest.approx(0.2 / size[2:8], rel=0.05)
    assert f.size == 12


@pytest.fixture
def early(tmp_path):
    """A passive device whose velocity is sampled half a sample early."""
    force, velocity = record(lambda f: mass_damper(0.008, 4.0)(f) * np.exp(2j * np.pi * f * 125e-6), 5, 120_000)
    np.savez(tmp_path / "early.npz", force_n=force, velocity_m_per_s=velocity, rate_hz=4000.0)
    return str(tmp_path / "early.npz")


@pytest.mark.parametrize("verb", ["trial", "import"])
def test_known_skew_is_taken_out_of_a_record(verb, early, tmp_path, capsys):
    _, out, _ = run([verb, early, "--out", str(tmp_path / "a")], capsys)
    assert "undecided in band" in out
    assert "or take a skew that is known out with --skew -0.00012" in out
    assert "no length of a record decides with channel_skew in it: mend that first" in out
    code, out, _ = run([verb, early, "--skew", "-125e-6", "--out", str(tmp_path / "b")], capsys)
    assert code == 0
    assert out.splitlines()[1].startswith("passive in band")
    assert json.loads((tmp_path / "b" / "run.json").read_text())["skew_taken_out_s"] == -125e-6


def test_known_high_pass_is_taken_out_of_a_record(tmp_path, capsys):
    force, velocity = record(lambda f: mass_damper(0.008, 1.0, 100.0)(f) * (1.0 + 0.5 / (1j * f)), 7)
    np.savez(tmp_path / "ac.npz", force_n=force, velocity_m_per_s=velocity, rate_hz=4000.0)
    words = ["trial", str(tmp_path / "ac.npz"), "--estimator", "h_force"]
    _, out, _ = run([*words, "--out", str(tmp_path / "a")], capsys)
    assert re.search(r"take a corner that is known out with --high-pass 0\.[45]\d*,", out)
    _, out, _ = run([*words, "--high-pass", "0.5", "--out", str(tmp_path / "b")], capsys)
    assert "high-pass" not in out
    assert out.splitlines()[1].startswith("passive in band")


@pytest.fixture
def daemon(monkeypatch):
    """The shipped configuration's daemon, on virtual time."""
    settings = load(shipped("config") / "hapticd.toml")

    @contextmanager
    def connected(instance, timeout_s=2.0):
        with LockStepBench(servo_params(settings, instance), board_params(settings)) as bench:
            yield bench

    monkeypatch.setattr(change, "connect", connected)


def test_live_trial_names_the_daemons_device_before_it_moves(daemon, tmp_path, capsys):
    code, out, err = run(["trial", "live", "-K", "50", "-B", "0.5", "--seconds", "8", "--out", str(tmp_path), "--plot"], capsys)
    assert code == 0
    who = "daemon 'default', device 'simulated display'"
    assert out.startswith(f"SIMULATED {who}: K 50 N/m, B 0.5 N s/m, M 0 kg")
    assert (
        "enables the device 'simulated display' of daemon 'default' (simulated) in K 50 N/m, B 0.5 N s/m, M 0 kg, "
        "added damping 0 N s/m, and shakes it; Ctrl-C ends it, force off" in err
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


def test_live_trial_without_stiffness_ends_at_the_stop(daemon, tmp_path, capsys):
    code, _, err = run(["trial", "live", "--out", str(tmp_path)], capsys)
    assert "in K 0 N/m, B 0 N s/m, M 0 kg" in err
    assert "with K = 0 nothing holds the device in its travel; -K 20 would" in err
    assert "travel: the device stands at" in err
    assert code == 65


def test_live_trial_of_a_scene_of_another_device_says_so(daemon, tmp_path, capsys):
    words = ["trial", "live", "--scene", "fig4", "-M", "0", "--seconds", "8", "--out", str(tmp_path)]
    code, out, err = run(words, capsys)
    assert code == 0
    assert "scene 'fig4' is of the device 'weir2008', the daemon has 'simulated display': what the scene says is rendered on" in err
    assert "device 'simulated display': K 100 N/m, B 1 N s/m, M 0 kg" in out


def test_help_says_what_live_does(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = run(["trial", "--help"], capsys)
    said = " ".join(out.replace("│", " ").split())
    assert "live: the daemon's device, ENABLED by this" in said
    assert "live without --scene they are 0" in said
    assert "`live` enables the daemon's device by itself, says so, shakes it, and disables it at the end and on Ctrl-C" in said


def test_device_is_known_by_its_name():
    assert scene_of_device("Weir 2008 display") == device_scene("weir2008")
    assert scene_of_device("nobody's display") is None
    assert "viscous" in {effect.key for effect in device_scene("simulated").effects}
