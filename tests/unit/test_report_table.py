"""Tables, numbers in words, and results as JSON."""

from dataclasses import dataclass
from math import inf, nan

import numpy as np
import pytest

from hapticd.zwidth.report.paper import changed, duration, shown, table, text
from hapticd.zwidth.store import to_json


def test_numbers_stand_right_and_words_left() -> None:
    content = table(("name", "value N", "why"), (("a", 1.0, "x"), ("long", 1234.5, "y")), "TITLE")
    assert (
        text(content)
        == "TITLE\nname  value N  why\n----  -------  ---\na           1  x\nlong    1,234  y"
    )


def test_long_words_of_the_last_column_are_wrapped_below_themselves() -> None:
    lines = text(table(("a", "why"), (("x", "word " * 20),))).splitlines()
    assert len(lines) == 4
    assert lines[3].startswith("   word")
    assert max(map(len, lines)) <= 3 + 70
    assert not [line for line in lines if line != line.rstrip()]


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("word", "word"),
        (nan, "-"),
        (inf, "inf"),
        (-inf, "-inf"),
        (0.012345, "0.0123"),
        (12345.6, "12,346"),
        (-2.0, "-2"),
    ],
)
def test_cells_have_three_digits(cell: str | float, expected: str) -> None:
    assert shown(cell) == expected


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.02, "2 %"), (0.0, "0 %"), (1e-9, "0 %"), (0.0123, "1.2 %"), (4.96, "496 %"), (inf, "all")],
)
def test_shares_are_percent(share: float, expected: str) -> None:
    assert changed(share) == expected


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (2.5, "2.5 s"),
        (0.0125, "12.5 ms"),
        (4.2e-5, "42 us"),
        (2e-9, "2 ns"),
        (nan, "-"),
        (90.0, "90 s"),
    ],
)
def test_durations_have_the_prefix_that_suits_them(seconds: float, expected: str) -> None:
    assert duration(seconds) == expected


@dataclass(frozen=True)
class Inner:
    values: object
    big: object = None


def test_plain_results_are_json_without_infinities() -> None:
    found = to_json(
        {
            "a": Inner(np.array([1.0, inf, nan])),
            "b": (1, True, None, "x"),
            "c": np.float64(2.0),
            "d": np.array([1 + 2j]),
        }
    )
    assert found == {
        "a": {"values": [1.0, None, None], "big": None},
        "b": [1, True, None, "x"],
        "c": 2.0,
        "d": [[1.0, 2.0]],
    }


def test_plain_results_leave_out_what_is_skipped() -> None:
    assert to_json(Inner(1.0, np.zeros(10**6)), skip=("big",)) == {"values": 1.0}
