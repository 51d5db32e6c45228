"""The operators' page in Chromium: what is clicked and typed, and what is seen, against the daemon
itself. Nothing here looks at the page's own variables: texts, roles and pixels alone.
"""

import json
import os
import signal
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, WebSocketRoute, expect, sync_playwright
from playwright.sync_api import TimeoutError as PageTimeoutError
from support.console_page import (
    ARGUMENTS,
    CHROMIUM,
    PATIENCE_MS,
    PatientClient,
    Served,
    commonest,
    lamp_colour,
    paused,
    picture,
    wait_text,
)
from support.daemon import QUIET, Daemon, last_record, shared_daemon, until, zeroed

from hapticd.client import Client, CommandError
from hapticd.client.blocks import Block
from hapticd.core.faults import BY_CODE, FAULTS
from hapticd.gateway.publisher import described
from hapticd.mailbox import files
from hapticd.mailbox.daemons import stop_taken
from hapticd.mailbox.layout import State
from hapticd.mailbox.servo_side import ServoMailbox

# a busy machine has long delays, with which little is safe
pytestmark = [
    pytest.mark.process,
    pytest.mark.filterwarnings("ignore::hapticd.core.errors.GuardWarning"),
]
GREEN = (26, 127, 55)
RED = (198, 34, 34)
TRACE = (10, 95, 180)
AMBER = (179, 89, 0)
INK = (17, 22, 27)
UPGRADE = (
    "GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
    "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)
OVERFLOWING = """() => [...document.querySelectorAll("body *")].filter((one) => {
    const box = one.getBoundingClientRect();
    const part = (one.closest("section") ?? one.closest("body > *")).getBoundingClientRect();
    return box.width && !one.closest("#log") && (box.right > part.right + 1
        || box.bottom > part.bottom + 1 || part.right > innerWidth || part.bottom > innerHeight);
}).map((one) => one.outerHTML.slice(0, 80))"""

READ_IN_FULL = """(place) => [document.querySelector(place)].flatMap((one) =>
    [one, ...one.querySelectorAll("*")]).every((one) => {
        const text = document.createRange();
        text.selectNodeContents(one);
        return [...text.getClientRects()].every((line) => {
            for (let part = one; part !== document.body; part = part.parentElement) {
                const box = part.getBoundingClientRect();
                const cuts = getComputedStyle(part).overflow !== "visible";
                if (cuts && (line.right > box.right + 1 || line.bottom > box.bottom + 1
                    || line.left < box.left - 1 || line.top < box.top - 1)) return false;
            }
            return line.right <= innerWidth && line.bottom <= innerHeight;
        });
    })"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def shared() -> Iterator[Daemon]:
    """A daemon that several tests use, each from `disabled` with nothing rendered."""
    with shared_daemon() as daemon:
        yield daemon


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the shared console was started, and so where its recordings go."""
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def served(shared: Daemon, recordings: Path) -> Iterator[Served]:
    with Served(shared.instance, recordings) as served:
        yield served


@pytest.fixture
def daemon(shared: Daemon) -> Daemon:
    return shared


@pytest.fixture
def client(daemon: Daemon) -> Iterator[Client]:
    with PatientClient(daemon.instance, name="test") as client:
        client.call("stop")  # answered: one whose answer came late would stop the next test
        until(lambda: daemon.cli("reset") == 0, "reset")
        client.set(K=0.0, B=0.0, M=0.0, active_damping=0.0)
        zeroed(client)  # a busy machine may have cost the board its origin
        yield client


@pytest.fixture
def page(served: Served, client: Client, chromium: Browser) -> Iterator[Page]:
    page = opened(chromium, served.url)
    wait_text(page, "#lamp", "disabled")
    yield page
    page.context.close()


def opened(chromium: Browser, url: str, **context: object) -> Page:
    context = {"viewport": {"width": 1280, "height": 720}, "color_scheme": "light", **context}
    page = chromium.new_context(**context).new_page()  # type: ignore[arg-type]
    page.set_default_timeout(PATIENCE_MS)
    page.goto(url)
    return page


def state(client: Client) -> str:
    return str(client.call("get")["state"])


def test_enable_is_shown_once_the_servo_has_it(page: Page, client: Client, tmp_path: Path) -> None:
    page.get_by_role("button", name="Enable").click()
    wait_text(page, "#lamp", "enabled")
    assert state(client) == "enabled"
    assert lamp_colour(page, tmp_path) == GREEN


def test_lamp_shows_what_others_do_too(page: Page, client: Client, tmp_path: Path) -> None:
    client.enable()
    wait_text(page, "#lamp", "enabled")
    client.stop()
    wait_text(page, "#lamp", "stopped")
    assert lamp_colour(page, tmp_path) == RED


@pytest.mark.parametrize("key", ["Space", "Escape"])
@pytest.mark.parametrize("focus", ["#enable", "#damping-switch", "#K", "#policy", "#pause", "body"])
def test_a_key_stops_whatever_has_the_focus(
    page: Page, client: Client, focus: str, key: str
) -> None:
    client.enable()
    wait_text(page, "#lamp", "enabled")
    if focus != "body":
        page.focus(focus)
    page.keyboard.press(key)
    wait_text(page, "#lamp", "stopped")
    assert state(client) == "stopped"


def test_space_on_enable_stops_and_never_enables(page: Page, client: Client) -> None:
    before = client.status().tick
    page.focus("#enable")
    page.keyboard.press("Space")
    wait_text(page, "#lamp", "stopped")
    assert "enabled" not in states_since(client, before)


@pytest.mark.parametrize("press", ["Space", "Escape", "button"])
def test_who_stopped_at_the_page_may_reset_at_once(
    page: Page, daemon: Daemon, client: Client, press: str
) -> None:
    client.enable()
    wait_text(page, "#lamp", "enabled")
    page.click("#stop") if press == "button" else page.keyboard.press(press)
    wait_text(page, "#lamp", "stopped")
    until(lambda: stop_taken(daemon.folder), "force faded")
    page.click("#reset")
    wait_text(page, "#lamp", "disabled")
    log = page.inner_text("#log")
    assert "enabled -> stopped (by page)" in log
    assert "refused" not in log


def test_each_page_stops_in_its_own_name(
    page: Page, served: Served, chromium: Browser, client: Client
) -> None:
    other = opened(chromium, served.url)
    wait_text(other, "#lamp", "disabled")
    actors: list[str] = []
    for one in (page, other):
        one.on("request", lambda asked: actors.append(asked.url.partition("actor=")[2]))
        one.keyboard.press("Escape")
        wait_text(one, "#lamp", "stopped")
    names = [client.call("status")["result"]["actors"][actor] for actor in dict.fromkeys(actors)]
    assert names == ["page", "page"]
    other.context.close()


def states_since(client: Client, tick: int) -> list[str]:
    """States that the servo came into after `tick`, in their order."""
    events = [one for one in client.status().events if one.kind == "state"]
    return [one.state for one in events if one.tick > tick]


def test_stop_needs_neither_socket_nor_gateway(chromium: Browser, runtime: Path) -> None:
    patient = f"{QUIET}[safety]\ngateway_timeout_s = 30.0\n"  # no fault of its own meanwhile
    with Daemon(runtime, settings=patient) as daemon, Served(daemon.instance, runtime) as served:
        page = opened(chromium, served.url)
        page.get_by_role("button", name="Enable").click()
        wait_text(page, "#lamp", "enabled")
        with paused(daemon.children()["gateway"]):
            wait_text(page, "#lamp", "NO DATA")
            page.click("#stop")
            ring = daemon.folder / files.TELEMETRY
            until(lambda: last_record(ring)["state"] == State.STOPPED, "stopped")
        wait_text(page, "#lamp", "stopped")
        page.context.close()


def test_stop_that_nobody_took_is_told_and_sent_again(
    page: Page, client: Client, served: Served
) -> None:
    client.enable()
    with paused(served.process.pid):
        page.context.set_offline(True)
        page.click("#stop")
        wait_text(page, "#log", "NOT STOPPED")
    page.context.set_offline(False)
    until(lambda: state(client) == "stopped", "stopped")


def test_stop_at_a_server_that_stands_still_is_told_while_it_stands(
    page: Page, client: Client, served: Served, tmp_path: Path
) -> None:
    client.enable()
    wait_text(page, "#lamp", "enabled")
    with paused(served.process.pid):
        page.click("#stop")
        wait_text(page, "#log", "NOT STOPPED")
        expect(page.locator("#stop")).to_have_class("failed")
        wait_text(page, "#not-stopped", "Use the emergency stop, or: hapticd stop")
        assert commonest(picture(page, "#not-stopped", tmp_path)) == RED
        assert read_in_full(page, "#not-stopped")
    until(lambda: state(client) == "stopped", "stopped")
    wait_text(page, "#lamp", "stopped")
    expect(page.locator("#stop")).not_to_have_class("failed")
    expect(page.locator("#not-stopped")).to_be_hidden()


def test_stop_goes_over_the_live_connection_where_its_request_does_not(
    page: Page, client: Client
) -> None:
    page.route("**/stop?*", lambda route: route.abort())
    client.enable()
    wait_text(page, "#lamp", "enabled")
    page.keyboard.press("Escape")
    wait_text(page, "#lamp", "stopped")
    assert state(client) == "stopped"
    expect(page.locator("#not-stopped")).to_be_hidden()
    page.click("#reset")
    wait_text(page, "#lamp", "disabled")
    page.wait_for_timeout(1000)
    assert state(client) == "disabled"  # nothing is sent again behind a stop that was taken


def test_stop_is_sent_again_until_the_operator_dismisses_it(
    page: Page, served: Served, client: Client
) -> None:
    sent: list[str] = []
    page.on("request", lambda asked: sent.append(f"{asked.method} {asked.url}"))
    with paused(served.process.pid):
        page.click("#stop")
        until(lambda: waited(page) and len(sent) > 2, "another stop")
        page.click("#not-stopped button")
        expect(page.locator("#not-stopped")).to_be_hidden()
        expect(page.locator("#stop")).not_to_have_class("failed")
        wait_text(
            page, "#log", "STOP is not sent again; whether the device is stopped is not known"
        )
        before = len(sent)
        page.wait_for_timeout(2000)
        assert len(sent) == before
        page.click("#stop")  # another press is another stop
        until(lambda: waited(page) and len(sent) > before, "a stop")
    assert all("POST" in one and "/stop?actor=" in one for one in sent)
    until(lambda: state(client) == "stopped", "stopped")
    expect(page.locator("#not-stopped")).to_be_hidden()


def waited(page: Page) -> bool:
    """Let the page go on for a while; the requests that it sends are seen only then."""
    page.wait_for_timeout(100)
    return True


def test_stop_that_the_servo_has_not_taken_is_not_stopped(
    served: Served, client: Client, chromium: Browser
) -> None:
    """It ends with a record that says so."""
    page = opened(chromium, "about:blank")
    sent: list[str] = []
    without_stops(page, sent)
    pressed = {"ok": True, "states": ["pressed"], "text": ""}
    page.route("**/stop?*", lambda route: route.fulfill(json=pressed))
    page.goto(served.url)
    client.enable()
    wait_text(page, "#lamp", "enabled")
    page.click("#stop")
    wait_text(page, "#not-stopped", "the servo has not taken it")
    assert state(client) == "enabled"
    client.stop()
    wait_text(page, "#lamp", "stopped")
    expect(page.locator("#not-stopped")).to_be_hidden()
    page.context.close()


def without_stops(page: Page, sent: list[str]) -> list[WebSocketRoute]:
    """The live connections of `page`, of which the first takes no stop to the server; what the page
    sends over them goes to `sent`.
    """
    lines: list[WebSocketRoute] = []

    def heard(server: WebSocketRoute, data: str) -> None:
        sent.append(json.loads(data).get("cmd", "ack"))
        if sent[-1] != "stop" or len(lines) > 1:
            server.send(data)

    def between(line: WebSocketRoute) -> None:
        lines.append(line)
        server = line.connect_to_server()
        line.on_message(lambda data: heard(server, str(data)))

    page.route_web_socket("**/live", between)
    return lines


def test_stop_is_sent_again_by_each_new_connection_and_never_resets(
    served: Served, client: Client, chromium: Browser
) -> None:
    page = opened(chromium, "about:blank")
    sent: list[str] = []
    lines = without_stops(page, sent)
    page.route("**/stop?*", lambda route: route.abort())
    page.goto(served.url)
    client.enable()
    wait_text(page, "#lamp", "enabled")
    page.click("#stop")
    wait_text(page, "#not-stopped", "the page's server does not answer")
    assert sent.count("stop") == 1  # a connection loses nothing
    lines[0].close()
    wait_text(page, "#lamp", "stopped")
    assert state(client) == "stopped"
    expect(page.locator("#not-stopped")).to_be_hidden()
    assert set(sent) <= {"hello", "ack", "stop"}
    page.context.close()


def test_damping_lamp_is_what_the_board_reports(page: Page, client: Client) -> None:
    switch = page.get_by_role("switch")
    expect(switch).to_have_attribute("aria-checked", "false")
    switch.click()
    expect(switch).to_have_attribute("aria-checked", "true")
    wait_text(page, "#damping-board", "board reports 11403 counts = 1.74")
    assert reported(client) == pytest.approx(1.74, abs=1e-4)
    switch.click()
    expect(switch).to_have_attribute("aria-checked", "false")
    assert reported(client) == 0.0


def reported(client: Client) -> float:
    """Active damping [N s/m] in effect, as the board says."""
    return float(client.record(0.02)[0]["active_damping_effect_ns_per_m"][-1])


def test_values_are_set_together_with_a_receipt_in_words(page: Page, client: Client) -> None:
    page.fill("#K", "80")
    page.fill("#B", "0.5")
    page.keyboard.press("Enter")
    wait_text(page, "#log", "disabled: applied at tick")
    parameters = client.get().parameters
    assert (parameters["K"], parameters["B"]) == (80.0, 0.5)
    wait_text(page, "#K-now", "80")


def test_a_refusal_is_told_in_words(page: Page, client: Client) -> None:
    page.fill("#K", "1e9")
    page.click("#set")
    wait_text(page, "#log", "refused: K = 1e+09 N/m: beyond the limit")
    assert client.get().parameters["K"] == 0.0


@pytest.mark.parametrize("text", ["1,5", "1.000,5", "0x10", "abc", "1e999"])
def test_what_the_command_line_takes_for_no_number_the_page_does_not_set(
    page: Page, client: Client, text: str
) -> None:
    page.fill("#K", "80")
    page.fill("#B", text)
    page.keyboard.press("Enter")
    wait_text(page, "#log", f"refused: B: '{text}' is not a number")
    assert client.get().parameters["K"] == 0.0


def test_a_trigger_at_no_number_says_so(page: Page) -> None:
    page.fill("#threshold", "1,5")
    page.select_option("#trigger", "normal")
    wait_text(page, "#scope-note", "'1,5' is not a number")


def test_numbers_are_the_newest_while_a_trigger_is_waited_for(page: Page, client: Client) -> None:
    page.fill("#threshold", "1000")
    page.select_option("#trigger", "normal")
    wait_text(page, "#scope-note", "waits for")
    client.damping(1.2)
    wait_text(page, "#strips .strip:last-child .value", "1.2")


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080), (1024, 768)])
def test_a_refusal_of_the_guard_is_read_in_full_a_thought_a_line(
    page: Page, client: Client, size: tuple[int, int]
) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    client.guard("refuse")
    try:
        page.fill("#K", "30000")
        until(lambda: "ask for less" in refusal(page), "a verdict, in time on a busy machine too")
        wrong, allowed, damping, remedy = page.inner_text("#log .refused span").splitlines()
        assert "K = 30000 N/m" in wrong
        assert allowed.startswith(("allowed, each", "no K, B or M alone"))
        assert "active damping" in damping
        assert remedy.startswith("ask for less")
        assert read_in_full(page, "#log .refused")
    finally:
        client.guard("warn")


