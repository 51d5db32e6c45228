"""What SECURITY.md says of the code: nothing that is read is run, and commands have no network
address.
"""

import ast
from functools import cache

from support.tree import ROOT

PACKAGE = ROOT / "hapticd"


@cache
def sources() -> dict[str, list[ast.AST]]:
    """What every module of the package is made of, by its place in it."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {
        path.relative_to(PACKAGE).as_posix(): list(ast.walk(ast.parse(path.read_text())))
        for path in paths
    }


def called(node: ast.Call) -> str:
    """The last word of what is called."""
    return getattr(node.func, "attr", "") or getattr(node.func, "id", "")
