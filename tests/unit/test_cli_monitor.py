"""The screen, and the watching loop on virtual time."""

import io
import json
from collections.abc import Iterator, Sequence
from typing import Any, Self

import msgpack
import numpy as np
import pytest
from rich.console import Console
from support.gateway_stand_in import setup

from hapticd.cli import monitor
from hapticd.cli.app import main
from hapticd.cli.monitor import View, screen
from hapticd.client import fast_stop
from hapticd.core.faults import BY_CODE
from hapticd.core.units import NS_PER_MS, NS_PER_S, VirtualClock
from hapticd.mailbox.layout import TELEMETRY, Flag, State
from hapticd.protocol.answers import Hello, Status
from hapticd.protocol.telemetry import Origin, RingBlock

DELIVERED = {"estimate_ns_per_m": 1.7, "low": 1.6, "high": 1.8, "commanded": 1.74}


GUARD = {
    "policy": "warn",
    "basis": "theorem",
    "margin_ns_per_m": 0.0,
    "mode": "level",
    "measuring": False,
    "delay_periods": 0.125,
    "worker": "up",
    "trouble": "",
    "verdict": {"safe": False, "text": "0.9 N s/m short at 112 Hz"},
}


def rows_of_ticks(count: int, first: int = 0, **fields: Any) -> Any:
    block = np.zeros(count, np.dtype([tuple(field) for field in TELEMETRY]))  # type: ignore[arg-type]
    block["tick"] = np.arange(first, first + count)
    block["time_ns"] = block["tick"] * NS_PER_MS
    for name, value in fields.items():
        block[name] = value
    return block


def view(**fields: Any) -> View:
    """A view of a simulated daemon whose newest record has `fields`."""
    return View(newest=rows_of_ticks(1, **fields)[0], simulated=True)


def drawn(shown: View, size: tuple[int, int] = (100, 45)) -> str:
    columns, lines = size
    console = Console(file=io.StringIO(), width=columns, height=lines, force_terminal=False)
    console.print(screen(shown))
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_screen_shows_state_and_simulated_badge() -> None:
    text = drawn(view(state=State.ENABLED, stiffness_n_per_m=100.0, position_m=0.002, force_n=-0.2))
    assert text.startswith(" SIMULATED   ENABLED   Space/Esc: STOP")
    assert "K 100 N/m" in text
    assert "x 2.0000 mm, force -0.2000 N" in text


def full(**fields: Any) -> View:
    """A view in which everything has something to say."""
    found = view(state=State.ENABLED, position_m=0.012, force_n=-0.2, **fields)
    found.state = {
        "delay_us": 125,
        "rate_hz": 1000.0,
        "counters": {"late_events": 3, "lost_slots": 2},
        "delivered_active_damping": DELIVERED,
        "guard": GUARD,
        "leases": {"environment": {"name": "sweep", "actor": 17, "ttl_s": 2.0}},
        "commissioning": {"force_limit_n": 0.8, "remedy": "the signs are not verified"},
        "late": {"bus": {"count": 2, "latest_us": 700.0}},
    }
    found.event = "enabled -> disabled (by sweep)"
    return found


def test_screen_fits_80_columns_and_24_lines() -> None:
    lines = drawn(full(), (80, 24)).splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    for told in (
        "Space/Esc: STOP  q: quit",
        "x 12.0000 mm, force -0.2000 N",
        "1000 Hz, 3 late, 2 slots lost",
        "sample to force 125 us (0.125 periods)",
        "delivered 1.7 (1.6 to 1.8)",
        "guard     warn, by theorem",
        "environment: sweep (actor 17)",
        "at most 0.8 N: the signs are not verified",
        "last event: enabled -> disabled (by sweep)",
    ):
        assert told in text


def test_a_narrow_terminal_cuts_lines_and_still_says_how_to_stop() -> None:
    lines = drawn(full(), (45, 10)).splitlines()
    assert max(map(len, lines)) <= 45
    assert "Space/Esc: STOP" in lines[0]
    assert "now       x 12.0000 mm" in lines[2]


def test_values_of_the_newest_record_go_before_those_of_the_newest_state() -> None:
    shown = full()
    shown.state |= {"state": "fault", "position_m": 0.5, "fault": "usb_lost"}
    text = drawn(shown)
    assert "x 12.0000 mm" in text
    assert "usb_lost" not in text