def refusal(page: Page) -> str:
    """What a click on Set is refused with, and time for the hand that would shake it."""
    page.click("#set")
    page.wait_for_timeout(1500)
    return page.inner_text("#log li.refused >> nth=0")


def read_in_full(page: Page, place: str) -> bool:
    """Whether nothing of the element `place` and of what is in it is cut or scrolled away."""
    return bool(page.evaluate(READ_IN_FULL, place))


def test_a_receipt_of_the_guard_says_policy_basis_and_verdict(page: Page, client: Client) -> None:
    client.set(K=100.0, B=1.0, active_damping=1.74)
    wait_text(page, "#verdict", "K = 100 N/m, B = 1 N s/m, M = 0 kg")
    page.select_option("#policy", "refuse")
    wait_text(page, "#log", "guard: refuse, by theorem")
    wait_text(page, "#log", "K = 100 N/m, B = 1 N s/m, M = 0 kg")
    page.select_option("#policy", "warn")
    wait_text(page, "#log", "guard: warn, by theorem")


def test_a_stop_is_left_by_the_button_and_its_remedy_is_read_in_full(
    page: Page, client: Client
) -> None:
    client.stop()
    wait_text(page, "#fault", "make sure it is safe, then press Reset")
    assert read_in_full(page, "#fault")
    page.click("#enable")
    wait_text(page, "#log", "refused: enable in state stopped")
    assert "hapticd reset" not in page.inner_text("body")


