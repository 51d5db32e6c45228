"""What a checkout installs: pins within their ranges, and what happens where a program is
missing.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from support.tree import ROOT

PINS = ROOT / "constraints.txt"
PYTHONS = ("3.11.2", "3.12.1", "3.13.5")  # bookworm, a Python between, trixie
GROUPS = ("reference", "bench", "test", "check", "lint", "docs")
FROM_MAKE = ("MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "PINS", "VENV")


def pinned(python: str) -> dict[str, str]:
    """Version by library of the pins that hold for that Python on Linux."""
    here = {"python_full_version": python, "python_version": python.rpartition(".")[0]}
    versions: dict[str, str] = {}
    for line in PINS.read_text().splitlines():
        if line.startswith("#"):
            continue
        pin = Requirement(line)
        if pin.marker is None or pin.marker.evaluate(here):
            assert pin.name not in versions, f"two pins of {pin.name} for Python {python}"
            versions[pin.name] = str(pin.specifier).removeprefix("==")
    return versions


def required() -> list[Requirement]:
    """Every library and tool that pyproject.toml asks for, our own extras aside."""
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = whole["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    lists += [whole["dependency-groups"][group] for group in GROUPS]
    return [Requirement(text) for texts in lists for text in texts if isinstance(text, str)]


@pytest.mark.parametrize("python", PYTHONS)
def test_every_requirement_is_pinned_within_its_range(python: str) -> None:
    versions = pinned(python)
    for asked in required():
        assert asked.specifier.contains(versions.get(asked.name, "0")), str(asked)


def test_pins_name_no_place_to_download_from() -> None:
    lines = PINS.read_text().splitlines()
    assert not [line for line in lines if "://" in line or line.startswith("-")]


def test_both_lines_of_numpy_are_checked() -> None:
    """numpy leaves old Pythons behind; its types differ, and each line is checked where it runs."""
    oldest, newest = (pinned(python)["numpy"] for python in (PYTHONS[0], PYTHONS[-1]))
    assert oldest < newest


@pytest.fixture
def environment(tmp_path: Path) -> Path:
    """An environment that make takes for complete."""
    (tmp_path / "bin").mkdir()
    for name in ("run.stamp", "test.stamp"):
        (tmp_path / name).touch()
    return tmp_path


def planned(environment: Path, *options: str) -> str:
    """What make would do for the tests, by its dry run; a make that runs these tests has no say."""
    places = (f"VENV={environment}", f"PYTHON={sys.executable}")
    command = ["make", "--dry-run", *places, *options, "test"]
    shell = {name: value for name, value in os.environ.items() if name not in FROM_MAKE}
    done = subprocess.run(command, cwd=ROOT, env=shell, capture_output=True, text=True, check=True)
    return done.stdout


@pytest.mark.parametrize("changed", ["pyproject.toml", "constraints.txt"])
def test_environment_is_made_again_when_its_description_changes(
    environment: Path, changed: str
) -> None:
    assert "pip" not in planned(environment)
    lines = planned(environment, f"--what-if={changed}").splitlines()
    itself, package, tools = [line for line in lines if " install " in line]
    assert "'pip>=" in itself
    assert "--constraint constraints.txt --editable" in package
    assert "--constraint constraints.txt --editable '.[engine," in tools
    assert "--group test --group lint" in tools


def test_newest_libraries_are_installed_without_pins(environment: Path) -> None:
    assert "--constraint" not in planned(environment, "--what-if=pyproject.toml", "PINS=")


PYTHON_DOUBLE = """#!/bin/bash
case $2 in
  *sysconfig*) exit {plain} ;;
  *ensurepip*) exit {incomplete} ;;
  *version_info*) exit {old} ;;
