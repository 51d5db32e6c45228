"""hapticd sim and hapticd accuracy: what they print, draw, return and refuse."""

from pathlib import Path

import pytest
from support.cli_sim import MINE, spoken


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