def is_state(message: str | bytes) -> bool:
    """Whether it is a message of the state, and no frame."""
    return isinstance(message, str) and json.loads(message)["kind"] == "state"


class Told:
    """A page that is told the state by a test, and everything else by the daemon."""

    def __init__(self, chromium: Browser, url: str, size: tuple[int, int]) -> None:
        self.page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
        self.sockets: list[WebSocketRoute] = []
        self.page.route_web_socket("**/live", self.between)
        self.page.goto(url)
        wait_text(self.page, "#lamp", "disabled")

    def between(self, socket: WebSocketRoute) -> None:
        daemon = socket.connect_to_server()
        self.sockets.append(socket)
        daemon.on_message(lambda data: is_state(data) or socket.send(data))

    def state(self, **told: str) -> None:
        self.tell("state", **told)

    def tell(self, kind: str, **told: str) -> None:
        self.sockets[0].send(json.dumps({"kind": kind, "told": told}))


@pytest.fixture
def told(chromium: Browser, served: Served, client: Client) -> Iterator[Told]:
    told = Told(chromium, served.url, (1280, 720))
    yield told
    told.page.close()


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080), (1024, 768)])
def test_every_fault_and_its_remedy_are_read_in_full(
    served: Served, client: Client, chromium: Browser, size: tuple[int, int]
) -> None:
    told = Told(chromium, served.url, size)
    for fault in FAULTS[1:]:
        told.state(fault=fault.code, **described(fault))
        wait_text(told.page, "#fault", fault.cause)
        assert read_in_full(told.page, "#fault"), fault.code
    told.page.close()


