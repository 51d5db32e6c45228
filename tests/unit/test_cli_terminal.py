"""What verbs share: options in groups, help that any terminal wraps, the progress bar."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.main import get_command

from hapticd.cli import terminal
from hapticd.cli.app import main
from hapticd.core.errors import HapticdError


@dataclass(frozen=True, kw_only=True)
class Spring:
    """A group of options; the first has no default."""

    name: Annotated[str, typer.Argument(metavar="NAME")]
    stiffness: Annotated[float | None, typer.Option("-K", "--stiffness")] = None
    series: Annotated[tuple[float, float], typer.Option("--series")] = (1.0, 2.0)


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Another group, behind a single option."""

    as_json: terminal.Json = False


def application(called: list[Any]) -> typer.Typer:
    app = typer.Typer()

    @terminal.verb(app, "stretch")
    def stretch(
        spring: Spring, *, seed: Annotated[int, typer.Option("--seed")] = 1, shown: Shown
    ) -> None:
        """Stretch a spring, whose paragraph is
        wrapped in the source.

        The second paragraph
        as well.
        """
        called.append((spring, seed, shown))

    @terminal.verb(app, "rest")
    def rest(seed: Annotated[int, typer.Option("--seed")] = 1) -> None:
        """Do nothing."""
        called.append(seed)

    return app


def run(words: list[str]) -> list[Any]:
    called: list[Any] = []
    with pytest.raises(SystemExit, match="0"):
        application(called)(words)
    return called


def test_fields_of_a_dataclass_are_options_and_arguments() -> None:
    words = ["stretch", "soft", "-K", "30", "--series", "3", "4", "--seed", "7", "--json"]
    spring = Spring(name="soft", stiffness=30.0, series=(3.0, 4.0))
    assert run(words) == [(spring, 7, Shown(as_json=True))]


def test_defaults_are_those_of_the_dataclass() -> None:
    assert run(["stretch", "soft"]) == [(Spring(name="soft"), 1, Shown())]


def test_options_stand_in_the_order_of_parameters_and_fields() -> None:
    stretch = get_command(application([])).commands["stretch"]  # type: ignore[attr-defined]
    names = [parameter.name for parameter in stretch.params]
    assert names == ["name", "stiffness", "series", "seed", "as_json"]


def test_verb_without_groups_is_called_as_it_is() -> None:
    assert run(["rest", "--seed", "3"]) == [3]


def test_paragraph_of_help_is_one_line() -> None:
    stretch = get_command(application([])).commands["stretch"]  # type: ignore[attr-defined]
    assert stretch.help.split("\n") == [
        "Stretch a spring, whose paragraph is wrapped in the source.",
        "",
        "The second paragraph as well.",
    ]


def test_config_check_names_an_injection_that_no_board_knows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text('[[simulation.injections]]\nkind = "estop"\ntick = 5\n')
    assert main(["config", "check", str(file)]) == 78
    error = capsys.readouterr().err
    assert f"{file}:2: simulation.injections[0].kind = 'estop': is unknown; use one of" in error
    assert "emergency_stop" in error


def test_long_lines_are_wrapped_in_a_terminal_and_nowhere_else(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "50")
    monkeypatch.setenv("NO_COLOR", "1")
    thoughts = " ".join(["refused: K = 500 N/m, B = 2 N s/m"] * 4)
    error = HapticdError(f"{thoughts}\nallowed: K 0 to 320 N/m")
    terminal.complain(error, as_json=False)
    lines = [f"hapticd: {thoughts}", "hapticd: allowed: K 0 to 320 N/m"]
    assert capsys.readouterr().err.splitlines() == lines
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    terminal.complain(error, as_json=False)
    told = capsys.readouterr().err.splitlines()
    assert len(told) > 3
    assert all(len(line) <= 50 for line in told)
    assert all(line.startswith(("hapticd: ", "  ")) for line in told)
    assert told[-1] == lines[1]
