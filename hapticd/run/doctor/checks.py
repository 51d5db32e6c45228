"""The checks of the doctor, and its report as one file.

Checks (`CHECKS`). Their table has the reasons, in the order in which they are shown.

    probe (probes)  -> a sentence if all is well, otherwise a Flaw
    the row of CHECKS -> name, level, reason and remedy, unless the flaw has its own
    `examine`       -> a CheckResult for each row

Nothing is measured or changed. A simulated board needs none of the USB checks.

A fix must be a command that can be pasted into a shell.

Report (`report_of`). It is a file to attach to a question, with the environment of hapticd, the
doctor's results and the status. Only the items listed here are included. From the daemon's status
these are numbers, states and the texts of its faults; names of clients, leases, addresses and the
texts of events are excluded. USB devices appear with ids and places, the board with the results of
the checks. No key is read. The home folder is written as ~ everywhere.

No field of KEPT may hold a name given by a person.
"""

import json
import os
import platform
import re
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import hapticd
from hapticd.core.errors import ConfigError
from hapticd.core.extras import requirements
from hapticd.run.doctor import probes
from hapticd.run.doctor.machine import Machine, Requirements
from hapticd.run.doctor.probes import FAIL, INSTALL, JOIN, OK, WARN, Flaw, board_path, hubs_above

__all__ = ["CheckResult", "examine", "report_of", "write_report"]


class CheckResult(NamedTuple):
    """Result of a check, as one line of the report."""

    name: str  # of the check
    level: str  # OK, WARN or FAIL
    found: str  # observation
    why: str = ""  # why it matters, unless it is ok
    fix: str = ""  # the exact remedy, unless it is ok


class Check(NamedTuple):
    """A row of the table."""

    name: str
    probe: Callable[[Machine, Requirements], str | Flaw]
    level: str  # of a flaw without its own
    why: str  # reason, if the flaw has none
    fix: str = ""  # remedy, if the flaw has none