def test_what_the_servo_waits_for_is_told_once_for_each_reason(told: Told) -> None:
    lost = described(BY_CODE["usb_lost"]) | {"fault": "usb_lost"}
    denied = "cannot open the board: Access denied"
    told.state(**lost)
    for reason in ("no board at the bus", denied, denied, ""):
        told.tell("board", text=reason and f"the servo waits for the board: {reason}")
    wait_text(told.page, "#log", "the board answers")
    lines = told.page.locator("#log li span").all_inner_texts()
    assert lines[:3] == [
        "the board answers",
        f"the servo waits for the board: {denied}",
        "the servo waits for the board: no board at the bus",
    ]


def test_margin_and_allowed_range_come_from_the_guard(page: Page, client: Client) -> None:
    client.set(K=100.0, B=1.0, active_damping=1.74)
    wait_text(page, "#margin", "spare")
    until(lambda: f"passive {allowed(client)}" in page.inner_text("#K-range"), "the range of K")
    client.damping("off")
    wait_text(page, "#margin", "short")


def allowed(client: Client) -> str:
    """The range of K that the guard names now, as the page writes numbers; the delay may change."""
    verdict = client.guard().verdict
    return "{:.3g} to {:.3g}".format(*verdict.allowed["K"]) if verdict else "unknown"


