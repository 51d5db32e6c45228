"""One file to attach to a question: the environment of hapticd, the doctor's results, and the
status.

Only the items listed here are included. From the daemon's status these are numbers, states and the
texts of its faults; names of clients, leases, addresses and the texts of events are excluded. USB
devices appear with ids and places, the board with the results of the checks. No key is read. The
home folder is written as ~ everywhere.

No field of KEPT may hold a name given by a person.
"""

import json
import os
import platform
import re
import sysconfig
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import hapticd
from hapticd.core.errors import ConfigError
from hapticd.core.extras import requirements
from hapticd.run.doctor.checks import CheckResult
from hapticd.run.doctor.machine import Machine, Requirements
from hapticd.run.doctor.probes import board_path, hubs_above

__all__ = ["report_of", "write_report"]

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
