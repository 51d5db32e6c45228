"""hapticd sim and hapticd accuracy: what they print, draw, return and refuse."""

from pathlib import Path

import pytest
from support.cli_sim import MINE, spoken, told


@pytest.fixture
def mine(tmp_path: Path) -> str:
    file = tmp_path / "mine.toml"
    file.write_text(MINE)
    return str(file)


# --- accuracy -------------------------------------------------------------------------------------


def test_quick_accuracy_prints_draws_and_says_what_defaults_buy(
    capsys: pytest.CaptureFixture[str], mine: str, tmp_path: Path
) -> None:
    code, out, _ = spoken(capsys, "accuracy", mine, "--quick", "--out", str(tmp_path / "f"))
    assert code == 0
    assert "Reference: exact first harmonic of the linear scene." in out
    assert "The defaults (8 s, 4 sub-steps, f64, window 2048) cost" in out
    names = [
        "mine-accuracy.pdf",
        "mine-accuracy.png",
        "mine-accuracy.svg",
        "mine-integrators.pdf",
        "mine-integrators.png",
        "mine-integrators.svg",
    ]
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == names


def test_run_draws_where_it_is_told(
    capsys: pytest.CaptureFixture[str], mine: str, tmp_path: Path
) -> None:
    folder = tmp_path / "figures"
    code, _, err = spoken(capsys, "sim", "run", mine, "--plot", "--out", str(folder))
    assert code == 0
    assert err == f"drawn: {folder}/mine.png, {folder}/mine.svg, {folder}/mine.pdf\n"
    assert sorted(path.name for path in folder.iterdir()) == ["mine.pdf", "mine.png", "mine.svg"]


def test_quick_accuracy_as_json_has_every_tier(
    capsys: pytest.CaptureFixture[str], mine: str
) -> None:
    found = told(capsys, "accuracy", mine, "--quick", "--no-plot")
    assert {row["sweep"] for row in found["rows"]} == {
        "tier",
        "sub-steps",
        "precision",
        "trial length",
        "window",
        "effect",
    }
    assert sum(row["knee"] for row in found["rows"]) == 5
    assert found["integrators"]["longest_s"]["exact"] is None
    assert (found["unit"], found["quick"], found["simulated"]) == ("deg", True, True)


def test_ceiling_over_the_winding_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = spoken(capsys, "sim", "ceiling", "fig7")
    assert code == 0
    assert "Largest stable active damping: no limit" in out
    assert "The scene asks for 1.74 N s/m: loop gain g dR / K^2 = 0.0582, unstable at -1;" in out
    assert "-0.3 is allowed." in out
    assert "-40 K                             10.2" in out


def test_ceiling_as_json_has_no_infinities(capsys: pytest.CaptureFixture[str]) -> None:
    found = told(capsys, "sim", "ceiling", "fig7")
    assert found["device"] is None
    assert found["unit"] == "N s/m"
    assert found["warmer"][0] == pytest.approx([-40.0, 10.17, 3.066], rel=0.01)


def test_effects_propose_a_set(
    capsys: pytest.CaptureFixture[str], mine: str, tmp_path: Path
) -> None:
    verb = (
        "sim",
        "effects",
        mine,
        "--for",
        "phase",
        "--tolerance",
        "60 %",
        "--seconds",
        "5",
        "--out",
        str(tmp_path),
    )
    code, out, err = spoken(capsys, *verb)
    assert code == 0
    assert "without viscous" in out
    assert "For phase within 60 % keep" in out
    assert "mine-effects-phase.png" in err
    assert (tmp_path / "mine-effects-phase.svg").is_file()
