"""`make pictures`: the screenshots of README and documentation, taken of the page itself.

A daemon on the simulated board and its page are started in a folder of their own, driven through
the page in Debian's Chromium, and looked at.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from hapticd.mailbox.daemons import console_place, daemon_folder

FIGURES = Path(__file__).with_name("figures")
CHROMIUM = "/usr/bin/chromium"
INSTANCE = "display"
SIZE = {"width": 1280, "height": 720}
LOOK_MS = 200
PATIENCE = 600  # looks
COLOURS = 160
PATIENT = "[safety]\ngateway_timeout_s = 30.0\n"  # a busy machine is no fault to be shown
PATIENCE_MS = 120_000
PLANE_DRAWN = "() => document.querySelector('#plane-note').textContent.startsWith('by')"


def main() -> None:
    """Take all pictures."""
    with daemon() as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        enabled(browser, url)
        refused(browser, url)
        stopped(browser, url)
        browser.close()


@contextmanager
def daemon() -> Iterator[str]:
    """A daemon of its own; the URL of its page."""
    with tempfile.TemporaryDirectory(prefix="hapticd-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        config = Path(folder) / "hapticd.toml"
        config.write_text(PATIENT)
        words = [sys.executable, "-m", "hapticd", "run", "--instance", INSTANCE]
        words += ["--config", str(config)]
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        try:
            yield page_of(process)
        finally:
            process.terminate()
            process.wait(20)


def page_of(process: "subprocess.Popen[bytes]") -> str:
    """Where the page is, once it is there."""
    for _ in range(PATIENCE):
        place = console_place(daemon_folder(INSTANCE))
        if place is not None:
            return str(place["url"])
        try:
            process.wait(LOOK_MS / 1000)
        except subprocess.TimeoutExpired:
            continue
        break
    raise SystemExit("the page did not come; see the messages of `hapticd run` above")


def opened(browser: Browser, url: str, scheme: str) -> Page:
    """The page at the size of the pictures, with data."""
    context = browser.new_context(
        viewport=SIZE,  # type: ignore[arg-type]
        color_scheme=scheme,  # type: ignore[arg-type]
        device_scale_factor=1.5,
    )
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(url)
    page.wait_for_selector("html:not([data-state=nodata])")
    page.wait_for_function(PLANE_DRAWN)
    return page


def taken(page: Page, name: str) -> None:
    """The picture of the whole page, with few colours so that the file is small; the page is
    closed.
    """
    drawn = Image.open(BytesIO(page.screenshot())).convert("RGB")
    drawn.quantize(COLOURS).save(FIGURES / f"{name}.png", optimize=True)
    page.context.close()


def enabled(browser: Browser, url: str) -> None:
    """A damped spring under noise: everything at work."""
    page = opened(browser, url, "light")
    page.click("#damping-switch")
    page.wait_for_selector("#damping-switch[aria-checked=true]")
    values(page, K="300", B="1")
    page.click("#enable")
    page.wait_for_selector("html[data-state=enabled]")
    page.click("#excite")
    page.wait_for_selector("#impedance-note .real")
    page.wait_for_timeout(6000)
    taken(page, "console")


def refused(browser: Browser, url: str) -> None:
    """What is not passive, under policy refuse, in the dark."""
    page = opened(browser, url, "dark")
    page.select_option("#policy", "refuse")
    page.wait_for_timeout(1000)
    page.click("#damping-switch")
    page.wait_for_selector("#log .refused")
    page.wait_for_timeout(2000)
    taken(page, "console-refused")


def stopped(browser: Browser, url: str) -> None:
    """After the space bar."""
    page = opened(browser, url, "light")
    page.focus("#enable")
    page.wait_for_timeout(3000)
    page.keyboard.press("Space")
    page.wait_for_selector("html[data-state=stopped]")
    page.wait_for_timeout(700)
    taken(page, "console-stopped")


def values(page: Page, **given: str) -> None:
    """Set values and wait for the receipt."""
    for name, value in given.items():
        page.fill(f"#{name}", value)
    page.click("#set")
    page.wait_for_selector("#log .done")
    page.wait_for_timeout(500)


if __name__ == "__main__":
    main()
