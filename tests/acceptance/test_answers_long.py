"""Answers of the daemon are frozen dataclasses with all that it sends, and are the one schema."""

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

import pytest
from test_answers import names, sent

import hapticd
from hapticd.protocol.answers import (
    Get,
    GuardStatus,
    Hello,
    Status,
    answer_of,
)


@pytest.fixture(scope="module")
def board() -> Iterator[Any]:
    with hapticd.virtual_board() as board:
        board.damping(1.5)
        board.sleep(0.5)
        board.set(K=100, B=1)
        board.enable()
        board.sleep(1.0)
        yield board


def within(sent: Any, made: Any) -> bool:
    """Whether `made`, of an answer, holds what was `sent`, and at most defaults beside it."""
    if isinstance(sent, dict) and isinstance(made, dict):
        return all(name in made and within(value, made[name]) for name, value in sent.items())
    if isinstance(sent, list) and isinstance(made, list) and len(sent) == len(made):
        return all(map(within, sent, made))
    return bool(sent == made)


@pytest.mark.parametrize(
    ("cmd", "kind"),
    [("hello", Hello), ("get", Get), ("status", Status), ("guard", GuardStatus)],
)
def test_answer_has_every_field_that_is_sent(board: Any, cmd: str, kind: Any) -> None:
    plain = sent(board, cmd)
    assert plain.keys() <= names(kind)
    answer = answer_of(kind, plain)
    there = json.loads(json.dumps(dataclasses.asdict(answer)))
    for name, value in json.loads(json.dumps(plain)).items():
        assert within(value, there[name]), name
