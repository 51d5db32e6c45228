"""What the reproduction leaves behind: table, report, figures and the documentation's page; all or
nothing when it is interrupted.
"""

import importlib.util
import json
import re
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


def rows_after(mark: str) -> list[list[str]]:
    """Cells of the first table of the page after `mark`, without its head."""
    _, _, text = (DOCS / "reproduction.md").read_text().partition(mark)
    (table,) = re.findall(r"((?:^\|.*\n)+)", text, re.MULTILINE)[:1]
    plain = re.sub(r"<!--.*?-->", "", table)
    lines = [line.strip("|\n").split("|") for line in plain.splitlines(keepends=True)]
    return [[cell.strip() for cell in line] for line in lines[2:]]


def numbers(text: str) -> list[float]:
    return [float(one) for one in re.findall(r"-?[\d.]+", text.replace("±", ""))]


PRINTED = {"K": (100.0, 600.0), "B": (3.0, 8.0), "M": (8.0, 22.0)}  # off, on; N/m, N s/m, -g
UNIT = {"K": 100.0, "B": 1.0, "M": 1.0}  # the last digit


def test_page_says_how_coarse_the_six_numbers_of_the_paper_are() -> None:
    """Half a unit of the last digit to each side, or one unit outwards, and the ratios of those."""
    found = {name: cells for name, *cells in rows_after("*Last\nthat passed* is")}
    for axis, printed in PRINTED.items():
        half = UNIT[axis] / 2.0
        for state, value in zip(("off", "on"), printed, strict=True):
            (cells,) = (row for name, row in found.items() if name.startswith(f"{axis} {state},"))
            paper, rounded, passed = ([abs(one) for one in numbers(cell)] for cell in cells[:3])
            assert paper == [value]
            assert rounded == [value - half, value + half, round(100.0 * half / value)]
            assert passed == [value, value + UNIT[axis]]
        off, on = printed
        ratios = found[f"ratio of {axis}"]
        assert numbers(ratios[0]) == pytest.approx([on / off], rel=0.02)
        least, most = (on - half) / (off + half), (on + half) / (off - half)
        assert numbers(ratios[1]) == pytest.approx([least, most], rel=0.025)
        least, most = on / (off + UNIT[axis]), (on + UNIT[axis]) / off
        assert numbers(ratios[2]) == pytest.approx([least, most], rel=0.025)


def test_page_says_which_limits_lie_inside_the_rounding() -> None:
    """Those of K and B; both of M lie outside, one by about the scatter between seeds."""
    limits = {one.quantity: one for one in committed() if one.device == "weir2008" and one.part}
    for axis, printed in PRINTED.items():
        for state, value in zip(("off", "on"), printed, strict=True):
            row = limits[f"{axis}_{'min' if axis == 'M' else 'max'}_{state}"]
            grams = 1000.0 if axis == "M" else 1.0
            beyond = abs(abs(row.ours) * grams - value) - UNIT[axis] / 2.0
            assert (beyond > 0.0) == (axis == "M")
            assert state == "on" or beyond < 2.0 * row.sd * grams
    least, most = 21.5 / 8.5, 22.5 / 7.5
    assert not least < limits["M_ratio"].ours < most


def test_page_says_how_far_trials_at_no_stiffness_wander() -> None:
    """Most that nothing holds leave the 20 mm to each side; no other does."""
    for damping, stiffness, virtual_damping, _, _, reached, beyond in rows_after("<!-- travel -->"):
        far = float(reached.split("-")[1])
        count = int(beyond.split()[0])
        held = float(damping) or float(stiffness) or float(virtual_damping)
        assert (count > 8) == (far > 20.0) == (not held)
        assert held or far < 71.0


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