IN_LIMITS = f"{INSTALL} (limits.d"
SLEEP = "a core in deep sleep takes 100 us and more to wake"
NO_RIGHTS = (
    "gateway, guard and page have no real-time rights: they wait, and after a second without the"
    " gateway the servo takes the force away (fault gateway_lost)"
)
BEHIND_HUB = (
    "a high-speed hub delays each transfer of a full-speed board by one or two microframes of"
    " 125 us each way, and shares its bus with other devices"
)
UDEV = "sudo udevadm control --reload && sudo udevadm trigger"
RIGHTS = (  # rights of this user to scheduling and memory
    Check(
        "group",
        probes.group,
        WARN,
        f"limits, board and sockets are given to members of group {probes.GROUP}",
        JOIN,
    ),
    Check(
        "rtprio limit",
        probes.rtprio,
        FAIL,
        "without SCHED_FIFO a busy machine wakes the servo milliseconds late",
        f"{IN_LIMITS}/95-hapticd.conf: @hapticd - rtprio 85); {JOIN}; in a unit: LimitRTPRIO=85",
    ),
    Check(
        "memlock limit",
        probes.memlock,
        WARN,
        "memory that is not locked may be missing when a tick needs it",
        f"{IN_LIMITS}: @hapticd - memlock unlimited); {JOIN}; in a unit: LimitMEMLOCK=infinity",
    ),
    Check(
        "rttime limit",
        probes.rttime,
        WARN,
        "the kernel ends a FIFO process that stays awake for longer, as a simulated board may",
        "ulimit -R unlimited (RealtimeKit lowers it); in a unit: LimitRTTIME=infinity",
    ),
    Check(
        "C-state latency",
        probes.c_states,
        WARN,
        SLEEP,
        f"{INSTALL} (udev rule), sudo udevadm trigger; {JOIN}",
    ),
)
PROCESSOR = (  # cores, clocks, and causes of slow cores
    Check(
        "governor",
        probes.governor,
        WARN,
        "a core that slows down between ticks is slow when the tick comes",
        "sudo cpupower frequency-set --governor performance",
    ),
    Check(
        "SMT",
        probes.smt,
        WARN,
        "a sibling thread takes half of the servo's core whenever it likes",
        f"echo off | sudo tee /{probes.CPU}/smt/control; for good: nosmt on the kernel command"
        " line",
    ),
    Check(
        "cores",
        probes.cores,
        WARN,
        "servo and gateway share it: the gateway's heartbeat depends on the servo's sleep",
        "allow a second core: taskset, AllowedCPUs=, or a machine with two",
    ),
    Check("isolation", probes.isolation, WARN, "other work takes its caches and its time"),
    Check(
        "clock source",
        probes.clock_source,
        WARN,
        "reading it costs a microsecond and more, and the loop reads it five times a tick",
        "see `dmesg | grep -i clocksource` for why the kernel distrusts the processor's counter",
    ),
    Check(
        "mitigations",
        probes.mitigations,
        WARN,
        "each system call, two transfers a tick, pays for them; 1 kHz can live with it",
        "leave them; on a machine that runs nothing foreign: mitigations=off on the kernel command"
        " line",
    ),
)
KERNEL = (  # timekeeping, scheduling, interrupts and swap
    Check(
        "timers",
        probes.timers,
        FAIL,
        "a sleep ends on a scheduler tick, milliseconds late",
        "boot a kernel with CONFIG_HIGH_RES_TIMERS=y, and without highres=off",
    ),
    Check(
        "tickless",
        probes.tickless,
        WARN,
        "the scheduler interrupts the servo's core even if it is idle",
        "remove nohz=off from the kernel command line, or boot one with CONFIG_NO_HZ_IDLE=y",
    ),
    Check(
        "preemption",
        probes.preemption,
        WARN,
        "the kernel may keep the core for milliseconds while others make system calls",
        "preempt=full threadirqs on the kernel command line; or a PREEMPT_RT kernel (Debian: apt"
        " install linux-image-rt-amd64)",
    ),
    Check(
        "IRQ priority",
        probes.irq_priority,
        WARN,
        "a frame that has arrived waits until the servo sleeps",
    ),
    Check(
        "IRQ sharing",
        probes.irq_sharing,
        WARN,
        "other drivers run before each USB transfer is seen",
        "plug the board into a port of another controller; see /proc/interrupts",
    ),
    Check(
        "throttling",
        probes.throttling,
        FAIL,
        "the servo would be held back for the rest of each period",
    ),
    Check(
        "RT groups",
        probes.rt_group,
        FAIL,
        "SCHED_FIFO is refused in it, whatever the limits are",
    ),
    Check(
        "swap",
        probes.swap,
        WARN,
        "gateway and recorder do not lock their memory and may stall when it is fetched back",
        f"sudo sysctl vm.swappiness={probes.SWAPPINESS_MAX}",
    ),
    Check("load", probes.load, WARN, NO_RIGHTS, "close other programs while the device is enabled"),
)
USB = (  # presence, permission and power of the board
    Check("USB board", probes.board, FAIL, "the servo waits for it and renders no force"),
    Check("USB hub", probes.hub, WARN, BEHIND_HUB, "use a root port"),
    Check(
        "USB permission",
        probes.permission,
        FAIL,
        "the servo cannot talk to the board",
        f"{INSTALL} (udev rule), {UDEV}; {JOIN}",
    ),
    Check(
        "USB autosuspend",
        probes.autosuspend,
        WARN,
        "the board falls asleep while no one talks to it, and takes milliseconds to come back",
    ),
    Check(
        "udev rule",
        probes.udev_rule,
        WARN,
        "the board belongs to root when it is plugged in",
        f"{INSTALL}, {UDEV}",
    ),
)
FOLDERS = (  # the daemon's report and folders: disk, and access by other users
    Check(
        "bus",
        probes.transport,
        FAIL,
        "both transfers have to fit into a period; what does not fit is a lost slot",
    ),
    Check("disk", probes.disk, WARN, "a recording ends when the disk is full"),
    Check(
        "runtime folder",
        probes.runtime_folder,
        FAIL,
        "any process that reaches its sockets commands a motor",
    ),
    Check("keys", probes.keys, FAIL, "anyone with the key can pose as its owner"),
)
INTERPRETER = Check(  # how it was built
    "interpreter",
    probes.interpreter,
    WARN,
    "a tick takes a tenth to a fifth longer, measured against Debian's build of 3.11",
    "run hapticd with the distribution's python3 or with one of `uv python install`; or build with"
    " --enable-optimizations --with-lto",
)
CHECKS = (*RIGHTS, *PROCESSOR, *KERNEL, *USB, *FOLDERS, INTERPRETER)


def examine(machine: Machine, asked: Requirements) -> list[CheckResult]:
    """Return one result per check, without measuring or changing anything."""
    return [examined(check, machine, asked) for check in CHECKS]


def examined(check: Check, machine: Machine, asked: Requirements) -> CheckResult:
    """Return the result of one check."""
    found = check.probe(machine, asked)
    if isinstance(found, str):
        return CheckResult(check.name, OK, found)
    level, why, fix = found.level or check.level, found.why or check.why, found.fix or check.fix
    return CheckResult(check.name, level, found.found, why, fix)


