"""Mistakes at the shell: each answer is the one in support/data/cli_mistakes.txt, which people
read; what programs go by is tested here as fields.
"""

import json
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import cli_mistakes
from support.cli_mistakes import CommandServerClient, Mistake, answer_lines, mistakes, noted
from support.gateway_rig import CommandServerRig

from hapticd.cli import change, daemon, recording
from hapticd.cli.app import main
from hapticd.client import fast_stop

ROWS = list(mistakes())
WAY_TO = {"disabled": (), "enabled": ("enable",), "stopped": ("stop",)}  # commands to a state
Answer = Callable[[str, str], tuple[int, dict[str, Any]]]


@pytest.fixture
def answer(
    runtime: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Answer:
    """What is answered to words that are typed in a state: the exit code and the JSON error."""
    monkeypatch.chdir(tmp_path)
    files(tmp_path)

    def ask(state: str, words: str) -> tuple[int, dict[str, Any]]:
        if state in WAY_TO:
            connect_to_command_server(state, runtime / "server", monkeypatch)
        typed = shlex.split(words)
        code = fast_stop_or_main(typed)
        error = json.loads(capsys.readouterr().out)["error"]
        error["message"] = error["message"].replace(str(runtime), "RUNTIME")
        return code, error

    return ask


def fast_stop_or_main(typed: list[str]) -> int:
    """As the installed command does it."""
    if typed[0] == "stop":
        return fast_stop.main(typed[-1], as_json=True)
    return main([*typed, "--json"])


def connect_to_command_server(state: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir(mode=0o700)
    rig = CommandServerRig(folder)
    for cmd in WAY_TO[state]:
        rig.ask(cmd=cmd)
    for module in (change, daemon, change, change, recording):
        monkeypatch.setattr(
            module, "connect", lambda instance, timeout_s=2.0: CommandServerClient(rig)
        )


def files(folder: Path) -> None:
    (folder / "few.csv").write_text("time,force_n,velocity_m_per_s\n0.0,0.1,0.2\n")
    (folder / "run1.h5").touch()
    (folder / "wave.wav").write_bytes(b"RIFF\xb8\x0b\x00\x00WAVE")
    (folder / "strong.txt").write_text("0.1\n400.0\n")
    (folder / "broken.toml").write_text("# mine\nrate 1000\n")
    (folder / "mine.toml").write_text('title = "mine"\ndevice = "nosuch"\neffects = ["viscous"]\n')
    np.save(folder / "table.npy", np.zeros((2, 3)))


@pytest.fixture(scope="module")
def written(request: pytest.FixtureRequest) -> Iterator[dict[Mistake, list[str]] | None]:
    """Answers for the file where it is to be written; None where it is to be held to."""
    if not request.config.getoption("--write-texts"):
        yield None
        return
    answers: dict[Mistake, list[str]] = {}
    yield answers
    cli_mistakes.write(answers)


@pytest.mark.parametrize("row", ROWS, ids=[f"{one.state}: {one.words}" for one in ROWS])
def test_answer_is_the_one_that_people_have_read(
    row: Mistake, answer: Answer, written: dict[Mistake, list[str]] | None
) -> None:
    code, error = answer(row.state, row.words)
    lines = answer_lines(code, error)
    if written is not None:
        written[row] = lines
    else:
        assert lines == noted(row)


FIELDS: dict[str, tuple[int, str, dict[str, Any]]] = {  # exit code, code, fields of the detail
    "set K=100N/m": (2, "usage", {"value": "100N/m", "unit": "N/m", "remedy": "K=100"}),
    "set M=10g": (2, "usage", {"value": "10g", "unit": "kg", "remedy": None}),
    "set K=1,5": (2, "usage", {"value": "1,5", "unit": "N/m", "remedy": "K=1.5"}),
    "set stiffness=100": (2, "usage", {"value": "stiffness", "remedy": "K=100"}),
    "set K=nan": (2, "usage", {"value": "nan", "unit": "N/m"}),
    "damping onn": (2, "usage", {"value": "onn", "unit": "N s/m"}),
    "damping -1": (4, "invalid", {"loc": "value", "value": -1.0, "low": 0.0, "high": 2.0}),
    "set K=1e9": (4, "invalid", {"loc": "K", "value": 1e9, "unit": "N/m", "high": 1e5}),
    "perturb load strong.txt": (4, "invalid", {"value": 400.0, "unit": "N", "high": 1.0}),
    "zwidth predict --scene mine.toml": (78, "ConfigError", {}),
    "zwidth report nosuch": (78, "ConfigError", {}),
    "sim run mine.toml": (78, "ConfigError", {}),
    "sim run nothere.toml": (78, "ConfigError", {}),
    "get --instance nope": (3, "DaemonDown", {"remedy": "hapticd run --instance nope"}),
    "set K=100": (3, "DaemonDown", {"remedy": "hapticd run", "running": []}),
}


@pytest.mark.parametrize("words", FIELDS)
def test_programs_have_value_unit_limit_and_remedy_as_fields(words: str, answer: Answer) -> None:
    state = next(one.state for one in ROWS if one.words == words)
    code, error = answer(state, words)
    expected_code, name, fields = FIELDS[words]
    assert (code, error["code"]) == (expected_code, name)
    detail = error["detail"]
    if not fields:
        return
    found = detail[0] if isinstance(detail, list) else detail
    assert {field: found[field] for field in fields} == fields


@pytest.mark.parametrize("words", ["damping ON", "damping Off", "guard WARN"])
def test_words_may_be_written_in_any_case(words: str, runtime: Path, monkeypatch: Any) -> None:
    connect_to_command_server("disabled", runtime / "server", monkeypatch)
    assert main(words.split()) == 0


def test_every_row_has_a_state_and_stands_once() -> None:
    assert {row.state for row in ROWS} == {"no daemon", *WAY_TO}
    typed = [(row.state, row.words) for row in ROWS]
    assert len(typed) == len(set(typed))
