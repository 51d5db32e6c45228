"""The command line against real processes: start, set, damping, stop, the end by every signal,
deaths and restarts.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.daemon import DEADLINE_S, QUIET, Daemon, asking, last_record, until

from hapticd.cli.app import main
from hapticd.mailbox import files
from hapticd.mailbox.layout import State
from hapticd.usb import codec

pytestmark = pytest.mark.process


@pytest.fixture
def daemon(runtime: Path) -> Iterator[Daemon]:
    with Daemon(runtime) as daemon:
        yield daemon


@pytest.fixture
def ask(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    return asking(daemon, capsys)


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):  # it may go between opening and reading
        return True


def judged(answer: Any) -> str:
    """The message of a refusal; none where a busy computer gave no verdict in time."""
    message = str(answer["error"]["message"])
    return "" if "the computer is busy" in message else message


def test_from_start_to_stop(
    daemon: Daemon, ask: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    status = ask("status")
    assert (status["state"], status["simulated"], status["rate_hz"]) == ("disabled", True, 1000.0)
    assert (status["revision"], status["fault"]) == (0, "none")
    assert (
        status["config_hash"]
        == json.loads((daemon.folder / files.SERVO_JSON).read_text())["config_hash"]
    )

    # the setting of Fig. 4, then that of Fig. 7 with the damping toggled live
    assert ask("set", "K=100", "B=1", "M=0.010", "--ramp-s", "0.1")["revision"] == 1
    assert ask("enable")["state"] == "enabled"
    parameters = ask("set", "K=50", "B=2", "M=0")["effective"]
    assert (parameters["K"], parameters["B"], parameters["M"]) == (50.0, 2.0, 0.0)
    assert ask("damping", "on")["effective"]["active_damping"] == pytest.approx(
        1.74, abs=10 / 65535
    )
    assert ask("damping", "off")["effective"]["active_damping"] == 0.0
    assert ask("damping", "2.5")["effective"]["active_damping"] == pytest.approx(
        2.5, abs=10 / 65535
    )
    changed = ("set", "K=-5", "filters.velocity_hz=80")
    assert "filters change only" in until(lambda: judged(ask(*changed, code=4)), "a verdict")
    assert ask("disable")["state"] == "disabled"
    assert ask(*changed)["effective"]["K"] == -5.0
    assert ask("enable")["state"] == "enabled"
    assert ask("get")["parameters"]["filters"]["velocity_hz"] == 80.0

    assert "beyond the limit" in ask("set", "K=1e9", code=4)["error"]["message"]
    assert ask("set", "K=nan", code=2)["error"]["code"] == "usage"
    assert ask("set", "K=1", "--at-tick", "1", code=4)["error"]["code"] == "refused_late"
    ahead = ask("status")["tick"] + 1_000_000
    assert ask("set", "K=1", "--at-tick", str(ahead))["result"] == "scheduled"

    (daemon.folder / "wave.txt").write_text("0.1\n-0.1\n" * 100)
    assert ask("perturb", "load", str(daemon.folder / "wave.txt"))["samples"] == 200
    assert ask("perturb", "start", "--loop")["ok"]
    assert ask("perturb", "stop")["ok"]
    (daemon.folder / "wave.txt").unlink()

    daemon.cli("monitor", "--json", "--seconds", "0.5")
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["state"] == "enabled"
    assert lines[-1]["simulated"] is True

    command = [sys.executable, "-m", "hapticd", "stop", "--instance", daemon.instance, "--json"]
    reply = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    assert (reply["ok"], reply["state"]) == (True, "stopped")
    assert ask("enable", code=5)["error"]["code"] == "stopped"
    assert ask("status")["fault"] == "stop"
    # somebody else pressed it: for a second of ticks nobody but the presser may reset
    until(lambda: daemon.cli("reset", "--json") == 0, "reset")
    assert ask("zero")["state"] == "disabled"


def test_foreground_run_says_what_to_try(runtime: Path) -> None:
    (runtime / "hapticd.toml").write_text(QUIET)
    command = [
        sys.executable,
        "-m",
        "hapticd",
        "run",
        "--instance",
        "words",
        "--config",
        str(runtime / "hapticd.toml"),
        "--no-console",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        text = "".join(iter(process.stdout.readline, "Ctrl-C here ends it.\n"))
        process.send_signal(signal.SIGINT)
        _, talk = process.communicate(timeout=DEADLINE_S)
    assert "SIMULATED" in text
    assert "████" in text
    for verb in ("set K=100 B=1 M=0.010", "enable", "damping on", "monitor", "stop", "status"):
        assert f"hapticd {verb} --instance words" in text
    assert "\x1b" not in text + talk
    assert talk.splitlines()[0] == "hapticd: starting the servo"
    assert process.returncode == 0


def test_foreground_run_tells_what_happens(runtime: Path) -> None:
    """Enabled again and again, until one comes after the terminal has begun to listen."""
    (runtime / "hapticd.toml").write_text(QUIET)
    words = ["run", "--instance", "told", "--config", str(runtime / "hapticd.toml")]
    log = runtime / "talk"
    with (
        log.open("wb") as talk,
        subprocess.Popen(
            [sys.executable, "-m", "hapticd", *words, "--no-console"],
            stdout=subprocess.PIPE,
            stderr=talk,
        ) as process,
    ):
        assert process.stdout is not None
        for _ in iter(process.stdout.readline, b"Ctrl-C here ends it.\n"):
            pass
        here = ["--instance", "told"]

        def enabled_is_told() -> bool:
            main(["enable", *here])
            main(["disable", *here])
            return "disabled -> enabled" in log.read_text()

        try:
            until(enabled_is_told, "an enable in the terminal")
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0


def test_run_ends_when_its_reader_leaves(runtime: Path) -> None:
    (runtime / "hapticd.toml").write_text(QUIET)
    command = [
        sys.executable,
        "-m",
        "hapticd",
        "run",
        "--instance",
        "pipe",
        "--config",
        str(runtime / "hapticd.toml"),
        "--json",
        "--no-console",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["event"] == "starting"
        process.stdout.close()
        assert process.wait(DEADLINE_S) == 0
    assert not list((runtime / "hapticd" / "instance-pipe").glob("*.json"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("background", [False, True], ids=["foreground", "background"])
def test_signals_end_cleanly(runtime: Path, number: int, background: bool) -> None:
    """Enabled, with a spring and damping on: both processes gone, nothing left but the last
    telemetry; an end in order is no fault, of which a flight recording would tell.
    """
    with Daemon(runtime, ignore_interrupt=background) as daemon:
        children = daemon.children()
        assert set(children) == {"servo", "gateway"}
        for words in (["set", "K=100"], ["enable"], ["damping", "on"]):
            assert daemon.cli(*words) == 0
        daemon.process.send_signal(number)
        assert daemon.process.wait(DEADLINE_S) == 0
    assert daemon.told()[-3:] == ["ending", "ending", "ended"]
    assert all(map(gone, children.values()))
    assert [file.name for file in daemon.folder.iterdir()] == [files.LAST_TELEMETRY]
    assert not list(runtime.rglob("*.flight"))
    last = last_record(daemon.folder / files.LAST_TELEMETRY)
    assert (last["state"], last["actor"], last["force_n"]) == (State.STOPPED, 0, 0.0)
    assert codec.decode_out(bytes(last["out_frame"])).damping > 0  # left to the board's watchdog


def test_second_run_is_refused(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    before = (daemon.folder / files.SERVO_JSON).read_bytes()
    assert daemon.cli("run", "--rate-hz", "500") == 1
    assert (
        f"a supervisor (pid {daemon.process.pid}) already runs in {daemon.folder}"
        in capsys.readouterr().err
    )
    assert (daemon.folder / files.SERVO_JSON).read_bytes() == before


def test_killed_servo_comes_back_disabled(daemon: Daemon, ask: Callable[..., Any]) -> None:
    ask("enable")
    before = daemon.children()
    os.kill(before["servo"], signal.SIGKILL)
    until(lambda: daemon.events().count("ready") == 2, "ready again")
    after = daemon.children()
    assert after["servo"] != before["servo"]
    assert after["gateway"] == before["gateway"]
    status = until(
        lambda: (found := ask_any(daemon, "status"))["state"] == "disabled" and found,
        "the gateway sees the new servo",
    )
    assert status["revision"] == 0


def test_killed_gateway_comes_back(daemon: Daemon) -> None:
    before = daemon.children()
    os.kill(before["gateway"], signal.SIGKILL)
    until(lambda: daemon.events().count("ready") == 2, "ready again")
    after = daemon.children()
    assert after["servo"] == before["servo"]
    assert after["gateway"] != before["gateway"]
    until(lambda: ask_any(daemon, "status")["state"] == "disabled", "it answers")


def test_children_die_with_the_supervisor(daemon: Daemon) -> None:
    children = daemon.children()
    daemon.process.kill()
    daemon.process.wait(DEADLINE_S)
    until(lambda: all(map(gone, children.values())), "both gone")


def test_status_exits_3_while_the_servo_is_gone(daemon: Daemon) -> None:
    children = daemon.children()
    os.kill(daemon.process.pid, signal.SIGSTOP)  # so that nobody starts another servo
    os.kill(children["servo"], signal.SIGKILL)
    until(lambda: ask_any(daemon, "status")["state"] == "down", "the gateway notices")
    assert daemon.cli("status") == 3
    os.kill(daemon.process.pid, signal.SIGCONT)


def ask_any(daemon: Daemon, *words: str) -> Any:
    """As `ask`, in a process of its own and with any exit code."""
    command = [sys.executable, "-m", "hapticd", *words, "--instance", daemon.instance, "--json"]
    return json.loads(subprocess.run(command, check=False, capture_output=True).stdout)


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=["SIGINT", "SIGTERM", "SIGHUP"]
)
def test_trial_that_is_ended_leaves_the_device_disabled(
    daemon: Daemon, ask: Callable[..., Any], number: int
) -> None:
    """Whoever closes the terminal must not leave the device shaking."""
    folder = str(daemon.folder.parent / "trial")
    command = [
        sys.executable,
        "-m",
        "hapticd",
        "zwidth",
        "trial",
        "live",
        "-K",
        "20",
        "--instance",
        daemon.instance,
        "--out",
        folder,
    ]
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # whoever started the tests by nohup has it ignored
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    ) as trial:
        until(lambda: ask("status")["perturbing"], "the trial shakes the device")
        trial.send_signal(number)
        assert trial.wait(DEADLINE_S) == 128 + number
    status = ask("status")
    assert (status["state"], status["perturbing"]) == ("disabled", 0)


def test_three_instances_on_one_machine_know_nothing_of_each_other(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each has its own device, state and end; a name that is not there is said to be none."""

    def told(daemon: Daemon, *words: str) -> Any:
        return asking(daemon, capsys)(*words)

    devices = {"-left": "simulated", "-middle": "ideal", "-right": "warming"}
    with contextlib.ExitStack() as stack:
        daemons = [
            stack.enter_context(
                Daemon(runtime, settings=f'device = "{device}"\n{QUIET}', name=name)
            )
            for name, device in devices.items()
        ]
        for number, daemon in enumerate(daemons):
            told(daemon, "set", f"K={100 + number}", "--ramp-s", "0")
        assert told(daemons[1], "enable")["state"] == "enabled"
        found = [told(daemon, "get")["parameters"]["K"] for daemon in daemons]
        assert found == [100.0, 101.0, 102.0]
        states = [told(daemon, "status")["state"] for daemon in daemons]
        assert states == ["disabled", "enabled", "disabled"]
        assert told(daemons[0], "stop")["ok"]
        daemons[2].process.send_signal(signal.SIGINT)
        assert daemons[2].process.wait(DEADLINE_S) == 0
        assert told(daemons[1], "status")["state"] == "enabled"
        assert told(daemons[0], "status")["state"] == "stopped"
        capsys.readouterr()
        assert daemons[2].cli("get") != 0
        assert "no daemon runs there" in capsys.readouterr().err