# --- the report -----------------------------------------------------------------------------------
FORMAT = "hapticd-doctor/1"
BUILD_FLAGS = ("Py_DEBUG", "Py_GIL_DISABLED", "WITH_PYMALLOC", "OPT")
KEPT: Mapping[str, tuple[str, ...]] = {  # of the status, by part; "" is the status itself
    "": (
        *("state", "simulated", "rate_hz", "revision", "fault", "cause", "waiting_for"),
        *("tick", "slot", "homed", "gain", "stiffness_n_per_m", "virtual_damping_ns_per_m"),
        *(
            "mass_kg",
            "active_damping_ns_per_m",
            "delay_us",
            "delay_spread_us",
            "frame_age_us",
            "winding_c",
        ),
        *(
            "limit_cycle_faults",
            "compensation",
            "delivered_active_damping",
            "counters",
            "stages",
            "late",
            "room",
        ),
    ),
    "servo": ("realtime", "transport", "differences", "uncompensated", "unsampled"),
    "gateway": ("cpu_s", "telemetry_lost"),
    "guard": (
        *("policy", "basis", "margin_ns_per_m", "mode", "measuring", "worker", "trouble"),
        *("delays", "timing"),
    ),
}


def report_of(
    machine: Machine,
    asked: Requirements,
    findings: Iterable[CheckResult],
    wake: Mapping[str, Any],
    status: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return the content of the file; `status` is that of the daemon, None without an answer."""
    kept = _kept(status or {})
    found = {
        "format": FORMAT,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": _versions(),
        "interpreter": _interpreter(),
        "machine": _machine(machine),
        "usb": usb_devices(machine, asked),
        "timing": {
            "rate_hz": asked.realtime.rate_hz,
            "transport": kept.get("servo", {}).get("transport"),
            "delays": kept.get("guard", {}).get("delays"),
            "cost": kept.get("guard", {}).get("timing"),
            "wake": dict(wake),
        },
        "checks": [finding._asdict() for finding in findings],
        "status": kept or None,
    }
    return dict(_without_home(found, _homes()))


def write_report(path: Path, found: Mapping[str, Any]) -> None:
    """Write `found` as JSON to a new file. ConfigError if it exists or cannot be written."""
    try:
        with path.open("x") as file:
            file.write(json.dumps(found, indent=2) + "\n")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; name another file with --report") from error


def _versions() -> dict[str, str]:
    """Return the versions of hapticd and of each installed library in its metadata."""
    found = {"hapticd": hapticd.__version__}
    for line in requirements():
        name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _interpreter() -> dict[str, Any]:
    return {
        "version": platform.python_version(),
        "implementation": platform.python_implementation(),
        "compiler": platform.python_compiler(),
        "options": re.findall(r"--(?:enable|with|disable|without)-[^\s'\"]+", _flag("CONFIG_ARGS")),
        "flags": {name: _flag(name) for name in BUILD_FLAGS},
    }


def _flag(name: str) -> str:
    value = sysconfig.get_config_var(name)
    return "" if value is None else str(value)


def _machine(machine: Machine) -> dict[str, Any]:
    lines = machine.lines("proc/cpuinfo")
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    system = re.search(r'^PRETTY_NAME="?([^"\n]*)', machine.text("etc/os-release") or "", re.M)
    return {
        "architecture": platform.machine(),
        "processor": models[0] if models else "",
        "cores": sorted(machine.cores),
        "system": system[1] if system else "",
        "kernel": machine.text("proc/sys/kernel/osrelease"),
        "kernel_build": machine.text("proc/sys/kernel/version"),
        "virtual": any(line.startswith("flags") and "hypervisor" in line for line in lines),
    }


def usb_devices(machine: Machine, asked: Requirements) -> list[dict[str, Any]]:
    """Return all USB devices with the hubs above each; no serial number and no product name."""
    board = board_path(machine, asked)
    found = []
    for path in machine.find("sys/bus/usb/devices/*"):
        names = ("idVendor", "idProduct", "bDeviceClass", "speed")
        vendor, product, kind, speed = (machine.text(str(path / name)) for name in names)
        if vendor is not None:  # otherwise it is an interface
            found.append(
                {
                    "name": path.name,
                    "id": f"{vendor}:{product}",
                    "class": kind,
                    "speed_mbit": speed,
                    "hubs_above": hubs_above(path.name),
                    "board": path == board,
                }
            )
    return found


def _kept(status: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: status[name] for name in KEPT[""] if name in status}
    for part, names in KEPT.items():
        if part and isinstance(status.get(part), Mapping):
            kept[part] = {name: status[part][name] for name in names if name in status[part]}
    return kept


def _homes() -> re.Pattern[str]:
    own = Path.home()
    named = {str(one) for one in (own, Path(os.path.realpath(own))) if len(one.parts) > 1}
    folders = [*map(re.escape, sorted(named, key=len, reverse=True)), r"/home/[^/\s'\",;:)]+"]
    return re.compile(rf"(?:{'|'.join(folders)})(?![^/\s'\",;:)])")


def _without_home(value: Any, homes: re.Pattern[str]) -> Any:
    if isinstance(value, str):
        return homes.sub("~", value)
    if isinstance(value, Mapping):
        return {_without_home(key, homes): _without_home(one, homes) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_home(one, homes) for one in value]
    return value
