"""The main job in real processes, as `make test` runs it: a daemon on the simulated board, its
page, a change, active damping, a refusal, STOP, a recording, a script, a trial, and three ends.

One daemon serves all tests; each begins disabled with nothing rendered. The tests that end a
process stand last.
"""

import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.daemon import DEADLINE_S, QUIET, Daemon, asking, shared_daemon, until, zeroed

from hapticd.client import Client

# a busy machine has long delays, with which little is safe
pytestmark = [
    pytest.mark.process,
    pytest.mark.filterwarnings("ignore::hapticd.core.errors.GuardWarning"),
]
# a busy machine loses slots, and what that does to force has tests on virtual time
PATIENT = QUIET + "[safety]\nlost_slots_limit = 10000\nmissing_frames_limit = 100\n"


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with shared_daemon(settings=PATIENT, console=True) as daemon:
        yield daemon


@pytest.fixture
def device(daemon: Daemon) -> Iterator[Client]:
    with Client(daemon.instance, name="test", timeout_s=DEADLINE_S) as device:
        device.stop()
        until(lambda: daemon.cli("reset") == 0, "reset")
        device.set(K=0.0, B=0.0, M=0.0, active_damping=0.0)
        zeroed(device)
        yield device


@pytest.fixture
def ask(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    return asking(daemon, capsys)


# it ends inside its lease, as one that is killed does
SCRIPT = """
import os, sys
from hapticd.client import Client

with Client(sys.argv[1], name="script") as device:
    with device.lease("environment", at_end="disable"):
        device.set(K=100.0)
        device.enable()
        records, lost = device.record(seconds=0.2)
        print(len(records), records["stiffness_n_per_m"][-1], flush=True)
        os._exit(0)
"""


def program(folder: Path, *words: str) -> str:
    """Output of a Python program that has to succeed."""
    command = [sys.executable, *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def reported_damping(device: Client) -> float:
    """Active damping [N s/m] that the board reports in effect."""
    records, _ = device.record(seconds=0.05)
    return float(records["active_damping_effect_ns_per_m"][-1])


def test_daemon_starts_disabled_on_the_simulated_board(daemon: Daemon) -> None:
    with Client(daemon.instance, name="test", timeout_s=DEADLINE_S) as device:
        status = device.status()
    assert (status.state, status.simulated, status.fault) == ("disabled", True, "none")


def test_page_answers_at_the_address_that_status_names(
    daemon: Daemon, device: Client, ask: Callable[..., Any]
) -> None:
    url = until(lambda: (ask("status").get("console") or {}).get("url"), "the page's address")
    with urllib.request.urlopen(url, timeout=DEADLINE_S) as page:
        text = page.read().decode()
    assert "STOP" in text
    assert "Damping" in text


def test_change_takes_effect_and_its_receipt_says_when(
    device: Client, ask: Callable[..., Any]
) -> None:
    receipt = ask("set", "K=100", "B=1", "M=0.010", "--ramp-s", "0.1")
    assert receipt["ramp_end_tick"] == receipt["first_tick"] + 100
    assert ask("enable")["state"] == "enabled"
    assert ask("get")["parameters"]["K"] == 100.0
    records, lost = device.record(seconds=0.2)
    assert lost == 0
    assert records["stiffness_n_per_m"][-1] == 100.0


def test_active_damping_is_switched_while_the_device_is_enabled(
    device: Client, ask: Callable[..., Any]
) -> None:
    ask("enable")
    assert ask("damping", "on")["effective"]["active_damping"] == pytest.approx(1.74, abs=1e-3)
    until(lambda: reported_damping(device) > 1.7, "the board reports it")
    assert ask("damping", "off")["effective"]["active_damping"] == 0.0


def test_unsafe_change_is_refused_with_its_reason_and_nothing_changes(
    daemon: Daemon, device: Client, ask: Callable[..., Any]
) -> None:
    ask("guard", "refuse")
    try:
        before = ask("get")["parameters"]
        error = ask("set", "K=200", "B=1", code=4)["error"]
        assert error["code"] == "guard"
        assert error["guard"]["margin_ns_per_m"] < 0.0
        assert ask("get")["parameters"] == before
        ask("damping", "on")
        until(lambda: daemon.cli("set", "K=200", "B=1") == 0, "the same with active damping")
    finally:
        ask("guard", "warn")


def test_stop_latches_until_reset_which_does_not_enable(
    daemon: Daemon, device: Client, ask: Callable[..., Any]
) -> None:
    ask("enable")
    ask("stop")
    assert ask("status")["state"] == "stopped"
    assert ask("enable", code=5)["error"]["code"] == "stopped"
    until(lambda: daemon.cli("reset") == 0, "a reset, 1 s after another client's stop")
    assert device.status().state == "disabled"


def test_recording_replays_to_the_bit(
    daemon: Daemon, device: Client, ask: Callable[..., Any], tmp_path: Path
) -> None:
    ask("set", "K=50", "B=2")
    ask("enable")
    ask("record", str(tmp_path / "run.h5"), "--seconds", "1")
    replay = program(tmp_path, "-m", "hapticd", "replay", "run.h5", "--json")
    assert json.loads(replay.splitlines()[-1])["bit_exact"] is True


def test_script_that_ends_inside_its_lease_leaves_the_device_disabled(
    daemon: Daemon, device: Client, tmp_path: Path
) -> None:
    (tmp_path / "experiment.py").write_text(SCRIPT)
    records, stiffness = program(tmp_path, "experiment.py", daemon.instance).split()
    assert int(records) > 0
    assert float(stiffness) == 100.0
    assert until(lambda: device.status().state == "disabled", "the end of the lease")


def test_simulated_trial_gives_a_verdict(tmp_path: Path) -> None:
    words = ("zwidth", "trial", "-K", "100", "-B", "1", "-M", "0.010", "--json")
    trial = json.loads(program(tmp_path, "-m", "hapticd", *words).splitlines()[-1])
    assert trial["simulated"] is True
    assert trial["verdict"]["answer"] == "passive"


def test_killed_gateway_comes_back_beside_the_same_servo(daemon: Daemon, device: Client) -> None:
    device.set(K=70.0)
    before = daemon.children()
    os.kill(before["gateway"], signal.SIGKILL)
    until(lambda: daemon.children().get("gateway", before["gateway"]) != before["gateway"], "new")
    assert daemon.children()["servo"] == before["servo"]
    with Client(daemon.instance, name="test", timeout_s=DEADLINE_S) as again:
        assert until(lambda: again.get().parameters["K"] == 70.0, "the value in force")


def test_killed_servo_comes_back_disabled(daemon: Daemon, device: Client) -> None:
    device.enable()
    os.kill(daemon.children()["servo"], signal.SIGKILL)
    until(lambda: daemon.told().count("ready") == 2, "a new servo")
    with Client(daemon.instance, name="test", timeout_s=DEADLINE_S) as again:
        assert until(lambda: again.status().state == "disabled", "disabled")


def test_interrupt_ends_everything(daemon: Daemon) -> None:
    children = daemon.children()
    daemon.process.send_signal(signal.SIGINT)
    assert daemon.process.wait(DEADLINE_S) == 0
    assert not any(Path(f"/proc/{pid}").exists() for pid in children.values())
