"""Disk, and who may read and write what is in the daemon's folders."""

import stat
from collections.abc import Iterator
from pathlib import Path

from hapticd.doctor.asked import Asked
from hapticd.doctor.finding import Finding, fail, ok, warn
from hapticd.doctor.machine import Machine
from hapticd.mailbox import files, layout

HOUR_S = 3600.0
ENOUGH_H, TOO_LITTLE_H = 8.0, 0.25
SECRETS = "*.key_secret"


def disk(machine: Machine, asked: Asked) -> Finding:
    """Room for recordings at every tick."""
    name, free = "disk", machine.free_bytes(asked.recordings)
    hours = free / (layout.RECORD.size * asked.realtime.rate_hz * HOUR_S)
    found = f"{free / 1e9:.3g} GB free in {asked.recordings}: {hours:.3g} h of recording at {asked.realtime.rate_hz:g} Hz"
    if hours >= ENOUGH_H:
        return ok(name, found)
    fix = f"free some space there, or record elsewhere; a working day takes {ENOUGH_H / max(hours, 1e-9) * free / 1e9:.3g} GB"
    return (fail if hours < TOO_LITTLE_H else warn)(name, found, "a recording ends when the disk is full", fix)


def runtime_folder(machine: Machine, asked: Asked) -> Finding:
    """Nobody but its owner and group reaches the daemon."""
    name, why = "runtime folder", "whoever reaches its sockets commands a motor"
    if not asked.runtime.is_dir():
        return ok(name, f"{asked.runtime}: no daemon has run yet")
    mode = stat.S_IMODE(asked.runtime.stat().st_mode)
    if mode & 0o027:
        return fail(name, f"{asked.runtime} has mode {mode:04o}", why, f"chmod 0750 {asked.runtime}, or 0700 if you are alone")
    open_files = list(_open_to_others(asked.runtime))
    if open_files:
        shown = ", ".join(f"{path.name} {mode:04o}" for path, mode in open_files)
        return fail(name, f"open to others: {shown}", why, f"chmod o= {' '.join(str(path) for path, _ in open_files)}")
    return ok(name, f"{asked.runtime}, mode {mode:04o}")


def _open_to_others(folder: Path) -> Iterator[tuple[Path, int]]:
    for name in (files.COMMAND_SOCKET, files.TELEMETRY_SOCKET, files.STOP, files.MAILBOX, files.TELEMETRY):
        try:
            mode = stat.S_IMODE((folder / name).stat().st_mode)
        except OSError:
            continue
        if mode & 0o007:
            yield folder / name, mode


def keys(machine: Machine, asked: Asked) -> Finding:
    """Secret keys are for their owner alone."""
    name = "keys"
    if asked.keys is None:
        return ok(name, "telemetry does not leave this machine: none needed")
    readable = [path for path in sorted(asked.keys.rglob(SECRETS)) if path.stat().st_mode & 0o077]
    if not readable:
        return ok(name, f"{asked.keys}: secret keys are for their owner alone")
    fix = f"chmod 600 {' '.join(map(str, readable))}, and make new ones if someone may have read them"
    return fail(name, f"{len(readable)} secret key readable by others", "whoever has the key can pose as its owner", fix)


CHECKS = (disk, runtime_folder, keys)
