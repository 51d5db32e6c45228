"""`import hapticd`: what it gives, and what it does not load."""

import json
import subprocess
import sys

import pytest

import hapticd
from hapticd.cli.terminal import deferred_imports

HEAVY = {"numpy", "zmq", "msgpack", "pydantic", "h5py", "asyncio", "usb", "logging"}


def loaded_after(code: str) -> set[str]:
    text = f"import json, sys\n{code}\nprint(json.dumps([*sys.modules]))"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in json.loads(done.stdout)}


def test_import_loads_the_standard_library_alone() -> None:
    assert loaded_after("import hapticd, hapticd.client") & HEAVY == set()


def test_a_name_is_loaded_when_it_is_used() -> None:
    assert "zmq" in loaded_after("import hapticd; hapticd.Client")
    assert "zmq" not in loaded_after("import hapticd; hapticd.Staircase")


@pytest.mark.parametrize("name", hapticd.__all__)
def test_every_public_name_is_there_and_listed(name: str) -> None:
    assert getattr(hapticd, name) is getattr(hapticd, name)
    assert name in dir(hapticd)


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'hapticd' has no attribute 'Clinet'"):
        _ = hapticd.Clinet  # type: ignore[attr-defined]


def test_help_of_all_verbs_loads_no_large_library() -> None:
    loaded = loaded_after(
        "import io, contextlib; from hapticd.cli.app import main;"
        " out = contextlib.redirect_stdout(io.StringIO()); out.__enter__();"
        " main(['zwidth', '--help']); main(['--help']); out.__exit__(None, None, None)"
    )
    large = {"numpy", "zmq", "msgpack", "pydantic", "h5py", "usb", "scipy", "numba", "matplotlib"}
    assert loaded & large == set()


WAITING = "from hapticd.cli.terminal import deferred_imports\nwith deferred_imports():\n"


def test_a_module_that_waits_is_loaded_at_its_first_use() -> None:
    waiting = f"{WAITING}    import numpy as np\n    from hapticd.signal import verdict\n"
    assert "numpy" not in loaded_after(waiting)
    assert "numpy" in loaded_after(f"{waiting}np.pi")
    assert "numpy" in loaded_after(f"{waiting}verdict.needed")


def test_a_module_that_is_missing_is_an_error_at_its_first_use() -> None:
    with deferred_imports():
        from hapticd import nothing  # type: ignore[attr-defined]
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'hapticd\.nothing'"):
        _ = nothing.something


def test_imports_happen_at_once_again_behind_the_block() -> None:
    with deferred_imports():
        pass
    assert "numpy" in loaded_after(f"{WAITING}    import json as waiting\nimport numpy")
