"""The table as text, as Markdown and as JSON, and back."""

import json
import re

import pytest
from support import reproduced

from examples.weir2008.page import parts
from examples.weir2008.rows import PaperRow, rows
from examples.weir2008.run import SCENES, ReproduceResult
from examples.weir2008.table import as_json, from_json, markdown, notes, paper_table


@pytest.fixture(scope="module")
def quick() -> ReproduceResult:
    return reproduced.by_prediction()


@pytest.fixture(scope="module")
def found(quick: ReproduceResult) -> tuple[PaperRow, ...]:
    return rows(quick)


def test_text_and_markdown_have_a_column_per_device(found: tuple[PaperRow, ...]) -> None:
    content = paper_table(found)
    assert content.columns == ("quantity", "unit", "paper", *SCENES, "seeds", "kind")
    assert markdown(content).count("\n") == len(content.rows) + 2


def test_cell_says_value_scatter_difference_and_note() -> None:
    row = PaperRow(
        "K_max_off",
        100.0,
        105.46,
        "N/m",
        "calibrated",
        "weir2008",
        sd=5.511,
        seeds=8,
        note="a reason",
    )
    assert paper_table([row]).rows == (
        ("K_max_off", "N/m", "100", "105 ± 5.5 (+5.5 %) [1]", "8", "calibrated"),
    )
    assert notes([row]) == ["[1] K_max_off of weir2008: a reason"]


def test_every_number_in_brackets_is_a_note(found: tuple[PaperRow, ...]) -> None:
    pointed = {
        int(number)
        for row in paper_table(found).rows
        for cell in row
        for number in re.findall(r"\[(\d+)\]", str(cell))
    }
    told = [int(re.match(r"\[(\d+)\]", note)[1]) for note in notes(found)]  # type: ignore[index]
    assert told == list(range(1, len(told) + 1))
    assert pointed == set(told)


def test_axis_and_set_stand_side_by_side(found: tuple[PaperRow, ...]) -> None:
    content = parts(found)["readings"].table
    assert content.columns[3:5] == ("weir2008, axis", "weir2008, set")
    by_name = {row.quantity: row.ours for row in found if row.device == "weir2008"}
    for line in content.rows:
        name = str(line[0])
        over = (
            name.replace("_ratio", "_ratio_set")
            if "ratio" in name
            else re.sub("_(off|on)$", r"_set_\1", name)
        )
        for cell, quantity in zip(line[3:5], (name, over), strict=True):
            assert float(str(cell).split()[0].replace(",", "")) == pytest.approx(
                by_name[quantity], rel=6e-3
            )


def test_rows_come_back_from_json(found: tuple[PaperRow, ...]) -> None:
    told = as_json(found)
    assert {"quantity", "paper", "ours", "unit", "kind", "device", "sd"} <= set(told[0])
    assert as_json(from_json(json.loads(json.dumps(told, allow_nan=False)))) == told
    literal = next(
        row for row in told if row["quantity"] == "K_ratio" and row["device"] == "weir2008_literal"
    )
    assert literal["ours"] is None
