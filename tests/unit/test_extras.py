"""A missing library is named with a command that works where the verb was called."""

import shlex
import sys
from pathlib import Path

import pytest
from support.tree import ROOT

from hapticd.core import extras
from hapticd.core.errors import ConfigError, MissingLibrary

LIBRARIES = ("numba", "matplotlib", "scipy", "pylsl", "distributed")


@pytest.mark.parametrize("library", LIBRARIES)
def test_missing_library_has_the_versions_of_pyproject(
    monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingLibrary) as missing:
        extras.need(library, "this verb")
    assert f'"{missing.value.requirement}"' in (ROOT / "pyproject.toml").read_text()
    assert missing.value.exit_code == ConfigError.exit_code


def test_library_that_is_there_is_imported() -> None:
    assert extras.need("json.decoder", "this verb").JSONDecoder


@pytest.mark.parametrize("library", LIBRARIES)
def test_command_is_pip_of_the_environment_that_runs(
    monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    monkeypatch.setattr(sys, "prefix", "/home/me/my env")
    monkeypatch.setattr(sys, "executable", "/home/me/my env/bin/python")
    words = shlex.split(extras.install_command(library))
    assert words == [sys.executable, "-m", "pip", "install", extras.requirement(library)]


def test_command_is_uv_where_the_environment_has_no_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "prefix", "/elsewhere")
    words = shlex.split(extras.install_command("numba"))
    assert words[:5] == ["uv", "pip", "install", "--python", sys.executable]


@pytest.mark.parametrize("library", ["numba", "matplotlib"])
def test_command_is_make_lab_in_the_environment_of_a_checkout(
    monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    monkeypatch.setattr(extras, "CHECKOUT", Path("/home/me/hapticd"))
    monkeypatch.setattr(sys, "prefix", "/home/me/hapticd/.venv")
    assert extras.install_command(library) == "make -C /home/me/hapticd lab"
    assert "\nlab: " in (ROOT / "Makefile").read_text()


def test_no_message_or_page_installs_hapticd_from_an_index() -> None:
    """It is on none: the name may be registered by anybody."""
    pages = [*ROOT.glob("hapticd/**/*.py"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")]
    pages += [*ROOT.glob("benchmarks/*.py"), *ROOT.glob("examples/**/*.md")]
    named = [page for page in pages if "install hapticd[" in page.read_text(encoding="utf-8")]
    assert named == []
