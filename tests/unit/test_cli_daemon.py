"""The command line without a daemon: what it parses, asks, prints and returns."""

import dataclasses
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from support.client_double import RECEIPT, ClientDouble

import hapticd.__main__ as entry
from hapticd import __version__
from hapticd.cli import change, daemon, system, terminal
from hapticd.cli.app import main
from hapticd.client import fast_stop
from hapticd.core.errors import CommandError, ConfigError, DaemonDown, HapticdError, RealtimeError
from hapticd.protocol.answers import LeaseHeld, answer_of
from hapticd.settings.toml import shipped


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> ClientDouble:
    double = ClientDouble()
    for module in (change, daemon):
        monkeypatch.setattr(module, "connect", lambda instance, timeout_s=2.0: double)
    return double


def test_set_asks_for_everything_at_once(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (
        "set K=100 B=-1 M=0.010 wall.side=-1 filters.velocity_hz=80 active_damping=1.74"
        " --ramp-s 0.1 --at-tick 9 --if-rev 3"
    )
    assert main(words.split()) == 0
    asked = {
        "K": 100,
        "B": -1,
        "M": 0.01,
        "wall": {"side": -1},
        "filters": {"velocity_hz": 80},
        "active_damping": 1.74,
    }
    assert client.asked == [
        ("set", {**asked, "ramp_s": 0.1, "at_tick": 9, "if_rev": 3}),
        ("closed", None),
    ]
    expected = (
        "enabled: applied at tick 1200, ramp ends at tick 1250, revision 7: K 100 N/m, B 1 N s/m, M"
        " 0.01 kg, active damping 1.74 N s/m"
    )
    assert capsys.readouterr().out == expected + "\n"


def test_json_is_one_object(client: ClientDouble, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["set", "K=100", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"ok": True, **dataclasses.asdict(RECEIPT)}


MISTAKES = {
    "k=1": "'k' is unknown; did you mean 'K'?",
    "K": "'K': write NAME=VALUE, for example K=100",
    "K=stiff": "K: 'stiff' is not a number",
    "filters.velocity=1": "did you mean 'filters.velocity_hz'?",
    "frobnicate=1": "'frobnicate' is unknown; see `hapticd set --help`",
}


@pytest.mark.parametrize("word", MISTAKES)
def test_mistyped_change_is_a_usage_error(
    client: ClientDouble,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    word: str,
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["set", word]) == 2
    assert MISTAKES[word] in capsys.readouterr().err
    assert client.asked == []


def test_value_given_twice_is_refused(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["set", "K=1", "K=2"]) == 2
    assert "K is given twice" in capsys.readouterr().err


def test_usage_error_is_json_too(client: ClientDouble, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["set", "K", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "usage"


@pytest.mark.parametrize(
    ("word", "value"), [("on", "on"), ("off", "off"), ("1.74", 1.74), ("2", 2)]
)
def test_damping_on_off_or_level(client: ClientDouble, word: str, value: Any) -> None:
    assert main(["damping", word]) == 0
    assert client.asked[0] == ("damping", value)


def test_damping_takes_no_other_word(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["damping", "onn"]) == 2
    told = " ".join(capsys.readouterr().err.replace("│", " ").split())  # in a frame, wrapped
    assert "'onn' is not on, off, auto or a level in N s/m" in told


@pytest.mark.parametrize("verb", ["enable", "disable", "reset", "zero"])
def test_simple_verbs_ask_their_name(client: ClientDouble, verb: str) -> None:
    assert main([verb, "--instance", "left"]) == 0
    assert client.asked[0] == (verb, None)


def test_home_waits_for_the_end(client: ClientDouble, capsys: pytest.CaptureFixture[str]) -> None:
    client.states.insert(0, {"state": "homing"})
    assert main(["home", "--json"]) == 0
    assert [verb for verb, _ in client.asked] == ["home", "status", "status", "closed"]
    assert json.loads(capsys.readouterr().out) == {"ok": True, "state": "disabled", "homed": True}


def test_failed_home_exits_5(client: ClientDouble, capsys: pytest.CaptureFixture[str]) -> None:
    client.states = [
        {"state": "fault", "cause": "no stop was found", "remedy": "check the mechanism"}
    ]
    assert main(["home"]) == 5
    assert "hapticd: home: no stop was found; check the mechanism" in capsys.readouterr().err


def test_get_shows_units(client: ClientDouble, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["get"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "K = 100 N/m",
        "B = 1 N s/m",
        "M = 0.01 kg",
        "wall.side = 0",
        "active_damping = 1.74 N s/m",
        "active_damping_level = 1.74 N s/m",
    ]


ERRORS = [
    (CommandError("invalid", "K = 1e9 N/m: beyond"), 4),
    (CommandError("stopped", "enable in state stopped"), 5),
    (CommandError("busy", "slow down"), 4),
    (DaemonDown("nobody answers"), 3),
    (ConfigError("a.toml:1: wrong"), 78),
    (RealtimeError("no FIFO"), 6),
    (HapticdError("broken"), 1),
]


@pytest.mark.parametrize(
    ("error", "code"), ERRORS, ids=[f"{type(error).__name__}-{code}" for error, code in ERRORS]
)
def test_errors_are_one_line_and_a_code(
    client: ClientDouble, capsys: pytest.CaptureFixture[str], error: HapticdError, code: int
) -> None:
    client.error = error
    assert main(["enable"]) == code
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", f"hapticd: {error}\n")


def test_errors_are_json_when_asked(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    client.error = CommandError("invalid", "no", [{"loc": "K", "msg": "no"}])
    assert main(["enable", "--json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert found == {
        "ok": False,
        "error": {"code": "invalid", "message": "no", "detail": [{"loc": "K", "msg": "no"}]},
    }


def test_perturb_reads_text_and_npy(
    client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import numpy as np

    (tmp_path / "wave.txt").write_text("0.1\n-0.2\n0.3\n")
    np.save(tmp_path / "wave.npy", np.zeros(8))
    assert main(["perturb", "load", str(tmp_path / "wave.txt")]) == 0
    assert main(["perturb", "load", str(tmp_path / "wave.npy"), "--json"]) == 0
    assert client.asked[0] == ("perturb_load", [0.1, -0.2, 0.3])
    assert (
        capsys.readouterr().out
        == '3 samples loaded, 0.001 s\n{"ok": true, "samples": 8, "seconds": 0.002}\n'
    )
    assert main(["perturb", "start", "--loop"]) == 0
    assert client.asked[-2] == ("perturb_start", True)


@pytest.mark.parametrize("content", ["a,b", "", "# nothing but words\n", None])
def test_perturb_names_a_bad_file(
    client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None
) -> None:
    if content is not None:
        (tmp_path / "wave.txt").write_text(content)
    code = 2 if content is None else 78
    assert main(["perturb", "load", str(tmp_path / "wave.txt")]) == code
    unwrapped = "".join(capsys.readouterr().err.replace("│", "").split())
    assert "wave.txt" in unwrapped
    assert client.asked == []


@pytest.mark.usefixtures("runtime")
def test_status_without_a_daemon_exits_3(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["state"] == "down"
    assert {"simulated", "rate_hz", "revision", "fault"} <= set(found)
    assert main(["status"]) == 3
    assert capsys.readouterr().out.startswith("down: ")


@pytest.mark.parametrize(
    ("state", "code"),
    [("down", 3), ("starting", 3), ("disabled", 0), ("enabled", 0), ("stopped", 0)],
)
def test_status_exit_says_ready(client: ClientDouble, state: str, code: int) -> None:
    client.states = [
        {
            "state": state,
            "simulated": True,
            "rate_hz": 1000.0,
            "revision": 0,
            "fault": "none",
            "instance": "x",
        }
    ]
    assert main(["status"]) == code
    assert main(["status", "--json"]) == code


def test_status_explains_a_fault(client: ClientDouble, capsys: pytest.CaptureFixture[str]) -> None:
    row = {"cause": "the board was unplugged", "action": "force to 0", "remedy": "plug it in"}
    client.states = [
        {
            "state": "fault",
            "simulated": True,
            "rate_hz": 1e3,
            "revision": 3,
            "fault": "usb_lost",
            "instance": "x",
            **row,
        }
    ]
    assert main(["status"]) == 0
    assert (
        "usb_lost: the board was unplugged. force to 0. To leave: plug it in"
        in capsys.readouterr().out
    )


RUNNING = {
    "state": "enabled",
    "simulated": True,
    "rate_hz": 1000.0,
    "revision": 3,
    "fault": "none",
    "instance": "x",
}


def test_status_says_the_measured_delay(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = {"delay_us": 1125, "delay_spread_us": 40, "frame_age_us": 1130}
    client.states = [RUNNING | measured, RUNNING | {"delay_us": -1}]
    assert main(["status"]) == 0
    expected = "sample to force 1125 us (1.12 periods), spread 40 us; frames 1130 us old when read"
    assert expected in capsys.readouterr().out
    assert main(["status"]) == 0
    assert "sample to force unknown" in capsys.readouterr().out


def test_status_says_where_telemetry_is_and_why_not_at_the_usual_port(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    usual = {"telemetry": ["ipc:///run/telemetry", "tcp://127.0.0.1:9872"]}
    told = "port 9872 is taken, telemetry is at tcp://127.0.0.1:40001 instead"
    client.states = [
        RUNNING | {"endpoints": usual},
        RUNNING | {"endpoints": usual | {"elsewhere": told}},
    ]
    assert main(["status"]) == 0
    assert "  telemetry tcp://127.0.0.1:9872\n" in capsys.readouterr().out
    assert main(["status"]) == 0
    assert f"  telemetry {told}\n" in capsys.readouterr().out


def test_status_says_what_is_compensated_of_the_winding(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    known = {
        "compensated_ohm": 1.83,
        "tolerance_ohm": 0.03,
        "least_loop_gain": -0.3,
        "winding_c": 61.2,
        "winding_ohm": 1.859,
        "residual_ohm": 0.029,
        "loop_gain": 0.0185,
        "loop_gain_at_ceiling": 0.0426,
    }
    blind = known | dict.fromkeys(("winding_c", "winding_ohm", "residual_ohm", "loop_gain"))
    over = known | {"residual_ohm": -0.029}
    client.states = [RUNNING | {"compensation": one} for one in (known, blind, over, None)]
    assert main(["status"]) == 0
    told = capsys.readouterr().out
    assert "winding   1.83 ohm compensated of 1.859 at 61.2 degC: 0.029 ohm too little" in told
    assert "(tolerance 0.03 ohm)" in told
    assert "loop gain +0.0185, +0.0426 at the highest active damping; never below -0.3" in told
    assert main(["status"]) == 0
    assert "without a sensor the rest is unknown" in capsys.readouterr().out
    assert main(["status"]) == 0
    assert "0.029 ohm TOO MUCH" in capsys.readouterr().out
    assert main(["status"]) == 0
    assert "winding" not in capsys.readouterr().out


def test_status_says_what_is_delivered_of_the_active_damping(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    known = {"estimate_ns_per_m": 0.87, "low": 0.8, "high": 0.94, "ratio": 0.5}
    delivered = {**known, "commanded": 1.74, "basis": "current and encoder", "seconds": 4.0}
    unknown = {**dict.fromkeys(known), "commanded": 1.74, "basis": "unknown: the handle rests"}
    client.states = [
        RUNNING | {"delivered_active_damping": delivered},
        RUNNING | {"delivered_active_damping": unknown},
    ]
    assert main(["status"]) == 0
    expected = "delivered 0.87 (0.8 to 0.94) of 1.74 N s/m commanded (50 %), by current and encoder"
    assert expected in capsys.readouterr().out
    assert main(["status"]) == 0
    expected = "delivered of 1.74 N s/m commanded: unknown: the handle rests"
    assert expected in capsys.readouterr().out


def test_doctor_warns_of_a_force_that_comes_a_period_late(
    client: ClientDouble, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(system, "connect", lambda instance: client)
    late = {"delay_us": 1125, "delay_spread_us": 0, "frame_age_us": 1130}
    client.states = [RUNNING | late, RUNNING | late | {"delay_us": 125}]
    levels = []
    for _ in range(2):
        main(["doctor", "--seconds", "0", "--json"])
        told = json.loads(capsys.readouterr().out.splitlines()[-1])
        levels.append({check["name"]: check["level"] for check in told["checks"]}["force delay"])
    assert levels == ["warn", "ok"]


LATE = {
    "wake": {"count": 3, "latest_us": 812.4},
    "bus": {"count": 9, "latest_us": 1500.0},
    "step": {"count": 0, "latest_us": 0.0},
}
LATE_LINE = "3 wake (latest 812 us), 9 bus (latest 1500 us)"


@pytest.mark.parametrize(
    ("late", "ticks", "level", "found"),
    [
        (LATE, 60_000, "warn", f"12 of 60000: {LATE_LINE}"),
        (LATE, 600_000, "ok", f"12 of 600000: {LATE_LINE}"),
        ({}, 0, "ok", "none"),
    ],
)
def test_status_and_doctor_name_causes_of_late_ticks(
    late: dict[str, Any],
    ticks: int,
    level: str,
    found: str,
    client: ClientDouble,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(system, "connect", lambda instance: client)
    client.states = [RUNNING | {"late": late, "counters": {"ticks": ticks}}] * 2
    assert main(["status"]) == 0
    assert (f"  late      {LATE_LINE}\n" in capsys.readouterr().out) == bool(late)
    main(["doctor", "--seconds", "0", "--json"])
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    (check,) = [check for check in told["checks"] if check["name"] == "late ticks"]
    assert (check["level"], check["found"]) == (level, found)
    assert ("use a root port" in check["fix"]) == (level == "warn")


def test_status_and_doctor_say_what_the_delay_costs(
    client: ClientDouble, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(system, "connect", lambda instance: client)
    cost = {"level_ns_per_m": 0.0, "stiffness_n_per_m": 292.3, "ideal_stiffness_n_per_m": 719.6}
    cost["lost_share"] = 0.594
    timing = {"delay_periods": 0.6875, "measured": True}
    timing["without_active_damping"] = cost
    timing["with_active_damping"] = cost
    guard = dict.fromkeys(("basis", "margin_ns_per_m", "mode", "measuring", "trouble", "policy"))
    guard |= {"delay_periods": 0.6875, "worker": "up", "timing": timing}
    client.states = [RUNNING | {"guard": guard}] * 2 + [RUNNING]
    says = "delay 0.6875 periods, measured: K up to 292.3 instead of 719.6 N/m without it"
    assert main(["status"]) == 0
    assert f"  costs     {says}" in capsys.readouterr().out
    assert main(["doctor", "--seconds", "0", "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["timing"] == timing
    (line,) = [check["found"] for check in told["checks"] if check["name"] == "stiffness"]
    assert line.startswith(says)
    assert main(["doctor", "--seconds", "0", "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["timing"] is None
    assert "stiffness" not in [check["name"] for check in told["checks"]]


def test_status_says_what_is_known_of_the_board(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    transport = {"pair_us": 400.0, "sample_phase": 0.3125, "delay_us": 687.5, "rate_hz": 1000.0}
    state = {"state": "disabled", "simulated": False, "rate_hz": 1e3, "revision": 3}
    servo = {
        "differences": ["serial: the board says 'B'"],
        "transport": transport,
        "unsampled": "at 500 Hz a frame carries 6 of 8 samples",
    }
    client.states = [{**state, "fault": "none", "instance": "x", "servo": servo}]
    assert main(["status"]) == 0
    shown = capsys.readouterr().out
    assert "board     serial: the board says 'B'" in shown
    assert "probe     at 500 Hz a frame carries 6 of 8 samples" in shown
    assert (
        "bus       a pair of transfers takes 400 us, IN latched 0.3125 periods after OUT, force 688"
        " us after its sample, up to 1000 Hz"
    ) in shown


def test_colour_only_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal:
        def isatty(self) -> bool:
            return True

    monkeypatch.delenv("NO_COLOR", raising=False)
    assert terminal.coloured("x", terminal.RED) == "x"
    assert terminal.coloured("x", terminal.RED, Terminal()) == "\x1b[1;31mx\x1b[0m"
    monkeypatch.setenv("NO_COLOR", "1")
    assert terminal.coloured("x", terminal.RED, Terminal()) == "x"


@pytest.mark.parametrize(
    ("words", "instance"),
    [
        ([], None),
        (["--json"], None),
        (["--instance", "a"], "a"),
        (["--json", "--instance=b"], "b"),
    ],
)
def test_stop_takes_the_short_way(
    monkeypatch: pytest.MonkeyPatch, words: list[str], instance: str | None
) -> None:
    asked: list[tuple[str | None, bool]] = []
    monkeypatch.setattr(fast_stop, "main", lambda name, as_json: asked.append((name, as_json)) or 0)
    monkeypatch.setattr("sys.argv", ["hapticd", "stop", *words])
    assert entry.main() == 0
    assert asked == [(instance, "--json" in words)]


def test_misspelt_stop_is_explained(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["hapticd", "stop", "--instanse", "a"])
    assert entry.main() == 2
    assert "--instance" in capsys.readouterr().err


@pytest.mark.usefixtures("runtime")
def test_stop_without_a_daemon_exits_3(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stop"]) == 3
    assert "hapticd run" in capsys.readouterr().err


@pytest.mark.parametrize(
    "verb",
    [
        "run",
        "set",
        "get",
        "damping",
        "enable",
        "disable",
        "stop",
        "reset",
        "zero",
        "home",
        "status",
        "monitor",
        "events",
    ],
)
def test_every_verb_explains_itself(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--instance" in text
    assert "--json" in text


def test_config_check_names_the_templates_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The board's serial number is written, and nothing was measured at it."""
    folder = tmp_path / "devices"
    folder.mkdir()
    template = (shipped("config") / "devices" / "example-board.toml").read_text()
    own = template.replace('serial = "CHANGE-ME"', 'serial = "B7"', 1)
    (folder / "mine.toml").write_text(own)
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "mine"\n')
    assert main(["config", "check", str(file)]) == 0
    talk = capsys.readouterr().err
    assert "not to be relied on: force: it is of the board 'CHANGE-ME'" in talk
    assert "`hapticd rig motor`" in talk


def test_config_check_refuses_the_untouched_template(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "example-board"\n')
    assert main(["config", "check", str(file)]) == 78
    assert "serial = 'CHANGE-ME': is the template's" in capsys.readouterr().err


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hapticd {__version__}\n"


def test_abbreviations_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["set", "K=1", "--ramp", "0.1"]) == 2
    assert "--ramp-s" in capsys.readouterr().err


# --- config ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("runtime")
def test_config_check_good_and_bad(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "check", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["config"] == str(shipped("config") / "hapticd.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[realtime]\nrate_hertz = 1\npriority = 0\n")
    assert main(["config", "check", str(bad)]) == 78
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        f"hapticd: {bad}:3: realtime.priority = 0: must be at least 1",
        f"hapticd: {bad}:2: realtime.rate_hertz: is unknown; did you mean 'rate_hz'?",
    ]


def test_config_check_tells_all_that_is_wrong_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each with value, limit and remedy, whoever looks for it."""
    file = tmp_path / "bad.toml"
    file.write_text(
        "device = 'example-board'\nactive_damping_ns_per_m = 1740\n[usb]\ntimeout_ms = 6\n"
        "[gateway]\ntcp_host = '0.0.0.0'\n[[simulation.injections]]\nkind = 'estop'\n"
    )
    assert main(["config", "check", str(file)]) == 78
    said = capsys.readouterr().err
    for one in (
        f"{file}:2: active_damping_ns_per_m = 1740",
        f"{file}:4: usb.timeout_ms = 6 ms: must be at most 5 ms",
        f"{file}:6: gateway.tcp_host = '0.0.0.0': beyond this machine telemetry needs keys; set",
        f"{file}:8: simulation.injections[0].kind = 'estop': is unknown; use one of",
        ": serial = 'CHANGE-ME': is the template's; copy it to devices/",
    ):
        assert one in said
    assert len(said.splitlines()) == 5


@pytest.mark.parametrize("verb", [["check"], ["resolve", "--config"]])
@pytest.mark.usefixtures("runtime")
def test_environment_at_start_keeps_the_limits_of_the_device(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a client's request; `hapticd run` resolves in the same way."""
    file = tmp_path / "far.toml"
    file.write_text(
        "device = 'weir2008'\n[environment]\nmass_kg = 9.0\nstiffness_n_per_m = 90000\n"
        "virtual_damping_ns_per_m = 1.0\n"
    )
    assert main(["config", *verb, str(file)]) == 78
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f"hapticd: {file}:4: environment.stiffness_n_per_m = 90000 N/m: beyond")
    assert second.startswith(f"hapticd: {file}:3: environment.mass_kg = 9 kg: beyond the limit -")
    assert "(of this device, against mistaken units)" in first
    file.write_text("device = 'weir2008'\n[environment]\nstiffness_n_per_m = 1000.0\n")
    assert main(["config", *verb, str(file)]) == 0


def test_config_check_knows_open_telemetry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "open.toml"
    file.write_text("[gateway]\ntcp_host = '0.0.0.0'\n")
    assert main(["config", "check", str(file)]) == 78
    assert (
        "gateway.tcp_host = '0.0.0.0': beyond this machine telemetry needs keys"
        in capsys.readouterr().err
    )
    file.write_text("[gateway]\ntcp_host = '0.0.0.0'\nallow_insecure = true\n")
    assert main(["config", "check", str(file)]) == 0
    assert (
        f"hapticd: {file}:2: INSECURE: telemetry is offered on 0.0.0.0" in capsys.readouterr().err
    )


@pytest.mark.usefixtures("runtime")
def test_config_show_says_units_and_origin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[realtime]\nrate_hz = 2000\n")
    assert main(["config", "show", "--origin", "--config", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"realtime.rate_hz = 2000.0 Hz    # {file}:2" in lines
    assert "realtime.priority = 79    # default" in lines
    assert main(["config", "show", "--origin", "--json", "--config", str(file)]) == 0
    assert json.loads(capsys.readouterr().out)["realtime.rate_hz"] == {
        "value": 2000.0,
        "unit": "Hz",
        "origin": f"{file}:2",
    }
    assert main(["config", "show", "--json", "--config", str(file)]) == 0
    assert json.loads(capsys.readouterr().out)["device"]["serial"] == "SIM0001"


def test_config_schema_is_the_shipped_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "schema"]) == 0
    assert capsys.readouterr().out == (shipped("config") / "hapticd.schema.json").read_text()
    assert main(["config", "schema", "--device"]) == 0
    assert capsys.readouterr().out == (shipped("config") / "device.schema.json").read_text()


def test_config_resolve_writes_the_runtime_files(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "resolve", "--instance", "left", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    folder = runtime / "hapticd" / "instance-left"
    assert {name: Path(path) for name, path in found["files"].items()} == {
        file.name: file for file in folder.iterdir()
    }
    assert json.loads((folder / "servo.json").read_text())["config_hash"] == found["hash"]


@pytest.mark.usefixtures("runtime")
def test_run_refuses_a_bad_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--rate-hz", "-5"]) == 78
    assert (
        capsys.readouterr().err
        == "hapticd: --rate-hz: realtime.rate_hz = -5.0 Hz: must be at least 50.0 Hz\n"
    )
    assert main(["run", "--config", "/nowhere.toml", "--json"]) == 78
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "ConfigError"


# --- leases ---------------------------------------------------------------------------------------

HELD = {
    "measuring": {
        "name": "trial",
        "actor": 17,
        "left_s": 4.25,
        "ttl_s": 5.0,
        "at_end": "disable",
    }
}


def test_leases_are_shown_with_holder_and_time(
    client: ClientDouble, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(change, "connect", lambda instance: client)
    client.states = [{"leases": HELD}]
    assert main(["lease", "show"]) == 0
    assert capsys.readouterr().out == (
        "measuring: trial (actor 17), 4.2 of 5 s left, at its end disable; guard and energy faults"
        " are off\n"
    )
    assert main(["lease", "show", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"ok": True, "leases": HELD}
    client.states = [{"leases": {}}]
    assert main(["lease", "show"]) == 0
    assert capsys.readouterr().out.startswith("no client holds a lease")


class LeaseDouble:
    """A lease that is granted; remembers what becomes of it."""

    def __init__(self, done: list[str]) -> None:
        self.done = done

    def take(self) -> LeaseHeld:
        self.done.append("take")
        return answer_of(LeaseHeld, HELD["measuring"])

    def sleep(self, seconds: float) -> None:
        self.done.append("sleep")
        os.kill(os.getpid(), signal.SIGINT)

    def release(self) -> str:
        self.done.append("release")
        return ""


def test_release_takes_over_and_leaves_it_to_anyone(
    client: ClientDouble, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    asked: list[Any] = []
    monkeypatch.setattr(change, "connect", lambda instance: client)
    client.states = [{"leases": HELD}]
    client.lease = lambda *what, **how: asked.append((what, how)) or LeaseDouble(done)  # type: ignore[attr-defined,func-returns-value]
    assert main(["lease", "release", "measuring"]) == 0
    assert (asked, done) == ([(("measuring",), {"take_over": True})], ["take", "release"])
    out = capsys.readouterr().out
    assert "before: measuring: trial (actor 17)" in out
    assert "measuring may be changed by any client" in out


def test_take_holds_until_ctrl_c_and_releases(
    client: ClientDouble, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    monkeypatch.setattr(change, "connect", lambda instance: client)
    client.lease = lambda *what, **how: LeaseDouble(done)  # type: ignore[attr-defined]
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    try:
        assert main(["lease", "take", "measuring"]) == 0
    finally:
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGTERM, before[1])
    assert done == ["take", "sleep", "release"]
    assert "Ctrl-C releases it" in capsys.readouterr().out


def test_shell_completes_verbs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_HAPTICD_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "hapticd mon")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert main([]) == 0
    assert capsys.readouterr().out.split() == ["monitor"]
