"""hapticd sim and hapticd accuracy: what they print, draw, return and refuse."""

import sys
from pathlib import Path

import pytest
from support.cli_sim import MINE, spoken, told

from hapticd.cli.terminal import progress


@pytest.fixture
def mine(tmp_path: Path) -> str:
    file = tmp_path / "mine.toml"
    file.write_text(MINE)
    return str(file)


# --- run ------------------------------------------------------------------------------------------


def test_run_compares_with_and_without_damping(
    capsys: pytest.CaptureFixture[str], mine: str
) -> None:
    code, out, err = spoken(capsys, "sim", "run", mine)
    assert (code, err) == (0, "")
    assert out.startswith("mine: 8 s, SIMULATED ideal\n")
    assert "no active damping (the scene)" in out
    assert "active damping 1.74 N s/m: passive in band [2, 500] Hz at 95 % confidence" in out


def test_run_draws_nothing_unasked(
    capsys: pytest.CaptureFixture[str], mine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(mine).parent
    monkeypatch.chdir(folder)
    spoken(capsys, "sim", "run", mine, "--seconds", "1")
    assert [path.name for path in folder.iterdir()] == ["mine.toml"]


def test_run_as_json_has_trials_and_impedance(
    capsys: pytest.CaptureFixture[str], mine: str
) -> None:
    found = told(capsys, "sim", "run", mine, "--seconds", "6")
    assert (found["ok"], found["simulated"], found["seconds"], found["figures"]) == (
        True,
        True,
        6.0,
        [],
    )
    first, second = found["trials"]
    assert first["leg"] == {
        "name": "no active damping",
        "active_damping": [[0.0, 0.0]],
        "own": True,
    }
    assert second["verdict"]["answer"] in ("passive", "undecided")
    assert {"frequency_hz", "impedance_ns_per_m", "phase_deg", "predicted_phase_deg"} <= first[
        "impedance"
    ][0].keys()
    assert first["diverged_at_s"] is None


def test_run_refuses_no_length(capsys: pytest.CaptureFixture[str], mine: str) -> None:
    assert spoken(capsys, "sim", "run", mine, "--seconds", "0")[0] == 2


def test_unknown_scene_is_told_with_those_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = spoken(capsys, "sim", "run", "fig44")
    assert code == 78
    assert "'fig44': no such scene" in err
    assert "'fig4'" in err


@pytest.mark.parametrize("verb", [("sim", "run", "--plot"), ("sim", "effects"), ("accuracy",)])
def test_missing_matplotlib_is_told_before_the_work(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, verb: tuple[str, ...]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, out, err = spoken(capsys, *verb, "no-such-scene")
    assert (code, out) == (78, "")
    assert "matplotlib>=" in err


# --- explain, ceiling -----------------------------------------------------------------------------


def test_explain_says_states_reasons_step_and_cost(
    capsys: pytest.CaptureFixture[str], mine: str
) -> None:
    code, out, _ = spoken(capsys, "sim", "explain", mine)
    assert code == 0
    for expected in (
        "2 states, 0 nonlinearities",
        "rotor_velocity",
        "physical damping: the budget",
        "MODES OF THE OPEN DEVICE",
        "8 ms",
        "PARAMETERS",
        "Step: 62.5 us, 4 per 4 kHz sample",
        "batch engine, each of",
        "lock-step, the whole product",
    ):
        assert expected in out


def test_explain_as_json_has_effects_and_cost(
    capsys: pytest.CaptureFixture[str], mine: str
) -> None:
    found = told(capsys, "sim", "explain", mine)
    assert [state["name"] for state in found["states"]] == ["rotor_position", "rotor_velocity"]
    assert {note["effect"] for note in found["notes"]} == {"masses", "motor", "probe", "viscous"}
    assert found["cost"]["engine_s"] > 0.0
    assert found["levels"][0]["modes"][0]["time_constant_s"] == pytest.approx(0.008)


# --- effects --------------------------------------------------------------------------------------


def test_effects_as_json_have_rows_and_the_proposal(
    capsys: pytest.CaptureFixture[str], mine: str
) -> None:
    found = told(
        capsys,
        "sim",
        "effects",
        mine,
        "--for",
        "phase",
        "--tolerance",
        "0.02",
        "--seconds",
        "5",
        "--no-plot",
    )
    assert (found["question"], found["tolerance"], found["figures"]) == ("phase", 0.02, [])
    assert {row["effect"] for row in found["rows"]} == {"probe", "viscous"}
    assert found["kept"] == ["probe", "viscous"]


@pytest.mark.parametrize(
    "words", [("--tolerance", "little"), ("--for", "width"), ("--seconds", "1")]
)
def test_effects_refuse_what_they_do_not_understand(
    capsys: pytest.CaptureFixture[str], words: tuple[str, str]
) -> None:
    assert spoken(capsys, "sim", "effects", "theory", *words)[0] == 2


def test_tolerance_of_nothing_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = spoken(capsys, "sim", "effects", "theory", "--tolerance", "0", "--no-plot")
    assert code == 78
    assert "tolerance 0: must be above 0" in err


# --- progress -------------------------------------------------------------------------------------


def test_progress_is_silent_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with progress() as tell:
        tell("reference", 0, 3)
        tell("done", 3, 3)
    assert capsys.readouterr() == ("", "")
