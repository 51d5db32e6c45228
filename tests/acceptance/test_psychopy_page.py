"""The script of docs/psychopy.md runs as it stands, on virtual time, with a stand-in for
PsychoPy.
"""

import csv
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from support import psychopy_stand_in
from support.tree import ROOT

import hapticd

PAGE = ROOT / "docs" / "psychopy.md"


def run(folder: Path, monkeypatch: pytest.MonkeyPatch, keys: str) -> dict[str, Any]:
    """The names of the script after it ran, with shorter presentations; `keys` are pressed one
    after the other, again and again.
    """
    (script,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert "lease.sleep(2.0)" in script
    script = script.replace("lease.sleep(2.0)", "lease.sleep(0.2)")
    pressed: list[str] = []

    def press(allowed: list[str]) -> str:
        key = {"e": "escape"}.get(one := keys[len(pressed) % len(keys)], one)
        assert key in allowed
        pressed.append(key)
        return key

    for name, module in psychopy_stand_in.modules(press).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(
        hapticd, "Client", lambda **asked: hapticd.virtual_board(hand=True, **asked)
    )
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {"__name__": "session"}
    exec(compile(script, str(PAGE), "exec"), names)
    return names


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "session.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_session_ends_with_a_threshold_and_a_row_for_each_presentation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = run(tmp_path, monkeypatch, "1122")
    assert names["staircase"].finished
    assert names["window"].closed
    found = rows(tmp_path)
    assert len(found) == 2 * names["trial"]
    assert {row["guard_safe"] for row in found} == {"True"}
    assert all(float(row["active_damping"]) > 1.0 for row in found)
    answered = found[1::2]
    assert {row["answer"] for row in answered} == {"1", "2"}
    assert {row["right"] for row in answered} == {"True", "False"}
    for earlier, row in zip(found[::2], answered, strict=True):
        stiffer = "1" if float(earlier["K"]) > float(row["K"]) else "2"
        assert (row["answer"] == stiffer) == (row["right"] == "True")


def test_escape_ends_the_session_with_force_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = run(tmp_path, monkeypatch, "1e")
    assert not names["staircase"].finished
    assert names["window"].closed
    assert len(rows(tmp_path)) == 4