def test_stale_data_are_no_data(page: Page, daemon: Daemon, tmp_path: Path) -> None:
    with paused(daemon.children()["gateway"]):
        wait_text(page, "#lamp", "NO DATA")
        assert lamp_colour(page, tmp_path) == RED
        for place in ("#K-now", "#damping-word", "#margin"):
            expect(page.locator(place)).to_be_hidden()
    wait_text(page, "#lamp", "disabled")


def test_page_goes_on_after_the_gateway_died(page: Page, daemon: Daemon, client: Client) -> None:
    gateway = daemon.children()["gateway"]
    with paused(daemon.process.pid):  # a slow browser would miss a gateway that is back at once
        os.kill(gateway, signal.SIGKILL)
        wait_text(page, "#lamp", "NO DATA")
    wait_text(page, "#lamp", "disabled")
    page.get_by_role("button", name="Enable").click()
    wait_text(page, "#lamp", "enabled")


def test_trace_moves_with_the_handle(page: Page, client: Client, tmp_path: Path) -> None:
    still = traced(page, tmp_path)
    client.enable()
    client.perturb_load(np.sin(2 * np.pi * 10 * np.arange(4000) / 4000))
    client.perturb_start(loop=True)
    until(lambda: traced(page, tmp_path) > 10 * max(still, 4), "a trace that moves")


def traced(page: Page, folder: Path) -> int:
    """Over how many rows of its strip the trace of the velocity goes."""
    rows = picture(page, ".strip:nth-child(2) .plot", folder)
    return sum(any(near(pixel, TRACE) for pixel in row) for row in rows)


def near(one: tuple[int, int, int], other: tuple[int, int, int]) -> bool:
    return sum(abs(a - b) for a, b in zip(one, other, strict=True)) < 60