esac
"""


@pytest.mark.parametrize(
    ("found", "best"),
    [
        ({"a/python3": "plain", "b/python3": "optimised"}, "b/python3"),
        ({"a/python3": "plain", "b/python3.12": "plain"}, "a/python3"),
        ({"a/python3": "old", "b/python3.12": "plain"}, "b/python3.12"),
        ({"a/python3": "optimised", "b/python3": "optimised"}, "a/python3"),
        ({"a/python3": "old"}, ""),
        ({"a/python3": "incomplete"}, "a/python3"),
        ({"a/python3": "incomplete", "b c/python3.12": "plain"}, "b c/python3.12"),
    ],
)
def test_make_takes_an_optimised_python_before_the_first(
    tmp_path: Path, found: dict[str, str], best: str
) -> None:
    for name, kind in found.items():
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(
            PYTHON_DOUBLE.format(
                plain=int(kind != "optimised"),
                incomplete=int(kind == "incomplete"),
                old=int(kind == "old"),
            )
        )
        file.chmod(0o755)
    path = os.pathsep.join(str(tmp_path / folder) for folder in ("a", "b", "b c"))
    command = ["/bin/bash", str(ROOT / ".ci" / "python")]
    (tmp_path / "a" / "timeout").symlink_to(str(shutil.which("timeout")))
    done = subprocess.run(command, env={"PATH": path}, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == (str(tmp_path / best) if best else "")


@pytest.fixture
def ordinary_user(tmp_path: Path) -> dict[str, str]:
    """Environment of someone without root, sudo, and the programs that tests need."""
    commands = {"id": "echo 1000", "apt-get": "exit 1", "dpkg": "exit 1"}
    for name, body in commands.items():
        (tmp_path / name).write_text(f"#!/bin/bash\n{body}\n")
        (tmp_path / name).chmod(0o755)
    return {**os.environ, "PATH": str(tmp_path), "PYTHON": sys.executable, "CC": ""}


@pytest.mark.parametrize(("purpose", "code"), [("check", 0), ("bench", 1)])
def test_user_is_told_what_to_install(
    ordinary_user: dict[str, str], purpose: str, code: int
) -> None:
    command = [ROOT / ".ci" / "deps", purpose]
    done = subprocess.run(command, env=ordinary_user, capture_output=True, text=True)
    assert done.returncode == code
    assert "sudo apt-get install -y --no-install-recommends gcc" in done.stderr
    assert "octave octave-signal" in done.stderr
    assert ("the tests that need them will be skipped" in done.stderr) == (code == 0)


# --- the lock -------------------------------------------------------------------------------------

LOCK = ROOT / "requirements.lock"


def locked(python: str) -> dict[str, str]:
    """Version by library that the lock gives that Python on Linux."""
    here = {"python_full_version": python, "python_version": python.rpartition(".")[0]}
    found = {}
    for line in LOCK.read_text().splitlines():
        if line[:1].isalpha():
            pin = Requirement(line.removesuffix("\\"))
            if pin.marker is None or pin.marker.evaluate(here):
                found[pin.name] = str(pin.specifier).removeprefix("==")
    return found


@pytest.mark.parametrize("python", PYTHONS)
def test_installations_are_locked_to_what_a_checkout_is_tested_with(python: str) -> None:
    pins = pinned(python)
    versions = locked(python)
    assert versions
    assert {name: pins.get(name) for name in versions} == versions


def test_lock_has_every_library_of_every_extra_and_no_tool() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    wanted = {Requirement(text).name for texts in lists for text in texts}
    assert wanted - set(locked(PYTHONS[0])) == set()
    assert {"pytest", "ruff", "sphinx", "uv"} & set(locked(PYTHONS[0])) == set()


def test_everything_that_is_locked_has_hashes() -> None:
    entries = re.split(r"\n(?=[a-z])", LOCK.read_text())[1:]
    assert len(entries) > 20
    for entry in entries:
        name, *hashes = [line.strip(" \\") for line in entry.strip().splitlines()]
        assert hashes, name
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", one) for one in hashes), name


def test_pins_write_the_lock() -> None:
    """Made from the same pins; that the lock is that of today's pyproject.toml the tests above
    see.
    """
    recipe = (ROOT / "Makefile").read_text()
    pins = recipe[recipe.index("\npins:") : recipe.index("\ntest-lowest:")]
    assert "lock" in pins.partition("\nlock:")[0]
    assert "--generate-hashes --constraint constraints.txt" in pins
