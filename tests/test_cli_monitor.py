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
from hapticd.clock import VirtualClock
from hapticd.faults import BY_CODE
from hapticd.gateway.telemetry import Origin, RingBlock, raw_message
from hapticd.mailbox.layout import TELEMETRY, State
from hapticd.units import NS_PER_MS, NS_PER_S

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


def records(count: int, first: int = 0, **fields: Any) -> Any:
    block = np.zeros(count, np.dtype([tuple(field) for field in TELEMETRY]))  # type: ignore[arg-type]
    block["tick"] = np.arange(first, first + count)
    block["time_ns"] = block["tick"] * NS_PER_MS
    for name, value in fields.items():
        block[name] = value
    return block


def drawn(history: History, simulated: bool | None, silent_s: float) -> str:
    console = Console(file=io.StringIO(), width=100, height=45, force_terminal=False)
    console.print(screen(history, simulated, silent_s, (100, 45)))
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
        history.add(records(20, 20 * block))
    assert history.length == 10_000
    assert 10_000 <= len(history.column("tick")) < 10_020
    assert history.newest["tick"] == 13_999


def test_screen_shows_state_and_simulated_badge() -> None:
    history = History()
    history.add(
        records(1000, state=State.ENABLED, stiffness_n_per_m=100.0, position_m=0.002, force_n=-0.2)
    )
    text = drawn(history, True, 0.0)
    assert "████" in text
    assert " ENABLED   K 100 N/m" in text
    assert "position  2 mm" in text
    assert "force  -0.2 N" in text
    assert "EEE" in text
    assert "Space or Esc: STOP" in text


def test_screen_names_who_holds_what() -> None:
    history = History()
    history.add(records(10))
    assert "leased" not in drawn(history, True, 0.0)
    history.add(records(10, lease_control=17))
    assert "leased: environment by actor 17" in drawn(history, True, 0.0)


def test_screen_of_a_real_board_says_so() -> None:
    history = History()
    history.add(records(10))
    text = drawn(history, False, 0.0)
    assert "REAL BOARD" in text
    assert "████" not in text


def test_screen_names_fault_and_remedy() -> None:
    history = History()
    fault = BY_CODE["usb_lost"]
    history.add(records(10, state=State.FAULT, fault=fault.number))
    assert f"usb_lost: {fault.cause}; {fault.remedy}" in drawn(history, True, 0.0)


def test_silence_replaces_every_value() -> None:
    history = History()
    history.add(records(100, state=State.ENABLED, position_m=0.002))
    assert "NO DATA" not in drawn(history, True, 0.49)
    text = drawn(history, True, 0.5)
    assert "NO DATA for 0.5 s" in text
    assert "ENABLED" not in text
    assert "position" not in text


class StreamDouble:
    """A daemon whose telemetry is a script: payloads 20 ms apart, None for half a second of
    silence.
    """

    def __init__(self, clock: VirtualClock, script: list[Any]) -> None:
        self._clock, self._script = clock, iter(script)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def hello(self) -> dict[str, Any]:
        return {}

    def call(self, cmd: str, **_fields: Any) -> dict[str, Any]:
        raise AssertionError(f"{cmd}: a key waits while the daemon is asked")

    status = call

    def messages(self, topics: Sequence[str], look_s: float) -> Iterator[Any]:
        assert set(topics) == {"servo.raw", "state"}
        yield "state", msgpack.packb({"delivered_damping": DELIVERED, "guard": GUARD})
        for payload in self._script:
            self._clock.time_ns += 20 * NS_PER_MS if payload else NS_PER_S // 2
            if payload is not None:
                yield "servo.raw", payload
            yield None
        while True:
            self._clock.time_ns += NS_PER_S // 2
            yield None


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> VirtualClock:
    clock = VirtualClock(NS_PER_S)
    monkeypatch.setattr("hapticd.clock.MonotonicClock", lambda: clock)
    return clock


def block(first: int, life: int = 1, **fields: Any) -> bytes:
    """20 records as the gateway sends them."""
    found = records(20, first, **fields)
    return raw_message(RingBlock(life, first, 0, found.tobytes(), found), Origin(life, 0, True))


def play(monkeypatch: pytest.MonkeyPatch, clock: VirtualClock, script: list[Any]) -> None:
    monkeypatch.setattr(monitor, "connect", lambda instance, timeout_s: StreamDouble(clock, script))


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
    assert lines[0]["delivered_damping"] == DELIVERED
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
    history.add(records(20))
    history.delivered = delivered
    (line,) = [
        one for one in drawn(history, True, 0.0).splitlines() if one.startswith("active damping")
    ]
    assert words in line


def test_screen_shows_policy_and_verdict() -> None:
    history = History()
    history.add(records(20))
    assert "guard: unknown" in drawn(history, True, 0.0)
    history.guard = GUARD
    (line,) = [one for one in drawn(history, True, 0.0).splitlines() if one.startswith("guard")]
    assert line.startswith("guard: warn, by theorem; damping level; delay 0.125 periods; 0.9 N s/m")


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


def test_arrow_keys_do_not_stop(monkeypatch: pytest.MonkeyPatch, clock: VirtualClock) -> None:
    pressed = iter(["\x1b[A", "q"])
    stopped = []
    monkeypatch.setattr(monitor.Keys, "pressed", lambda self: next(pressed))
    monkeypatch.setattr(fast_stop, "stop", stopped.append)
    play(monkeypatch, clock, [block(20 * i) for i in range(10)])
    monitor.watch("left", None, lambda *view: None)
    assert stopped == []


@pytest.mark.usefixtures("runtime")
def test_monitor_without_a_daemon_says_so_and_ends(capsys: pytest.CaptureFixture[str]) -> None:
    from hapticd.cli.app import main

    assert main(["monitor", "--json"]) == 3
    assert "no daemon runs there; start it with `hapticd run`" in capsys.readouterr().err