def test_two_browsers_see_and_do_the_same(
    page: Page, served: Served, chromium: Browser, client: Client
) -> None:
    other = opened(chromium, served.url, color_scheme="dark")
    other.get_by_role("button", name="Enable").click()
    for one in (page, other):
        wait_text(one, "#lamp", "enabled")
    page.keyboard.press("Escape")
    for one in (page, other):
        wait_text(one, "#lamp", "stopped")
    other.context.close()


def test_page_says_simulated_without_scripts(
    served: Served, chromium: Browser, client: Client
) -> None:
    bare = opened(chromium, served.url, java_script_enabled=False)
    expect(bare.locator("#board")).to_have_text("SIMULATED")
    assert "SIMULATED" in bare.title()
    bare.context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080), (1024, 768), (1280, 800), (1024, 700)])
def test_nothing_overflows(
    served: Served, chromium: Browser, client: Client, scheme: str, size: tuple[int, int]
) -> None:
    viewport = {"width": size[0], "height": size[1]}
    page = opened(chromium, served.url, viewport=viewport, color_scheme=scheme)
    wait_text(page, "#verdict", "N")
    assert page.evaluate(OVERFLOWING) == []
    page.context.close()


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080), (1024, 768)])
def test_verdict_margin_and_level_are_read_in_full(
    served: Served, chromium: Browser, client: Client, size: tuple[int, int]
) -> None:
    page = opened(chromium, served.url, viewport={"width": size[0], "height": size[1]})
    client.set(K=500.0, B=2.0, active_damping=0.7143)
    client.damping("off")
    wait_text(page, "#verdict", "K = 500 N/m, B = 2 N s/m, M = 0 kg with 0 N s/m of active damping")
    assert read_in_full(page, "#guard")
    page.evaluate("document.querySelector('#margin').textContent = 'spare 0.678 N\u202fs/m'")
    assert read_in_full(page, "#guard")
    client.damping("on")
    wait_text(page, "#level-now", "0.7143")
    fits = "(one) => one.scrollWidth <= one.clientWidth"
    assert page.eval_on_selector("#level-now", fits)
    page.context.close()


def test_page_loads_nothing_from_elsewhere(served: Served, chromium: Browser) -> None:
    page = opened(chromium, "about:blank")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(served.url)
    wait_text(page, "#lamp", "disabled")
    assert all(url.startswith(served.url) for url in asked)
    page.context.close()


def test_a_lease_and_a_proxy_of_another_are_shown_and_refuse_in_words(
    page: Page, client: Client
) -> None:
    with client.lease("environment", ttl_s=60.0):
        wait_text(page, "#lease-holder", "environment: test")
        assert read_in_full(page, "#lease-holder")
        page.fill("#K", "50")
        page.click("#set")
        wait_text(page, "#log", "refused")
        assert client.get().parameters["K"] == 0.0
        client.enable()
        client.proxy(0.002)
        wait_text(page, "#proxy", "mm, by test (")
        wait_text(page, "#proxy", "proxy held: ")
        assert read_in_full(page, "#proxy")
        assert page.evaluate(OVERFLOWING) == []
        page.click("#stop")
        wait_text(page, "#lamp", "stopped")
        expect(page.locator("#proxy")).to_have_text("")
    wait_text(page, "#lease-holder", "none")


def test_a_lease_of_the_page_is_kept_while_it_is_open_and_ends_with_it(
    served: Served, chromium: Browser, client: Client
) -> None:
    page = opened(chromium, served.url)
    wait_text(page, "#lamp", "disabled")
    page.select_option("#lease-what", "active_damping")
    page.click("#lease-take")
    wait_text(page, "#lease-holder", "damping: this page")
    taken = client.status().leases["active_damping"]
    until(lambda: client.status().leases["active_damping"].left_s < taken.ttl_s - 0.5, "time")
    until(
        lambda: client.status().leases["active_damping"].left_s > taken.ttl_s - 0.4,
        "renewed",
    )
    with pytest.raises(CommandError):
        client.damping("on")
    page.context.close()
    until(lambda: not client.status().leases, "its end")


def test_plane_shows_the_point_and_follows_damping(page: Page, tmp_path: Path) -> None:
    wait_text(page, "#plane-note", "by theorem")
    until(lambda: has(page, "#plane .plot", tmp_path, AMBER), "the edge with damping")
    assert has(page, "#plane .plot", tmp_path, GREEN)
    assert has(page, "#plane .plot", tmp_path, INK)


