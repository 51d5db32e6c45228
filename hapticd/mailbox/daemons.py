"""The folders in which a daemon may run: which of them are trusted, and which daemons are alive.

A daemon derives its folder from its own environment at its start. The environment of another
process (a session, an ssh login, cron, systemd) may differ, so every place is searched.

A folder is trusted if it is a directory and not a link, belongs to this user, and no other user may
write it. The service's folder belongs to another user; it is trusted because only root can create
its path. Any user can create names in shared memory and in the temporary folder, as a trap for
another. Such a folder is refused with its name, and no file in it is opened.

A daemon is alive if it holds the stop word or listens at the gateway's socket. Files alone prove
nothing: a killed daemon leaves them all behind.

It must have no large import at the top and must not wait: `hapticd stop` starts with this module.
"""

import os
import stat
from pathlib import Path
from typing import Any, NamedTuple

from hapticd.core.errors import DaemonDown, MailboxError
from hapticd.mailbox import files
from hapticd.mailbox.files import DEFAULT_INSTANCE, INSTANCE_PREFIX
from hapticd.mailbox.stop_word import servo_lives

__all__ = [
    "RuntimeFolder",
    "console_place",
    "daemon_folder",
    "down",
    "instance_of",
    "living_report",
    "read_json",
    "read_report",
    "require_trusted",
    "runtime_folders",
    "untrusted_daemon_folder",
]


class RuntimeFolder(NamedTuple):
    """A folder in which a daemon may run, and the name of that daemon."""

    folder: Path
    instance: str


def daemon_folder(instance: str = DEFAULT_INSTANCE) -> Path:
    """Return the folder of the daemon `instance`: this user's own, or otherwise the system
    service's.

    Only the default instance is a service. MailboxError: the folder exists and is not trusted.
    """
    folder = untrusted_daemon_folder(instance)
    require_trusted(folder)
    return folder


def untrusted_daemon_folder(instance: str = DEFAULT_INSTANCE) -> Path:
    """Return the folder as `daemon_folder`, without requiring that it is trusted."""
    own = files.runtime_folder(instance)
    if instance != DEFAULT_INSTANCE or not os.path.lexists(files.SERVICE_FOLDER):
        return own
    try:
        require_trusted(own)
    except MailboxError:
        return own
    return own if is_running(own) else files.SERVICE_FOLDER


def runtime_folders(instance: str | None) -> list[RuntimeFolder]:
    """Return the possible folders of daemons of this user and the service; `instance` None: all.

    They are not yet checked, and most of them do not exist.
    """
    found: list[RuntimeFolder] = []
    for base in _bases():
        if instance in (None, DEFAULT_INSTANCE):
            found.append(RuntimeFolder(base, DEFAULT_INSTANCE))
        names = _instances(base) if instance is None else [instance]
        found += [
            RuntimeFolder(base / f"{INSTANCE_PREFIX}{name}", name)
            for name in names
            if name != DEFAULT_INSTANCE
        ]
    return found


def _bases() -> list[Path]:
    uid = os.getuid()
    own = files.runtime_folder()
    session = files.SESSION_FOLDERS / str(uid) / "hapticd"
    shared = [files.MEMORY_FOLDER / f"hapticd-{uid}", files.temporary_folder() / f"hapticd-{uid}"]
    return list(dict.fromkeys([own, session, *shared, files.SERVICE_FOLDER]))


def _instances(base: Path) -> list[str]:
    try:
        require_trusted(base)
        entries = sorted(os.listdir(base)) if os.path.isdir(base) else []
    except (OSError, MailboxError):
        return []
    return [
        name.removeprefix(INSTANCE_PREFIX) for name in entries if name.startswith(INSTANCE_PREFIX)
    ]


