"""The file of `hapticd doctor --report` holds what a question needs, and nothing private."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.client_double import ClientDouble
from test_doctor import HUB_FILES, asked, make  # noqa: F401  # a fixture

from hapticd.cli import system
from hapticd.cli.app import main
from hapticd.core.errors import ConfigError
from hapticd.run.doctor.checks import CheckResult, report_of, usb_devices, write_report
from hapticd.run.doctor.machine import Machine

HOME = "/home/ada.lovelace"
SECRET = "s3cr3t-k3y"
PRIVATE = {  # where a status has what people named, or a secret
    "actor_name": SECRET,
    "actors": {"17": SECRET},
    "leases": {"damping": {"holder": SECRET}},
    "endpoints": {"telemetry": [f"tcp://10.0.0.7:9872?{SECRET}"]},
    "console": {"url": f"http://127.0.0.1:1/{SECRET}"},
    "events": [{"kind": "note", "text": SECRET}],
    "requests": {SECRET: 1},
    "reason": SECRET,
}
COST = dict.fromkeys(("level_ns_per_m", "stiffness_n_per_m", "ideal_stiffness_n_per_m"), 1.0)
COST["lost_share"] = 0.0
TIMING = {
    "delay_periods": 0.6875,
    "measured": True,
    "without_active_damping": COST,
    "with_active_damping": COST,
}
STATUS: dict[str, Any] = {
    **PRIVATE,
    "state": "enabled",
    "rate_hz": 1000.0,
    "cause": f"{HOME}/rig/board.toml is wrong",
    "counters": {"late_events": 3},
    "stages": {"read": {"p50_us": 84.1}},
    "late": {"bus": {"count": 2, "latest_us": 700.0}},
    "servo": {"transport": {"pair_us": 400.0}, "device": SECRET, "board": {"serial": SECRET}},
    "guard": {"delays": {"counted_periods": 0.6875}, "timing": TIMING, "pid": SECRET},
}


@pytest.fixture
def home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", HOME)


def test_report_has_what_a_question_needs(
    home: None,
    make: Callable[..., Machine],  # noqa: F811
) -> None:
    files = HUB_FILES | {
        "proc/cpuinfo": "model name\t: Ryzen 7\nflags\t: fpu hypervisor\nmodel name\t: Ryzen 7",
        "etc/os-release": 'NAME="Debian"\nPRETTY_NAME="Debian GNU/Linux 12"',
        "proc/sys/kernel/osrelease": "6.1",
    }
    findings = [CheckResult("disk", "warn", f"full: {HOME}/data", "why", f"rm {HOME}")]
    found = report_of(make(files), asked(), findings, {"p99_us": 12}, STATUS)
    assert found["format"] == "hapticd-doctor/1"
    assert {"hapticd", "pyusb", "numpy"} <= found["versions"].keys()
    assert found["interpreter"]["flags"].keys() >= {"Py_DEBUG", "Py_GIL_DISABLED"}
    assert found["machine"] == {
        **found["machine"],
        "processor": "Ryzen 7",
        "cores": [0, 1, 2, 3],
        "system": "Debian GNU/Linux 12",
        "kernel": "6.1",
        "virtual": True,
    }
    assert found["timing"] == {
        "rate_hz": 1000.0,
        "transport": {"pair_us": 400.0},
        "delays": {"counted_periods": 0.6875},
        "cost": TIMING,
        "wake": {"p99_us": 12},
    }
    (check,) = found["checks"]
    assert (check["found"], check["fix"]) == ("full: ~/data", "rm ~")
    assert found["status"]["cause"] == "~/rig/board.toml is wrong"
    assert found["status"]["counters"] == {"late_events": 3}
    assert found["status"]["late"] == STATUS["late"]


def test_topology_names_hubs_and_no_serial_numbers(
    make: Callable[..., Machine],  # noqa: F811
) -> None:
    devices = usb_devices(make(HUB_FILES), asked())
    assert [(one["name"], one["board"], one["hubs_above"]) for one in devices] == [
        ("1-2", False, []),
        ("1-2.4.1", True, ["1-2", "1-2.4"]),
        ("1-3", False, []),
        ("usb1", False, []),
    ]
    assert devices[0]["speed_mbit"] == "480"
    assert "PRIVATE" not in json.dumps(devices)
    assert "Ada" not in json.dumps(devices)


def test_written_file_parses_and_has_no_secret_of_the_runtime_folder(
    home: None, runtime: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    folder = tmp_path / "run"
    for name in ("server.key_secret", "console.json", "guard.terms", "servo.json"):
        folder.mkdir(exist_ok=True)
        (folder / name).write_text(json.dumps({"token": SECRET, "home": HOME}))
    wanted = asked(runtime=folder, keys=folder, recordings=tmp_path)
    client = ClientDouble()
    client.states = [STATUS]
    monkeypatch.setattr(system, "connect", lambda instance: client)
    monkeypatch.setattr("hapticd.run.doctor.machine.requirements", lambda *given: wanted)
    file = tmp_path / "report.json"
    assert main(["doctor", "--seconds", "0", "--report", str(file)]) == 0
    text = file.read_text()
    found = json.loads(text)
    assert found["status"]["state"] == "enabled"
    assert len(found["checks"]) > 20
    assert SECRET not in text
    assert HOME not in text
    assert "attach this file" in capsys.readouterr().err


def test_report_is_written_without_a_daemon(runtime: Path, tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    assert main(["doctor", "--seconds", "0", "--report", str(file)]) == 0
    assert json.loads(file.read_text())["status"] is None


def test_file_that_exists_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    file.write_text("mine")
    with pytest.raises(ConfigError, match=r"File exists; name another file with --report"):
        write_report(file, {})
    assert file.read_text() == "mine"
