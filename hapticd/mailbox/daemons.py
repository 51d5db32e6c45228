"""The daemons of this computer: their folders, and the stop word that ends their force.

Folders (`runtime_folders`). A daemon derives its folder from its own environment at its start. The
environment of another process (a session, an ssh login, cron, systemd) may differ, so every place
is searched.

Trust (`require_trusted`). A folder is trusted if it is a directory and not a link, belongs to this
user, and no other user may write it. The service's folder belongs to another user; it is trusted
because only root can create its path. Any user can create names in shared memory and in the
temporary folder, as a trap for another. Such a folder is refused with its name, and no file in it
is opened.

Life (`is_running`). A daemon is alive if it holds the stop word or listens at the gateway's socket.
Files alone prove nothing: a killed daemon leaves them all behind.

This module must have no large import at the top and must not wait: `hapticd stop` starts with this
module.

Stop word (`StopWord`, `press_stop`). It is a file of eight bytes, with which any process that may
write it can stop the servo, and do nothing else. Zero bytes mean not pressed. Everything else is a
stop: other content, a shorter or longer file, a removed or replaced one. Eight bytes that are the
number of a client (little-endian, from FIRST_CLIENT on) make it that client's stop. That client may
reset it at once, as after a stop through the gateway. Every other press belongs to ACTOR_STOP_WORD.
A process that writes another client's number gives away its own stop, and takes no other.

The servo reads the word in every tick with `pread`, from a descriptor that it opened itself. This
takes 0.4 us and maps no page of a file that another process may truncate (a load beyond its end
kills with SIGBUS). A read of a regular file in memory does not wait for writers or locks, and no
name is opened in a tick.

A write could wait: a process that writes or reserves 100 MB in the file holds its inode meanwhile.
So the servo never writes or truncates a word that other processes can open. A press stops in every
tick until no force acts. Then `take_back` creates a new file under another name and renames it over
the old one, which needs no access to the old one. That is the acknowledgement: a process that has
pressed and reads zero again under the name knows that the servo read the press. It also knows that
the force is off. The old file lives as long as a process has it open. If it is large, the last
process that closes it frees it; if that is the servo, it may miss ticks (0.1 s for 1 GB), without
force.

Every 256 ticks `mend` compares the file under the name with the one that the servo made. If they
differ, the loop's file becomes an empty one: a press, which is taken back like any other.

The file is created under another name and locked before the rename, so every word under the name is
locked by its owner: the lock shows a client that a servo is alive. A client that opened the word
just before the rename presses once more (`press_stop`).

Limitations: a runtime folder on a file system where `pread` waits for a writer (XFS does, tmpfs and
ext4 do not). A group that may write the folder.
"""

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from hapticd.core.errors import DaemonDown, MailboxError
from hapticd.mailbox import files

__all__ = [
    "ACTOR_STOP_WORD",
    "FIRST_CLIENT",
    "NOT_PRESSED",
    "READ_BYTES",
    "RuntimeFolder",
    "console_place",
    "daemon_folder",
    "down",
    "instance_of",
    "living_report",
    "press_stop",
    "read_json",
    "read_report",
    "require_trusted",
    "runtime_folders",
    "servo_lives",
    "stop_taken",
    "untrusted_daemon_folder",
]

# --- the stop word --------------------------------------------------------------------------------
NOT_PRESSED = bytes(8)
ACTOR_STOP_WORD = 2  # of a press without a client
FIRST_CLIENT = 16  # lower numbers are parts of the daemon
LAST_CLIENT = (1 << 32) - 1  # largest number in a tick's record
UNNAMED = 1  # a press without a client
READ_BYTES = len(NOT_PRESSED) + 1  # one more shows that the file has grown
MODE = 0o660  # its owner, and under systemd every member of group hapticd


