"""Names of a package that are loaded on first use (PEP 562).

`import hapticd` takes 1 ms, while the modules behind its names (numpy, ZeroMQ, pydantic) take
hundreds. The servo process imports the package too, and must load none of them.
"""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

__all__ = ["lazily"]


def lazily(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of the module `package`, for names by their modules.

    AttributeError for any other name.
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, found)  # later uses need no call
        return found

    return load, lambda: sorted({*vars(sys.modules[package]), *homes})
