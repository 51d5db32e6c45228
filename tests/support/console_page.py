"""The operators' page in a real browser, and daemons behind it."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from playwright.sync_api import Page, TimeoutError

from hapticd.client import Client, CommandError
from hapticd.gateway.command_server import OUTDATED

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ("--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu")
PATIENCE_MS = 30_000


class Served:
    """`hapticd console` of an instance, started in `folder`; its URL is known once it serves."""

    def __init__(self, instance: str, folder: Path) -> None:
        command = [sys.executable, "-m", "hapticd", "console", "--instance", instance, "--json"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)

    def __enter__(self) -> Self:
        assert self.process.stdout is not None
        self.url: str = json.loads(self.process.stdout.readline())["url"]
        return self

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(20) == 0
        assert self.process.stdout is not None
        self.process.stdout.close()


class PatientClient(Client):
    """Repeats requests that a gateway dropped after a pause of the machine. A dropped request had
    no effect, and its reply states that.
    """

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        try:
            return super().call(cmd, **fields)
        except CommandError as error:
            if OUTDATED not in str(error):
                raise
            return self.call(cmd, **fields)


@contextmanager
def paused(pid: int) -> Iterator[None]:
    """Stop a process (SIGSTOP) for the duration of the context."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def wait_text(page: Page, place: str, text: str) -> None:
    """Until the element `place` shows `text`."""
    shows = "([place, text]) => document.querySelector(place).textContent.includes(text)"
    try:
        page.wait_for_function(shows, arg=[place, text], timeout=PATIENCE_MS)
    except TimeoutError:
        seen = {one: page.inner_text(one) for one in (place, "#lamp", "#fault", "#log")}
        raise AssertionError(f"{text!r} did not come: {seen}") from None


def lamp_colour(page: Page, folder: Path) -> tuple[int, int, int]:
    """The colour that most of the state lamp has on the screen."""
    return commonest(picture(page, "#lamp", folder))


def picture(page: Page, place: str, folder: Path) -> list[list[tuple[int, int, int]]]:
    """Pixels of an element, rows of (red, green, blue), as the browser drew them."""
    from PIL import Image

    file = folder / "shot.png"
    page.locator(place).screenshot(path=str(file))
    with Image.open(file) as image:
        plain = image.convert("RGB")
        width, height = plain.size
        pixels = list(plain.get_flattened_data())
    return [pixels[row * width : (row + 1) * width] for row in range(height)]


def commonest(rows: list[list[tuple[int, int, int]]]) -> tuple[int, int, int]:
    """The colour of most pixels."""
    flat = [pixel for row in rows for pixel in row]
    return max(set(flat), key=flat.count)
