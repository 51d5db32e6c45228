"""The scorer of examples/trials: what it counts, and what it says of files that are wrong."""

import json
from pathlib import Path
from typing import Any

import pytest

from examples.trials.__main__ import main
from examples.trials.score import groups, read_truth, read_verdicts, score, score_json

TRUTHS = {  # truth, margin, near the edge
    "a": ("passive", 1.0, False),
    "b": ("not_passive", -0.5, False),
    "c": ("unstable", None, False),
    "d": ("passive", 0.1, True),
    "e": ("not_passive", -0.1, True),
}
HEADER = "trial,verdict,margin_n_s_per_m,margin_low_n_s_per_m,margin_high_n_s_per_m"
RIGHT = ("a,passive", "b,not_passive", "c,not_passive", "d,passive", "e,not_passive")


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """The file of TRUTHS."""
    trials = {
        name: {"truth": kind, "margin_n_s_per_m": margin, "near_edge": near}
        for name, (kind, margin, near) in TRUTHS.items()
    }
    path = tmp_path / "truth.json"
    path.write_text(json.dumps({"band_hz": [2, 500], "trials": trials}))
    return path


def verdicts(folder: Path, *lines: str, header: str = HEADER) -> Path:
    """A file of verdicts; lines that end before the last column get empty cells."""
    wide = header.count(",")
    path = folder / "verdicts.csv"
    path.write_text("\n".join((header, *(line + "," * (wide - line.count(",")) for line in lines))))
    return path


def scored(folder: Path, truth: Path, *lines: str) -> dict[str, Any]:
    """The scores by group."""
    found = score(read_verdicts(verdicts(folder, *lines)), read_truth(truth))
    return {one["trials"]: one for one in score_json(found)["groups"]}


def refusal(folder: Path, truth: Path, capsys: pytest.CaptureFixture[str], path: Path) -> str:
    """What is said of that file of verdicts, on a line."""
    assert main(["score", str(path), "--truth", str(truth)]) == 78
    captured = capsys.readouterr()
    assert captured.out == ""
    return " ".join(captured.err.split())


# --- what is counted ------------------------------------------------------------------------------


def test_right_verdicts_are_correct_and_unstable_means_not_passive(
    tmp_path: Path, truth: Path
) -> None:
    found = scored(tmp_path, truth, *RIGHT)
    assert found["all"]["correct"] == found["all"]["number"] == 5
    assert found["unstable"]["correct"] == 1


def test_each_kind_of_error_is_counted_apart(tmp_path: Path, truth: Path) -> None:
    lines = ("a,not_passive", "b,passive", "c,passive", "d,undecided", "e,not_passive")
    found = scored(tmp_path, truth, *lines)
    assert found["all"] == {
        "trials": "all",
        "number": 5,
        "correct": 1,
        "wrongly_passive": 2,
        "wrongly_not_passive": 1,
        "undecided": 1,
        "margin_bias_n_s_per_m": None,
        "margin_rms_error_n_s_per_m": None,
        "intervals": 0,
        "intervals_that_cover": 0,
    }


def test_groups_part_what_is_near_the_edge_from_what_is_clear(tmp_path: Path, truth: Path) -> None:
    found = score(read_verdicts(verdicts(tmp_path, *RIGHT)), read_truth(truth))
    assert [(one.trials, one.number) for one in groups(found)] == [
        ("clearly passive", 1),
        ("clearly not passive", 1),
        ("unstable", 1),
        ("near the edge", 2),
        ("all", 5),
    ]


def test_margins_have_a_bias_and_intervals_cover_or_not(tmp_path: Path, truth: Path) -> None:
    """Errors of +0.2 and -0.1; the margin of an unstable trial is not compared with anything."""
    lines = ("a,passive,1.2,0.5,1.5", "b,not_passive,-0.6,-0.9,-0.55", "c,not_passive,-9,-10,-8")
    found = scored(tmp_path, truth, *lines, *RIGHT[3:])["all"]
    assert found["margin_bias_n_s_per_m"] == pytest.approx(0.05)
    assert found["margin_rms_error_n_s_per_m"] == pytest.approx(0.025**0.5)
    assert (found["intervals"], found["intervals_that_cover"]) == (2, 1)


