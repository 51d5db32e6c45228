"""Every check of the doctor in every branch, on machines made of a few files."""

import dataclasses
import gzip
import json
import os
import platform
import socket
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapticd.cli.app import main
from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.core.units import NS_PER_S, NS_PER_US, VirtualClock
from hapticd.run.doctor import late, machine, probes
from hapticd.run.doctor.checks import CHECKS, Check, CheckResult, examine, examined
from hapticd.run.doctor.machine import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    UNLIMITED,
    Build,
    Machine,
    Requirements,
    cores_in,
    requirements,
)
from hapticd.run.lockstep import virtual_wait
from hapticd.settings.load import load
from hapticd.settings.toml import shipped

Probe = Callable[[Machine, Requirements], str | probes.Flaw]
TABLE = {check.probe: check for check in CHECKS}
NO_LIMIT = (UNLIMITED, UNLIMITED)
BOARD_FILES = {
    "sys/bus/usb/devices/1-2/idVendor": "1209",
    "sys/bus/usb/devices/1-2/idProduct": "0001",
    "sys/bus/usb/devices/1-2/serial": "HB-7",
    "sys/bus/usb/devices/1-2/busnum": "1",
    "sys/bus/usb/devices/1-2/devnum": "12",
    "sys/bus/usb/devices/usb1/idVendor": "1d6b",
}
HUB_FILES = {  # the board behind two hubs, beside a device with a name of its own
    **{place.replace("/1-2/", "/1-2.4.1/"): one for place, one in BOARD_FILES.items()},
    "sys/bus/usb/devices/1-2/idVendor": "05e3",
    "sys/bus/usb/devices/1-2/idProduct": "0610",
    "sys/bus/usb/devices/1-2/bDeviceClass": "09",
    "sys/bus/usb/devices/1-2/speed": "480",
    "sys/bus/usb/devices/1-2:1.0/bInterfaceClass": "09",
    "sys/bus/usb/devices/1-3/idVendor": "04e8",
    "sys/bus/usb/devices/1-3/idProduct": "6860",
    "sys/bus/usb/devices/1-3/serial": "R58-PRIVATE",
    "sys/bus/usb/devices/1-3/product": "Ada's phone",
}


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., Machine]:
    """A machine with the given files; facts are those of an ordinary user with every right."""

    def build(files: dict[str, str] | None = None, **facts: Any) -> Machine:
        for place, content in (files or {}).items():
            path = tmp_path / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{content}\n")
        ordinary: dict[str, Any] = {
            "uid": 1000,
            "groups": frozenset({"hapticd"}),
            "limits": {"rtprio": (85, 85), "memlock": NO_LIMIT, "rttime": NO_LIMIT},
            "capabilities": 0,
            "cores": frozenset({0, 1, 2, 3}),
            "clock_resolution_s": 1e-9,
            "may_write": lambda path: True,
            "free_bytes": lambda path: 10**12,
            "build": PYENV,
        }
        return Machine(root=tmp_path, **(ordinary | facts))

    return build


def asked(**changes: Any) -> Requirements:
    base = Requirements(
        RealtimeParams(), UsbParams(serial="HB-7"), False, Path("/nowhere"), Path("/data"), None
    )
    return dataclasses.replace(base, **changes)


def judged(probe: Probe, machine: Machine, wanted: Requirements) -> CheckResult:
    """What the row of the table with `probe` says."""
    return examined(TABLE[probe], machine, wanted)


def realtime(**changes: Any) -> Requirements:
    return asked(realtime=RealtimeParams(**changes))