class StopWord:
    """The servo's side. `descriptor` keeps the same number for its lifetime."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / files.STOP
        self._empty = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
        self._word = self._made()
        self.descriptor = os.dup(self._word)

    @property
    def pressed(self) -> bool:
        """Whether a stop is requested; the loop has the same test inline."""
        return os.pread(self.descriptor, READ_BYTES, 0) != NOT_PRESSED

    @property
    def presser(self) -> int:
        """The actor that pressed it."""
        found = os.pread(self.descriptor, READ_BYTES, 0)
        number = int.from_bytes(found, "little")
        whole = len(found) == len(NOT_PRESSED)
        return number if whole and _is_client(number) else ACTOR_STOP_WORD

    def take_back(self) -> bool:
        """Replace the word by a new zero file; return False if it cannot be created. A later press
        is a new one. Do not call it while force acts: freeing a large old file takes time.
        """
        try:
            fresh = self._made()
        except MailboxError:
            return False  # no space, or the name is blocked: it stays a stop
        os.dup2(fresh, self.descriptor, inheritable=False)
        os.close(self._word)
        self._word = fresh
        return True

    def mend(self) -> None:
        """Press the word if the file under its name was changed. Never waits."""
        if not self._as_made():
            os.dup2(self._empty, self.descriptor, inheritable=False)

    def close(self) -> None:
        """Release the lock: this word is no longer taken back."""
        for descriptor in (self.descriptor, self._word, self._empty):
            os.close(descriptor)

    def _made(self) -> int:
        """Return the descriptor of a new file, locked and then renamed over any file of
        that name.
        """
        fresh = self._path.with_name(f"{files.STOP}.{os.getpid()}")
        with files.refusals(self._path):
            fresh.unlink(missing_ok=True)
            descriptor = os.open(fresh, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            try:
                os.pwrite(descriptor, NOT_PRESSED, 0)
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.fchmod(descriptor, MODE)
                fresh.replace(self._path)
            except OSError:
                os.close(descriptor)
                fresh.unlink(missing_ok=True)
                raise
        return descriptor

    def _as_made(self) -> bool:
        ours = os.fstat(self._word)
        untouched = ours.st_size == len(NOT_PRESSED) and stat.S_IMODE(ours.st_mode) == MODE
        return untouched and _is_there(self._path, self._word)


def press_stop(folder: Path, actor: int = ACTOR_STOP_WORD) -> None:
    """Latch STOP in the servo of `folder` without the gateway, in the name of client `actor`.

    MailboxError: no servo is running, or the file is not a stop word.
    """
    path = folder / files.STOP
    number = actor if _is_client(actor) else UNNAMED
    current = held = False
    while not current:  # the servo takes back other presses, at most one per tick
        current, held = _pressed(path, number)
    if not held:
        raise MailboxError(
            f"{path}: its servo has ended, and the board stopped with it; start one with `hapticd"
            " run`"
        )


def _is_client(actor: int) -> bool:
    return FIRST_CLIENT <= actor <= LAST_CLIENT


def _pressed(path: Path, number: int) -> tuple[bool, bool]:
    """Press once; return whether the written file still has the name, and whether a living servo
    holds it.
    """
    word = number.to_bytes(8, "little")
    with _opened(path, os.O_RDWR) as descriptor:
        try:
            # an unread press of another client becomes a common press, without a client
            alone = os.pread(descriptor, READ_BYTES, 0) in (NOT_PRESSED, word)
            os.pwrite(descriptor, word if alone else UNNAMED.to_bytes(8, "little"), 0)
            held = files.is_locked(descriptor)
            return _is_there(path, descriptor), held
        except OSError as error:
            raise MailboxError(f"{path}: {error.strerror}; the stop was not written") from error


def _is_there(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.lstat(path), os.fstat(descriptor))
    except OSError:
        return False


def stop_taken(folder: Path) -> bool:
    """Return whether the servo of `folder` has obeyed a press and taken it back, so that no force
    acts.
    """
    with suppress(MailboxError), _opened(folder / files.STOP, os.O_RDONLY) as descriptor:
        return os.pread(descriptor, READ_BYTES, 0) == NOT_PRESSED
    return False


def servo_lives(folder: Path) -> bool:
    """Return whether a servo holds the stop word of `folder`."""
    with suppress(MailboxError), _opened(folder / files.STOP, os.O_RDONLY) as descriptor:
        return files.is_locked(descriptor)
    return False


@contextmanager
def _opened(path: Path, access: int) -> Iterator[int]:
    """Open the stop word `path` without waiting, whatever its type; yield its descriptor."""
    try:
        # opening a pipe of that name would wait for its other end
        descriptor = os.open(path, access | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError as error:
        raise MailboxError(
            f"{path}: {error.strerror}; no servo runs there, start one with `hapticd run`"
        ) from error
    except OSError as error:
        raise MailboxError(
            f"{path}: {error.strerror}; its owner and the service's group may press it"
        ) from error
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise MailboxError(f"{path} is not a file; remove it, the next servo makes it again")
        yield descriptor
    finally:
        os.close(descriptor)


# --- folders --------------------------------------------------------------------------------------


class RuntimeFolder(NamedTuple):
    """A folder in which a daemon may run, and the name of that daemon."""

    folder: Path
    instance: str


def daemon_folder(instance: str = files.DEFAULT_INSTANCE) -> Path:
    """Return the folder of the daemon `instance`: this user's own, or otherwise the system
    service's.

    Only the default instance is a service. MailboxError: the folder exists and is not trusted.
    """
    folder = untrusted_daemon_folder(instance)
    require_trusted(folder)
    return folder


def untrusted_daemon_folder(instance: str = files.DEFAULT_INSTANCE) -> Path:
    """Return the folder as `daemon_folder`, without requiring that it is trusted."""
    own = files.runtime_folder(instance)
    if instance != files.DEFAULT_INSTANCE or not os.path.lexists(files.SERVICE_FOLDER):
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
        if instance in (None, files.DEFAULT_INSTANCE):
            found.append(RuntimeFolder(base, files.DEFAULT_INSTANCE))
        names = _instances(base) if instance is None else [instance]
        found += [
            RuntimeFolder(base / f"{files.INSTANCE_PREFIX}{name}", name)
            for name in names
            if name != files.DEFAULT_INSTANCE
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
        name.removeprefix(files.INSTANCE_PREFIX)
        for name in entries
        if name.startswith(files.INSTANCE_PREFIX)
    ]


def require_trusted(folder: Path) -> None:
    """Return if `folder` does not exist or is trusted; otherwise raise MailboxError with
    its name.
    """
    steps = (folder.parent, folder) if folder.name.startswith(files.INSTANCE_PREFIX) else (folder,)
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
        name
        for name in (files.DEFAULT_INSTANCE, *_instances(files.runtime_folder()))
        if _reached(name)
    )


def _reached(instance: str) -> bool:
    try:
        return is_running(daemon_folder(instance))
    except MailboxError:
        return False


def down(where: str, instance: str | None, more: str = "") -> DaemonDown:
    """Return the error for `instance` (None: any) without a daemon at `where`."""
    known = instance in (None, files.DEFAULT_INSTANCE)
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
        name.removeprefix(files.INSTANCE_PREFIX)
        if name.startswith(files.INSTANCE_PREFIX)
        else files.DEFAULT_INSTANCE
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
