"""The examples of docs/analysis.md run as they stand, on a recording; its tables are those of the
program.
"""

import contextlib
import io
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import h5py
import pytest
from support.programs import program
from support.tree import ROOT

PAGE = (ROOT / "docs" / "analysis.md").read_text()
DEADLINE_S = 60
EEG_S_PER_US = 1.00002e-6


def blocks(language: str) -> str:
    """The blocks of the page in `language`, one after the other."""
    return "\n".join(re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL))


@pytest.fixture
def run1(recording_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The recording of which the page speaks, in the working directory, and the markers of an
    instrument whose clock began 12.5 s earlier and is 20 ppm fast.
    """
    monkeypatch.chdir(tmp_path)
    with h5py.File(recording_file) as file:
        codes, times_us = file["servo/event_code"][:], file["servo/event_us"][:]
    rows = [
        f"{code},{12.5 + EEG_S_PER_US * time_us!r}"
        for code, time_us in zip(codes.tolist(), times_us.tolist(), strict=True)
        if code > 0
    ]
    (tmp_path / "eeg_markers.csv").write_text("\n".join(["code,time_s", *rows, ""]))
    return Path(shutil.copy(recording_file, "run1.h5"))


def test_python_of_the_page_selects_steady_ticks_by_condition(run1: Path) -> None:
    names: dict[str, object] = {}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(blocks("python"), names)
    assert 0 < len(names["enabled"]) < len(names["servo"])  # type: ignore[arg-type]
    assert {key[0] for key in names["by_condition"].groups} == {50.0}  # type: ignore[attr-defined]
    assert len(names["records"]) == len(names["servo"])  # type: ignore[arg-type]
    assert names["servo"]["time"].iloc[0].year == 2027  # type: ignore[index]
    assert "mm at 1000.0 Hz" in printed.getvalue()


def test_python_of_the_page_puts_samples_on_the_clock_of_another_instrument(run1: Path) -> None:
    names: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(blocks("python"), names)
    servo = names["servo"]
    assert names["eeg"]["code"].tolist() == [17, 18]
    expected_s = 12.5 + EEG_S_PER_US * servo["board_us"]
    assert (servo["eeg_s"] - expected_s).abs().max() < 1e-6
    assert len(names["around"]) == pytest.approx(500, abs=2)


@pytest.mark.process
def test_octave_of_the_page_counts_the_same_ticks(run1: Path) -> None:
    with h5py.File(run1) as file:
        steady = (file["servo/flags"][:] & 289) == 0
        moved = 1e3 * file["servo/position_m"][:][steady].std(ddof=1)
    done = subprocess.run(
        [program("octave-cli"), "--norc", "--eval", blocks("octave")],
        capture_output=True,
        text=True,
        env={**os.environ, "HOME": str(run1.parent)},
        timeout=DEADLINE_S,
    )
    expected = f"{steady.sum()} of {len(steady)} ticks, {moved:.3f} mm rms"
    assert done.stdout.strip() == expected, done.stderr


def test_matlab_of_the_page_reads_what_is_in_the_file(run1: Path) -> None:
    with h5py.File(run1) as file:
        read = re.findall(r"h5read\('run1\.h5', '([^']+)'\)", blocks("matlab"))
        assert len(read) == 3
        assert not [name for name in read if name not in file]
        assert file["servo/flags"].dtype == "uint32"
        ((name, key),) = re.findall(r"h5readatt\('run1\.h5', '(\S+)', '(\w+)'\)", blocks("matlab"))
        assert file[name].attrs[key] == b"N"


def test_groups_and_columns_of_the_page_are_in_the_file(run1: Path) -> None:
    rows = re.findall(r"^\| `(\w+)` \| [^|]* \| (.*) \|$", PAGE.split("## With pandas")[0], re.M)
    assert [group for group, _ in rows] == ["servo", "probe", "energy", "event", "gap", "life"]
    with h5py.File(run1) as file:
        missing = [
            f"{group}/{name}"
            for group, text in rows
            for name in re.findall(r"`(\w+)`", text)
            if name not in file[group]
        ]
    assert missing == []