Row = tuple[Probe, dict[str, str], dict[str, Any], Requirements, str, str, str]
CONFIG = "boot/config-6.1"
RELEASE = {"proc/sys/kernel/osrelease": "6.1"}
FOUR_CORES = [f"sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor" for core in range(4)]
CLOCK = f"{probes.CLOCK}/available_clocksource"
NOW = f"{probes.CLOCK}/current_clocksource"
CPU = probes.CPU
IDLE = f"{probes.CPU}/cpuidle/current_driver"
FLAW = f"{CPU}/vulnerabilities/mds"
LATENCY = probes.DMA_LATENCY
RT_TIME = "sys/fs/cgroup/cpu/user.slice/cpu.rt_runtime_us"
IRQS = "proc/interrupts"
POWER = "sys/bus/usb/devices/1-2/power/control"
RULE = "etc/udev/rules.d/70-hapticd.rules"
IRQ_STAT = "77 (irq/128-xhci_hcd) S " + " ".join(["0"] * 36) + " 50 1 0"
HZ_100 = {**RELEASE, CONFIG: "CONFIG_HZ=100"}
IRQ_THREAD = {"proc/77/stat": IRQ_STAT}
GROUPED = {
    **RELEASE,
    CONFIG: "CONFIG_RT_GROUP_SCHED=y",
    "proc/self/cgroup": "9:name=systemd:/\n1:cpu,cpuacct:/user.slice\n0::/",
}

DENIED = {"may_write": lambda path: False}
ASKED = asked()


def throttled(runtime_us: int) -> dict[str, str]:
    return {f"{probes.SCHED}_runtime_us": str(runtime_us), f"{probes.SCHED}_period_us": "1000000"}


def limited(name: str, limit: tuple[int, int]) -> dict[str, Any]:
    return {"limits": {name: limit}}


def swapping(swappiness: int) -> dict[str, str]:
    return {"proc/swaps": "Filename\n/dev/sda2", "proc/sys/vm/swappiness": str(swappiness)}


PYENV = Build("3.11.7", "/home/ada/.pyenv", "'--enable-shared'", "-DNDEBUG -g -O3 -Wall", False)
QUICK = "'--enable-optimizations' '--with-lto'"


def built(**changes: Any) -> dict[str, Any]:
    return {"build": PYENV._replace(**changes)}