@pytest.mark.parametrize(
    ("flags", "words"), [(Flag.PROXY_HELD, "held: 4.0000 mm"), (0, "4.0000 mm")]
)
def test_screen_and_json_show_the_proxy_and_its_client(flags: int, words: str) -> None:
    shown = full(proxy_m=0.004, flags=flags)
    assert f"proxy     {words}, by sweep (actor 17)" in drawn(shown)
    found = monitor._newest(shown)
    assert (found["proxy_m"], found["proxy_held"]) == (0.004, bool(flags))


def test_screen_without_a_proxy_has_no_line_for_it() -> None:
    assert "proxy" not in drawn(full())


def test_proxy_that_stays_after_its_lease_is_nobodys() -> None:
    shown = full(flags=Flag.PROXY_HELD)
    del shown.state["leases"]
    assert "proxy     held: 0.0000 mm\n" in drawn(shown)


def test_screen_of_a_real_board_says_so() -> None:
    shown = view()
    shown.simulated = False
    text = drawn(shown)
    assert "REAL BOARD" in text
    assert "SIMULATED" not in text


def test_screen_names_fault_and_remedy() -> None:
    fault = BY_CODE["usb_lost"]
    text = drawn(view(state=State.FAULT, fault=fault.number), (200, 45))
    assert f"usb_lost: {fault.cause}. {fault.action}. To leave: {fault.remedy}" in text


def test_silence_replaces_every_value() -> None:
    shown = view(state=State.ENABLED, position_m=0.002)
    shown.silent_s = 0.49
    assert "NO DATA" not in drawn(shown)
    shown.silent_s = 0.5
    text = drawn(shown)
    assert "NO DATA for 0.5 s" in text
    assert "ENABLED" not in text
    assert "2.0000" not in text


def test_screen_waits_for_the_daemon_before_the_first_record() -> None:
    assert "waiting for the daemon" in drawn(View())


class StreamDouble:
    """A daemon whose telemetry is a script: payloads 20 ms apart, None for half a second of
    silence.
    """

    def __init__(self, clock: VirtualClock, script: list[Any]) -> None:
        self._clock = clock
        self._script = iter(script)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def hello(self) -> Hello:
        return Hello(1000.0, True, setup().servo)

    def status(self) -> Status:
        refused = {"granted": False, "text": "refused: no; LimitRTPRIO=80"}
        granted = {"granted": True, "text": "granted"}
        return Status(state="disabled", servo={"realtime": {"core": granted, "fifo": refused}})

    def call(self, cmd: str, **_fields: Any) -> dict[str, Any]:
        raise AssertionError(f"{cmd}: a key waits while the daemon is asked")

    def messages(self, topics: Sequence[str], look_s: float) -> Iterator[Any]:
        if topics == ("event",):
            yield from self._events()
        assert set(topics) == {"servo.raw", "state", "event"}
        yield "state", msgpack.packb({"delivered_active_damping": DELIVERED, "guard": GUARD})
        for payload in self._script:
            self._clock.time_ns += 20 * NS_PER_MS if payload else NS_PER_S // 2
            if payload is not None:
                yield "servo.raw", payload
            yield None
        while True:
            self._clock.time_ns += NS_PER_S // 2
            yield None

    def _events(self) -> Iterator[Any]:
        for event in self._script:
            self._clock.time_ns += NS_PER_S
            yield None
            yield "event", msgpack.packb(event)
        self._clock.time_ns += NS_PER_S
        yield None


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> VirtualClock:
    clock = VirtualClock(NS_PER_S)
    monkeypatch.setattr("hapticd.cli.monitor.MonotonicClock", lambda: clock)
    return clock


def block(first: int, life: int = 1, **fields: Any) -> bytes:
    """20 records as the gateway sends them."""
    found = rows_of_ticks(20, first, **fields)
    return RingBlock(life, first, 0, found.tobytes(), found).message(Origin(life, 0, True))


def play(monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, script: list[Any]) -> None:
    """Have the verbs watch a daemon that sends `script`."""

    def connect(instance: str, timeout_s: float = 1.0) -> StreamDouble:
        return StreamDouble(clock, script)

    monkeypatch.setattr(monitor, "connect", connect)


