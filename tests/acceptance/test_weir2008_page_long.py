"""What the reproduction leaves behind: table, report, figures and the documentation's page; all or
nothing when it is interrupted.
"""

import csv
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from support import reproduced
from support.tree import ROOT

from examples.weir2008 import future_work, run
from examples.weir2008 import page as pages
from examples.weir2008.__main__ import main
from examples.weir2008.page import Drawing, Section, keep, page, parts, sections, terminal
from examples.weir2008.rows import PaperRow, rows
from examples.weir2008.run import SCENES, ReproduceResult

DOCS = ROOT / "docs"
AXIS_LIMITS = {"K_max": "N/m", "B_max": "Ns/m", "M_min": "kg"}

FIGURES = {"fig03", "fig04", "fig07", "fig08", "fig09", "fig10", "fig11", "limits", "band_edge"} | {
    f"beyond_{name}" for name in ("lower_edge", "free_motion", "shaped", "levels")
}


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> None:
    """The program finds the run already done."""
    monkeypatch.setattr(run, "run_reproduce", lambda plan, tell: reproduced.by_prediction())
    monkeypatch.setattr(
        future_work, "run_future_work", lambda plan, tell: reproduced.future_work_by_prediction()
    )


@pytest.fixture(scope="module")
def quick() -> ReproduceResult:
    return reproduced.by_prediction()


@pytest.fixture(scope="module")
def found(quick: ReproduceResult) -> tuple[PaperRow, ...]:
    return rows(quick)


# --- the files ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("flown")
def test_program_writes_report_table_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    assert main(["--quick", "--json", "--out", str(tmp_path)]) == 0
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


@pytest.mark.usefixtures("flown")
def test_json_names_axis_limits_as_agreed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["quick"] is True
    assert "files" not in told
    for stem, unit in AXIS_LIMITS.items():
        for mode in ("off", "on"):
            named = [row for row in told["table"] if row["quantity"] == f"{stem}_{mode}"]
            assert [row["device"] for row in named] == list(SCENES)
            assert {row["unit"] for row in named} == {unit}


def test_page_is_made_of_sections(found: tuple[PaperRow, ...]) -> None:
    more = Section(
        "Beyond the paper",
        "What it left to the future.",
        tuple(replace(row, part="beyond") for row in found[:1]),
    )
    text = page("Title", "Head.", [*parts(found).values(), more])
    assert text.startswith("# Title\n\nHead.\n\n## Limits on their axes\n")
    assert "## Beyond the paper\n\nWhat it left to the future.\n\n| quantity" in text
    assert "Beyond the paper\n\nquantity" in terminal([more])


def test_interrupted_drawing_leaves_the_run_before(
    quick: ReproduceResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "table.json").write_text("before")
    saved: list[str] = []

    def save(figure: object, folder: Path, name: str) -> None:
        if saved:
            raise KeyboardInterrupt
        saved.append(name)
        (folder / f"{name}.png").write_text("drawn")

    monkeypatch.setattr(pages, "save", save)
    with pytest.raises(KeyboardInterrupt):
        keep(sections(quick), tmp_path, {})
    assert saved
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]
    assert (tmp_path / "table.json").read_text() == "before"


def test_smaller_run_leaves_no_figure_of_the_run_before(
    quick: ReproduceResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def save(figure: object, folder: Path, name: str) -> None:
        for kind in ("png", "svg", "pdf"):
            (folder / f"{name}.{kind}").write_text("drawn")

    monkeypatch.setattr(pages, "save", save)
    told = {"quick": True, "seeds": 1, "provenance": {"libraries": {}, "date": "", "hapticd": ""}}
    one, *more = (replace(section, drawings=()) for section in sections(quick))
    drawn = [Drawing(name, "caption", lambda width_mm: None) for name in ("fig02", "fig03")]  # type: ignore[arg-type,return-value]
    keep([replace(one, drawings=tuple(drawn)), *more], tmp_path, told)
    for foreign in ("fig02_mine.png", "notes.txt", "fig12.svg"):
        (tmp_path / foreign).write_text("mine")
    assert (tmp_path / "fig02.svg").is_file()
    keep([replace(one, drawings=tuple(drawn[1:])), *more], tmp_path, told)
    assert {path.name for path in tmp_path.iterdir()} == {
        "REPORT.md",
        "table.json",
        "table.csv",
        "table.md",
        "fig03.png",
        "fig03.svg",
        "fig03.pdf",
        "fig02_mine.png",
        "notes.txt",
        "fig12.svg",
    }


def test_documentation_has_every_figure(quick: ReproduceResult) -> None:
    text = (DOCS / "reproduction.md").read_text()
    shown = re.findall(r"\]\((figures/reproduction/\w+\.png)\)", text)
    drawn = {drawing.name for section in sections(quick) for drawing in section.drawings}
    assert {Path(name).stem for name in shown} >= drawn | {"fig02"}
    assert all((DOCS / name).stat().st_size < 100_000 for name in shown)


def test_page_of_trials_refuses_a_prediction(tmp_path: Path) -> None:
    (tmp_path / "table.json").write_text('{"quick": true, "table": []}')
    before = (DOCS / "reproduction.md").read_text()
    done = subprocess.run(
        [sys.executable, str(DOCS / "reproduce.py"), str(tmp_path)], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "predicted with --quick; the page reports trials: run it without" in done.stderr
    assert (DOCS / "reproduction.md").read_text() == before


@pytest.mark.parametrize(
    ("words", "folder"), [("", "build/reproduction"), ("--quick", "build/reproduction-quick")]
)
def test_make_keeps_quick_runs_apart(words: str, folder: str) -> None:
    planned = subprocess.run(
        ["make", "--dry-run", "reproduce", f"ARGS={words}"],
        cwd=DOCS.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"python -m examples.weir2008 --out {folder} {words}\n" in planned.stdout
