"""The report on the language of the documentation counts prose, and nothing else."""

import importlib
from types import ModuleType

import pytest
from support.tree import ROOT


@pytest.fixture
def language(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("language")


PATTERNS = [
    ("noun clause", "Omit what is not needed here."),
    ("person", "It waits until somebody resets it."),
    ("speech", "The daemon says why."),
    ("is no", "This is no folder."),
    ("else", "It takes the file, else the default."),
    ("margin", "There are 2 N s/m to spare."),
    ("false friend", "The daemon starts anew."),
]


@pytest.mark.parametrize(("name", "sentence"), PATTERNS)
def test_a_pattern_is_counted_once(language: ModuleType, name: str, sentence: str) -> None:
    found = dict(zip(language.PATTERNS, language.count(sentence).patterns, strict=True))
    assert found == {key: int(key == name) for key in found}


def test_code_quotations_and_the_safety_case_are_left_out(language: ModuleType) -> None:
    page = """# Title
```
somebody says so
```
The message "nobody is there" and `somebody` are quoted.

> somebody said it

| nobody is told | servo | - | `test_a.py::test_b` |
"""
    assert sum(language.count(page).patterns) == 0


def test_long_sentences_and_chains_of_clauses_are_counted(language: ModuleType) -> None:
    found = language.count(f"{'word ' * 26}end. One; two; three. Short.")
    assert (found.sentences, found.long, found.chains) == (3, 1, 1)
