"""Imports that happen when a module is first used, so that `--help` and small verbs start quickly.

    with lazily():
        from hapticd.zwidth import limits

Python's own LazyLoader finds the module now and runs it at the first access to one of its names.
Only modules can wait, not names of them, so such a block imports modules alone. A file that is
missing is an error at once; an error inside the module comes at its first use.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import LazyLoader
from types import ModuleType


class _LazyFinder(MetaPathFinder):
    """Finds what the usual finder of files finds, and has it loaded at its first use."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = LazyLoader(spec.loader)
        return spec


FINDER = _LazyFinder()


@contextmanager
def lazily() -> Iterator[None]:
    """Modules that are imported within this context are loaded at their first use."""
    sys.meta_path.insert(0, FINDER)
    try:
        yield
    finally:
        sys.meta_path.remove(FINDER)
