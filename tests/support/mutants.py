"""Known defects as entries of tests/mutants/*.toml, and how one is inserted into the text of a
file.

    [[mutant]]
    name = "zero_without_a_position"
    claim = "zero is refused while no frame comes"
    file = "hapticd/servo/commands.py"
    function = "obey"              # qualified: Class.method, function.inner; "" is the module
    old = "not state.lost"         # an expression, or consecutive statements
    new = "True"                   # "" leaves the statements out
    tests = ["test_servo_origin.py::test_zero_waits_for_a_frame"]

`old` is compared as syntax, without positions, comments and layout, and must occur exactly once in
the function. A mutant therefore survives reformatting and changes around it, and a renamed function
changes one line. In files of other languages `old` is exact text that occurs once, and `function`
is absent.
"""

import ast
import textwrap
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from support.tree import TESTS

FOLDER = TESTS / "mutants"
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class DoesNotApply(Exception):
    """The code has changed: the place of the mutant is missing or ambiguous."""


@dataclass(frozen=True)
class Change:
    """One place of a mutant."""

    function: str
    old: str
    new: str


@dataclass(frozen=True)
class Mutant:
    """One defect: the broken property, its place, and the tests that must fail."""

    name: str
    claim: str
    file: str
    changes: tuple[Change, ...]
    tests: tuple[str, ...]


def mutants(folder: Path = FOLDER) -> list[Mutant]:
    """All entries, by file and place. KeyError: one lacks a field. ValueError: a name is double."""
    found = [_mutant(entry) for path in sorted(folder.glob("*.toml")) for entry in _entries(path)]
    names = [one.name for one in found]
    if double := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"several mutants of one name: {', '.join(double)}")
    return found


def mutated(mutant: Mutant, text: str) -> str:
    """The file's `text` with the defect. DoesNotApply: a place is not found, or found twice."""
    replace = _replaced if mutant.file.endswith(".py") else _replaced_text
    for change in mutant.changes:
        text = replace(text, change)
    return text


# --- entries --------------------------------------------------------------------------------------


def _entries(path: Path) -> list[dict[str, object]]:
    return tomllib.loads(path.read_text())["mutant"]


def _mutant(entry: dict) -> Mutant:
    places = entry.get("change", [entry])
    changes = tuple(Change(one.get("function", ""), one["old"], one["new"]) for one in places)
    return Mutant(entry["name"], entry["claim"], entry["file"], changes, tuple(entry["tests"]))


# --- text -----------------------------------------------------------------------------------------


def _replaced_text(text: str, change: Change) -> str:
    if text.count(change.old) != 1:
        raise DoesNotApply(f"{text.count(change.old)} times, not once:\n{change.old}")
    return text.replace(change.old, change.new)


# --- syntax ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Place:
    """Consecutive statements, or one expression, of the file."""

    nodes: Sequence[ast.AST]
    fills_body: bool = False  # the block has no other statement


@lru_cache(maxsize=1)  # the mutants of a file follow each other; the tree stays as it is
def parsed(text: str) -> ast.Module:
    """The syntax of a file of Python."""
    return ast.parse(text)


def _replaced(text: str, change: Change) -> str:
    scope = _scope(parsed(text), change.function)
    wanted = ast.parse(textwrap.dedent(change.old)).body
    places = list(_statements(scope, wanted))
    expression = len(wanted) == 1 and isinstance(wanted[0], ast.Expr) and not places
    if expression:
        places = list(_expressions(scope, wanted[0].value))
    if len(places) != 1:
        where = change.function or "the module"
        raise DoesNotApply(f"{len(places)} times in {where}, not once:\n{change.old}")
    return _written(text, places[0], change.new, expression)


def _scope(tree: ast.AST, name: str) -> ast.AST:
    """The definition of that qualified name."""
    for part in name.split(".") if name else ():
        inner = [one for one in _own(tree) if isinstance(one, FUNCTIONS) and one.name == part]
        if len(inner) != 1:
            raise DoesNotApply(f"{part} of {name} is defined {len(inner)} times, not once")
        tree = inner[0]
    return tree


def _own(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes below `tree` that are in no inner definition."""
    for node in ast.iter_child_nodes(tree):
        yield node
        if not isinstance(node, FUNCTIONS):
            yield from _own(node)


def same_syntax(one: object, other: object) -> bool:
    """Whether two trees are equal, but for positions; it ends at the first difference."""
    if type(one) is not type(other):
        return False
    if isinstance(one, ast.AST):
        return all(
            same_syntax(getattr(one, name, None), getattr(other, name, None))
            for name in one._fields
        )
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same_syntax, one, other))
    return one == other


def _statements(scope: ast.AST, wanted: list[ast.stmt]) -> Iterator[_Place]:
    for node in ast.walk(scope):
        for _, block in ast.iter_fields(node):
            if not (isinstance(block, list) and block and isinstance(block[0], ast.stmt)):
                continue
            for begin in range(len(block) - len(wanted) + 1):
                run = block[begin : begin + len(wanted)]
                if same_syntax(run, wanted):
                    yield _Place(run, len(run) == len(block))


def _expressions(scope: ast.AST, wanted: ast.expr) -> Iterator[_Place]:
    if same_syntax(scope, wanted):
        yield _Place([scope])
    if not isinstance(scope, ast.JoinedStr):  # the parts of an f-string have no exact position
        for node in ast.iter_child_nodes(scope):
            yield from _expressions(node, wanted)


def _written(text: str, place: _Place, new: str, expression: bool) -> str:
    """`text` with `new` at `place`."""
    lines = [line.encode() for line in text.splitlines(keepends=True)]  # columns count bytes
    first, last = place.nodes[0], place.nodes[-1]
    row = min([first.lineno, *(one.lineno for one in getattr(first, "decorator_list", []))])
    head = lines[row - 1][: first.col_offset]
    tail = lines[last.end_lineno - 1][last.end_col_offset :]
    if expression:
        body = f"({new.strip()})"
    else:
        body = textwrap.dedent(new).strip("\n") or ("pass" if place.fills_body else "")
        body = body.replace("\n", "\n" + " " * first.col_offset)
        if not body:
            head, tail = b"", b""
    after = lines[last.end_lineno :]
    return b"".join([*lines[: row - 1], head, body.encode(), tail, *after]).decode()
