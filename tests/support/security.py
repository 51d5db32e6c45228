"""The promises of SECURITY.md about the code: no input is executed, and commands have no network
address.
"""

import ast
from functools import cache

from support.tree import ROOT

PACKAGE = ROOT / "hapticd"


@cache
def sources() -> dict[str, list[ast.AST]]:
    """Return the syntax nodes of every module of the package, by its path."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {
        path.relative_to(PACKAGE).as_posix(): list(ast.walk(ast.parse(path.read_text())))
        for path in paths
    }


def called(node: ast.Call) -> str:
    """Return the last word of the called name."""
    return getattr(node.func, "attr", "") or getattr(node.func, "id", "")
