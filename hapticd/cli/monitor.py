"""Watch one daemon live in a terminal, where a key stops it, or event by event.

This is for a terminal without a browser: the lines of `hapticd status`, ten times a second, from
telemetry alone. Charts and controls are on the operators' page.

Two rules. The lamp shows the servo's actual state, never a request. Without new data, NO DATA
replaces every value: an old value never looks like a new one. Each line is cut at the right edge,
and the stop key is on the left of the first.

Keys are read without waiting and without Enter, and not at all if stdin is not a terminal. A wait
for data must have a time-out: otherwise a silent daemon would leave an old screen.
"""

import os
import select
import sys
import termios
import tty
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, Any, Self

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.daemon import status_lines
from hapticd.client import fast_stop
from hapticd.client.formatting import event_words
from hapticd.core.errors import HapticdError
from hapticd.core.faults import BY_NUMBER
from hapticd.core.process import die_with_parent
from hapticd.core.units import NS_PER_S, MonotonicClock
from hapticd.mailbox.layout import Flag, State
from hapticd.protocol.answers import Event, Status, answer_of

with terminal.deferred_imports():
    import msgpack
    from rich import console as rich_console
    from rich import live as rich_live
    from rich import text as rich_text

    from hapticd.client import blocks, telemetry


class Keys:
    """A context in which the terminal passes on each key at once and echoes none."""

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
        if self._before is not None:
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def pressed(self) -> str:
        """Return the keys since the last call; an arrow or function key is its escape sequence."""
        if self._before is None or not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 64).decode(errors="replace")


REDRAW_NS = NS_PER_S // 10
NO_DATA_S = 0.5
LOOK_S = 0.02  # between checks of messages and keys
TICKS = "servo.raw"
STATE = "state"  # fields that no record has; no request is sent, so that no key waits for an answer
EVENT = "event"
STOP_KEYS = (" ", "\x1b")
NEWEST = (
    "tick",
    "position_m",
    "proxy_m",
    "force_n",
    "stiffness_n_per_m",
    "virtual_damping_ns_per_m",
    "mass_kg",
    "active_damping_ns_per_m",
    "gain",
    "watches",
    "lease_control",
    "lease_active_damping",
)
DELAYS = ("delay_us", "delay_spread_us", "frame_age_us")  # of many ticks, so not of the newest


LAMPS = {
    "disabled": "black on white",
    "enabled": "black on green",
    "homing": "black on yellow",
}
TRIPPED = "bold white on red"
BADGES = {
    None: (" hapticd ", "reverse"),
    True: (" SIMULATED ", "bold black on yellow"),
    False: (" REAL BOARD ", "bold white on red"),
}


@dataclass
class View:
    """Known state of the daemon at one moment."""

    newest: Any = None  # its newest record (layout.TELEMETRY); None before the first
    simulated: bool | None = None  # None until the daemon reports it
    silent_s: float = 0.0  # since the arrival of the newest record
    state: dict[str, Any] = field(default_factory=dict)  # the newest message `state`
    event: str = "none yet"  # the newest one, as text

    @property
    def fresh(self) -> bool:
        """Whether the newest record may be shown."""
        return self.newest is not None and self.silent_s < NO_DATA_S


def monitor(
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="Stop after S seconds.")
    ] = None,
    as_json: terminal.JsonLines = False,
) -> None:
    """Watch live in a terminal: state, force, position, verdict and faults. Space or Esc stops the
    daemon; q or Ctrl-C only closes this screen. The operators' page has charts and controls.

    With --json, or if stdout is not a terminal: one line every 0.1 s.
    """
    if as_json or not sys.stdout.isatty():

        def show(view: View) -> None:
            terminal.data_json(_newest(view)) if as_json else terminal.data(_line(view))

        watch(instance, seconds, show)
        return
    console = rich_console.Console()
    with rich_live.Live(console=console, screen=True, auto_refresh=False) as live:
        watch(instance, seconds, lambda view: live.update(screen(view), refresh=True))


def watch(instance: str, seconds: float | None, show: Callable[[View], None]) -> None:
    """Show the state ten times a second, also without new data, and obey keys.

    `seconds` None: until q is pressed.
    """
    now_ns = MonotonicClock().now_ns
    begin_ns = now_ns()
    newest_ns = begin_ns  # arrival of the last record
    shown_ns = 0
    view = View()
    decoder = blocks.BlockDecoder()
    with (
        connect(instance, timeout_s=NO_DATA_S) as client,
        Keys() as keys,
        closing(client.messages((TICKS, STATE, EVENT), LOOK_S)) as messages,
    ):
        # a missing daemon at the start is an error; one that disappears later is NO DATA
        client.hello()
        for message in messages:
            at_ns = now_ns()
            if message is not None and _take(view, decoder, *message):
                newest_ns = at_ns
            elif message is None and at_ns - shown_ns >= REDRAW_NS:  # redraw once a batch
                shown_ns = at_ns
                view.silent_s = (at_ns - newest_ns) / NS_PER_S
                show(view)
            pressed = keys.pressed()
            if pressed in STOP_KEYS:
                _press_stop(instance)
            if "q" in pressed or (seconds is not None and at_ns - begin_ns >= seconds * NS_PER_S):
                return


