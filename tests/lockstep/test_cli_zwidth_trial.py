"""`hapticd zwidth trial` and `import`: multisines, windows, admittance, live devices, and what
is said of a result.
"""

import json
import re
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.cli_zwidth_trial import LINEAR, MULTISINE, run
from support.spectral_trials import exact_trial, mass_damper, record
from typer.main import get_command

from hapticd.cli import change
from hapticd.cli.app import command_line, main
from hapticd.cli.zwidth.trial import compared, needed
from hapticd.run.lockstep import LockStepClient
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.signal.findings import Finding
from hapticd.signal.impedance import impedance
from hapticd.signal.verdict import judge, two_digits
from hapticd.zwidth.sources import ReferenceSines, Trial, device_scene, scene_of_device
from hapticd.zwidth.trial import MultisineLayout, TrialParams


def test_multisine_trial_says_what_its_interval_covers(tmp_path, capsys):
    code, out, _ = run(["trial", *LINEAR, *MULTISINE, "--out", str(tmp_path)], capsys)
    assert code == 0
    assert "passive in band [2, 500] Hz at 95 % confidence" in out
    assert (
        "the interval covers noise and nonlinear distortion at this perturbation, from the scatter"
        " of 6 realisations of 1 per" in out
    )
    kept = json.loads((tmp_path / "run.json").read_text())
    assert kept["estimator"] == "h_force"
    assert kept["perturbation"]["kind"] == "multisine"
    assert kept["perturbation"]["band_hz"] == 500.0
    assert kept["multisine"]["realisations"] == 6
    assert kept["command_limit_n"] is None


@pytest.mark.parametrize("source", ["engine", "lockstep"])
@pytest.mark.parametrize(
    ("words", "exit_code", "told"),
    [
        (
            ["-K", "1e6"],
            2,
            r"K = 1e\+06 N/m: beyond the limit -1000\.\.\d+ N/m .*; use a value within",
        ),
        (
            ["--active-damping", "500"],
            2,
            r"active_damping = 500 N s/m: beyond the limit 0\.\.\d+ N s/m .*; use a value",
        ),
        (
            ["-K", "10", "--psd", "0.01"],
            65,
            r"N, and the device file allows 2 N .*: --psd \S+ stays below",
        ),
    ],
)
def test_trial_beyond_the_device_is_refused_as_a_live_one(
    source, words, exit_code, told, tmp_path, capsys
):
    code, _, err = run(["trial", source, *words, "--out", str(tmp_path)], capsys)
    assert code == exit_code
    assert re.search(told, re.sub(r"\s+", " ", err))
    assert "simulates" not in err
    assert not list(tmp_path.iterdir())


def test_multisine_of_friction_names_no_number_that_means_nothing(tmp_path, capsys):
    """Thousands of realisations, told from eight of them."""
    code, out, _ = run(["trial", "--excitation", "multisine", "--out", str(tmp_path)], capsys)
    assert code == 0
    assert "many more than 8 realisations would be needed; use noise (--excitation noise)" in out


def test_multisines_of_a_file_are_judged_in_their_layout(tmp_path, capsys):
    run(["trial", *LINEAR, *MULTISINE, "--out", str(tmp_path / "made")], capsys)
    made = json.loads((tmp_path / "made" / "run.json").read_text())
    record = str(tmp_path / "made" / "record.h5")
    code, out, _ = run(
        ["trial", record, *MULTISINE, "--out", str(tmp_path / "again"), "--json"], capsys
    )
    assert code == 0
    found = json.loads(out)
    assert found["multisine"]["realisations"] == 6
    assert found["verdict"]["margin_deg"]["value"] == pytest.approx(
        made["verdict"]["margin_deg"]["value"], abs=1e-2
    )


def test_longer_window_is_kept_with_the_run(tmp_path, capsys):
    code, _, _ = run(
        ["trial", *LINEAR, "--seconds", "30", "--lag", "4096", "--out", str(tmp_path)], capsys
    )
    assert code == 0
    assert json.loads((tmp_path / "run.json").read_text())["lag"] == 4096


@pytest.mark.parametrize("verb", ["trial", "import", "limits", "map", "search", "walls", "report"])
def test_help_has_one_name_for_each_damping(verb, capsys):
    told = " ".join(run([verb, "--help"], capsys)[1].split())
    assert "--active-damping" in told
    assert "--added-damping" not in told


def bracketed(command, path=()):
    """Every text in square brackets in the help of a verb, with the words that call it."""
    for name, below in getattr(command, "commands", {}).items():
        yield from bracketed(below, (*path, name))
    texts = [command.help, *(getattr(param, "help", "") for param in command.params)]
    yield from ((path, found) for text in texts for found in re.findall(r"\[[^\]]*\]", text or ""))


