"""The experiment of docs/experiment.md runs as it stands: each block is taken from the page."""

import csv
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from support.beside_daemon import run_beside
from support.tree import ROOT

from hapticd.pytest_plugin import DaemonProcess

pytestmark = [pytest.mark.process, pytest.mark.timeout(400)]
DEADLINE_S = 300.0
PAGE = (ROOT / "docs" / "experiment.md").read_text()
*EXPERIMENT, ANALYSIS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture
def hapticd_config(tmp_path: Path) -> Path:
    """A host that may be busy: the real-time rights of the machine are not asked for."""
    path = tmp_path / "hapticd.toml"
    path.write_text('[realtime]\nmode = "off"\n[gateway]\ntelemetry_port = 0\n')
    return path


@pytest.fixture
def rehearsed(hapticd_daemon: DaemonProcess, tmp_path: Path) -> Path:
    """The folder in which the session was rehearsed."""
    (tmp_path / "experiment.py").write_text("\n\n".join(EXPERIMENT))
    (tmp_path / "analyse.py").write_text(ANALYSIS)
    python(hapticd_daemon, tmp_path, "experiment.py", "rehearsal")
    with hapticd_daemon.client() as device:
        assert device.status().state == "disabled"
    return tmp_path


def python(daemon: DaemonProcess, folder: Path, *words: str) -> str:
    return run_beside(daemon, folder, sys.executable, *words, deadline_s=DEADLINE_S)


def test_experiment_of_the_page_ends_in_a_data_frame(
    rehearsed: Path, hapticd_daemon: DaemonProcess
) -> None:
    said = python(hapticd_daemon, rehearsed, "analyse.py", "rehearsal")
    assert said.count("rehearsal") == 2  # a threshold at each level
    with (rehearsed / "data.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["guard_safe"] for row in rows} == {"True"}
    assert {float(row["level"]) for row in rows if row["level"]} == {1.5, 3.0}
    assert len([row for row in rows if row["threshold"]]) == 2
    presented = len((rehearsed / "rehearsal.csv").read_text().splitlines()) - 1
    assert presented > 40
    # a busy computer may lose every slot of a presentation that lasts a tenth of a second
    assert 20 < len(rows) <= presented


def test_staircase_of_the_page_converges_to_71_percent() -> None:
    names: dict[str, object] = {"__name__": "page"}
    exec("\n\n".join(EXPERIMENT), names)
    random = np.random.default_rng(2)
    found = []
    for _ in range(200):
        staircase = names["staircase"]()  # type: ignore[operator]
        while not staircase.finished:
            names["chance"] = random
            staircase.answer(names["observer"](1, staircase.level) == 1)  # type: ignore[operator]
        found.append(staircase.threshold)
    assert np.exp(np.mean(np.log(found))) == pytest.approx(0.12, rel=0.15)


def test_person_of_the_page_is_asked_until_the_answer_is_one_or_two(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names: dict[str, object] = {"__name__": "page"}
    exec("\n\n".join(EXPERIMENT), names)
    typed = iter(["", "3", " 2 "])
    monkeypatch.setattr("builtins.input", lambda _: next(typed))
    assert names["person"](1, 0.1) == 2  # type: ignore[operator]
