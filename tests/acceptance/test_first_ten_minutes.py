"""A newcomer's first ten minutes, from a copy of the checkout: `make run`, its page, the session of
README with the output that README shows, a gateway that dies, a recording, a script, Ctrl-C.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright
from support.console_page import ARGUMENTS, CHROMIUM, PATIENCE_MS, wait_text
from support.daemon import until
from support.tree import ROOT

pytestmark = [pytest.mark.process, pytest.mark.timeout(600)]

MOST_MB = 170  # of what `make run` installs
PATIENCE_S = 120.0
# variables that point to another environment, configuration or daemon
FROM_OUTSIDE = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME", "HAPTICD_CONFIG", "RUNTIME_DIRECTORY")
NUMBER = r"-?\d+(\.\d+)?(e[+-]?\d+)?"
# the guard judges by the delay that it measured: on a slow computer the same environment, with too
# little active damping, is unstable by itself and leaves no virtual damping that would do
BY_DELAY = {
    "N N s/m short at N Hz (theorem)": (
        "unstable by itself, its motion doubles in N ms, worst near N Hz"
    ),
    "hapticd: allowed, each with the others as asked: B N to N N s/m": (
        "hapticd: no K, B or M alone is enough, with the others as asked"
    ),
}


class Checkout:
    """A copy of the files that git tracks, with a home and a runtime folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "hapticd"
        listed = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True
        )
        for name in filter(None, listed.stdout.decode().split("\0")):
            if (ROOT / name).exists():
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.folder / name)
        (folder / "run").mkdir(mode=0o700)
        kept = {name: value for name, value in os.environ.items() if name not in FROM_OUTSIDE}
        here = {"HOME": str(folder), "XDG_RUNTIME_DIR": str(folder / "run")}
        cache = {"PIP_CACHE_DIR": os.environ.get("PIP_CACHE_DIR", str(Path.home() / ".cache/pip"))}
        path = f"{self.folder}/.venv/bin:{os.environ['PATH']}"
        self.environment = kept | here | cache | {"PATH": path}

    def do(self, command: str) -> tuple[int, str]:
        """Exit code and output of a command line, as a terminal shows it."""
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=PATIENCE_S,
        )
        return done.returncode, done.stdout

    def status(self) -> dict[str, object]:
        code, text = self.do("hapticd status --json")
        return dict(json.loads(text)) if code in (0, 5) else {}


@pytest.fixture
def checkout() -> Iterator[Checkout]:
    # directly in the temporary folder, since a socket's path may have 107 bytes only
    folder = Path(tempfile.mkdtemp(prefix="hapticd-"))
    yield Checkout(folder)
    shutil.rmtree(folder)


