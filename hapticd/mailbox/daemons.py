"""The folders in which a daemon may run: which of them are trusted, and which daemons are alive.

A daemon puts its folder where its own environment points at its start. The environment of another
process (a session, an ssh login, cron, systemd) may differ, so every place is searched.

A folder is trusted if it is a folder and not a link, belongs to this user, and no other user may
write it. The service's folder belongs to another user; it is trusted because only root can put
anything at its path. Names in shared memory and in the temporary folder can be taken by anyone, and
may be another user's trap. Such a folder is refused by name, and nothing in it is opened.

A daemon is alive if it holds the stop word or listens at the gateway's socket. Files alone prove
nothing: a daemon that was killed leaves them all behind.

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
    """Where a client finds the daemon `instance`: in this user's own folder, or else in the system
    service's if that is there.

    Only the default instance is a service. MailboxError: a folder that is there and not believed.
    """
    folder = untrusted_daemon_folder(instance)
    require_trusted(folder)
    return folder


def untrusted_daemon_folder(instance: str = DEFAULT_INSTANCE) -> Path:
    """As `daemon_folder`, to be looked at from outside: this folder need not be believed."""
    own = files.runtime_folder(instance)
    if instance != DEFAULT_INSTANCE or not os.path.lexists(files.SERVICE_FOLDER):
        return own
    try:
        require_trusted(own)
    except MailboxError:
        return own
    return own if is_running(own) else files.SERVICE_FOLDER


def runtime_folders(instance: str | None) -> list[RuntimeFolder]:
    """Where daemons of this user and the service may run; `instance` None: all of them.

    Not believed yet, and most of them do not exist.
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
    """Names of the instances below `base`, if that is ours to look into."""
    try:
        require_trusted(base)
        entries = sorted(os.listdir(base)) if os.path.isdir(base) else []
    except (OSError, MailboxError):
        return []
    return [
        name.removeprefix(INSTANCE_PREFIX) for name in entries if name.startswith(INSTANCE_PREFIX)
    ]


def require_trusted(folder: Path) -> None:
    """Return if `folder` is not there or may be believed, else MailboxError with its name."""
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
    """Whether a servo or a gateway is alive in `folder`."""
    return servo_lives(folder) or gateway_lives(folder)


def running() -> tuple[str, ...]:
    """The instances that are alive where a client looks for them."""
    return tuple(
        name for name in (DEFAULT_INSTANCE, *_instances(files.runtime_folder())) if _reached(name)
    )


def _reached(instance: str) -> bool:
    try:
        return is_running(daemon_folder(instance))
    except MailboxError:
        return False


def down(where: str, instance: str | None, more: str = "") -> DaemonDown:
    """The error for `instance` (None: any), of which nobody is alive at `where`."""
    known = instance in (None, DEFAULT_INSTANCE)
    command = "hapticd run" if known else f"hapticd run --instance {instance}"
    others = running()
    listed = f"; running: {', '.join(others)}" if others else ""
    return DaemonDown(
        f"{where}no daemon runs there; start it with `{command}`{listed}{more}", command, others
    )


def instance_of(folder: Path) -> str:
    """The name of the daemon whose runtime folder is `folder`."""
    name = folder.name
    return (
        name.removeprefix(INSTANCE_PREFIX) if name.startswith(INSTANCE_PREFIX) else DEFAULT_INSTANCE
    )


def read_json(path: Path) -> dict[str, Any]:
    """The table in the file `path`; empty if it cannot be read."""
    import json

    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def read_report(folder: Path) -> dict[str, Any]:
    """servo.report in `folder`; empty if it cannot be read."""
    return read_json(folder / files.REPORT)


class Report:
    """servo.report in `folder`, read again when it was replaced; it is only ever replaced whole."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: tuple[int, int] = (0, 0)  # inode and time [ns] of what was read
        self._content: dict[str, Any] = {}

    def content(self) -> dict[str, Any]:
        """What stands there now, not to be changed; empty if it cannot be read."""
        try:
            there = (self._folder / files.REPORT).stat()
        except OSError:
            return {}
        if (there.st_ino, there.st_mtime_ns) != self._read:
            self._content = read_report(self._folder)
            self._read = (there.st_ino, there.st_mtime_ns)
        return self._content


def living_report(folder: Path) -> dict[str, Any]:
    """What a living servo of `folder` reports, also one that still waits for its board."""
    return read_report(folder) if servo_lives(folder) else {}


def console_place(folder: Path) -> dict[str, Any] | None:
    """Where the operators' page of the daemon in `folder` is: {url, port, pid}; None without one
    that is alive.
    """
    found = read_json(folder / files.CONSOLE)
    pid = found.get("pid")
    return found if isinstance(pid, int) and os.path.exists(f"/proc/{pid}") else None


def gateway_lives(folder: Path) -> bool:
    """Whether somebody listens at the command socket of `folder`; a queue that is full is one."""
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