def test_brackets_of_help_texts_are_printed(capsys):
    """Unless escaped they are taken for markup."""
    for path, text in bracketed(get_command(command_line())):
        main([*path, "--help"])
        assert text in capsys.readouterr().out, f"{' '.join(path)}: {text}"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--excitation", "chirp"], 2, "'chirp' is not one of 'noise', 'multisine'"),
        (
            ["--excitation", "multisine", "--until-decided"],
            2,
            "multisines are judged at their end; ask for fewer --realisations",
        ),
        (
            ["--excitation", "multisine", "--realisations", "1", "--periods", "1"],
            65,
            "have no scatter to learn from",
        ),
        (
            ["--excitation", "multisine", "--band", "0.5", "500"],
            65,
            "the period of 4096 samples contains nothing below 0.977 Hz",
        ),
        (["--lag", "4096", "--seconds", "5"], 65, "a verdict takes 7.68 s or more"),
        (
            ["noise.npz", "--excitation", "multisine"],
            65,
            "a realisation of 1 + 2 periods of 4096 samples takes 3.07 s",
        ),
    ],
)
def test_mistakes_are_answered_in_words(words, code, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("noise.npz", force_n=np.ones(8000), velocity_m_per_s=np.ones(8000), rate_hz=4000.0)
    found, _, err = run(["trial", *words, "--out", str(tmp_path / "x")], capsys)
    assert found == code
    assert said in " ".join(err.replace("│", " ").split())


def judged_as(layout, seconds_needed, *findings):
    """A result that is not decided."""
    verdict = replace(
        judge(exact_trial(mass_damper(), 0.99), channels=False),
        answer="undecided",
        findings=findings,
    )
    verdict = replace(verdict, seconds=90.0, seconds_needed=seconds_needed)
    return SimpleNamespace(
        verdict=verdict, plan=SimpleNamespace(params=TrialParams(Trial(), multisine=layout))
    )


@pytest.mark.parametrize(
    ("layout", "seconds_needed", "findings", "said"),
    [
        (None, 123.4, (), "a record like it of some 120 s would decide"),
        (
            None,
            901.0,
            (),
            (
                "a record more than 10 times as long would be needed: the margin cannot be"
                " distinguished from 0"
            ),
        ),
        (
            None,
            float("inf"),
            (),
            (
                "a record more than 10 times as long would be needed: the margin cannot be"
                " distinguished from 0"
            ),
        ),
        (MultisineLayout(8), 123.4, (), "some 11 realisations would decide"),
        (
            MultisineLayout(8),
            123.4,
            (Finding("distortion", "x"),),
            "some 11 realisations would decide; where friction distorts, noise",
        ),
        (
            MultisineLayout(8),
            9e4,
            (),
            "many more than 8 realisations would be needed; use noise (--excitation noise)",
        ),
        (
            None,
            0.0,
            (Finding("lost_slots", "x", voids=True), Finding("line", "y")),
            "no record, however long, can be judged with lost_slots in it",
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
    said = compared(
        result,
        ReferenceSines(
            np.array([3.0, 5.0]), np.array([1.0 + 1j, np.nan]), 0.2, np.array([0.0123, np.nan])
        ),
    )
    assert "the sines move the device at 12.3 to 12.3 mm/s rms, the noise at" in said
    assert "dry friction is another damping at each amplitude" in said
    assert said.endswith("the verdict is the noise's")


def test_stepped_sine_says_how_fast_it_moved(tmp_path, capsys):
    """A sine of 0.2 N rms on mass m and damping b at f: v = F / |Z|, as long as nothing but f
    moves.
    """
    words = [
        "trial",
        "--scene",
        "theory",
        "-K",
        "0",
        "--seconds",
        "8",
        "--stepped-sine",
        "--out",
        str(tmp_path),
    ]
    code, out, _ = run(words, capsys)
    assert code == 0
    assert "another damping at each amplitude" in out
    told = json.loads((tmp_path / "run.json").read_text())["stepped_sine"]
    moved = np.array(told["velocity_rms_m_per_s"])
    f = np.array(told["frequency_hz"])
    size = np.abs([complex(*pair) for pair in told["impedance_ns_per_m"]])
    assert moved[2:8] == pytest.approx(0.2 / size[2:8], rel=0.05)
    assert f.size == 12


@pytest.fixture
def early(tmp_path):
    """A passive device whose velocity is sampled half a sample early."""
    force, velocity = record(
        lambda f: mass_damper(0.008, 4.0)(f) * np.exp(2j * np.pi * f * 125e-6), 5, 120_000
    )
    np.savez(tmp_path / "early.npz", force_n=force, velocity_m_per_s=velocity, rate_hz=4000.0)
    return str(tmp_path / "early.npz")


@pytest.mark.parametrize("verb", ["trial", "import"])
def test_known_skew_is_taken_out_of_a_record(verb, early, tmp_path, capsys):
    _, out, _ = run([verb, early, "--out", str(tmp_path / "a")], capsys)
    assert "undecided in band" in out
    assert "or take a skew that is known out with --skew -0.00012" in out
    assert "no record, however long, can be judged with channel_skew in it: fix that first" in out
    code, out, _ = run([verb, early, "--skew", "-125e-6", "--out", str(tmp_path / "b")], capsys)
    assert code == 0
    assert out.splitlines()[1].startswith("passive in band")
    assert json.loads((tmp_path / "b" / "run.json").read_text())["skew_taken_out_s"] == -125e-6


@pytest.fixture
def daemon(monkeypatch):
    """The shipped configuration's daemon, on virtual time."""
    settings = load(shipped("config") / "hapticd.toml")

    @contextmanager
    def connected(instance, timeout_s=2.0):
        with LockStepClient(servo_params(settings, instance), board_params(settings)) as bench:
            yield bench

    monkeypatch.setattr(change, "connect", connected)


def test_help_says_what_live_does(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = run(["trial", "--help"], capsys)
    said = " ".join(out.replace("│", " ").split())
    assert "live: the daemon's device, which this ENABLES" in said
    assert "live uses 0" in said
    assert (
        "`live` enables the device of the daemon, announces it, drives it, and disables it at the"
        " end and on Ctrl-C" in said
    )


def test_device_is_known_by_its_name():
    assert scene_of_device("Weir 2008 display") == device_scene("weir2008")
    assert scene_of_device("nobody's display") is None
    assert "viscous" in {effect.key for effect in device_scene("simulated").effects}