def has(page: Page, place: str, folder: Path, colour: tuple[int, int, int]) -> bool:
    """Whether pixels of this colour are seen."""
    rows = picture(page, place, folder)
    return sum(near(pixel, colour) for row in rows for pixel in row) > 20


def test_impedance_is_estimated_while_something_excites_the_device(
    page: Page, client: Client, tmp_path: Path
) -> None:
    wait_text(page, "#impedance-note", "no excitation")
    client.enable()
    page.click("#excite")
    wait_text(page, "#impedance-note", "Re Z")
    wait_text(page, "#impedance h2", "running estimate, no verdict")
    until(lambda: has(page, "#impedance .plot", tmp_path, TRACE), "an estimate")
    page.click("#excite")
    wait_text(page, "#impedance-note", "no excitation")


def test_a_recording_has_the_operators_words(page: Page, served: Served, recordings: Path) -> None:
    page.fill("#note", "a stiff wall")
    page.keyboard.press("Space")  # a space of the note, and no stop
    page.click("#record")
    wait_text(page, "#record", "End recording")
    wait_text(page, "#log", "recording into")
    page.wait_for_timeout(1500)
    console = served.process.pid
    (recorder,) = Path(f"/proc/{console}/task/{console}/children").read_text().split()
    with paused(int(recorder)):  # else it may have packed before anybody looks
        page.click("#record")
        wait_text(page, "#record", "packing")
        expect(page.locator("#record")).to_be_disabled()
    wait_text(page, "#log", "ticks, 0 missing")
    expect(page.locator("#record")).to_be_enabled()
    (file,) = recordings.glob("*.h5")
    with h5py.File(file) as recording:
        assert recording.attrs["note"] == b"a stiff wall "
    file.unlink()


def test_what_is_seen_is_saved(page: Page, client: Client) -> None:
    """Against what the daemon published meanwhile. A busy machine may lose frames on the way to the
    page; then another second is looked at.
    """
    excited(client)
    page.select_option("#span", "1")

    def whole() -> bool:
        with ThreadPoolExecutor(1) as beside:
            recording = beside.submit(lambda: list(client.stream(seconds=4.0)))
            page.wait_for_timeout(2000)
            page.click("#pause")
            head, zero_s, values = saved(page)
            page.click("#pause")
            compared, published = same(recording.result(), zero_s, values)
        assert "SIMULATED" in head
        assert values[0, 0] >= -1.0 - 1e-6
        assert values[-1, 0] == pytest.approx(0.0, abs=1e-6)  # the newest
        return published - 3 <= compared > 200 and np.ptp(values[:, 2]) > 0.01

    until(whole, "a second of which nothing was lost on the way")


def same(blocks: list[Block], zero_s: float, values: np.ndarray) -> tuple[int, int]:
    """How many saved rows are of the time of `blocks`, and how many records of these are of the
    time of the rows; each such row is one of them.
    """
    records = np.concatenate([block.records for block in blocks])
    unix_s = (records["time_ns"] + blocks[0].header["mono_unix_offset_ns"]) / 1e9
    names = ("position_m", "velocity_m_per_s", "force_n")
    known = set(zip(*(records[name].tolist() for name in names), strict=True))
    at_s = zero_s + values[:, 0]  # 0 s is told to 1 ms
    first_s = max(at_s[0], unix_s[0]) + 0.01
    last_s = min(at_s[-1], unix_s[-1]) - 0.01
    compared = values[(at_s > first_s) & (at_s < last_s), 1:4]
    assert {tuple(row) for row in compared.tolist()} <= known
    return len(compared), int(np.count_nonzero((unix_s > first_s) & (unix_s < last_s)))


def excited(client: Client) -> None:
    """Force is on, and a sine of 10 Hz moves the device by 6 mm to each side: at its stops it would
    bounce until the encoder seems to glitch.
    """
    client.enable()
    client.perturb_load(0.2 * np.sin(2 * np.pi * 10 * np.arange(4000) / 4000))
    client.perturb_start(loop=True)


def saved(page: Page, timeout_ms: float = 30_000.0) -> tuple[str, float, np.ndarray]:
    """What Save writes: its head, the Unix time of its 0 s, and the rows."""
    with page.expect_download(timeout=timeout_ms) as download:
        page.click("#save")
    head, _, rows = Path(download.value.path()).read_text().partition("time_s,")
    zero = head.partition("time 0 is ")[2].partition(";")[0]
    at_s = datetime.fromisoformat(zero).timestamp()
    return head, at_s, np.loadtxt(rows.splitlines()[1:], delimiter=",")