@pytest.fixture
def running(checkout: Checkout) -> Iterator[subprocess.Popen[bytes]]:
    """`make run`, ready."""
    log = checkout.folder / "run.log"
    with log.open("wb") as file:
        process = subprocess.Popen(
            ["make", "run"],
            cwd=checkout.folder,
            env=checkout.environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        until_ready(process, log)
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(PATIENCE_S)


def until_ready(process: subprocess.Popen[bytes], log: Path) -> None:
    """Wait until `make run` has installed everything and the daemon and its page are there."""
    for _ in range(5):  # an installation may take longer than one wait
        assert process.poll() is None, log.read_text()
        try:
            until(lambda: "Ctrl-C here ends it." in log.read_text(), log.read_text())
            return
        except AssertionError:
            continue
    raise AssertionError(log.read_text())


def megabytes(folder: Path) -> float:
    return sum(file.lstat().st_size for file in folder.rglob("*") if not file.is_dir()) / 1e6


def session(page: str, heading: str) -> list[tuple[str, list[str]]]:
    """Commands of the first console block of `page` after `heading`, each with its output."""
    text = (ROOT / page).read_text()
    block = text[text.index(heading) :].partition("```\n$")[2].partition("```")[0]
    found: list[tuple[str, list[str]]] = []
    for line in filter(None, f"${block}".splitlines()):
        if line.startswith("$ "):
            found.append((line[2:].partition(" #")[0].strip(), []))
        else:
            found[-1][1].append(line)
    return found


def without_numbers(lines: list[str]) -> list[str]:
    """Measured values, ticks and the length of the output's columns differ from run to run."""
    return [re.sub(r"\s+", " ", re.sub(NUMBER, "N", line)).strip() for line in lines]


def shows(checkout: Checkout, command: str, expected: list[str]) -> None:
    """The output of `command` is that of the page but for numbers and `BY_DELAY`; without one
    there, any is. On a busy computer the guard asks to try again.
    """
    lines = without_numbers(until(lambda: answered(checkout, command), f"an answer to {command}"))
    if expected:
        shown = [*without_numbers(expected), ""]
        assert lines in (shown, [with_longer_delay(line) for line in shown]), command


def with_longer_delay(line: str) -> str:
    for reason, instead in BY_DELAY.items():
        line = line.replace(reason, instead)
    return line


def answered(checkout: Checkout, command: str) -> list[str] | None:
    _, text = checkout.do(command)
    return None if "the computer is busy" in text else [*text.splitlines(), ""]


def test_the_session_of_readme_goes_as_it_is_written(
    checkout: Checkout, running: subprocess.Popen[bytes]
) -> None:
    assert megabytes(checkout.folder / ".venv") <= MOST_MB
    page_switches_damping_and_stops(checkout)
    for command, expected in session("README.md", "**A refusal, explained.**"):
        if not command.startswith("source"):
            shows(checkout, command, expected)
    gateway_comes_back(checkout)
    recording_replays(checkout)
    assert checkout.do("hapticd guard warn")[0] == 0
    for command, expected in session("docs/quickstart.md", "## A sweep, from a script"):
        if command.startswith("python"):
            shows(checkout, command, expected)
    os.killpg(running.pid, signal.SIGINT)
    running.wait(PATIENCE_S)
    assert checkout.status() == {}


def page_switches_damping_and_stops(checkout: Checkout) -> None:
    """Damping, Enable, STOP and Reset in Chromium, at the address that `make run` names."""
    log = checkout.folder / "run.log"
    address = until(lambda: re.search(r"http://127\.0\.0\.1:\d+/", log.read_text()), "a page")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        page = browser.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(address[0])
        wait_text(page, "#lamp", "disabled")
        page.click("#damping-switch")
        page.click("#enable")
        wait_text(page, "#lamp", "enabled")
        page.keyboard.press("Space")
        wait_text(page, "#lamp", "stopped")
        until(lambda: reset_at(page), "a reset, once the force has faded")
        browser.close()
    assert checkout.status()["state"] == "disabled"


def reset_at(page: object) -> bool:
    page.click("#reset")  # type: ignore[attr-defined]
    return "disabled" in page.text_content("#lamp")  # type: ignore[attr-defined]


def gateway_comes_back(checkout: Checkout) -> None:
    """kill -9 of the gateway: a new one answers beside the same servo."""
    before = checkout.status()
    pattern = f"hapticd.run.gateway_main.*{checkout.environment['XDG_RUNTIME_DIR']}"
    (killed,) = checkout.do(f"pgrep -f '{pattern}'")[1].split()
    os.kill(int(killed), signal.SIGKILL)

    def another() -> bool:
        found = checkout.do(f"pgrep -f '{pattern}'")[1].split()
        return bool(found) and found != [killed] and bool(checkout.status())

    until(another, "another gateway")
    after = checkout.status()
    assert (after["epoch"], after["revision"]) == (before["epoch"], before["revision"])


def recording_replays(checkout: Checkout) -> None:
    """What was recorded is replayed to the bit, with what `make run` installed."""
    assert checkout.do("hapticd set K=100 B=1")[0] == 0
    assert checkout.do("hapticd enable")[0] == 0
    assert checkout.do("hapticd record run.h5 --seconds 1")[0] == 0
    code, text = checkout.do("hapticd replay run.h5 --json")
    assert code == 0, text
    assert json.loads(text.splitlines()[-1])["bit_exact"] is True
