"""What a release has beside the code: a README that stands alone, a citation, a container."""

import importlib.util
import json
import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from support.tree import ROOT

import hapticd
from hapticd.console.server import DEFAULT_PORT

README = (ROOT / "README.md").read_text()
ADDRESS = "https://example.org/hapticd"


@pytest.fixture
def hatch_build(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The hook, without hatchling, which only a build has."""
    names = ("hatchling", "hatchling.metadata", "hatchling.metadata.plugin")
    for name in (*names, f"{names[-1]}.interface"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    interface: Any = sys.modules["hatchling.metadata.plugin.interface"]
    interface.MetadataHookInterface = object
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def targets(text: str) -> list[str]:
    return re.findall(r"\]\(([^)]+)\)", text)


def test_readme_without_an_address_has_the_words_of_its_links(hatch_build: Any) -> None:
    found = hatch_build.alone(README, "", "1.2.3")
    assert [one for one in targets(README) if not one.startswith("http")]
    assert [one for one in targets(found) if not one.startswith("http")] == []
    words = re.findall(r"(?<!!)\[([^\]]+)\]\(", README)
    assert [one for one in words if one not in found] == []
    assert "![" not in found


def test_readme_with_an_address_points_at_the_tag(hatch_build: Any) -> None:
    found = hatch_build.alone(README, ADDRESS, "1.2.3")
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", found)
    assert pictures
    assert all(one.startswith(f"{ADDRESS}/raw/v1.2.3/docs/") for one in pictures)
    assert all(one.startswith("http") for one in targets(found))
    assert f"({ADDRESS}/blob/v1.2.3/CONTRIBUTING.md)" in found


def test_absolute_links_stay(hatch_build: Any) -> None:
    text = "[a](https://example.org/x) [b](docs/b.md)"
    assert hatch_build.alone(text, "", "1") == "[a](https://example.org/x) b"


def test_citation_has_the_version_and_what_its_format_asks_for() -> None:
    lines = (ROOT / "CITATION.cff").read_text().splitlines()
    fields = dict(line.split(": ", 1) for line in lines if re.match(r"[a-z-]+: ", line))
    assert fields["cff-version"] == "1.2.0"
    assert fields["version"] == hapticd.__version__
    assert {"message", "title"} <= fields.keys()
    assert "authors:" in lines


def instructions() -> list[tuple[str, str]]:
    """(instruction, rest) of each line of the Dockerfile, continued lines joined."""
    text = re.sub(r"\\\n\s*", "", (ROOT / "Dockerfile").read_text())
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [tuple(line.split(" ", 1)) for line in lines]  # type: ignore[misc]


def test_container_has_every_file_that_an_installation_is_made_of() -> None:
    copied = " ".join(rest for name, rest in instructions() if name == "COPY").split()
    sources = [one for one in copied if not one.startswith("./")]
    assert [one for one in sources if not (ROOT / one).exists()] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    build = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*build["packages"], *build["force-include"], *project["project"]["license-files"]}
    needed |= {"pyproject.toml", "hatch_build.py", "README.md"}
    assert [one for one in needed if not any(Path(one).is_relative_to(at) for at in sources)] == []
    kept = (ROOT / ".dockerignore").read_text().splitlines()
    assert {f"!{one}" for one in sources} <= set(kept)


def test_container_passes_on_the_port_of_the_page_and_is_not_root() -> None:
    found = dict(instructions())
    assert "python:3.13" in found["FROM"]
    assert found["USER"] == "hapticd"
    (shell, option, command) = json.loads(found["CMD"])
    assert (shell, option) == ("sh", "-c")
    assert f"TCP-LISTEN:{found['EXPOSE']},fork,reuseaddr TCP:127.0.0.1:{DEFAULT_PORT} &" in command
    assert command.endswith("exec hapticd run")
