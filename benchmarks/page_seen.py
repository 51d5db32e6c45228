"""Latency for a person at the page, in Chromium: from a click on the damping switch to the board's
report on the page, and from an address to the first paint.

The yardstick of the click is a minimal page whose button sends one message over a websocket and
shows the echo. The same mouse clicks both, in turns. The same lines inside the page time them, from
the time stamp of the click until the count reported by the board changes. (Damping then starts its
ramp, on any page.) The yardstick of the first paint is a page with the same bytes as text, from a
minimal server, by Chromium's own paint timing.
"""

import random
from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

from benchmarks import daemon, targets
from benchmarks.blocks import quantile
from benchmarks.figures import Figure, compared
from benchmarks.page_cpu import page_of, worker
from benchmarks.worker import next_json
from hapticd.client import Client

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

TARGETS = targets.of("page_seen")
CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ("--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu")
SIZE = {"width": 1280, "height": 720}
ROUNDS = 20
CLICKS = 20  # a round
PAINTS = 20
REST_MS = (120, 200)  # after each report: the damping's ramp ends, and clicks are not synchronised
WATCHED = """([button, report]) => {
    window.taken_ms = [];
    let clicked_ms = null;
    let tell = () => {};
    button.addEventListener("click", (event) => { clicked_ms = event.timeStamp; }, true);
    const reported = () => {
        if (clicked_ms === null) return;
        taken_ms.push(performance.now() - clicked_ms);
        clicked_ms = null;
        tell();
    };
    new MutationObserver(reported).observe(report, { childList: true });
    window.reports = (count) => new Promise((done) => {
        tell = () => taken_ms.length >= count && done();
        tell();
    });
}"""
PAINTED = """() => new Promise((done) => {
    const first = (list) => {
        const found = list.find((one) => one.name === "first-contentful-paint");
        if (found) done(found.startTime);
    };
    new PerformanceObserver((found) => first(found.getEntries())).observe(
        { type: "paint", buffered: true });
})"""


def measure() -> Iterator[Figure]:
    """Yield the ratio of the 99th percentiles of a click, and of the medians of the first paint."""
    from playwright.sync_api import sync_playwright  # a tool of `make check`, not of `make test`

    with daemon.running("seen") as instance, ExitStack() as stack:
        url = str(page_of(instance)["url"])
        bare = next_json(worker(stack, "serve"), "the bare server")["url"]
        playwright = stack.enter_context(sync_playwright())
        browsers = [
            playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
            for _ in range(2)
        ]
        with Client(instance) as client:
            client.damping("off")
        pages = [opened(browser, one) for browser, one in zip(browsers, (url, bare), strict=True)]
        taken_ms = clicked(pages)
        for page in pages:
            page.close()
        painted_ms = [
            [
                painted(browser, one)
                for browser, one in zip(browsers, (url, f"{bare}same"), strict=True)
            ]
            for _ in range(PAINTS)
        ]
        for browser in browsers:
            browser.close()
    ours, theirs = (quantile(one, 0.99) for one in taken_ms)
    middles = " and ".join(f"{quantile(one, 0.5):.1f}" for one in taken_ms)
    note = f"{len(taken_ms[0])} clicks each, medians {middles} ms"
    yield compared("toggle_ratio", TARGETS["toggle_ratio"], ours, "ms", theirs, note)
    ours, theirs = (quantile(list(one), 0.5) for one in zip(*painted_ms, strict=True))
    yield compared("first_paint_ratio", TARGETS["first_paint_ratio"], ours, "ms", theirs)


def opened(browser: "Browser", url: str) -> "Page":
    """Return a page with a ready switch and an observed report."""
    page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
    page.goto(url)
    page.wait_for_selector("#damping-switch[aria-checked=false]")
    page.wait_for_timeout(2000)
    parts = [page.query_selector(one) for one in ("#damping-switch", "#damping-board")]
    page.evaluate(WATCHED, parts)
    return page


def clicked(pages: "list[Page]") -> list[list[float]]:
    """Return times [ms] from click to report, for each page, in alternating series of clicks."""
    random.seed(1)
    for _ in range(ROUNDS):
        for page in pages:
            box = page.locator("#damping-switch").bounding_box()
            assert box is not None
            for _ in range(CLICKS):
                page.wait_for_timeout(random.uniform(*REST_MS))
                count = page.evaluate("taken_ms.length") + 1
                page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
                page.evaluate("(count) => reports(count)", count)
    return [page.evaluate("taken_ms") for page in pages]


def painted(browser: "Browser", url: str) -> float:
    """Return the time [ms] to the first contentful paint of a browser with an empty cache."""
    page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
    page.goto(url)
    found: float = page.evaluate(PAINTED)
    page.context.close()
    return found
