"""The units, as systemd's own tools judge them; the promises they make; what the processes tell
systemd.
"""

import ipaddress
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.programs import program
from support.systemd import DEADLINE_S, Service
from support.tree import ROOT

from hapticd.cli.app import main
from hapticd.core.errors import ConfigError
from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.mailbox import files
from hapticd.mailbox.daemons import daemon_folder
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.run import system_files, watchdog
from hapticd.run.supervisor import PATIENCE_NS, RESTARTS_MAX, WINDOW_NS
from hapticd.settings.scene import schema
from hapticd.settings.toml import shipped

UNITS = ("hapticd-servo.service", "hapticd-gateway.service", "hapticd.target")
SERVICES = UNITS[:2]
EXPOSURE = {"hapticd-servo.service": 0.9, "hapticd-gateway.service": 1.1}
SYSTEMD = "/lib/systemd/systemd"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything installed below a folder of its own."""
    folder = tmp_path_factory.mktemp("root")
    system_files.write_below(folder, system_files.system_files(UsbParams()))
    return folder


def unit(root: Path, name: str) -> dict[str, list[str]]:
    """All values by key, sections thrown together."""
    found: dict[str, list[str]] = {}
    for line in (root / system_files.PLACES[name]).read_text().splitlines():
        if line and line[0] not in "#[":
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found


# --- what systemd thinks of them ------------------------------------------------------------------


def test_units_verify_without_a_word(root: Path) -> None:
    paths = [str(root / system_files.PLACES[name]) for name in UNITS]
    done = subprocess.run(
        [program("systemd-analyze"), "verify", "--man=no", *paths], capture_output=True, text=True
    )
    said = [line for line in (done.stdout + done.stderr).splitlines() if "hapticd" in line]
    assert (done.returncode, said) == (0, [])


@pytest.mark.parametrize("name", SERVICES)
def test_exposure_is_no_worse_than_the_page_says(root: Path, name: str) -> None:
    path = str(root / system_files.PLACES[name])
    done = subprocess.run(
        [program("systemd-analyze"), "security", "--offline=true", path],
        capture_output=True,
        text=True,
    )
    level = re.search(r"Overall exposure level for \S+: (\d+\.\d+)", done.stdout)
    assert level is not None, done.stdout + done.stderr
    assert float(level[1]) <= EXPOSURE[name]
    told = "rates the servo {} and the gateway {};".format(*EXPOSURE.values())
    assert told in (ROOT / "docs/service.md").read_text()


def test_user_and_folders_can_be_made(tmp_path: Path) -> None:
    system_files.write_below(tmp_path, system_files.system_files(UsbParams()))
    subprocess.run(
        [program("systemd-sysusers"), f"--root={tmp_path}"], check=True, capture_output=True
    )
    assert (tmp_path / "etc/passwd").read_text().startswith("hapticd:x:")
    if os.getuid() == 0:
        subprocess.run(
            [program("systemd-tmpfiles"), f"--root={tmp_path}", "--create", "hapticd.conf"],
            check=True,
        )
        assert (tmp_path / "var/lib/hapticd/flights").stat().st_mode & 0o777 == 0o750


# --- what they promise ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", SERVICES)
def test_restarts_are_those_of_the_supervisor(root: Path, name: str) -> None:
    found = unit(root, name)
    assert found["Restart"] == ["on-failure"]
    assert found["RestartPreventExitStatus"] == [str(ConfigError.exit_code)]
    if name == "hapticd-servo.service":
        assert int(found["StartLimitBurst"][0]) - 1 == RESTARTS_MAX
        assert int(found["StartLimitIntervalSec"][0]) * NS_PER_S == WINDOW_NS


def test_gateway_that_is_aborted_again_and_again_leaves_the_service_alone(root: Path) -> None:
    found = unit(root, "hapticd-gateway.service")
    assert found["StartLimitIntervalSec"] == ["0"]  # no limit of restarts
    assert found["MemoryMax"] == ["512M"]  # what it can take from the servo's machine
    servo = unit(root, "hapticd-servo.service")
    named = [key for key, values in servo.items() if "gateway" in " ".join(values)]
    assert named == []  # no dependency by which its end could reach the servo


@pytest.mark.parametrize("name", SERVICES)
def test_runtime_folder_is_shared_and_closed(root: Path, name: str) -> None:
    found = unit(root, name)
    assert Path("/run", found["RuntimeDirectory"][0]) == files.SERVICE_FOLDER
    assert found["RuntimeDirectoryMode"] == ["0750"]
    assert found["RuntimeDirectoryPreserve"] == ["yes"]
    assert found["User"] == found["Group"] == ["hapticd"]


@pytest.mark.parametrize("name", SERVICES)
def test_configuration_is_resolved_before_each_start(root: Path, name: str) -> None:
    found = unit(root, name)
    assert found["ExecStartPre"] == [f"{sys.executable} -I -m hapticd config resolve"]
    assert found["Type"] == ["notify"]
    assert found["WatchdogSec"] == ["5"]


def test_servo_has_rights_for_its_priority(root: Path) -> None:
    found = unit(root, "hapticd-servo.service")
    assert int(found["LimitRTPRIO"][0]) >= RealtimeParams().priority
    assert found["LimitRTTIME"] == found["LimitMEMLOCK"] == ["infinity"]
    assert not {"RestrictRealtime", "PrivateDevices", "CPUSchedulingPolicy"} & set(found)
    assert found["NotifyAccess"] == ["all"]


def test_servo_has_time_to_fade_its_force_before_it_is_killed(root: Path) -> None:
    """Under the longest ramp that may be configured, every tick drawn out by a silent board."""
    found = unit(root, "hapticd-servo.service")
    limit = schema("config")["$defs"]["SafetyParams"]["properties"]["stop_ramp_s"]["maximum"]
    ticks_s = limit * (1 + UsbParams().timeout_ms)
    assert ticks_s < float(found["TimeoutStopSec"][0]) <= PATIENCE_NS / NS_PER_S
    assert found["TimeoutStopFailureMode"] == ["kill"]
    assert found["KillMode"] == ["mixed"]


def test_gateway_talks_to_this_machine_alone(root: Path) -> None:
    found = unit(root, "hapticd-gateway.service")
    assert found["IPAddressDeny"] == ["any"]
    assert found["IPAddressAllow"] == ["localhost"]
    assert found["NotifyAccess"] == ["main"]


def directives(text: str) -> list[tuple[str, str, str]]:
    """(section, key, value) of a unit file, in order."""
    found = []
    section = ""
    for line in text.splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif line and line[0] not in "#;":
            key, _, value = line.partition("=")
            found.append((section, key, value))
    return found


def test_drop_in_for_telemetry_widens_the_gateways_addresses_and_nothing_else(root: Path) -> None:
    drop_in = (shipped("systemd") / "hapticd-telemetry.conf").read_text()
    ((section, key, value),) = directives(drop_in)
    whole = directives((root / system_files.PLACES["hapticd-gateway.service"]).read_text())
    assert (section, key, "localhost") in whole  # the same directive, in the same section
    network, *named = value.split()
    assert ipaddress.ip_network(network) in [ipaddress.ip_network("192.0.2.0/24")]  # RFC 5737
    assert set(named) <= {"link-local", "localhost", "multicast"}  # systemd.resource-control(5)
    told = (ROOT / "docs" / "service.md").read_text()
    assert "systemd/hapticd-telemetry.conf" in told
    assert "/etc/systemd/system/hapticd-gateway.service.d/telemetry.conf" in told


def test_drop_in_for_telemetry_verifies_beside_its_unit(root: Path) -> None:
    """systemd names a directive that it does not know, and a value that it cannot read."""
    unit_file = root / system_files.PLACES["hapticd-gateway.service"]
    folder = unit_file.with_name(f"{unit_file.name}.d")
    folder.mkdir()
    place = folder / "telemetry.conf"
    text = (shipped("systemd") / "hapticd-telemetry.conf").read_text()
    try:
        for wrong in ("", "IPAddressAllowed=10.0.0.0/8\n", "IPAddressAllow=10.0.0.0/99\n"):
            place.write_text(text + wrong)
            done = subprocess.run(
                [program("systemd-analyze"), "verify", "--man=no", str(unit_file)],
                capture_output=True,
                text=True,
            )
            said = "telemetry.conf" in done.stdout + done.stderr
            assert said == bool(wrong), done.stderr
    finally:
        shutil.rmtree(folder)


def test_target_starts_both(root: Path) -> None:
    assert unit(root, "hapticd.target")["Wants"] == [" ".join(SERVICES)]
    assert all(unit(root, name)["PartOf"] == ["hapticd.target"] for name in SERVICES)


def test_nobody_who_starts_the_target_waits_for_a_board(root: Path, runtime: Path) -> None:
    """A target orders itself behind what it wants, unless it says that it does not."""
    program("systemd-analyze")  # of the same package
    runtime.chmod(0o755)  # read by nobody: systemd shows no plan to root
    shutil.copytree(root / "etc/systemd/system", runtime / "units")
    as_nobody = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
    words = [SYSTEMD, "--test", "--system", "--unit=hapticd.target"]
    done = subprocess.run(
        [*(as_nobody if os.getuid() == 0 else []), *words],
        env={"SYSTEMD_UNIT_PATH": f"{runtime}/units:/lib/systemd/system"},
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
    )
    plan = (done.stdout + done.stderr).replace("→", "->")  # systemd 257 draws the arrow
    _, _, target = plan.partition("-> Unit hapticd.target:")
    target, _, _ = target.partition("-> Unit ")
    assert "Wants: hapticd-servo.service" in target
    assert "Before: shutdown.target" in target
    assert "After: hapticd-servo.service" not in target


def test_servo_has_no_network(root: Path) -> None:
    """It finds boards that are plugged in later all the same: see tests/support/usb_guest."""
    found = unit(root, "hapticd-servo.service")
    assert found["PrivateNetwork"] == ["yes"]
    assert found["RestrictAddressFamilies"] == ["AF_UNIX AF_NETLINK"]
    assert found["IPAddressDeny"] == ["any"]


def test_udev_rule_names_the_configured_board() -> None:
    rule = system_files.system_files(UsbParams(vendor_id=0x16C0, product_id=0x04D2))[
        "etc/udev/rules.d/70-hapticd.rules"
    ]
    assert rule.count('ATTR{idVendor}=="16c0", ATTR{idProduct}=="04d2"') == 2
    assert 'GROUP="hapticd", MODE="0660", TAG+="uaccess"' in rule
    assert 'ATTR{power/control}="on"' in rule
    assert 'KERNEL=="cpu_dma_latency"' in rule


def test_no_template_word_is_left() -> None:
    assert not [
        place
        for place, content in system_files.system_files(UsbParams()).items()
        if re.search(r"@[A-Z]+@", content)
    ]


def test_every_template_has_a_place() -> None:
    by_hand = "hapticd-telemetry.conf"  # who widens the unit says for which network
    names = {path.name for path in shipped("systemd").iterdir()}
    assert names - {by_hand} == set(system_files.PLACES)


# --- install-system -------------------------------------------------------------------------------


def test_every_file_is_shown_where_no_root_is_named(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["install-system"]) == 0
    shown = capsys.readouterr().out
    assert [line[7:] for line in shown.splitlines() if line.startswith("# === /")] == list(
        system_files.PLACES.values()
    )


def test_root_receives_every_file_and_nothing_else(
    runtime: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["install-system", "--root", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    there = {str(path) for path in tmp_path.rglob("*") if path.is_file()}
    assert (
        set(told["files"])
        == there
        == {str(tmp_path / place) for place in system_files.PLACES.values()}
    )
    assert told["next"][-1] == "systemctl enable --now hapticd.target"


def test_root_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("a file where a folder should be")
    with pytest.raises(
        ConfigError,
        match=(
            r"etc/systemd/system/hapticd-servo\.service: .*; write elsewhere with --root DIR, or as"
            r" root"
        ),
    ):
        system_files.write_below(tmp_path, system_files.system_files(UsbParams()))


def test_interpreter_in_a_home_is_warned_about(tmp_path: Path) -> None:
    (tmp_path / "python").symlink_to("/root/.pyenv/versions/3.11/bin/python")
    assert system_files.hidden_interpreter(str(tmp_path / "python")).startswith("/root/.pyenv")
    assert "install hapticd into /opt/hapticd" in system_files.hidden_interpreter(
        "/home/lab/venv/bin/python"
    )
    assert system_files.hidden_interpreter("/opt/hapticd/bin/python") == ""


# --- where clients find the service ---------------------------------------------------------------


def test_client_finds_the_service_when_alone(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = runtime / "service"
    monkeypatch.setattr(files, "SERVICE_FOLDER", service)
    assert daemon_folder() == files.runtime_folder()
    service.mkdir()
    assert daemon_folder() == service
    assert daemon_folder("rig-2") == files.runtime_folder("rig-2")
    own = ServoMailbox(files.runtime_folder(), 1000.0, "", True, 5)
    assert daemon_folder() == files.runtime_folder()
    own.close()
    assert daemon_folder() == service


@pytest.fixture
def service(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    address = str(runtime / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    found = Service(address)
    yield found
    found.socket.close()


def test_notify_without_systemd_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    watchdog.notify("READY=1")


def test_notify_sends_one_datagram(service: Service) -> None:
    watchdog.notify("READY=1", "STATUS=fine")
    assert service.hear() == (os.getpid(), ["READY=1", "STATUS=fine"])


def test_notify_knows_abstract_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"hapticd-test-{os.getpid()}"
    listener = Service(f"\0{name}")
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    watchdog.notify("READY=1")
    assert listener.hear()[1] == ["READY=1"]
    listener.socket.close()


def test_feeder_feeds_four_times_a_limit(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "4000000")
    clock = VirtualClock(NS_PER_S)
    feeder = watchdog.Feeder(clock)
    for _ in range(40):
        feeder.feed()
        clock.time_ns += NS_PER_S // 10
    watchdog.notify("end")
    heard = [service.hear()[1][0] for _ in range(5)]
    assert heard == ["WATCHDOG=1"] * 4 + ["end"]


def test_feeder_without_a_watchdog_is_silent(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("WATCHDOG_USEC", raising=False)
    watchdog.Feeder(VirtualClock(NS_PER_S)).feed()
    watchdog.notify("end")
    assert service.hear()[1] == ["end"]
    assert watchdog.start_feeder(Path("/nowhere")) is None


def test_feeder_feeds_only_while_the_head_advances() -> None:
    heads = iter([7, 7, 8, 9, 9, 9, 12, 12])
    fed: list[int] = []
    clock = VirtualClock()
    watchdog.watch(
        lambda: next(heads),
        lambda: fed.append(clock.now_ns() // NS_PER_S),
        clock,
        NS_PER_S,
        looks=7,
    )
    assert fed == [2, 3, 6]


def test_feeder_without_a_ring_says_so(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = [
        sys.executable,
        "-m",
        "hapticd.run.watchdog",
        str(tmp_path),
        "--parent",
        str(os.getpid()),
    ]
    assert subprocess.run(arguments).returncode == 1
    assert "hapticd watchdog:" in capfd.readouterr().err
