"""`import hapticd`: what it gives, and what it does not load."""

import json
import subprocess
import sys

import pytest

import hapticd

HEAVY = {"numpy", "zmq", "msgpack", "pydantic", "h5py", "asyncio", "usb", "logging"}


def loaded_after(code: str) -> set[str]:
    text = f"import json, sys; {code}; print(json.dumps([*sys.modules]))"
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
