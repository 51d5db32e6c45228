"""Strip charts, the screen, and the watching loop on virtual time."""

import io
import json
from collections.abc import Iterator, Sequence
from typing import Any, Self

import msgpack
import numpy as np
import pytest
from rich.console import Console

from hapticd.cli import monitor
from hapticd.cli.app import main
from hapticd.cli.screen import History, envelope, screen, strip
from hapticd.client import fast_stop
from hapticd.core.clock import VirtualClock
from hapticd.core.faults import BY_CODE
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.mailbox.layout import TELEMETRY, Flag, State
from hapticd.protocol.answers import Hello, Status
from hapticd.protocol.telemetry import Origin, RingBlock, raw_message

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


def drawn(
    history: History,
    simulated: bool | None,
    silent_s: float,
    size: tuple[int, int] = (100, 45),
) -> str:
    columns, lines = size
    console = Console(file=io.StringIO(), width=columns, height=lines, force_terminal=False)
    console.print(screen(history, simulated, silent_s, size))
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_envelope_keeps_a_single_peak() -> None:
    values = np.zeros(1000)
    values[777] = 5.0
    lows, highs = envelope(values, 1000, 50)
    assert lows.tolist() == [0.0] * 50
    assert np.flatnonzero(highs).tolist() == [777 // 20]


def test_envelope_is_blank_before_the_first_sample() -> None:
    lows, highs = envelope([1.0, 2.0], 10, 5)
    assert np.isnan(lows[:4]).all()
    assert (lows[4], highs[4]) == (1.0, 2.0)


def test_strip_draws_a_ramp_dot_by_dot() -> None:
    assert strip([0, 1, 2, 3], 4, 2, 1, 0, 3) == ["⡠⠊"]


def test_strip_of_a_constant_is_one_line() -> None:
    assert strip([7.0] * 6, 6, 3, 2, 7.0, 7.0) == ["⠀⠀⠀", "⣀⣀⣀"]


def test_history_holds_ten_seconds() -> None:
    history = History()
    for block in range(700):
        history.add(rows_of_ticks(20, 20 * block))
    assert history.length == 10_000
    assert 10_000 <= len(history.column("tick")) < 10_020
    assert history.newest["tick"] == 13_999


def test_screen_shows_state_and_simulated_badge() -> None:
    history = History()
    history.add(
        rows_of_ticks(
            1000, state=State.ENABLED, stiffness_n_per_m=100.0, position_m=0.002, force_n=-0.2
        )
    )
    text = drawn(history, True, 0.0)
    assert text.startswith(" SIMULATED   ENABLED   Space/Esc: STOP")
    assert "K 100 N/m" in text
    assert "position  2 mm" in text
    assert "force  -0.2 N" in text
    assert "ENABLED---" in text


def full(**fields: Any) -> History:
    """Ten seconds in which everything has something to say."""
    history = History()
    moving = {
        "watches": 7,
        "position_m": np.sin(np.arange(10_000)),
        "force_n": -0.2,
        "winding_c": 43.21,
    }
    history.add(rows_of_ticks(10_000, state=State.ENABLED, revision=12345, **moving, **fields))
    history.delivered = DELIVERED
    history.guard = GUARD
    history.force_limit_n = 8.0
    history.event = "enabled -> disabled (by sweep)"
    return history


def test_screen_fits_80_columns_and_24_lines() -> None:
    lines = drawn(full(), True, 0.0, (80, 24)).splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    for told in (
        "Space/Esc: STOP  d: damping  q: quit",
        "position  ",
        "limit 8 N",
        "active damping",
        "wake-up latency",
        "lost slots 0",
        "winding 43.2 C",
        "last event: enabled -> disabled (by sweep)",
    ):
        assert told in text
    axis = lines[-1]
    assert axis.startswith("-10 s")
    assert axis.index("-5 s") == 37
    assert axis.endswith("now")


def test_a_small_terminal_shows_fewer_charts_and_how_to_stop() -> None:
    text = drawn(full(), True, 0.0, (60, 16))
    lines = text.splitlines()
    assert len(lines) <= 16
    assert "Space/Esc: STOP" in lines[0]
    assert "position" in text
    assert "wake-up" not in text


def test_screen_counts_what_was_late_lost_or_at_the_limit() -> None:
    flags = np.zeros(10_000, int)
    flags[:100] = Flag.LATE
    flags[:2000] |= Flag.CLAMPED
    text = drawn(full(flags=flags, lost_slots=3), True, 0.0)
    assert "lost slots 3  late 1 %  at the force limit 20 %" in text


def test_stretches_of_a_state_carry_its_name() -> None:
    history = History()
    history.add(rows_of_ticks(5000))
    history.add(rows_of_ticks(4900, 5000, state=State.ENABLED))
    history.add(rows_of_ticks(100, 9900, state=State.FAULT))
    text = drawn(history, True, 0.0, (101, 24))
    assert f"DISABLED{42 * '-'}ENABLED{42 * '-'}F" in text


def test_screen_names_who_holds_what() -> None:
    history = History()
    history.add(rows_of_ticks(10))
    assert "leased" not in drawn(history, True, 0.0)
    history.add(rows_of_ticks(10, lease_control=17))
    assert "leased: environment by actor 17" in drawn(history, True, 0.0)


def test_screen_of_a_real_board_says_so() -> None:
    history = History()
    history.add(rows_of_ticks(10))
    text = drawn(history, False, 0.0)
    assert "REAL BOARD" in text
    assert "SIMULATED" not in text


def test_screen_names_fault_and_remedy() -> None:
    history = History()
    fault = BY_CODE["usb_lost"]
    history.add(rows_of_ticks(10, state=State.FAULT, fault=fault.number))
    assert f"usb_lost: {fault.cause}; {fault.remedy}" in drawn(history, True, 0.0)


def test_silence_replaces_every_value() -> None:
    history = History()
    history.add(rows_of_ticks(100, state=State.ENABLED, position_m=0.002))
    assert "NO DATA" not in drawn(history, True, 0.49)
    text = drawn(history, True, 0.5)
    assert "NO DATA for 0.5 s" in text
    assert "ENABLED" not in text
    assert "position" not in text


class StreamDouble:
    """A daemon whose telemetry is a script: payloads 20 ms apart, None for half a second of
    silence.
    """

    def __init__(self, clock: VirtualClock, script: list[Any], asked: list[str]) -> None:
        self._clock = clock
        self._script = iter(script)
        self._asked = asked

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def hello(self) -> Hello:
        return Hello(1000.0, True, {"safety": {"force_limit_n": 8.0}})

    def status(self) -> Status:
        refused = {"granted": False, "text": "refused: no; LimitRTPRIO=80"}
        granted = {"granted": True, "text": "granted"}
        return Status("disabled", servo={"realtime": {"core": granted, "fifo": refused}})

    def damping(self, value: str) -> None:
        self._asked.append(value)

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
    monkeypatch.setattr("hapticd.core.clock.MonotonicClock", lambda: clock)
    return clock


def block(first: int, life: int = 1, **fields: Any) -> bytes:
    """20 records as the gateway sends them."""
    found = rows_of_ticks(20, first, **fields)
    return raw_message(RingBlock(life, first, 0, found.tobytes(), found), Origin(life, 0, True))


def play(monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, script: list[Any]) -> list[str]:
    """What is asked of the damping."""
    asked: list[str] = []

    def connect(instance: str, timeout_s: float = 1.0) -> StreamDouble:
        return StreamDouble(clock, script, asked)

    monkeypatch.setattr(monitor, "connect", connect)
    return asked


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
    [(DELIVERED, "delivered 1.7 (1.6 .. 1.8)"), ({"basis": "unknown"}, "delivered: unknown")],
)
def test_screen_shows_what_is_delivered_beside_what_is_commanded(
    delivered: dict[str, Any], words: str
) -> None:
    history = History()
    history.add(rows_of_ticks(20))
    history.delivered = delivered
    (line,) = [
        one for one in drawn(history, True, 0.0).splitlines() if one.startswith("active damping")
    ]
    assert words in line


