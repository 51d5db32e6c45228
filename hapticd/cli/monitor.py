"""Watch one daemon live: as strip charts, where single keys stop it or end the view, or event by
event.

Keys come from the terminal without waiting and without Enter, and none come when stdin is no
terminal. What would break it: waiting for data without a time-out, for then a silent daemon would
leave an old screen standing.
"""

import os
import select
import sys
import termios
import tty
from collections import deque
from collections.abc import Callable
from contextlib import closing
from datetime import datetime
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.core.errors import HapticdError
from hapticd.core.units import NS_PER_S

if TYPE_CHECKING:
    from hapticd.cli.screen import History


class Keys:
    """A context in which the terminal hands over each key at once and echoes none."""

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
        if self._before is not None:
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def pressed(self) -> str:
        """The keys since the last call; an arrow or function key comes as its escape sequence."""
        if self._before is None or not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 64).decode(errors="replace")


REDRAW_NS = NS_PER_S // 10
LOOK_S = 0.02  # between looks at what has come, and at the keys
TICKS = "servo.raw"
STATE = "state"  # what no record holds; nothing is asked, so that no key waits for an answer
EVENT = "event"
ASKED = "active_damping_asked_ns_per_m"
NEWEST = (
    "tick",
    "position_m",
    "force_n",
    "stiffness_n_per_m",
    "virtual_damping_ns_per_m",
    "mass_kg",
    "active_damping_ns_per_m",
    "gain",
    "delay_us",
    "delay_spread_us",
    "frame_age_us",
    "watches",
    "lease_control",
    "lease_active_damping",
)
Show = Callable[["History", bool | None, float], None]  # history, simulated, seconds without data


def monitor(
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="End after S seconds.")
    ] = None,
    as_json: terminal.JsonLines = False,
) -> None:
    """Watch live on one screen. Space or Esc stops the daemon, d switches active damping on or off,
    q or Ctrl-C ends only this screen.

    With --json, or when stdout is no terminal: one line every 0.1 s.
    """
    if as_json or not sys.stdout.isatty():
        watch(instance, seconds, _print_json if as_json else _print_line)
        return
    from rich.console import Console
    from rich.live import Live

    from hapticd.cli.screen import screen

    console = Console()

    def show(history: "History", simulated: bool | None, silent_s: float) -> None:
        live.update(screen(history, simulated, silent_s, console.size), refresh=True)

    with Live(console=console, screen=True, auto_refresh=False) as live:
        watch(instance, seconds, show)


def watch(instance: str, seconds: float | None, show: Show) -> None:
    """Show what comes ten times a second, also when nothing comes, and obey keys.

    `seconds` None: until q is pressed.
    """
    import msgpack

    from hapticd.cli.screen import NO_DATA_S, History
    from hapticd.client.blocks import BlockDecoder
    from hapticd.client.events import event_words
    from hapticd.core.clock import MonotonicClock

    clock = MonotonicClock()
    begin_ns = clock.now_ns()
    newest_ns = begin_ns  # when the last record came
    shown_ns = 0
    history = History()
    news: deque[str] = deque()
    simulated = None
    decoder = BlockDecoder()
    with (
        connect(instance, timeout_s=NO_DATA_S) as client,
        Keys() as keys,
        closing(client.messages((TICKS, STATE, EVENT), LOOK_S)) as messages,
    ):
        # nobody there at the start is an error; one who goes away later is NO DATA
        history.force_limit_n = float(client.hello().servo["safety"]["force_limit_n"])
        for message in messages:
            now_ns = clock.now_ns()
            if message is not None and message[0] == STATE:
                history.told(msgpack.unpackb(message[1]))
            elif message is not None and message[0] == EVENT:
                history.event = event_words(msgpack.unpackb(message[1]))
            elif message is not None:
                block = decoder.decode(message[1])
                newest_ns = now_ns if len(block.records) else newest_ns
                simulated = bool(block.header["simulated"])
                history = history.follow(block)
            elif now_ns - shown_ns >= REDRAW_NS:  # what came together is shown once
                shown_ns = now_ns
                show(history, simulated, (now_ns - newest_ns) / NS_PER_S)
            while news:
                history.event = news.popleft()
            pressed = keys.pressed()
            if pressed in (" ", "\x1b"):
                _press_stop(instance)
            if "d" in pressed and history.newest is not None:
                _switch_damping(instance, not history.newest[ASKED], news)
            if "q" in pressed or (seconds is not None and now_ns - begin_ns >= seconds * NS_PER_S):
                return


