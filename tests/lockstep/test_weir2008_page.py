"""What the reproduction leaves behind: table, report, figures and the documentation's page; all or
nothing when it is interrupted.
"""

import importlib.util
import json
import re
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from support.tree import ROOT

from examples.weir2008 import __main__ as program
from examples.weir2008 import run
from examples.weir2008.page import keep
from examples.weir2008.rows import PaperRow
from examples.weir2008.table import from_json
from hapticd.core.errors import ConfigError

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    """docs/pages/reproduction.py, which is no part of the package."""
    spec = importlib.util.spec_from_file_location(
        "reproduction_page", DOCS / "pages" / "reproduction.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_interrupted_run_keeps_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "run_reproduce", interrupted)
    assert program.main(["--out", str(tmp_path / "x")]) == 130
    assert "interrupted: no result of this run was stored" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


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


def test_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(
        ConfigError, match=r"file: File exists; name a folder that you may write to with --out"
    ):
        keep((), tmp_path / "file", {})


def test_log_is_told_every_ten_seconds(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = iter((0.0, 0.0, 3.0, 9.9, 10.0, 10.0))
    monkeypatch.setattr(program, "monotonic", lambda: next(now_s))
    with program.watched() as tell:
        for done in range(4):
            tell("flying", done, 4)
    assert capsys.readouterr().err.splitlines() == ["flying, 0 of 4", "flying, 3 of 4"]


@pytest.mark.parametrize("words", ["--seeds 1", "--seeds many", "--figure-width 3", "--quic"])
def test_mistyped_option_is_a_usage_error(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ending:
        program.main([*words.split(), "--json"])
    assert ending.value.code == 2
    told = capsys.readouterr()
    error = json.loads(told.out)["error"]
    assert error["code"] == "usage"
    assert error["message"] in told.err


def test_error_is_one_line_with_its_exit_code_and_an_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise ConfigError("no such scene")

    monkeypatch.setattr(run, "run_reproduce", refused)
    assert program.main(["--json"]) == ConfigError.exit_code
    told = capsys.readouterr()
    assert told.err == "weir2008: no such scene\n"
    error = {"code": "ConfigError", "message": "no such scene", "detail": None}
    assert json.loads(told.out) == {"ok": False, "error": error}


# --- the documentation ----------------------------------------------------------------------------


def committed() -> tuple[PaperRow, ...]:
    return from_json(json.loads((DOCS / "figures/reproduction/table.json").read_text())["table"])


def test_documentation_says_what_its_table_says(pages: ModuleType) -> None:
    text = (DOCS / "reproduction.md").read_text()
    assert pages.filled(text, committed()) == text, "run `make reproduction-docs`"
    assert len(pages.NUMBER.findall(text)) > 20


def test_device_file_says_how_near_its_limits_are() -> None:
    (worst,) = (
        one.ours
        for one in committed()
        if (one.quantity, one.device, one.part) == ("worst_limit", "weir2008", "limits")
    )
    text = (ROOT / "config" / "devices" / "weir2008.toml").read_text()
    (stated,) = re.findall(r"limits within ([\d.]+) %", text)
    assert worst <= float(stated) < worst + 0.1


def test_stale_number_and_table_are_mended(pages: ModuleType) -> None:
    row = PaperRow(
        "K_max_off", 100.0, 105.46, "N/m", "calibrated", "weir2008", sd=5.5, seeds=8, part="limits"
    )
    numbers = (
        "<!--= K_max_off weir2008 .0f -->99<!--/--> <!--= K_max_off:sd weir2008 .1f x10"
        " --><!--/-->\n"
    )
    text = pages.filled(f"{numbers}<!-- table limits -->\nold\n<!-- /table -->\n", [row])
    assert text.startswith(
        "<!--= K_max_off weir2008 .0f -->105<!--/--> <!--= K_max_off:sd weir2008 .1f x10"
        " -->55.0<!--/-->\n"
    )
    assert "old" not in text
    assert "| K_max_off | N/m | 100 | 105 ± 5.5 (+5.5 %) | 8 | calibrated |" in text
    assert pages.filled(text, [row]) == text


def test_mark_without_its_row_is_refused(pages: ModuleType) -> None:
    row = PaperRow("K_max_off", 100.0, 105.46, "N/m", "calibrated", "weir2008", part="limits")
    with pytest.raises(ConfigError, match=r"the table has no K_max of weir2008; correct the mark"):
        pages.filled("<!--= K_max weir2008 .0f -->99<!--/-->", [row])
    with pytest.raises(
        ConfigError, match=r"table sets -->: the table has no part of that name; it has limits"
    ):
        pages.filled("<!-- table sets -->\n<!-- /table -->", [row])
