"""Imports that happen when a module is first used, so that `--help` and small verbs start quickly.

    with deferred_imports():
        import numpy as np
        from hapticd.zwidth import limits

Each name bound there represents a module, which is imported at the first access to one of its
names. So only whole modules can be deferred, not names of them, and a missing module is an error at
its first use. No placeholder is in `sys.modules`: libraries that search all modules, like
`inspect`, would load unneeded modules, in the middle of other imports.

A package must not reuse the name of one of its modules.
"""

import builtins
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from threading import get_ident
from types import ModuleType
from typing import Any


class _Waiting(ModuleType):
    """A module that is imported on first use."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)


def _waiting(
    name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
) -> ModuleType:
    """Return the value bound by `import name`, or `from name import fromlist`. ImportError for
    `import a.b`, which binds a.
    """
    if "." in name and not fromlist:
        raise ImportError(f"import {name}: name it with `from`, so that it can wait")
    found = _Waiting(name)
    for one in fromlist or ():
        setattr(found, one, _Waiting(f"{name}.{one}"))
    return found


@contextmanager
def deferred_imports() -> Iterator[None]:
    """Defer the imports within this context until first use."""
    usual = builtins.__import__
    here = get_ident()

    def imported(
        name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
    ) -> ModuleType:
        act = _waiting if get_ident() == here else usual
        return act(name, globals, locals, fromlist, level)

    builtins.__import__ = imported
    try:
        yield
    finally:
        builtins.__import__ = usual