def _press_stop(instance: str) -> None:
    from hapticd.client.fast_stop import stop

    try:
        stop(instance)
    except HapticdError as error:
        terminal.talk(f"hapticd: stop: {error}")


def _switch_damping(instance: str, on: bool, news: deque[str]) -> None:
    """Ask beside the screen, so that a stop pressed meanwhile waits for nobody's answer; what came
    of it goes into `news`.
    """

    def ask() -> None:
        try:
            with connect(instance) as client:
                client.damping("on" if on else "off")
            news.append(f"damping {'on' if on else 'off'}")
        except HapticdError as error:
            news.append(f"damping: {error}")

    Thread(target=ask, daemon=True).start()


def _newest(history: "History", simulated: bool | None, silent_s: float) -> dict[str, Any]:
    from hapticd.cli.screen import NO_DATA_S
    from hapticd.core.faults import BY_NUMBER
    from hapticd.mailbox.layout import State

    newest = history.newest
    if newest is None or silent_s >= NO_DATA_S:
        return {"state": "no_data", "simulated": simulated, "silent_s": round(silent_s, 3)}
    words = {
        "state": State(int(newest["state"])).name.lower(),
        "fault": BY_NUMBER[int(newest["fault"])].code,
    }
    return {
        **words,
        "simulated": simulated,
        **{name: newest[name].item() for name in NEWEST},
        "wake_us": newest["wake_ns"] / 1e3,
        "delivered_active_damping": history.delivered,
        "guard": history.guard,
    }


def _print_json(history: "History", simulated: bool | None, silent_s: float) -> None:
    terminal.data_json(_newest(history, simulated, silent_s))


def _print_line(history: "History", simulated: bool | None, silent_s: float) -> None:
    found = _newest(history, simulated, silent_s)
    badge = "SIMULATED " if simulated else ""
    if found["state"] == "no_data":
        terminal.data(f"{badge}NO DATA for {silent_s:.1f} s")
    else:
        x_mm = 1e3 * found["position_m"]
        force_n = found["force_n"]
        damping = found["active_damping_ns_per_m"]
        moving = f"x {x_mm:.4f} mm  force {force_n:.4f} N  damping {damping:.4g} N s/m"
        terminal.data(f"{badge}{found['state']} {moving}")


def events(
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="End after S seconds.")
    ] = None,
    parent: Annotated[int | None, typer.Option("--parent", hidden=True)] = None,
    as_json: terminal.JsonLines = False,
) -> None:
    """Say what happens, a line each: states, faults with remedy, leases, warnings, flight files.

    `hapticd run` does the same in its own terminal. Ctrl-C ends it.
    """
    import msgpack

    from hapticd.core.clock import MonotonicClock
    from hapticd.core.process import die_with_parent

    die_with_parent(parent)
    clock = MonotonicClock()
    begin_ns = clock.now_ns()
    with connect(instance) as client, closing(client.messages((EVENT,), LOOK_S)) as messages:
        rights = client.status().servo.get("realtime") or {}
        refused = [f"{name}: {one['text']}" for name, one in rights.items() if not one["granted"]]
        if not as_json:
            for line in refused:
                terminal.data(f"real-time right {line}")
        for message in messages:
            if message is not None:
                event = msgpack.unpackb(message[1])
                terminal.data_json(event) if as_json else terminal.data(_timed(event))
            if seconds is not None and clock.now_ns() - begin_ns >= seconds * NS_PER_S:
                return


def _timed(event: dict[str, Any]) -> str:
    """An event with the time of day."""
    from hapticd.client.events import event_words

    at = datetime.fromtimestamp(event["timestamp"]).strftime("%H:%M:%S")
    return f"{at} {event_words(event)}"