def test_json_lines_follow_data_and_silence(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, capsys: pytest.CaptureFixture[str]
) -> None:
    play(
        monkeypatch,
        clock,
        [
            *(block(20 * i, state=1, force_n=0.5) for i in range(20)),
            None,
            None,
            block(400, state=2, fault=1),
        ],
    )
    assert main(["monitor", "--json", "--seconds", "3"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["simulated"] for line in lines} == {True}
    assert [line["state"] for line in lines[:4]] == ["enabled"] * 4
    assert lines[0]["force_n"] == 0.5
    assert lines[0]["delivered_active_damping"] == DELIVERED
    assert lines[0]["guard"] == GUARD
    assert lines[4] == {"state": "no_data", "simulated": True, "silent_s": 0.5}
    assert "stopped" not in {line["state"] for line in lines[4:6]}


def test_plain_lines_when_stdout_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, capsys: pytest.CaptureFixture[str]
) -> None:
    play(monkeypatch, clock, [block(0, position_m=0.001), None, None])
    assert main(["monitor", "--seconds", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "SIMULATED disabled x 1.0000 mm  force 0.0000 N  damping 0 N s/m"
    assert lines[1] == "SIMULATED NO DATA for 0.5 s"


@pytest.mark.parametrize(
    ("delivered", "words"),
    [
        (DELIVERED, "delivered 1.7 (1.6 to 1.8) of 1.74"),
        ({"basis": "too little motion"}, "delivered of 0 N s/m commanded: too little motion"),
    ],
)
def test_screen_shows_what_is_delivered_beside_what_is_commanded(
    delivered: dict[str, Any], words: str
) -> None:
    shown = view()
    shown.state = {"delivered_active_damping": delivered}
    (line,) = [one for one in drawn(shown).splitlines() if one.startswith("  damping ")]
    assert words in line


def test_screen_shows_policy_and_verdict() -> None:
    shown = view()
    assert "guard" not in drawn(shown)
    shown.state = {"guard": GUARD}
    text = drawn(shown)
    assert "warn, by theorem; active damping level; delay 0.125 periods" in text
    assert "0.9 N s/m short at 112 Hz" in text


def test_nothing_is_known_of_another_servo_but_its_records(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock
) -> None:
    told: list[tuple[int, bool]] = []
    script = [*(block(20 * i) for i in range(10)), *(block(20 * i, life=2) for i in range(10))]
    play(monkeypatch, clock, script)
    monitor.watch(
        "default", 0.39, lambda shown: told.append((shown.newest["tick"], bool(shown.state)))
    )
    assert told == [(19, True), (119, True), (19, False), (119, False)]


@pytest.mark.parametrize("key", [" ", "\x1b"])
def test_space_and_escape_stop_the_daemon(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, key: str
) -> None:
    pressed = iter(["", key, "q"])
    stopped = []
    monkeypatch.setattr(monitor.Keys, "pressed", lambda self: next(pressed))
    monkeypatch.setattr(fast_stop, "stop", stopped.append)
    play(monkeypatch, clock, [block(20 * i) for i in range(10)])
    monitor.watch("left", None, lambda *view: None)
    assert stopped == ["left"]


def test_arrow_keys_do_not_stop(monkeypatch: pytest.MonkeyPatch, clock: VirtualClock) -> None:
    pressed = iter(["\x1b[A", "q"])
    stopped = []
    monkeypatch.setattr(monitor.Keys, "pressed", lambda self: next(pressed))
    monkeypatch.setattr(fast_stop, "stop", stopped.append)
    play(monkeypatch, clock, [block(20 * i) for i in range(10)])
    monitor.watch("left", None, lambda *view: None)
    assert stopped == []


HAPPENED = [
    {"timestamp": 0.0, "kind": "state", "text": "disabled -> enabled (by sweep)"},
    {"timestamp": 2.0, "kind": "warning", "text": "the disk is full"},
]


def test_events_are_told_as_they_come(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, capsys: pytest.CaptureFixture[str]
) -> None:
    play(monkeypatch, clock, HAPPENED)
    assert main(["events", "--seconds", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "real-time right fifo: refused: no; LimitRTPRIO=80"
    assert [line.split(" ", 1)[1] for line in lines[1:]] == [
        "disabled -> enabled (by sweep)",
        "warning: the disk is full",
    ]


def test_events_are_told_to_scripts_as_they_are(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, capsys: pytest.CaptureFixture[str]
) -> None:
    play(monkeypatch, clock, HAPPENED)
    assert main(["events", "--json", "--seconds", "3"]) == 0
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == HAPPENED


@pytest.mark.usefixtures("runtime")
def test_monitor_without_a_daemon_says_so_and_ends(capsys: pytest.CaptureFixture[str]) -> None:
    from hapticd.cli.app import main

    assert main(["monitor", "--json"]) == 3
    assert "no daemon runs there; start it with `hapticd run`" in capsys.readouterr().err
