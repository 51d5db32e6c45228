"""What a package offers to others is named: `__all__` in each module that is used from outside."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from structure import names_across
from support.tree import ROOT


@cache  # not when it is imported: each worker collects all tests
def trees(folder: str) -> dict[str, ast.Module]:
    """The syntax of all modules below `folder`, by name."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): ast.parse(path.read_text())
        for path in sorted((ROOT / folder).rglob("*.py"))
    }


@pytest.fixture(autouse=True, scope="module")
def none_is_kept() -> Iterator[None]:
    """A million nodes of syntax would slow every later collection of garbage."""
    yield
    offered_by.cache_clear()
    trees.cache_clear()


def offered(tree: ast.Module) -> set[str]:
    """The names in `__all__`."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


@cache
def offered_by(module: str) -> set[str]:
    """The names that a module of the package offers."""
    return offered(trees("hapticd")[module])


def unnamed(module: str, tree: ast.Module) -> list[str]:
    """Imports of `module` across packages that the other module does not offer."""
    path = Path(*module.removeprefix("hapticd.").split("."))
    return [
        f"{module}: {other}.{name}"
        for other, name in sorted(names_across(path, tree))
        if other in trees("hapticd") and name not in offered_by(other)
    ]


def modules_taken(tree: ast.Module) -> list[str]:
    """Modules of the package that are imported as a whole: their names are not looked at here."""
    plain = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import)
             for alias in node.names]  # fmt: skip
    named = [f"{node.module}.{alias.name}" for node in ast.walk(tree)
             if isinstance(node, ast.ImportFrom) for alias in node.names]  # fmt: skip
    return [name for name in (*plain, *named) if name in trees("hapticd")]


def test_what_crosses_packages_is_in_all() -> None:
    assert [
        line for module, tree in trees("hapticd").items() for line in unnamed(module, tree)
    ] == []


def test_examples_take_public_names_alone() -> None:
    """So the paper is measured again with nothing but what any laboratory has."""
    assert [
        line for module, tree in trees("examples").items() for line in unnamed(module, tree)
    ] == []
    assert [name for tree in trees("examples").values() for name in modules_taken(tree)] == []


@pytest.mark.parametrize("name", ["_stage", "flat"])
def test_a_private_or_unnamed_import_is_seen(name: str) -> None:
    tree = ast.parse(f"from hapticd.guard.pending import {name}")
    assert unnamed("hapticd.cli.app", tree) == [f"hapticd.cli.app: hapticd.guard.pending.{name}"]
    assert unnamed("examples.weir2008.run", tree) == [
        f"examples.weir2008.run: hapticd.guard.pending.{name}"
    ]


def test_first_level_packages_import_nothing_and_say_what_they_are_for() -> None:
    for module, tree in trees("hapticd").items():
        if not module.endswith(".__init__") or module.count(".") != 2:
            continue
        assert (ast.get_docstring(tree) or "").count("\n") > 3, module
        imports = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
        assert not imports or module == "hapticd.client.__init__", module


def test_first_level_packages_name_their_modules() -> None:
    for face in sorted((ROOT / "hapticd").glob("*/__init__.py")):
        package = face.parent
        said = set(re.findall(r"\w+", ast.get_docstring(ast.parse(face.read_text())) or ""))
        modules = {path.stem for path in package.glob("*.py")} - {"__init__"}
        assert modules <= said, package.name
