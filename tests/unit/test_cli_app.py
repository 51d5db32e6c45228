"""All verbs under one name: help in every way that people ask for it, and which daemon is meant."""

import json

import pytest
from support.client_double import ClientDouble

from hapticd.cli import change, daemon
from hapticd.cli.app import main


@pytest.fixture
def instances(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the daemons that verbs connect to."""
    found: list[str] = []

    def connect(instance: str, timeout_s: float = 2.0) -> ClientDouble:
        found.append(instance)
        return ClientDouble()

    monkeypatch.delenv("HAPTICD_INSTANCE", raising=False)
    for module in (change, daemon):
        monkeypatch.setattr(module, "connect", connect)
    return found


def said(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What `hapticd WORDS` prints on stdout, in one line; it ends with 0."""
    assert main(words.split()) == 0
    return " ".join(capsys.readouterr().out.split())


# --- help -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", ["", "set ", "perturb ", "perturb load ", "rig ", "zwidth map "])
def test_h_is_help_everywhere(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(f"{words}-h", capsys) == said(f"{words}--help", capsys)


@pytest.mark.parametrize("words", ["", "set", "perturb", "perturb load"])
def test_help_of_a_verb_is_its_help(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(f"help {words}", capsys) == said(f"{words} --help", capsys)


def test_help_suggests_the_verb_that_was_meant(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "statsu"]) == 2
    assert "Did you mean 'status'?" in " ".join(capsys.readouterr().err.split())


SECTIONS = ("Daily use", "Look", "Record", "Set up", "Simulate", "Measure")


def test_help_has_sections_in_the_order_of_use(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("--help", capsys)
    places = [text.index(f" {name} ─") for name in SECTIONS]
    assert places == sorted(places)
    assert " Commands ─" not in text
    assert text.index(" enable ") < places[1] < text.index(" monitor ")


# --- which daemon ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "instance"),
    [
        ("enable", "default"),
        ("--instance left enable", "left"),
        ("--instance=left enable", "left"),
        ("enable --instance left", "left"),
        ("--instance left enable --instance right", "right"),
        ("--instance left perturb start", "left"),
    ],
)
def test_instance_is_named_before_or_after_the_verb(
    instances: list[str], words: str, instance: str
) -> None:
    assert main(words.split()) == 0
    assert instances == [instance]


@pytest.mark.parametrize(
    ("words", "instance"),
    [
        ("enable", "bench"),
        ("--instance left enable", "left"),
        ("enable --instance default", "default"),
    ],
)
def test_environment_names_the_instance_where_nobody_else_does(
    instances: list[str], monkeypatch: pytest.MonkeyPatch, words: str, instance: str
) -> None:
    monkeypatch.setenv("HAPTICD_INSTANCE", "bench")
    assert main(words.split()) == 0
    assert instances == [instance]


def test_help_names_the_environment_variable(capsys: pytest.CaptureFixture[str]) -> None:
    assert "HAPTICD_INSTANCE" in said("enable --help", capsys)


def test_stop_heeds_the_word_before_the_verb_and_not_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A variable that was set yesterday must not keep a stop from a display that moves."""
    asked: list[tuple[str | None, bool]] = []

    def main_of_stop(name: str | None, as_json: bool) -> int:
        asked.append((name, as_json))
        return 0

    monkeypatch.setattr("hapticd.client.fast_stop.main", main_of_stop)
    monkeypatch.setenv("HAPTICD_INSTANCE", "bench")
    assert main(["stop"]) == 0
    assert main(["--instance", "left", "stop"]) == 0
    assert asked == [(None, False), ("left", False)]


@pytest.mark.parametrize(
    "words", [["enable", "--instance", "my rig"], ["--instance", "my rig", "enable"]]
)
def test_name_that_no_instance_can_have_is_a_usage_error(
    instances: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--json"]) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["code"] == "usage"
    assert "instance name 'my rig': use 1 to 64 letters, digits, - and _" in error["message"]
    assert instances == []


def test_name_in_the_environment_is_blamed_on_it(
    instances: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HAPTICD_INSTANCE", "my rig")
    assert main(["enable", "--json"]) == 2
    message = json.loads(capsys.readouterr().out)["error"]["message"]
    assert message.startswith("Invalid value for 'HAPTICD_INSTANCE': instance name 'my rig'")
    assert main(["--instance", "left", "enable"]) == 0
    assert instances == ["left"]


def test_instance_before_a_verb_without_a_daemon_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--instance", "left", "keys", "server", "folder", "--json"]) == 2
    message = json.loads(capsys.readouterr().out)["error"]["message"]
    assert "`hapticd keys` asks no daemon: leave --instance out" in message


@pytest.mark.parametrize("verb", ["status", "lease", "bridge", "rig"])
def test_instance_before_a_verb_or_group_with_a_daemon_is_taken(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"hapticd {verb}" in said(f"--instance left {verb} --help", capsys)
