"""Where no daemon runs: which ones do, and the command that starts the one that was asked for."""

import json
import pickle

import pytest

from hapticd.cli.app import main
from hapticd.core.errors import DaemonDown
from hapticd.mailbox.daemons import StopWord
from hapticd.mailbox.files import prepare_folder, runtime_folder

WORDS = ["get --instance nope", "stop --instance nope"]


def alive(*instances: str) -> list[StopWord]:
    """Their stop words, as their servos hold them."""
    return [StopWord(prepare_folder(runtime_folder(name))) for name in instances]


@pytest.mark.usefixtures("runtime")
@pytest.mark.parametrize("words", WORDS)
def test_error_names_the_command_and_the_instances_that_run(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    held = alive("left", "right")
    prepare_folder(runtime_folder("dead"))
    assert main(words.split()) == 3
    told = capsys.readouterr().err
    assert told.endswith(
        "no daemon runs there; start it with `hapticd run --instance nope`; running: left, right\n"
    )
    assert len(held) == 2


@pytest.mark.usefixtures("runtime")
def test_error_of_the_default_instance_needs_no_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["get", "--json"]) == 3
    shown = capsys.readouterr()
    assert shown.err.endswith("no daemon runs there; start it with `hapticd run`\n")
    detail = json.loads(shown.out)["error"]["detail"]
    assert detail == {"remedy": "hapticd run", "running": []}


@pytest.mark.usefixtures("runtime")
@pytest.mark.parametrize("words", WORDS)
def test_programs_have_command_and_instances_as_fields(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    held = alive("default", "left")
    assert main([*words.split(), "--json"]) == 3
    detail = json.loads(capsys.readouterr().out)["error"]["detail"]
    running = ["default", "left"]
    assert detail == {"remedy": "hapticd run --instance nope", "running": running}
    assert len(held) == 2


@pytest.mark.usefixtures("runtime")
def test_status_names_them_too(capsys: pytest.CaptureFixture[str]) -> None:
    held = alive("left")
    assert main(["status", "--instance", "nope"]) == 3
    assert "`hapticd run --instance nope`; running: left" in capsys.readouterr().out
    assert main(["status", "--instance", "nope", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert (found["remedy"], found["running"]) == ("hapticd run --instance nope", ["left"])
    assert len(held) == 1


@pytest.mark.usefixtures("runtime")
def test_folder_of_a_stranger_is_not_listed(capsys: pytest.CaptureFixture[str]) -> None:
    held = alive("left")
    runtime_folder("left").chmod(0o777)
    assert main(["get", "--instance", "nope"]) == 3
    assert "running" not in capsys.readouterr().err
    assert len(held) == 1


def test_error_survives_a_pipe() -> None:
    error = pickle.loads(pickle.dumps(DaemonDown("gone", "hapticd run", ("left",))))
    assert (str(error), error.command, error.running) == ("gone", "hapticd run", ("left",))
