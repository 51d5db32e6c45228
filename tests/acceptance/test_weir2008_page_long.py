"""What `reproduce` leaves behind: table, report, figures and the documentation's page; all or
nothing when it is interrupted.
"""

import csv
import json
import re
from pathlib import Path

import pytest
from support import reproduced

from hapticd.cli.app import main

FIGURES = {"fig03", "fig04", "fig07", "fig08", "fig09", "fig10", "fig11", "limits", "band_edge"} | {
    f"beyond_{name}" for name in ("lower_edge", "free_motion", "shaped", "levels")
}


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb finds the run already done."""
    from hapticd.weir2008 import future_work, run

    monkeypatch.setattr(run, "run_reproduce", lambda plan, tell: reproduced.by_prediction())
    monkeypatch.setattr(
        future_work, "run_future_work", lambda plan, tell: reproduced.future_work_by_prediction()
    )


# --- the files ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("flown")
def test_verb_writes_report_table_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    assert main(["zwidth", "reproduce", "--quick", "--json", "--out", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    wanted = {f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg", "pdf")} | {
        "REPORT.md",
        "table.json",
        "table.csv",
        "table.md",
    }
    assert (
        {Path(file).name for file in told["files"]}
        == wanted
        == {path.name for path in tmp_path.iterdir()}
    )
    assert json.loads((tmp_path / "table.json").read_text())["table"] == told["table"]
    with (tmp_path / "table.csv").open(newline="") as file:
        assert [row["quantity"] for row in csv.DictReader(file)] == [
            row["quantity"] for row in told["table"]
        ]
    report = (tmp_path / "REPORT.md").read_text()
    assert set(re.findall(r"\]\((\w+)\.png\)", report)) == FIGURES
    assert "SIMULATED" in report
    assert "by prediction alone" in report
