"""What people install: wheel and sdist, in an environment of its own, with hashes, and with the
lowest versions that pyproject.toml declares.
"""

import email
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import time
import urllib.request
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from markdown_it import MarkdownIt
from support.programs import program
from support.tree import ROOT

pytestmark = [pytest.mark.process, pytest.mark.timeout(600)]

LOCK = ROOT / "requirements.lock"
MOST_MB = 140  # of a base installation, numpy and what Python compiles included
PATIENCE_S = 120.0
READ_BY_THE_PROGRAM = {
    "config": "hapticd/_data/config",
    "firmware_iface": "hapticd/_data/firmware_iface",
    "systemd": "hapticd/_data/systemd",
    "hapticd/console/static": "hapticd/console/static",
    "hapticd/zwidth/report": "hapticd/zwidth/report",
}
IN_THE_SOURCES_ALONE = {"hardware", "pico"}  # the circuit, and the firmware of one chip
FROM_OUTSIDE = ("PYTHONPATH", "VIRTUAL_ENV", "HAPTICD_CONFIG", "PYTHONHOME")


def uv(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run uv, which comes with the test tools."""
    beside = Path(sys.executable).with_name("uv")
    command = [str(beside) if beside.exists() else program("uv"), *map(str, words)]
    index = os.environ.get("PIP_INDEX_URL")  # uv does not look where pip is told to
    environment = {**os.environ, **({"UV_DEFAULT_INDEX": index} if index else {})}
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)


def done(result: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    assert result.returncode == 0, result.stdout + result.stderr
    return result


@dataclass(frozen=True)
class Built:
    """What `uv build` made: the wheel is that of the sdist."""

    wheel: Path
    sdist: Path


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    out = tmp_path_factory.mktemp("dist")
    done(uv("build", "--quiet", "--out-dir", out))
    (wheel,) = out.glob("*.whl")
    (sdist,) = out.glob("*.tar.gz")
    return Built(wheel, sdist)


@dataclass(frozen=True)
class Installed:
    """An environment with hapticd, and a home that nobody has used yet."""

    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    @property
    def environment(self) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if name not in FROM_OUTSIDE}
        home = self.folder / "home"
        return {**kept, "HOME": str(home), "XDG_RUNTIME_DIR": str(home / "run")}

    def command(self, *words: str) -> list[str]:
        return [str(self.folder / "bin" / "hapticd"), *words]

    def hapticd(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a verb, in an empty folder."""
        return subprocess.run(
            self.command(*words),
            env=self.environment,
            cwd=self.folder / "home",
            capture_output=True,
            text=True,
        )


def installed(folder: Path, *words: str | Path) -> Installed:
    """A new environment into which `uv pip install` has put what `words` say."""
    done(uv("venv", "--quiet", "--python", sys.executable, folder))
    done(uv("pip", "install", "--quiet", "--python", folder / "bin" / "python", *words))
    (folder / "home" / "run").mkdir(parents=True, mode=0o700)
    return Installed(folder)


def by_hash(built: Built, folder: Path, lock: Path) -> list[str | Path]:
    """How docs/installing.md installs a wheel: every file by the hash that it has."""
    digest = hashlib.sha256(built.wheel.read_bytes()).hexdigest()
    asked = folder / "wheel.txt"
    asked.write_text(f"hapticd @ {built.wheel.as_uri()} --hash=sha256:{digest}\n")
    return ["--require-hashes", "--compile-bytecode", "-r", asked, "--constraint", lock]


@pytest.fixture(scope="module")
def locked(built: Built, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("locked")
    return installed(folder / "venv", *by_hash(built, folder, LOCK))


@pytest.fixture(scope="module")
def lowest(built: Built, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("lowest")
    return installed(folder / "venv", "--resolution", "lowest-direct", built.wheel)


@contextmanager
def daemon(one: Installed) -> Iterator[dict[str, Any]]:
    """A daemon on the simulated board with its page; its status once everything is there."""
    child = subprocess.Popen(
        one.command("run"),
        env=one.environment,
        cwd=one.folder / "home",
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield _until(child, lambda: _whole(one))
    finally:
        child.terminate()
        child.communicate(timeout=PATIENCE_S)


def _whole(one: Installed) -> dict[str, Any] | None:
    answer = one.hapticd("status", "--json")
    status: dict[str, Any] = json.loads(answer.stdout) if answer.returncode == 0 else {}
    return (
        status if status.get("servo_alive") and (status.get("console") or {}).get("url") else None
    )


def _until(
    child: "subprocess.Popen[str]", there: Callable[[], dict[str, Any] | None]
) -> dict[str, Any]:
    deadline = time.monotonic() + PATIENCE_S
    while (found := there()) is None:
        assert child.poll() is None, child.communicate()[0]
        assert time.monotonic() < deadline, "the daemon did not come up"
    return found


# --- what is in them ------------------------------------------------------------------------------


def test_wheel_holds_everything_that_the_program_reads(built: Built) -> None:
    names = set(zipfile.ZipFile(built.wheel).namelist())
    for source, target in READ_BY_THE_PROGRAM.items():
        files = [
            path
            for path in (ROOT / source).rglob("*")
            if path.is_file() and not IN_THE_SOURCES_ALONE & set(path.parts)
        ]
        wanted = {f"{target}/{path.relative_to(ROOT / source)}" for path in files}
        assert wanted
        assert {name for name in wanted - names if "__pycache__" not in name} == set()


def test_wheel_holds_no_tests_and_the_sdist_does(built: Built) -> None:
    names = zipfile.ZipFile(built.wheel).namelist()
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"hapticd"}
    with tarfile.open(built.sdist) as archive:
        members = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"tests/conftest.py", "Makefile", "SECURITY.md", "LICENSE", "requirements.lock"}
    assert wanted - members == set()


def test_readme_of_both_renders_and_links_to_nothing_beside_it(built: Built) -> None:
    (name,) = [one for one in zipfile.ZipFile(built.wheel).namelist() if one.endswith("/METADATA")]
    wheel = zipfile.ZipFile(built.wheel).read(name).decode()
    with tarfile.open(built.sdist) as archive:
        (member,) = [one for one in archive.getmembers() if one.name.count("/") == 1
                     and one.name.endswith("/PKG-INFO")]  # fmt: skip
        stream = archive.extractfile(member)
        assert stream is not None
        sdist = stream.read().decode()
    texts = [email.message_from_string(one) for one in (wheel, sdist)]
    assert [one["Description-Content-Type"] for one in texts] == ["text/markdown"] * 2
    bodies = [one.get_payload() for one in texts]
    assert bodies[0] == bodies[1]
    html = MarkdownIt("gfm-like", {"linkify": False}).render(bodies[0])
    assert html.count("<h2>") == bodies[0].count("\n## ") > 3
    assert "<table>" in html
    links = re.findall(r'(?:href|src)="([^"]*)"', html)
    assert [one for one in links if not one.startswith("http")] == []


# --- what runs of them ----------------------------------------------------------------------------


def test_base_installation_is_at_most_140_mb(locked: Installed) -> None:
    packages = next((locked.folder / "lib").glob("python*/site-packages"))
    found = sum(path.stat().st_size for path in packages.rglob("*") if path.is_file())
    assert found <= MOST_MB * 1e6, f"{found / 1e6:.0f} MB"


@pytest.mark.parametrize("which", ["locked", "lowest"])
def test_base_installation_runs_daemon_commands_and_page(
    which: str, request: pytest.FixtureRequest
) -> None:
    one: Installed = request.getfixturevalue(which)
    assert re.fullmatch(r"hapticd \d+\.\d+\.\d+\S*\n", one.hapticd("--version").stdout)
    with daemon(one) as status:
        assert status["simulated"] is True
        assert one.hapticd("set", "K=100", "B=1").returncode == 0
        assert one.hapticd("stop").returncode == 0
        with urllib.request.urlopen(status["console"]["url"], timeout=PATIENCE_S) as page:
            assert "SIMULATED" in page.read().decode()
        assert one.hapticd("record", "a.h5", "--seconds", "1").returncode == 0
        assert "bit-exact" in one.hapticd("replay", "a.h5").stdout


def test_base_installation_writes_the_files_of_the_service(locked: Installed) -> None:
    shown = done(locked.hapticd("install-system")).stdout
    assert f"ExecStart={locked.python} -I -X utf8 -m hapticd.run.servo_main" in shown


@pytest.mark.parametrize(
    ("words", "library"),
    [(("zwidth", "map"), "numba"), (("bridge", "lsl"), "pylsl"), (("accuracy", "fig4"), "numba")],
)
def test_verb_without_its_library_fails_before_it_works(
    locked: Installed, words: tuple[str, ...], library: str
) -> None:
    said = locked.hapticd(*words)
    assert (said.returncode, "Traceback" in said.stderr) == (78, False), said.stderr
    assert "predicted" not in said.stdout + said.stderr
    # an environment that uv made has no pip
    assert f"type: uv pip install --python {locked.python} '{library}>=" in said.stderr


def test_the_command_of_a_missing_library_installs_it(built: Built, tmp_path: Path) -> None:
    """A wheel in an environment that pip made: the line that is printed, typed."""
    done(subprocess.run([sys.executable, "-m", "venv", tmp_path], capture_output=True, text=True))
    pip = [tmp_path / "bin" / "python", "-m", "pip", "--quiet", "install", built.wheel]
    done(subprocess.run(pip, capture_output=True, text=True))
    (tmp_path / "home" / "run").mkdir(parents=True, mode=0o700)
    said = Installed(tmp_path).hapticd("bridge", "lsl")
    assert said.returncode == 78
    command = said.stderr.partition("type: ")[2].strip()
    done(subprocess.run(shlex.split(command), capture_output=True, text=True))
    assert "pylsl" not in Installed(tmp_path).hapticd("bridge", "lsl").stderr


def test_a_file_with_another_hash_is_not_installed(built: Built, tmp_path: Path) -> None:
    text = LOCK.read_text()
    place = text.index("msgpack==")
    wrong = re.sub(r"sha256:[0-9a-f]{8}", "sha256:00000000", text[place:])
    lock = tmp_path / "wrong.lock"
    lock.write_text(text[:place] + wrong)
    done(uv("venv", "--quiet", "--python", sys.executable, tmp_path / "venv"))
    python = tmp_path / "venv" / "bin" / "python"
    said = uv("pip", "install", "--python", python, *by_hash(built, tmp_path, lock))
    assert said.returncode != 0
    assert "Hash mismatch" in said.stderr
    assert shutil.which("hapticd", path=str(python.parent)) is None