def test_screen_shows_policy_and_verdict() -> None:
    history = History()
    history.add(rows_of_ticks(20))
    assert "guard: unknown" in drawn(history, True, 0.0)
    history.guard = GUARD
    text = drawn(history, True, 0.0)
    assert "guard: warn, by theorem; active damping level; delay 0.125 periods" in text
    assert "0.9 N s/m short at 112 Hz" in text


def test_new_servo_life_begins_a_new_history(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock
) -> None:
    lengths: list[int] = []
    play(
        monkeypatch,
        clock,
        [
            *(block(20 * i) for i in range(10)),
            *(block(20 * i, life=2) for i in range(10)),
        ],
    )
    monitor.watch(
        "default",
        0.39,
        lambda history, simulated, silent_s: lengths.append(len(history.column("tick"))),
    )
    assert lengths == [20, 120, 20, 120]


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


@pytest.mark.parametrize(("asked_ns_per_m", "answer"), [(0.0, "on"), (1.74, "off")])
def test_d_switches_the_active_damping(
    monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, asked_ns_per_m: float, answer: str
) -> None:
    class AtOnce:
        """A thread that is done when it has begun."""

        def __init__(self, target: Any, daemon: bool) -> None:
            self.start = target

    pressed = iter(["", "", "d", "", "q"])
    told: list[str] = []
    monkeypatch.setattr(monitor, "Thread", AtOnce)
    monkeypatch.setattr(monitor.Keys, "pressed", lambda self: next(pressed))
    script = [block(20 * i, active_damping_asked_ns_per_m=asked_ns_per_m) for i in range(10)]
    asked = play(monkeypatch, clock, script)
    monitor.watch("left", None, lambda history, *_: told.append(history.event))
    assert asked == [answer]


def test_arrow_keys_do_not_stop(monkeypatch: pytest.MonkeyPatch, clock: VirtualClock) -> None:
    pressed = iter(["\x1b[A", "q"])
    stopped = []
    monkeypatch.setattr(monitor.Keys, "pressed", lambda self: next(pressed))
    monkeypatch.setattr(fast_stop, "stop", stopped.append)
    play(monkeypatch, clock, [block(20 * i) for i in range(10)])
    monitor.watch("left", None, lambda *view: None)
    assert stopped == []


HAPPENED = [
    {"timestamp": 0.0, "kind": "state", "before": "disabled", "state": "enabled", "name": "sweep"},
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
