"""The file of mistakes at the shell, and the daemon in process that answers them."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from hapticd.client import Client
from hapticd.client.telemetry import accepted
from support.gateway_rig import CommandServerRig

TEXTS = Path(__file__).with_name("data") / "cli_mistakes.txt"
STATE = "== "
TYPED = "$ hapticd "


class Mistake(NamedTuple):
    """A mistyped command, its state, and its place in the file."""

    state: str
    words: str
    line: int


class CommandServerClient(Client):
    """A client of a gateway's command server with a substitute servo, without sockets."""

    def __init__(self, rig: CommandServerRig) -> None:
        super().__init__(folder=rig.folder)
        self._rig = rig

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """The command server's reply to a request."""
        given = {name: value for name, value in fields.items() if value is not None}
        return accepted(self._rig.ask(cmd=cmd, **given))


def mistakes() -> Iterator[Mistake]:
    """Every row of the file."""
    state = ""
    for line, text in enumerate(TEXTS.read_text().splitlines()):
        if text.startswith(STATE):
            state = text.strip("= ")
        if text.startswith(TYPED):
            yield Mistake(state, text.removeprefix(TYPED), line)


def answer_lines(code: int, error: dict[str, Any]) -> list[str]:
    """An answer as the file has it."""
    fields = [f"    {json.dumps(error['detail'])}"] if error["detail"] else []
    message = [f"    {line}" for line in error["message"].splitlines()]
    return [f"    exit {code}, {error['code']}", *message, *fields]


def noted(mistake: Mistake) -> list[str]:
    """The answer that the file has."""
    found: list[str] = []
    for text in TEXTS.read_text().splitlines()[mistake.line + 1 :]:
        if not text.startswith("    "):
            break
        found.append(text)
    return found


def write(answers: dict[Mistake, list[str]]) -> None:
    """Replace the answers of the file by `answers`."""
    lines = TEXTS.read_text().splitlines()
    for mistake in sorted(answers, key=lambda one: one.line, reverse=True):
        begin = mistake.line + 1
        lines[begin : begin + len(noted(mistake))] = answers[mistake]
    TEXTS.write_text("\n".join(lines) + "\n")