def require_trusted(folder: Path) -> None:
    """Return if `folder` does not exist or is trusted; otherwise raise MailboxError with
    its name.
    """
    steps = (folder.parent, folder) if folder.name.startswith(INSTANCE_PREFIX) else (folder,)
    for step in steps:
        if not os.path.lexists(step):
            return
        if step == files.SERVICE_FOLDER:
            _believe_service(step)
        else:
            files.check_own(step)


def _believe_service(folder: Path) -> None:
    above = folder.parent.stat()
    if above.st_uid not in (0, os.getuid()) or above.st_mode & 0o022:
        raise MailboxError(
            f"{folder}: {folder.parent} belongs to user {above.st_uid}, mode"
            f" {stat.S_IMODE(above.st_mode):o}: others may have put it there",
            "remove it",
        )
    files.check_closed(folder)
    if not os.access(folder, os.R_OK | os.X_OK, effective_ids=True):
        raise MailboxError(
            f"{folder}: you may not enter the service's folder",
            "have yourself added to its group (`usermod --append --groups hapticd NAME`) and log in"
            " again",
        )


def is_running(folder: Path) -> bool:
    """Return whether a servo or a gateway is alive in `folder`."""
    return servo_lives(folder) or gateway_lives(folder)


def running() -> tuple[str, ...]:
    """Return the instances that are alive at the places where a client searches."""
    return tuple(
        name for name in (DEFAULT_INSTANCE, *_instances(files.runtime_folder())) if _reached(name)
    )


def _reached(instance: str) -> bool:
    try:
        return is_running(daemon_folder(instance))
    except MailboxError:
        return False


def down(where: str, instance: str | None, more: str = "") -> DaemonDown:
    """Return the error for `instance` (None: any) without a daemon at `where`."""
    known = instance in (None, DEFAULT_INSTANCE)
    command = "hapticd run" if known else f"hapticd run --instance {instance}"
    others = running()
    listed = f"; running: {', '.join(others)}" if others else ""
    return DaemonDown(
        f"{where}no daemon runs there; start it with `{command}`{listed}{more}", command, others
    )


def instance_of(folder: Path) -> str:
    """Return the name of the daemon whose runtime folder is `folder`."""
    name = folder.name
    return (
        name.removeprefix(INSTANCE_PREFIX) if name.startswith(INSTANCE_PREFIX) else DEFAULT_INSTANCE
    )


def read_json(path: Path) -> dict[str, Any]:
    """Return the table in the file `path`; empty if it cannot be read."""
    import json

    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def read_report(folder: Path) -> dict[str, Any]:
    """Return servo.report in `folder`; empty if it cannot be read."""
    return read_json(folder / files.REPORT)


class Report:
    """servo.report in `folder`, read again after it was replaced; it is always replaced
    as a whole.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: tuple[int, int] = (0, 0)  # inode and time [ns] of the file that was read
        self._content: dict[str, Any] = {}

    def content(self) -> dict[str, Any]:
        """Return its present content, not to be modified; empty if it cannot be read."""
        try:
            there = (self._folder / files.REPORT).stat()
        except OSError:
            return {}
        if (there.st_ino, there.st_mtime_ns) != self._read:
            self._content = read_report(self._folder)
            self._read = (there.st_ino, there.st_mtime_ns)
        return self._content


def living_report(folder: Path) -> dict[str, Any]:
    """Return the report of a living servo of `folder`, including one that waits for its board."""
    return read_report(folder) if servo_lives(folder) else {}


def console_place(folder: Path) -> dict[str, Any] | None:
    """Return the address of the operators' page of the daemon in `folder`: {url, port, pid}. None
    without a living one.
    """
    found = read_json(folder / files.CONSOLE)
    pid = found.get("pid")
    return found if isinstance(pid, int) and os.path.exists(f"/proc/{pid}") else None


def gateway_lives(folder: Path) -> bool:
    """Return whether a process listens at the command socket of `folder`; its queue may be full."""
    import socket

    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(folder / files.COMMAND_SOCKET))
        except BlockingIOError:
            return True
        except OSError:
            return False
    return True
