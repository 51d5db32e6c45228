"""Kernels on disk: generated once per shape, compiled once per machine, then loaded in a fraction
of a second.

Folder: $XDG_CACHE_HOME/hapticd/kernels-VERSION (~/.cache without it). A kernel is k_HASH.py there,
imported through sys.path, because numba's own disk cache requires this to find compiled code again.
HASH covers the text and the law it calls. `_called` must read every file that kernels are compiled
from (an old kernel would otherwise be loaded again).
"""

import hashlib
import importlib
import os
import sys
import threading
from functools import cache
from pathlib import Path
from types import ModuleType

from hapticd import __version__
from hapticd.core.errors import ConfigError
from hapticd.core.extras import need
from hapticd.render import law, parts
from hapticd.zwidth.engine.shape import Shape
from hapticd.zwidth.engine.source import kernel_source


@cache
def kernel(shape: Shape) -> ModuleType:
    """Return the module of `shape`: `run`, `plant`, `tally`, ROWS. ConfigError without numba or a
    writable folder.
    """
    need("numba", "the batch engine")
    text = kernel_source(shape)
    digest = hashlib.sha256(text.encode() + _called()).hexdigest()
    name = f"k_{digest[:16]}"
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.py"
        if not path.exists():
            _write(path, text)
    except OSError as error:
        raise ConfigError(
            f"kernels cannot be kept in {folder}: {error.strerror}; set XDG_CACHE_HOME to a folder"
            " of yours"
        ) from error
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    importlib.invalidate_caches()
    return importlib.import_module(name)


def cache_folder() -> Path:
    """Return the folder of the kernels."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hapticd" / f"kernels-{__version__}"


@cache
def _called() -> bytes:
    """Return the other sources of a kernel besides its text."""
    paths = (Path(law.__file__), Path(parts.__file__), Path(__file__).with_name("compiled.py"))
    return b"".join(path.read_bytes() for path in paths)


def _write(path: Path, text: str) -> None:
    """Write atomically: other processes and threads may be writing the same kernel."""
    fresh = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    fresh.write_text(text)
    fresh.replace(path)