ROWS: list[Row] = [
    # --- rights
    (probes.group, {}, {"uid": 0, "groups": frozenset()}, ASKED, "ok", "root", ""),
    (probes.group, {}, {}, ASKED, "ok", "member of hapticd", ""),
    (
        probes.group,
        {"etc/group": "hapticd:x:999:"},
        {"groups": frozenset()},
        ASKED,
        "warn",
        "not a member",
        "usermod --append",
    ),
    (
        probes.group,
        {"etc/group": "users:x:100:"},
        {"groups": frozenset()},
        ASKED,
        "warn",
        "does not exist",
        "systemd-sysusers",
    ),
    (probes.rtprio, {}, {}, ASKED, "ok", "85, the servo asks for 79", ""),
    (
        probes.rtprio,
        {},
        {"capabilities": 1 << CAP_SYS_NICE, "limits": {"rtprio": (0, 0)}},
        ASKED,
        "ok",
        "CAP_SYS_NICE",
        "",
    ),
    (
        probes.rtprio,
        {},
        limited("rtprio", (0, 0)),
        ASKED,
        "fail",
        "0, the servo asks for 79",
        "LimitRTPRIO=85",
    ),
    (
        probes.rtprio,
        {},
        limited("rtprio", (85, 85)),
        realtime(priority=90),
        "fail",
        "85, the servo asks for 90",
        "rtprio 85",
    ),
    (probes.memlock, {}, {}, ASKED, "ok", "unlimited", ""),
    (probes.memlock, {}, limited("memlock", (1 << 23, 1 << 28)), ASKED, "ok", "256 MB", ""),
    (
        probes.memlock,
        {},
        limited("memlock", (1 << 23, 1 << 23)),
        ASKED,
        "warn",
        "8 MB",
        "LimitMEMLOCK=infinity",
    ),
    (
        probes.memlock,
        {},
        {"capabilities": 1 << CAP_IPC_LOCK, "limits": {"memlock": (0, 0)}},
        ASKED,
        "ok",
        "CAP_IPC_LOCK",
        "",
    ),
    (probes.rttime, {}, {}, ASKED, "ok", "unlimited", ""),
    (
        probes.rttime,
        {},
        limited("rttime", (200_000, 200_000)),
        ASKED,
        "warn",
        "200000 us",
        "LimitRTTIME=infinity",
    ),
    (probes.c_states, {LATENCY: ""}, {}, ASKED, "ok", "may be written", ""),
    (probes.c_states, {LATENCY: ""}, DENIED, ASKED, "warn", "is not writable", "udev rule"),
    (probes.c_states, {IDLE: "haltpoll"}, {}, ASKED, "ok", "haltpoll", ""),
    (probes.c_states, {}, {}, ASKED, "ok", "driver none", ""),
    (probes.c_states, {IDLE: "intel_idle"}, {}, ASKED, "warn", "intel_idle", "max_cstate=1"),
    # --- processor
    (probes.governor, {}, {}, ASKED, "ok", "not scaled", ""),
    (
        probes.governor,
        dict.fromkeys(FOUR_CORES, "performance"),
        {},
        ASKED,
        "ok",
        "performance on all 4 cores",
        "",
    ),
    (
        probes.governor,
        dict.fromkeys(FOUR_CORES, "powersave"),
        {},
        ASKED,
        "warn",
        "powersave on 4 of 4",
        "cpupower",
    ),
    (probes.smt, {}, {}, ASKED, "ok", "no two threads", ""),
    (probes.smt, {f"{CPU}/smt/active": "0"}, {}, ASKED, "ok", "no two threads", ""),
    (
        probes.smt,
        {f"{CPU}/smt/active": "1"},
        {},
        ASKED,
        "warn",
        "two threads share a core",
        "smt/control",
    ),
    (probes.cores, {}, {}, ASKED, "ok", "0,1,2,3 allowed, the servo takes 3", ""),
    (
        probes.cores,
        {},
        {},
        realtime(core=7),
        "fail",
        "realtime.core = 7, this process may use 0,1,2,3",
        "name one of 0,1,2,3",
    ),
    (probes.cores, {f"{CPU}/isolated": "7"}, {}, realtime(core=7), "ok", "takes 7", ""),
    (probes.cores, {}, {"cores": frozenset({2})}, ASKED, "warn", "only core 2", "second core"),
    (probes.isolation, {f"{CPU}/isolated": "2-3"}, {}, ASKED, "ok", "core 3 is isolated", ""),
    (probes.isolation, {}, {}, ASKED, "ok", "not needed at 1000 Hz", ""),
    (
        probes.isolation,
        {},
        {},
        realtime(rate_hz=4000.0),
        "warn",
        "not isolated at 4000 Hz",
        "isolcpus=managed_irq,domain,3",
    ),
    (probes.clock_source, {NOW: "tsc"}, {}, ASKED, "ok", "tsc", ""),
    (probes.clock_source, {NOW: "hpet", CLOCK: "tsc hpet"}, {}, ASKED, "warn", "hpet", "echo tsc"),
    (probes.clock_source, {NOW: "hpet"}, {}, ASKED, "warn", "hpet", "dmesg"),
    (probes.clock_source, {NOW: "jiffies"}, {}, ASKED, "fail", "jiffies", "dmesg"),
    (probes.mitigations, {"proc/cmdline": "quiet mitigations=off"}, {}, ASKED, "ok", "off", ""),
    (probes.mitigations, {FLAW: "Not affected"}, {}, ASKED, "ok", "none is active", ""),
    (
        probes.mitigations,
        {FLAW: "Mitigation: clear"},
        {},
        ASKED,
        "warn",
        "1 active (mds)",
        "mitigations=off",
    ),
    # --- kernel
    (probes.timers, {}, {}, ASKED, "ok", "high resolution", ""),
    (
        probes.timers,
        {**RELEASE, CONFIG: "CONFIG_HZ=250"},
        {},
        ASKED,
        "ok",
        "high resolution, HZ=250",
        "",
    ),
    (
        probes.timers,
        HZ_100,
        {"clock_resolution_s": 0.01},
        ASKED,
        "fail",
        "10 ms, HZ=100",
        "HIGH_RES",
    ),
    (
        probes.tickless,
        {f"{CPU}/nohz_full": "3"},
        {},
        ASKED,
        "ok",
        "core 3 has no scheduler tick",
        "",
    ),
    (probes.tickless, {}, {}, ASKED, "ok", "only while busy", ""),
    (probes.tickless, {"proc/cmdline": "nohz=off"}, {}, ASKED, "warn", "off", "remove nohz=off"),
    (
        probes.tickless,
        {**RELEASE, CONFIG: "CONFIG_HZ_PERIODIC=y"},
        {},
        ASKED,
        "warn",
        "off",
        "NO_HZ_IDLE",
    ),
    (probes.preemption, {"sys/kernel/realtime": "1"}, {}, ASKED, "ok", "PREEMPT_RT", ""),
    (
        probes.preemption,
        {"proc/version": "Linux 6.12 #1 SMP PREEMPT_RT"},
        {},
        ASKED,
        "ok",
        "PREEMPT_RT",
        "",
    ),
    (
        probes.preemption,
        {"sys/kernel/debug/sched/preempt": "none voluntary (full)"},
        {},
        ASKED,
        "ok",
        "full",
        "",
    ),
    (
        probes.preemption,
        {"proc/cmdline": "preempt=voluntary threadirqs"},
        {},
        ASKED,
        "ok",
        "voluntary, threadirqs",
        "",
    ),
    (
        probes.preemption,
        {**RELEASE, CONFIG: "CONFIG_PREEMPT_VOLUNTARY=y"},
        {},
        ASKED,
        "warn",
        "voluntary",
        "preempt=full",
    ),
    (probes.preemption, {}, {}, ASKED, "warn", "unknown", "linux-image-rt-amd64"),
    (probes.irq_priority, {}, {}, ASKED, "ok", "not threads", ""),
    (
        probes.irq_priority,
        IRQ_THREAD,
        {},
        ASKED,
        "warn",
        "xhci_hcd runs at 50, the servo at 79",
        "chrt --fifo --pid 85 77",
    ),
    (
        probes.irq_priority,
        {"proc/77/stat": IRQ_STAT.replace(" 50 1 0", " 90 1 0")},
        {},
        ASKED,
        "ok",
        "above the servo's 79",
        "",
    ),
    (
        probes.irq_sharing,
        {IRQS: " 16: 5 IO-APIC xhci_hcd:usb1"},
        {},
        ASKED,
        "ok",
        "no interrupt line",
        "",
    ),
    (
        probes.irq_sharing,
        {IRQS: " 16: 5 IO-APIC xhci_hcd:usb1, snd_hda"},
        {},
        ASKED,
        "warn",
        "line 16 is shared",
        "another",
    ),
    (probes.throttling, throttled(950000), {}, ASKED, "ok", "950000 of", ""),
    (probes.throttling, throttled(-1), {}, ASKED, "warn", "off", "sched_rt_runtime_us=950000"),
    (
        probes.throttling,
        throttled(400000),
        {},
        ASKED,
        "fail",
        "400000 of",
        "sched_rt_runtime_us=950000",
    ),
    (probes.throttling, {}, {}, ASKED, "ok", "does not throttle", ""),
    (probes.rt_group, {}, {}, ASKED, "ok", "no real-time time is given to groups", ""),
    (
        probes.rt_group,
        {**GROUPED, "proc/cmdline": "rt_group_sched=0"},
        {},
        ASKED,
        "ok",
        "no real-time time is given to groups",
        "",
    ),
    (
        probes.rt_group,
        {**GROUPED, "proc/self/cgroup": "1:cpu:/"},
        {},
        ASKED,
        "ok",
        "root group",
        "",
    ),
    (
        probes.rt_group,
        GROUPED,
        {},
        ASKED,
        "fail",
        "group /user.slice has no",
        "cpu/user.slice/cpu.rt_runtime_us",
    ),
    (probes.rt_group, {**GROUPED, RT_TIME: "950000"}, {}, ASKED, "ok", "has real-time time", ""),
    (probes.swap, {"proc/swaps": "Filename Type Size"}, {}, ASKED, "ok", "none", ""),
    (probes.swap, swapping(60), {}, ASKED, "warn", "swappiness 60", "swappiness=10"),
    (probes.swap, swapping(1), {}, ASKED, "ok", "swappiness 1", ""),
    (probes.load, {"proc/loadavg": "1.20 3.0 2.0 1/300 4"}, {}, ASKED, "ok", "1.2 programs", ""),
    (probes.load, {"proc/loadavg": "99.5 3.0 2.0 1/300 4"}, {}, ASKED, "warn", "99.5", "close"),
    # --- usb
    (probes.board, BOARD_FILES, {}, ASKED, "ok", "1209:0001 at 1-2", ""),
    (
        probes.board,
        BOARD_FILES,
        {},
        asked(usb=UsbParams(serial="HB-8")),
        "fail",
        "with serial HB-8",
        "lsusb -d 1209:0001",
    ),
    (probes.board, {}, {}, asked(usb=UsbParams()), "fail", "no 1209:0001 on the bus", "plug it in"),
    (probes.board, {}, {}, asked(simulated=True), "ok", "simulated", ""),
    (probes.hub, BOARD_FILES, {}, ASKED, "ok", "1-2 is a root port", ""),
    (probes.hub, HUB_FILES, {}, ASKED, "warn", "1-2.4.1 is behind 1-2, 1-2.4", "use a root port"),
    (probes.hub, {}, {}, ASKED, "ok", "no board", ""),
    (probes.hub, {}, {}, asked(simulated=True), "ok", "simulated", ""),
    (probes.permission, BOARD_FILES, {}, ASKED, "ok", "/dev/bus/usb/001/012 may be opened", ""),
    (
        probes.permission,
        BOARD_FILES,
        DENIED,
        ASKED,
        "fail",
        "/dev/bus/usb/001/012 may not be",
        "udevadm trigger",
    ),
    (probes.permission, {}, {}, ASKED, "ok", "no board", ""),
    (probes.permission, {}, {}, asked(simulated=True), "ok", "simulated", ""),
    (probes.autosuspend, BOARD_FILES | {POWER: "on"}, {}, ASKED, "ok", "off", ""),
    (
        probes.autosuspend,
        BOARD_FILES | {POWER: "auto"},
        {},
        ASKED,
        "warn",
        "on",
        "1-2/power/control",
    ),
    (probes.autosuspend, {}, {}, ASKED, "ok", "no board", ""),
    (probes.udev_rule, {RULE: '"1209" "0001"'}, {}, ASKED, "ok", "70-hapticd.rules", ""),
    (
        probes.udev_rule,
        {RULE: '"16c0" "04d2"'},
        {},
        ASKED,
        "warn",
        "names another board",
        "install-system",
    ),
    (probes.udev_rule, {}, {}, ASKED, "warn", "none for hapticd", "install-system --root /"),
    (probes.udev_rule, {}, {}, asked(simulated=True), "ok", "simulated", ""),
    # --- folders
    (probes.disk, {}, {}, ASKED, "ok", "1e+03 GB free in /data", ""),
    (
        probes.disk,
        {},
        {"free_bytes": lambda path: 10**9},
        ASKED,
        "warn",
        "1 GB free in /data",
        "record elsewhere",
    ),
    (
        probes.disk,
        {},
        {"free_bytes": lambda path: 10**8},
        ASKED,
        "fail",
        "0.1 GB free",
        "record elsewhere",
    ),
    (probes.runtime_folder, {}, {}, ASKED, "ok", "no daemon has run yet", ""),
    (probes.transport, {}, {}, ASKED, "ok", "no daemon has measured it yet", ""),
    (probes.keys, {}, {}, ASKED, "ok", "none needed", ""),
    # --- interpreter
    (probes.interpreter, {}, {}, ASKED, "warn", "3.11.7 without profile-guided", "--with-lto"),
    (
        probes.interpreter,
        {},
        built(options=QUICK),
        ASKED,
        "ok",
        "Python 3.11.7, profile-guided and link-time optimisation, -O3",
        "",
    ),
    (
        probes.interpreter,
        {},
        built(prefix="/usr", flags="-O3 -g -O2"),
        ASKED,
        "ok",
        "of the distribution, -O2",
        "",
    ),
    (
        probes.interpreter,
        {},
        built(options=QUICK, flags="-O3 -O0"),
        ASKED,
        "warn",
        "for debugging (-O0)",
        "uv python install",
    ),
    (
        probes.interpreter,
        {},
        built(options=QUICK, debug=True),
        ASKED,
        "warn",
        "for debugging",
        "uv python install",
    ),
    (
        probes.interpreter,
        {},
        built(flags=""),
        ASKED,
        "warn",
        "an unknown -O level",
        "uv python install",
    ),
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0].__name__}-{row[4]}-{row[5][:24]}")
def test_check_finds_judges_and_fixes(row: Row, make: Callable[..., Machine]) -> None:
    probe, files, facts, wanted, level, found, fix = row
    finding = judged(probe, make(files, **facts), wanted)
    assert (finding.level, found in finding.found) == (level, True), finding
    assert (fix in finding.fix) if fix else finding.fix == "", finding
    assert bool(finding.why) == (level != "ok")