def test_margins_may_be_left_out_and_remarks_are_no_verdicts(tmp_path: Path, truth: Path) -> None:
    path = verdicts(tmp_path, "# by hand", *RIGHT, header="trial,verdict")
    path.write_text(path.read_text() + "\n\n")
    assert len(read_verdicts(path)) == 5


def test_table_and_json_say_the_same(
    tmp_path: Path, truth: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(verdicts(tmp_path, *RIGHT[:4], "e,passive"))
    assert main(["score", path, "--truth", str(truth)]) == 0
    last = capsys.readouterr().out.splitlines()[-1].split()
    assert main(["score", path, "--truth", str(truth), "--json"]) == 0
    whole = json.loads(capsys.readouterr().out)
    numbers = [whole["groups"][-1][name] for name in ("number", "correct", "wrongly_passive")]
    assert last[:4] == ["all", *map(str, numbers)] == ["all", "5", "4", "1"]
    assert whole["trials"][4]["outcome"] == "wrongly_passive"


# --- what is wrong --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (("a,stable",), ("verdicts.csv:2", "'stable'", "passive, not_passive, undecided")),
        (("a,passive,much",), ("verdicts.csv:2", "'much'", "margin_n_s_per_m", "N s/m")),
        (("a,passive,nan",), ("verdicts.csv:2", "'nan'", "finite")),
        (("a,passive", "b,passive,1,2,0"), ("verdicts.csv:3", "2 is above", "exchange")),
        (("a,passive,1,0",), ("verdicts.csv:2", "both")),
        (("a,passive,1,0,2,3",), ("verdicts.csv:2", "6 cells", "has 5")),
        ((*RIGHT, "z,passive"), ("verdicts.csv:7", "'z'", "no such trial", "a, b, c, d, e")),
        ((*RIGHT, "b,passive"), ("verdicts.csv:7", "second verdict on b", "verdicts.csv:3")),
        (RIGHT[:3], ("no verdict on d, e", "3 of 5", "undecided")),
    ],
)
def test_wrong_line_is_named_with_its_value_and_remedy(
    tmp_path: Path,
    truth: Path,
    capsys: pytest.CaptureFixture[str],
    lines: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    said = refusal(tmp_path, truth, capsys, verdicts(tmp_path, *lines))
    assert [word for word in words if word not in said] == []


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("trial,answer", ("verdicts.csv:1", "no column 'verdict'", "header line")),
        ("trial,verdict,phase", ("verdicts.csv:1", "unknown column 'phase'")),
        ("", ("verdicts.csv:1", "no column 'trial'")),
    ],
)
def test_wrong_header_line_is_named(
    tmp_path: Path,
    truth: Path,
    capsys: pytest.CaptureFixture[str],
    header: str,
    words: tuple[str, ...],
) -> None:
    said = refusal(tmp_path, truth, capsys, verdicts(tmp_path, header=header))
    assert [word for word in words if word not in said] == []


@pytest.mark.parametrize(
    "content", ["", "[]", '{"trials": {"a": {}}}', '{"trials": {"a": {"truth": "maybe"}}}']
)
def test_file_that_is_no_truth_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    path = tmp_path / "truth.json"
    path.write_text(content)
    said = refusal(tmp_path, path, capsys, verdicts(tmp_path, *RIGHT))
    assert "truth.json: no truth of trials" in said


def test_missing_files_are_named(
    tmp_path: Path, truth: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "none.csv: no such file" in refusal(tmp_path, truth, capsys, tmp_path / "none.csv")
    there = verdicts(tmp_path, *RIGHT)
    assert "lost.json: no such file" in refusal(tmp_path, tmp_path / "lost.json", capsys, there)


def test_folder_without_trials_is_refused_with_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["judge", str(tmp_path)]) == 78
    assert "examples.trials make" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("seconds", ["7", "nan", "1e9", "long"])
def test_length_out_of_range_is_a_mistake_of_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seconds: str
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["make", "--out", str(tmp_path / "out"), "--seconds", seconds])
    assert left.value.code == 2
    assert seconds in capsys.readouterr().err
