"""`make structure`: the size of the package, and how much its parts share.

    python tests/structure.py            a table of the packages, then the totals with their limits
    python tests/structure.py --json     the same for scripts

A statement is a node of the syntax tree (`ast.stmt`) that is not a docstring. A name across
packages is a (module, name) that a `from` import takes from another package of hapticd. An error in
a package of MOTOR may move a motor.
"""

import argparse
import ast
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hapticd"
MOTOR = ("core", "render", "mailbox", "usb", "settings", "protocol", "guard", "servo", "gateway")
LIMITS = {
    "files": 253,
    "statements": 35_500,
    "names": 747,
    "private_names": 0,
    "longest_function": 120,
}
# the hot loop: closures over locals and code without calls save time in each tick
HOT = {"servo/loop.py", "servo/step.py", "usb/device.py"}


def trees(package: Path = PACKAGE) -> Iterator[tuple[Path, ast.Module]]:
    """Each module of the package, by its path within the package, and its syntax tree."""
    for path in sorted(package.rglob("*.py")):
        yield path.relative_to(package), ast.parse(path.read_text())


def is_docstring(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def statements(tree: ast.Module) -> int:
    """Statements of a module, without docstrings."""
    return sum(isinstance(node, ast.stmt) and not is_docstring(node) for node in ast.walk(tree))


def names_across(path: Path, tree: ast.Module) -> set[tuple[str, str]]:
    """(module, name) of what a module imports from other packages of hapticd."""
    return {
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hapticd.")
        for alias in node.names
        if node.module.split(".")[1] != path.parts[0]
    }


def longest_function(tree: ast.Module) -> int:
    """Lines of the longest function of a module, 0 without one."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    functions = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    return max((node.end_lineno - node.lineno + 1 for node in functions), default=0)


def measured(package: Path = PACKAGE) -> dict:
    """Files and statements by package, and the totals of the module's docstring."""
    files, counts = Counter(), Counter()
    names, longest = set(), 0
    for path, tree in trees(package):
        name = path.parts[0] if len(path.parts) > 1 else "."
        files[name] += 1
        counts[name] += statements(tree)
        names |= names_across(path, tree)
        if str(path) not in HOT:
            longest = max(longest, longest_function(tree))
    return {
        "packages": {name: [files[name], counts[name]] for name in sorted(counts)},
        "files": files.total(),
        "statements": counts.total(),
        "motor_statements": sum(counts[name] for name in MOTOR),
        "names": len(names),
        "private_names": sum(name.startswith("_") for _, name in names),
        "longest_function": longest,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--json", action="store_true")
    found = measured()
    if parser.parse_args().json:
        print(json.dumps(found))
        return
    print(f"{'package':12}{'files':>8}{'statements':>12}")
    for name, (files, count) in found.pop("packages").items():
        print(f"{name:12}{files:8}{count:12}")
    for name, count in found.items():
        limit = f"  limit {LIMITS[name]}" if name in LIMITS else ""
        print(f"{name:20}{count:8}{limit}")


if __name__ == "__main__":
    main()