def test_every_check_is_tested_in_every_level() -> None:
    tested = {row[0] for row in ROWS}
    assert tested == set(TABLE)


def test_names_are_unique(make: Callable[..., Machine]) -> None:
    names = [finding.name for finding in examine(make(), asked())]
    assert len(set(names)) == len(names) == len(CHECKS)


# --- folders --------------------------------------------------------------------------------------


def test_runtime_folder_open_to_others_fails(make: Callable[..., Machine], tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir(mode=0o750)
    folder.chmod(0o750)
    wanted = asked(runtime=folder)
    assert judged(probes.runtime_folder, make(), wanted).level == "ok"
    folder.chmod(0o777)
    finding = judged(probes.runtime_folder, make(), wanted)
    assert (finding.level, finding.found) == ("fail", f"{folder} has mode 0777")
    assert finding.fix.startswith(f"chmod 0750 {folder}")


def test_runtime_folder_that_clients_do_not_believe_fails(
    make: Callable[..., Machine], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there").mkdir(mode=0o750)
    (tmp_path / "link").symlink_to(tmp_path / "there")
    finding = judged(probes.runtime_folder, make(), asked(runtime=tmp_path / "link"))
    assert (finding.level, finding.found) == ("fail", f"{tmp_path / 'link'} is a link")
    owner = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    finding = judged(probes.runtime_folder, make(), asked(runtime=tmp_path / "there"))
    assert finding.found == f"{tmp_path / 'there'} belongs to user {owner}, not to {owner + 1}"


def test_socket_open_to_others_fails(make: Callable[..., Machine], tmp_path: Path) -> None:
    folder = tmp_path / "r"
    folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as command:
        command.bind(str(folder / "command"))
        (folder / "command").chmod(0o666)
        finding = judged(probes.runtime_folder, make(), asked(runtime=folder))
    assert (finding.level, finding.found) == ("fail", "open to others: command 0666")
    assert finding.fix == f"chmod o= {folder / 'command'}"


@pytest.mark.parametrize(("rate_hz", "level"), [(1000.0, "ok"), (820.0, "fail")])
def test_bus_is_judged_as_the_daemon_measured_it(
    make: Callable[..., Machine], tmp_path: Path, rate_hz: float, level: str
) -> None:
    found = {"pair_us": 400.0, "sample_phase": 0.3125, "delay_us": 687.5, "rate_hz": rate_hz}
    (tmp_path / "servo.report").write_text(json.dumps({"transport": found}))
    finding = judged(probes.transport, make(), asked(runtime=tmp_path))
    assert finding.level == level
    assert "takes 400 us; IN is latched 0.3125 periods" in finding.found
    assert finding.fix == ("" if level == "ok" else "set realtime.rate_hz to at most 820")


def test_key_readable_by_others_fails(make: Callable[..., Machine], tmp_path: Path) -> None:
    secret = tmp_path / "server.key_secret"
    secret.touch(mode=0o600)
    assert judged(probes.keys, make(), asked(keys=tmp_path)).level == "ok"
    secret.chmod(0o644)
    finding = judged(probes.keys, make(), asked(keys=tmp_path))
    assert (finding.level, finding.fix.startswith(f"chmod 600 {secret}")) == ("fail", True)


# --- the machine ----------------------------------------------------------------------------------


def test_kernel_options_come_from_the_running_kernel(
    make: Callable[..., Machine], tmp_path: Path
) -> None:
    found = make(RELEASE | {CONFIG: "CONFIG_HZ=100\n# CONFIG_PREEMPT is not set"})
    assert (found.kernel_option("HZ"), found.kernel_option("PREEMPT")) == ("100", "n")
    (tmp_path / "proc/config.gz").write_bytes(gzip.compress(b"CONFIG_HZ=1000\n"))
    assert found.kernel_option("HZ") == "1000"


def test_kernel_without_a_config_tells_nothing(make: Callable[..., Machine]) -> None:
    assert make().kernel_option("HZ") == ""


def test_boot_options_are_read_by_name(make: Callable[..., Machine]) -> None:
    found = make({"proc/cmdline": "quiet preempt=none threadirqs preempt=full"})
    assert [found.boot_option(name) for name in ("preempt", "threadirqs", "nohz")] == [
        "full",
        "",
        None,
    ]


def test_unreadable_numbers_are_none(make: Callable[..., Machine]) -> None:
    found = make({"a": "", "b": "x"})
    assert [found.number(name) for name in ("a", "b", "c")] == [None, None, None]


@pytest.mark.parametrize(("text", "cores"), [("", set()), ("3", {3}), ("0-2,5", {0, 1, 2, 5})])
def test_core_lists_are_those_of_the_kernel(text: str, cores: set[int]) -> None:
    assert cores_in(text) == cores


def test_this_machine_can_be_examined() -> None:
    wanted = requirements(load(shipped("config") / "hapticd.toml"))
    assert wanted.simulated
    found = examine(machine.this_machine(), wanted)
    assert len(found) == len(CHECKS)
    assert f"Python {platform.python_version()}" in found[-1].found


# --- the wake-up measurement ----------------------------------------------------------------------


def test_latencies_are_from_deadline_to_waking() -> None:
    clock = VirtualClock(NS_PER_S)
    late_us = iter([3, 3, 7, 2500, 3])

    def wait(deadline_ns: int, rehearse: Callable[[], object]) -> int:
        return virtual_wait(clock)(deadline_ns + next(late_us) * NS_PER_US, rehearse)

    assert late.latencies_us(wait, clock.now_ns(), 5) == Counter({3: 3, 7: 1, 2500: 1})


def test_late_wake_drops_periods_instead_of_catching_up() -> None:
    clock = VirtualClock(NS_PER_S)
    deadlines = []

    def wait(deadline_ns: int, rehearse: Callable[[], object]) -> int:
        deadlines.append(deadline_ns)
        return virtual_wait(clock)(
            deadline_ns + (2500 * NS_PER_US if len(deadlines) == 1 else 0), rehearse
        )

    late.latencies_us(wait, clock.now_ns(), 3)
    assert [deadline - deadlines[0] for deadline in deadlines] == [0, 3_000_000, 4_000_000]


def test_quantiles_of_a_histogram() -> None:
    assert late.quantiles({10: 500, 20: 480, 90: 19, 4000: 1}) == {
        "p50_us": 10,
        "p99_us": 90,
        "p999_us": 90,
        "max_us": 4000,
    }


@pytest.mark.parametrize(
    ("p99_us", "fifo", "level", "text"),
    [
        (
            30,
            "granted",
            "ok",
            "p50 30 us, p99 30 us, p99.9 30 us, max 30 us over 100 wakes, SCHED_FIFO 80",
        ),
        (30, "refused: EPERM", "warn", "without SCHED_FIFO"),
        (150, "granted", "warn", "p99 150 us"),
        (600, "granted", "fail", "p99 600 us"),
    ],
)
def test_histogram_is_judged_by_spin_and_period(
    p99_us: int, fifo: str, level: str, text: str
) -> None:
    histogram = {p99_us: 100}
    rights = {"fifo": {"granted": fifo == "granted", "text": fifo}}
    found = {"rights": rights, "histogram_us": histogram, **late.quantiles(histogram)}
    finding = late.judge_wake(found, asked())
    assert (finding.level, text in finding.found) == (level, True)


# --- the verb -------------------------------------------------------------------------------------


def told(result: CheckResult) -> str | probes.Flaw:
    """What a probe returns whose row says `result`."""
    return result.found if result.level == "ok" else probes.Flaw(result.found)


def find_only(monkeypatch: pytest.MonkeyPatch, *found: CheckResult) -> None:
    """`hapticd doctor` finds this."""
    checks = [
        Check(one.name, lambda m, a, one=one: told(one), one.level, one.why, one.fix)  # type: ignore[misc]
        for one in found
    ]
    monkeypatch.setattr("hapticd.run.doctor.checks.CHECKS", checks)


@pytest.fixture
def findings(monkeypatch: pytest.MonkeyPatch) -> list[CheckResult]:
    found = [
        CheckResult("one", "ok", "good"),
        CheckResult("two", "warn", "so so", "because", "do this"),
    ]
    find_only(monkeypatch, *found)
    return found


def test_doctor_prints_why_and_fix(
    runtime: Path, findings: list[CheckResult], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", "--seconds", "0", "--strict"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ok    one               good",
        "warn  two               so so",
        "      why: because",
        "      fix: do this",
    ]


def test_doctor_is_strict_only_when_asked(
    runtime: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    find_only(monkeypatch, CheckResult("three", "fail", "bad", "because", "do that"))
    assert main(["doctor", "--seconds", "0"]) == 0
    assert main(["doctor", "--seconds", "0", "--strict", "--json"]) == 6
    out, err = capsys.readouterr()
    told = json.loads(out.splitlines()[-1])
    assert told == {
        "ok": False,
        "checks": [
            {"name": "three", "level": "fail", "found": "bad", "why": "because", "fix": "do that"}
        ],
        "wake": {},
        "timing": None,
    }
    assert "1 of 1 fail: three" in err


def test_doctor_adds_the_measurement(
    runtime: Path, findings: list[CheckResult], monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    rights = {"fifo": {"granted": True, "text": "granted"}}
    measured = {"rights": rights, "histogram_us": {9: 10}, **late.quantiles({9: 10})}
    monkeypatch.setattr(late, "measure", lambda seconds, core: measured)
    assert main(["doctor", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["checks"][-1]["name"] == "wake-up"
    assert told["wake"]["histogram_us"] == {"9": 10}


def test_doctor_survives_a_failed_measurement(
    runtime: Path, findings: list[CheckResult], monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def measure(seconds: float, core: int | None) -> dict[str, Any]:
        raise OSError("no more processes")

    monkeypatch.setattr(late, "measure", measure)
    assert main(["doctor", "--strict"]) == 6
    assert "could not be measured: no more processes" in capsys.readouterr().out
