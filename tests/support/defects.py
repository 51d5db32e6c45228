"""A mutant of tests/mutants in this process: its functions have the code of the defect for a while.

Limitations: a mutant of a module's own statements, which belong to no function.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import CodeType, FunctionType
from typing import Any

from support.mutants import mutants, mutated
from support.tree import ROOT


@contextmanager
def defect(name: str) -> Iterator[None]:
    """The mutant `name` is in force."""
    mutant = next(one for one in mutants() if one.name == name)
    text = mutated(mutant, (ROOT / mutant.file).read_text())
    module = compile(text, mutant.file, "exec")
    dotted = mutant.file.removesuffix(".py").replace("/", ".")
    kept: dict[FunctionType, CodeType] = {}
    for place in {change.function for change in mutant.changes}:
        function = _function(dotted, place)
        kept[function] = function.__code__
        function.__code__ = _code(module, place)
    try:
        yield
    finally:
        for function, code in kept.items():
            function.__code__ = code


def _function(module: str, place: str) -> FunctionType:
    found: Any = import_module(module)
    for part in place.split("."):
        found = vars(found)[part]
    return found.fget if isinstance(found, property) else found


def _code(within: CodeType, place: str) -> CodeType:
    """The code of the function of that qualified name."""
    for one in within.co_consts:
        if isinstance(one, CodeType):
            if one.co_qualname == place:
                return one
            if place.startswith(f"{one.co_qualname}."):
                return _code(one, place)
    raise LookupError(place)
