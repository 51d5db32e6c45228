"""The runtime folder: where it is, who may own it, and how its files are created, claimed, mapped and removed."""

import fcntl
import mmap
import os
import stat
import tempfile
from pathlib import Path

from hapticd.errors import MailboxError

MAILBOX, TELEMETRY, STOP, PERTURBATION = "mailbox", "telemetry.ring", "stop", "perturbation"
LAST_TELEMETRY, REPORT = "last.ring", "servo.report"
SERVO_JSON, BOARD_JSON, GATEWAY_JSON = "servo.json", "board.json", "gateway.json"  # what the processes start from
COMMAND_SOCKET, TELEMETRY_SOCKET, ENDPOINTS = "command", "telemetry", "endpoints.json"  # the gateway's
SERVO_LOCK, GATEWAY_LOCK = "servo.lock", "gateway.lock"
DEFAULT_INSTANCE = "default"
SERVICE_FOLDER = Path("/run/hapticd")  # RuntimeDirectory= of the systemd units


def runtime_folder(instance: str = DEFAULT_INSTANCE) -> Path:
    """Folder of `instance`, the same for every process of this user. Not created, not checked.

    $RUNTIME_DIRECTORY (systemd), else $XDG_RUNTIME_DIR/hapticd, else <tempdir>/hapticd-<uid>; another instance than the
    default one gets a folder of its own inside.
    """
    if not instance or not all(c.isalnum() or c in "-_" for c in instance):
        raise MailboxError(f"instance name {instance!r}: use letters, digits, - and _")
    systemd, session = os.environ.get("RUNTIME_DIRECTORY"), os.environ.get("XDG_RUNTIME_DIR")
    if systemd:
        base = Path(systemd.split(":")[0])
    else:
        base = Path(session) / "hapticd" if session else Path(tempfile.gettempdir()) / f"hapticd-{os.getuid()}"
    return base if instance == DEFAULT_INSTANCE else base / f"instance-{instance}"


def daemon_folder(instance: str = DEFAULT_INSTANCE) -> Path:
    """Where a client finds the daemon `instance`: in this user's own folder, or else in the system service's if that is there.

    Only the default instance is a service. Not created, not checked.
    """
    own = runtime_folder(instance)
    there = any(os.path.exists(own / name) for name in (COMMAND_SOCKET, MAILBOX))
    service = instance == DEFAULT_INSTANCE and not there and os.path.isdir(SERVICE_FOLDER)
    return SERVICE_FOLDER if service else own


def prepare_folder(folder: Path) -> Path:
    """Make `folder` (0700) and check that it is ours. Raises MailboxError when someone else owns it."""
    for step in (folder.parent, folder) if folder.name.startswith("instance-") else (folder,):
        step.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = step.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            raise MailboxError(f"{step} belongs to user {found.st_uid}, not to {os.getuid()}; remove it or set XDG_RUNTIME_DIR")
        if found.st_mode & 0o022:
            raise MailboxError(f"{step} may be written by others (mode {stat.S_IMODE(found.st_mode):o}); chmod 700 it")
    return folder


def claim(folder: Path, lock: str) -> int:
    """Hold `lock` until this process ends; the returned descriptor is the claim. MailboxError if someone alive has it."""
    descriptor = os.open(folder / lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        owner = os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
        os.close(descriptor)
        role = lock.removesuffix(".lock")
        raise MailboxError(f"a {role} (pid {owner}) already runs in {folder}; stop it or use --instance NAME") from None
    if os.fstat(descriptor).st_nlink == 0:  # released, and so removed, between our open and our lock
        os.close(descriptor)
        return claim(folder, lock)
    os.ftruncate(descriptor, 0)
    os.write(descriptor, str(os.getpid()).encode())
    return descriptor


def release(folder: Path, lock: str, descriptor: int) -> None:
    """Give up a claim and remove its file."""
    (folder / lock).unlink(missing_ok=True)
    os.close(descriptor)


def create_map(path: Path, size: int, mode: int = 0o600) -> mmap.mmap:
    """A fresh zeroed file of `size` bytes, mapped shared and touched, in place of any stale one."""
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        os.fchmod(descriptor, mode)
        os.posix_fallocate(descriptor, 0, size)
        fresh = mmap.mmap(descriptor, size, mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
        for page in range(0, size, mmap.PAGESIZE):
            fresh[page] = 0  # the first write to a page costs 8 us (dirty bit, nested tables): not within a tick
        return fresh
    finally:
        os.close(descriptor)


def open_map(path: Path, size: int, writable: bool = True) -> mmap.mmap:
    """Map an existing file of exactly `size` bytes. MailboxError if it is missing or of another size."""
    access = os.O_RDWR if writable else os.O_RDONLY
    try:
        descriptor = os.open(path, access | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError as error:
        raise MailboxError(f"{path}: {error.strerror}; no servo runs there, start one with `hapticd run`") from error
    try:
        found = os.fstat(descriptor).st_size
        if found != size:
            raise MailboxError(f"{path} has {found} bytes, this version expects {size}; restart servo and gateway together")
        protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
        return mmap.mmap(descriptor, size, mmap.MAP_SHARED, protection)
    finally:
        os.close(descriptor)