def test_no_trigger_counts_within_the_hold_off(page: Page, client: Client) -> None:
    excited(client)
    page.select_option("#span", "0.1")
    page.select_option("#source", "velocity_m_per_s")
    page.select_option("#trigger", "normal")
    page.select_option("#holdoff", "0.5")
    page.wait_for_timeout(500)  # what is shown is of this setting
    wait_text(page, "#scope-note", "0 s is the trigger")
    times_s: set[float] = set()

    def several() -> bool:
        with suppress(PageTimeoutError):  # nothing is shown, so nothing is saved, now and then
            times_s.add(saved(page, 2000.0)[1])
        return len(times_s) > 3

    until(several, "triggers")
    assert np.diff(sorted(times_s)).min() >= 0.5 - 2e-3  # a crossing comes every 0.1 s


def test_what_is_not_allowed_is_refused_in_words(page: Page, client: Client) -> None:
    page.click("#home")
    wait_text(page, "#log", "refused: home: the device file names no way to home")
    client.enable()
    page.click("#zero")
    wait_text(page, "#log", "refused: zero in state enabled: possible only in disabled")


def test_zero_has_the_position_count_from_here(page: Page, client: Client) -> None:
    page.click("#zero")
    wait_text(page, "#log", "disabled: applied at tick")
    assert abs(client.record(0.02)[0]["position_m"][-1]) < 1e-4


def test_a_dump_names_the_file_of_the_flight_recorder(page: Page) -> None:
    page.click("#dump")
    wait_text(page, "#log", "flight recording of asked: ")
    _, _, told = page.inner_text("#log").partition("flight recording of asked: ")
    assert Path(told.splitlines()[0]).is_file()


def test_a_board_that_is_not_there_is_named_as_status_names_it(
    chromium: Browser, runtime: Path
) -> None:
    reason = "cannot open the board: Access denied"
    with Served("waiting", runtime) as served:
        page = opened(chromium, served.url)
        wait_text(page, "#fault", "no servo runs; start it with `hapticd run`")
        mailbox = ServoMailbox(files.runtime_folder("waiting"), 1000.0, "", False, 1)
        mailbox.report({"waiting_for": reason})
        wait_text(page, "#fault", f"the servo waits for the board: {reason}")
        wait_text(page, "#log", reason)
        assert page.inner_text("#lamp") == "NO DATA"
        assert read_in_full(page, "#fault")
        mailbox.close()
        page.context.close()


def test_trigger_shows_a_crossing_at_0_s(page: Page, client: Client) -> None:
    excited(client)
    page.select_option("#span", "0.5")
    page.select_option("#source", "velocity_m_per_s")
    page.fill("#threshold", "10")
    page.select_option("#trigger", "single")
    wait_text(page, "#pause", "Run")
    _, _, values = saved(page)
    after = np.searchsorted(values[:, 0], -1e-9)
    assert values[after - 1, 2] < 0.010 <= values[after, 2]
    assert -0.135 < values[0, 0] < -0.05  # a quarter of the span, less what a busy host lost


def test_a_slow_browser_delays_nobody(page: Page, served: Served, client: Client) -> None:
    port = int(served.url.rsplit(":", 1)[1].strip("/"))
    with socket.create_connection(("127.0.0.1", port)) as slow:
        slow.sendall(UPGRADE.format(port=port).encode())
        assert slow.recv(12) == b"HTTP/1.1 101"
        page.wait_for_timeout(3000)  # it reads nothing
        page.get_by_role("button", name="Enable").click()
        wait_text(page, "#lamp", "enabled")
        expect(page.locator("#lamp")).not_to_have_text("NO DATA")
        slow.setblocking(False)
        waiting = len(slow.recv(1 << 22))
    assert waiting < 60 * 2000  # a window of frames and the states, not three seconds of them


def test_console_that_died_comes_back_at_its_port_and_finds_its_pages(
    chromium: Browser, runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Daemon(runtime, console=True) as daemon:
        until(lambda: "page" in daemon.events(), "a page")
        assert daemon.cli("status", "--json") == 0
        place = json.loads(capsys.readouterr().out)["console"]
        assert place["url"] in daemon.log.read_text()  # what `hapticd run` says
        page = opened(chromium, place["url"])
        wait_text(page, "#lamp", "disabled")
        os.kill(place["pid"], signal.SIGKILL)
        wait_text(page, "#lamp", "NO DATA")
        wait_text(page, "#lamp", "disabled")
        page.click("#stop")
        wait_text(page, "#lamp", "stopped")
        page.context.close()
