"""`make pictures`: screenshots of the page for README and documentation.

A daemon on the simulated board and its page run in a temporary folder and are driven through the
page in Debian's Chromium. In the animation a simulated hand holds the handle.
"""

import os
import subprocess
import sys
import tempfile
import time
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
PATIENT = "[safety]\ngateway_timeout_s = 30.0\n"  # a busy machine must not show a fault
PATIENCE_MS = 120_000
# a grip that destabilises the undamped device, slowly enough to be seen, without a fault
HAND = """
limit_cycle_faults = false

[simulation.touch]

[[simulation.touch.hands]]
kind = "hold"
start_s = 1.0
duration_s = 3600.0
stiffness_n_per_m = 2467.0
damping_ns_per_m = 0.1
tremor_m = 3e-5
"""
MOVING_SIZE = (800, 450)
MOVING_COLOURS = 32
FRAME_MS = 200
SHOWN_MS = 2500  # of each part
PLANE_DRAWN = "() => document.querySelector('#plane-note').textContent.startsWith('by')"


def main() -> None:
    """Take all pictures, or those named on the command line."""
    asked = sys.argv[1:] or ["still", "moving"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        if "still" in asked:
            with daemon() as url:
                enabled(browser, url)
                refused(browser, url)
                stopped(browser, url)
        if "moving" in asked:
            with daemon(HAND) as url:
                moving(browser, url)
        browser.close()


@contextmanager
def daemon(more: str = "") -> Iterator[str]:
    """Start a separate daemon, with `more` in its configuration; yield the URL of its page."""
    with tempfile.TemporaryDirectory(prefix="hapticd-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        config = Path(folder) / "hapticd.toml"
        config.write_text(PATIENT + more)
        words = [sys.executable, "-m", "hapticd", "run", "--instance", INSTANCE]
        words += ["--config", str(config)]
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        try:
            yield page_of(process)
        finally:
            process.terminate()
            process.wait(20)


def page_of(process: "subprocess.Popen[bytes]") -> str:
    """Return the address of the page, once it exists."""
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


def opened(browser: Browser, url: str, scheme: str, scale: float = 1.5) -> Page:
    """Return the page at the size of the pictures, with data."""
    context = browser.new_context(
        viewport=SIZE,  # type: ignore[arg-type]
        color_scheme=scheme,  # type: ignore[arg-type]
        device_scale_factor=scale,
    )
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(url)
    page.wait_for_selector("html:not([data-state=nodata])")
    page.wait_for_function(PLANE_DRAWN)
    return page


def taken(page: Page, name: str) -> None:
    """Save a picture of the whole page, with few colours for a small file, and close the page."""
    drawn = Image.open(BytesIO(page.screenshot())).convert("RGB")
    drawn.quantize(COLOURS).save(FIGURES / f"{name}.png", optimize=True)
    page.context.close()


def enabled(browser: Browser, url: str) -> None:
    """Show a damped spring under noise: everything active."""
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
    """Show a refused change that is not passive, in the dark scheme."""
    page = opened(browser, url, "dark")
    page.select_option("#policy", "refuse")
    page.wait_for_timeout(1000)
    page.click("#damping-switch")
    page.wait_for_selector("#log .refused")
    page.wait_for_timeout(2000)
    taken(page, "console-refused")


def stopped(browser: Browser, url: str) -> None:
    """Show the page after the space bar."""
    page = opened(browser, url, "light")
    page.focus("#enable")
    page.wait_for_timeout(3000)
    page.keyboard.press("Space")
    page.wait_for_selector("html[data-state=stopped]")
    page.wait_for_timeout(700)
    taken(page, "console-stopped")


def moving(browser: Browser, url: str) -> None:
    """Record damping on and quiet, off and oscillating, on and quiet, STOP: one animation."""
    page = opened(browser, url, "light", 1.0)  # a smaller page leaves the servo its core
    page.click("#damping-switch")
    page.wait_for_selector("#damping-switch[aria-checked=true]")
    values(page, K="170", B="1")
    page.click("#enable")
    page.wait_for_selector("html[data-state=enabled]")
    page.wait_for_timeout(5000)
    frames = frames_of(page)
    for _ in range(2):
        page.click("#damping-switch")
        frames += frames_of(page)
    page.focus("#enable")
    page.keyboard.press("Space")
    frames += frames_of(page)
    first, *others = [one.quantize(MOVING_COLOURS) for one in frames]
    first.save(
        FIGURES / "console-moving.gif",
        save_all=True,
        append_images=others,
        duration=FRAME_MS,
        loop=0,
        optimize=True,
    )
    page.context.close()


def frames_of(page: Page) -> list[Image.Image]:
    """Return the page every FRAME_MS, or as often as the browser can, for SHOWN_MS."""
    taken_frames = []
    begin_ns = time.monotonic_ns()
    for number in range(SHOWN_MS // FRAME_MS):
        ahead_ms = number * FRAME_MS - (time.monotonic_ns() - begin_ns) / 1e6
        page.wait_for_timeout(max(0.0, ahead_ms))
        drawn = Image.open(BytesIO(page.screenshot())).convert("RGB")
        taken_frames.append(drawn.resize(MOVING_SIZE, Image.Resampling.LANCZOS))
    return taken_frames


def values(page: Page, **given: str) -> None:
    """Set values and wait for the receipt."""
    for name, value in given.items():
        page.fill(f"#{name}", value)
    page.click("#set")
    page.wait_for_selector("#log .done")
    page.wait_for_timeout(500)


if __name__ == "__main__":
    main()