def _take(view: View, decoder: Any, topic: str, payload: bytes) -> bool:
    """Put a message into `view`; return whether it contained records."""
    if topic == STATE:
        view.state = msgpack.unpackb(payload)
        return False
    if topic == EVENT:
        view.event = event_words(telemetry.message_of(topic, payload))
        return False
    block = decoder.decode(payload)
    view.simulated = bool(block.header["simulated"])
    if block.restarted:  # another servo, whose state is not known yet
        view.state = {}
    if len(block.records):
        view.newest = block.records[-1]
    return len(block.records) > 0


def _press_stop(instance: str) -> None:
    try:
        fast_stop.stop(instance)
    except HapticdError as error:
        terminal.talk(f"hapticd: stop: {error}")


def _newest(view: View) -> dict[str, Any]:
    newest = view.newest
    if not view.fresh:
        silent_s = round(view.silent_s, 3)
        return {"state": "no_data", "simulated": view.simulated, "silent_s": silent_s}
    return {
        "state": State(int(newest["state"])).name.lower(),
        "fault": BY_NUMBER[int(newest["fault"])].code,
        "simulated": view.simulated,
        **{name: newest[name].item() for name in NEWEST},
        **{name: view.state.get(name, -1) for name in DELAYS},
        "proxy_held": bool(newest["flags"] & Flag.PROXY_HELD),
        "wake_us": newest["wake_ns"] / 1e3,
        "delivered_active_damping": view.state.get("delivered_active_damping", {}),
        "guard": view.state.get("guard", {}),
    }


def screen(view: View) -> "rich_console.Group":
    """Return `view` as a terminal screen."""
    lines = [rich_text.Text().append(*BADGES[view.simulated])]
    if view.fresh:
        found = _newest(view)
        lines[0].append(" ").append(
            f" {found['state'].upper()} ", LAMPS.get(found["state"], TRIPPED)
        )
        lines += [rich_text.Text.from_ansi(line) for line in _status(view, found)]
        lines.append(rich_text.Text(f"  last event: {view.event}"))
    else:
        waiting = view.simulated is None
        silent = "waiting for the daemon" if waiting else f"NO DATA for {view.silent_s:.1f} s"
        lines.append(rich_text.Text(f"\n {silent} \n", TRIPPED))
    lines[0].append("  Space/Esc: STOP  q: quit", "bold")
    for line in lines:
        line.no_wrap = True
        line.overflow = "ellipsis"
    return rich_console.Group(*lines)


def _status(view: View, newest: dict[str, Any]) -> list[str]:
    """Return the lines of `status`, with the values of the newest record where it has them."""
    fault = BY_NUMBER[int(view.newest["fault"])]
    named = {"cause": fault.cause, "action": fault.action, "remedy": fault.remedy}
    known = {name: value for name, value in newest.items() if value != {}}
    found = {**view.state, **known, **named}
    return status_lines(answer_of(Status, found), found)[1:]


def _line(view: View) -> str:
    found = _newest(view)
    badge = "SIMULATED " if view.simulated else ""
    if not view.fresh:
        return f"{badge}NO DATA for {view.silent_s:.1f} s"
    return (
        f"{badge}{found['state']} x {1e3 * found['position_m']:.4f} mm  force"
        f" {found['force_n']:.4f} N  damping {found['active_damping_ns_per_m']:.4g} N s/m"
    )


def events(
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="Stop after S seconds.")
    ] = None,
    parent: terminal.Parent = None,
    as_json: terminal.JsonLines = False,
) -> None:
    """Print events, one line each: states, faults with remedy, leases, warnings, flight files.

    Stops at Ctrl-C. `hapticd run` prints the same lines in its own terminal.
    """
    die_with_parent(parent)
    now_ns = MonotonicClock().now_ns
    begin_ns = now_ns()
    with connect(instance) as client, closing(client.messages((EVENT,), LOOK_S)) as messages:
        rights = client.status().servo.get("realtime") or {}
        refused = [f"{name}: {one['text']}" for name, one in rights.items() if not one["granted"]]
        if not as_json:
            for line in refused:
                terminal.data(f"real-time right {line}")
        for message in messages:
            if message is not None:
                content = msgpack.unpackb(message[1])
                terminal.data_json(content) if as_json else terminal.data(_timed(content))
            if seconds is not None and now_ns() - begin_ns >= seconds * NS_PER_S:
                return


def _timed(content: dict[str, Any]) -> str:
    """Return an event with the time of day."""
    event = answer_of(Event, content)
    at = datetime.fromtimestamp(event.timestamp)
    return f"{at:%H:%M:%S} {event_words(event)}"
