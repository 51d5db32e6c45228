"""The package stays within its size, and `make structure` counts what it says."""

import ast
from pathlib import Path

import structure

SOURCE = '''"""A docstring."""

from hapticd.core.units import NS_PER_S, _private
from hapticd.guard.terms import Terms


def plain():
    """Another one."""
    if NS_PER_S:
        return 1
    return 0
'''


def test_docstrings_are_not_statements() -> None:
    assert structure.statements(ast.parse(SOURCE)) == 6


def test_names_of_the_own_package_do_not_count() -> None:
    names = structure.names_across(Path("guard/policy.py"), ast.parse(SOURCE))
    assert names == {("hapticd.core.units", "NS_PER_S"), ("hapticd.core.units", "_private")}


def test_a_function_is_as_long_as_its_lines() -> None:
    assert structure.longest_function(ast.parse(SOURCE)) == 5


def test_the_package_is_within_its_limits() -> None:
    measured = structure.measured()
    assert {
        name: measured[name] for name, limit in structure.LIMITS.items() if measured[name] > limit
    } == {}
