"""The defects that `make mutate` puts back: each can still be put in and names tests that exist."""

import ast
import re
from pathlib import Path

import pytest
from support.mutants import Change, DoesNotApply, Mutant, mutants, mutated, parsed, same_syntax
from support.tree import ROOT, path_of_test

ALL = mutants()  # those of one file follow each other
TEXT = """
LIMIT = 8.0

def clamp(force):
    if force > LIMIT:  # the motor's
        return LIMIT
    return force

class Servo:
    def step(self):
        def inner():
            self.count += 1
            return self.count
        return inner() + inner()
"""


@pytest.mark.parametrize("mutant", ALL, ids=lambda one: one.name)
def test_known_defect_can_be_put_back_and_names_the_tests_that_notice(mutant: Mutant) -> None:
    text = (ROOT / mutant.file).read_text()
    changed = mutated(mutant, text)
    if mutant.file.endswith(".py"):
        assert not same_syntax(ast.parse(changed), parsed(text))
    else:
        assert changed != text
    assert mutant.tests
    for name in mutant.tests:
        file, _, test = name.partition("[")[0].partition("::")
        # written there, or imported to be run on something else
        pattern = rf"^ *(def {test}\(|{test},$)"
        assert re.search(pattern, path_of_test(file).read_text(), re.M), f"{name} is gone"


def put(function: str, old: str, new: str, text: str = TEXT) -> str:
    return mutated(Mutant("one", "a claim", "one.py", (Change(function, old, new),), ()), text)


@pytest.mark.parametrize(
    ("function", "old", "new", "line"),
    [
        ("clamp", "force > LIMIT", "False", "    if (False):  # the motor's"),
        ("clamp", "return force", "return 0.0", "    return 0.0"),
        (
            "Servo.step.inner",
            "self.count += 1",
            "",
            "        def inner():\n            return self",
        ),
        (
            "Servo.step",
            "return inner() + inner()",
            "pass",
            "            return self.count\n        pass",
        ),
        ("", "LIMIT = 8.0", "LIMIT = 80.0", "LIMIT = 80.0"),
        ("clamp", "if force > LIMIT:\n    return LIMIT", "", "def clamp(force):\n    return force"),
    ],
)
def test_the_rest_of_the_file_stays_as_it_is(function: str, old: str, new: str, line: str) -> None:
    changed = put(function, old, new)
    assert line in changed
    assert set(TEXT.splitlines()) - set(changed.splitlines()) != set()


def test_layout_comments_and_what_is_around_do_not_matter() -> None:
    other = TEXT.replace("force > LIMIT:  # the motor's", "(force\n        > LIMIT):")
    other = other.replace("class Servo", "RATE_HZ = 1000.0\n\nclass Servo")
    assert "if ((False)):" in put("clamp", "force > LIMIT", "False", other)


@pytest.mark.parametrize(
    ("function", "old"),
    [
        ("clamp", "force < LIMIT"),  # not there
        ("Servo.step", "inner()"),  # twice
        ("Servo.stop", "return force"),  # no such function
        ("", "LIMIT"),  # several times
    ],
)
def test_a_place_that_is_gone_or_not_the_only_one_is_refused(function: str, old: str) -> None:
    with pytest.raises(DoesNotApply):
        put(function, old, "pass")


def test_text_of_other_languages_is_found_once_or_refused() -> None:
    mutant = Mutant("one", "a claim", "one.c", (Change("", "a = 1;", "a = 2;"),), ())
    assert mutated(mutant, "a = 1; b = 1;") == "a = 2; b = 1;"
    with pytest.raises(DoesNotApply):
        mutated(mutant, "a = 1; a = 1;")


def test_entry_without_tests_is_refused(tmp_path: Path) -> None:
    text = '[[mutant]]\nname = "a"\nclaim = "b"\nfile = "c.py"\nold = "d"\nnew = ""\n'
    (tmp_path / "one.toml").write_text(text)
    with pytest.raises(KeyError, match="tests"):
        mutants(tmp_path)
