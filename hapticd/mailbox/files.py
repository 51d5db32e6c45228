"""The runtime folder: its place, its owner, and the life of its files, from creation to removal.

It also defines the order in which a reader sees a word and the data that it announces. On x86-64 an
aligned 8-byte store from a memoryview is one `mov`. Stores are not reordered with earlier stores
(TSO), and the call into C stops the compiler: a plain assignment is a release store. On aarch64 the
same store is single-copy atomic but may overtake the data written before it. There the word is
stored by libatomic's `__atomic_store_8(..., RELEASE)` and read by `__atomic_load_8(..., ACQUIRE)`.
A Python lock or a bare `dmb`-less store would not be enough: neither is documented as a barrier.
Records contain their number first and last, and commands a CRC, so a mistake here is detected.

Limitations: a runtime folder on a network file system (locks, shared maps). No import at the top
may be large: `hapticd stop` and every command start with this module.
"""

import fcntl
import mmap
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hapticd.core.errors import MailboxError

__all__ = [
    "BOARD_JSON",
    "COMMAND_SOCKET",
    "CONSOLE",
    "DEFAULT_INSTANCE",
    "ENDPOINTS",
    "GATEWAY_JSON",
    "GATEWAY_LOCK",
    "GUARD_JSON",
    "GUARD_TERMS",
    "MAILBOX",
    "REPORT",
    "SERVICE_FOLDER",
    "SERVO_JSON",
    "STOP",
    "TELEMETRY",
    "TELEMETRY_SOCKET",
    "claim",
    "open_map",
    "plain_store",
    "prepare_folder",
    "release",
    "remove",
    "runtime_folder",
    "write_whole",
]

MAILBOX = "mailbox"
TELEMETRY = "telemetry.ring"
STOP = "stop"
PERTURBATION = "perturbation"
LAST_TELEMETRY = "last.ring"
REPORT = "servo.report"
# configuration of the processes
SERVO_JSON = "servo.json"
BOARD_JSON = "board.json"
GATEWAY_JSON = "gateway.json"
GUARD_JSON = "guard.json"
# of the gateway
COMMAND_SOCKET = "command"
TELEMETRY_SOCKET = "telemetry"
ENDPOINTS = "endpoints.json"
GUARD_TERMS = "guard.terms"
CONSOLE = "console.json"  # address of the operators' page
SERVO_LOCK = "servo.lock"
GATEWAY_LOCK = "gateway.lock"
DEFAULT_INSTANCE = "default"
INSTANCE_PREFIX = "instance-"  # of the folders of other instances
LONGEST_NAME = 64
SERVICE_FOLDER = Path("/run/hapticd")  # RuntimeDirectory= of the systemd units
SESSION_FOLDERS = Path("/run/user")  # logind creates XDG_RUNTIME_DIR here, by user number
MEMORY_FOLDER = Path("/dev/shm")


def runtime_folder(instance: str = DEFAULT_INSTANCE) -> Path:
    """Return the folder of `instance`, the same for every process of this user. Not created, not
    checked.

    It is $RUNTIME_DIRECTORY (systemd), or $XDG_RUNTIME_DIR/hapticd, or hapticd-<uid> in shared
    memory (/dev/shm), or in <tempdir>. Mapped files on a disk would be written back, and their
    pages would fault again within a tick. Any instance but the default one has its own folder
    inside.
    """
    if not 0 < len(instance) <= LONGEST_NAME or not all(c.isalnum() or c in "-_" for c in instance):
        raise MailboxError(
            f"instance name {instance[:LONGEST_NAME]!r}: use 1 to {LONGEST_NAME} letters, digits, -"
            " and _"
        )
    systemd = os.environ.get("RUNTIME_DIRECTORY")
    session = os.environ.get("XDG_RUNTIME_DIR")
    if systemd:
        base = Path(systemd.split(":")[0])
    else:
        base = Path(session) / "hapticd" if session else _memory_folder() / f"hapticd-{os.getuid()}"
    return base if instance == DEFAULT_INSTANCE else base / f"{INSTANCE_PREFIX}{instance}"


@contextmanager
def refusals(path: Path) -> Iterator[None]:
    """Turn an OSError about `path` into a MailboxError with its name."""
    try:
        yield
    except OSError as error:
        remedy = "free some space, correct its permissions or remove the obstacle"
        raise MailboxError(f"{path}: {error.strerror}", remedy) from error


def _memory_folder() -> Path:
    memory = MEMORY_FOLDER
    return memory if os.access(memory, os.W_OK | os.X_OK) else temporary_folder()


def temporary_folder() -> Path:
    """Return the folder for temporary files; importing `tempfile` would take 5 ms in
    every command.
    """
    return Path(os.environ.get("TMPDIR") or "/tmp")


def prepare_folder(folder: Path) -> Path:
    """Create `folder` (0700) and check that this user owns it.

    MailboxError: another user owns it, or it cannot be created.
    """
    for step in (folder.parent, folder) if folder.name.startswith(INSTANCE_PREFIX) else (folder,):
        with refusals(step):
            step.mkdir(mode=0o700, parents=True, exist_ok=True)
        check_own(step)
    return folder


def check_own(folder: Path) -> None:
    """Raise MailboxError unless `folder` is a real folder of this user that no other user may
    write.
    """
    with refusals(folder):
        owner = folder.lstat().st_uid
    check_closed(folder)
    if owner != os.getuid():
        raise MailboxError(
            f"{folder} belongs to user {owner}, not to {os.getuid()}",
            "remove it or set XDG_RUNTIME_DIR",
        )


def check_closed(folder: Path) -> None:
    """Raise MailboxError unless `folder` is a real folder that only its owner may write."""
    with refusals(folder):
        mode = folder.lstat().st_mode
    if stat.S_ISLNK(mode):
        raise MailboxError(f"{folder} is a link", "remove it or set XDG_RUNTIME_DIR")
    if not stat.S_ISDIR(mode):
        raise MailboxError(f"{folder} is not a folder", "remove it or set XDG_RUNTIME_DIR")
    if mode & 0o022:
        raise MailboxError(
            f"{folder} may be written by others (mode {stat.S_IMODE(mode):o})", "chmod 700 it"
        )


def claim(folder: Path, lock: str) -> int:
    """Hold `lock` until this process ends; the returned descriptor is the claim.

    MailboxError: a living process holds it.
    """
    with refusals(folder / lock):
        descriptor = os.open(folder / lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        owner = os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
        os.close(descriptor)
        role = lock.removesuffix(".lock")
        raise MailboxError(
            f"a {role} (pid {owner}) already runs in {folder}; stop it or use --instance NAME"
        ) from None
    # the file was released, and so removed, between open and lock
    if os.fstat(descriptor).st_nlink == 0:
        os.close(descriptor)
        return claim(folder, lock)
    with refusals(folder / lock):
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
    return descriptor


def release(folder: Path, lock: str, descriptor: int) -> None:
    """Release a claim and remove its file."""
    remove(folder, lock)
    os.close(descriptor)


def is_locked(descriptor: int) -> bool:
    """Return whether another living process holds the lock of the open file `descriptor`."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False


def write_whole(path: Path, text: str) -> Path:
    """Write `text` into `path` completely or not at all. MailboxError: no space, no permission."""
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    with refusals(path):
        try:
            with open(fresh, "w", opener=_for_group_to_read) as file:
                file.write(text)
            return fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)


def _for_group_to_read(path: str, flags: int) -> int:
    """Open a file that the group may read, as far as the umask allows, and never write."""
    return os.open(path, flags | os.O_CLOEXEC, 0o640)


def remove(folder: Path, *names: str) -> None:
    """Remove files of this user where possible; the next start replaces the rest, or refuses them
    by name.
    """
    for name in names:
        with suppress(OSError):
            (folder / name).unlink(missing_ok=True)


def create_map(path: Path, size: int) -> mmap.mmap:
    """Create a zeroed file of `size` bytes, mapped shared and touched; it replaces any stale one.

    MailboxError: no space.
    """
    with refusals(path):
        path.unlink(missing_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
            fresh = mmap.mmap(descriptor, size, mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
        finally:
            os.close(descriptor)
    # the first write to a page costs 8 us (dirty bit, nested tables): not within a tick
    for page in range(0, size, mmap.PAGESIZE):
        fresh[page] = 0
    return fresh


def open_map(path: Path, size: int, writable: bool = True) -> mmap.mmap:
    """Map an existing file of exactly `size` bytes. MailboxError: it is missing or has another
    size.
    """
    access = os.O_RDWR if writable else os.O_RDONLY
    try:
        descriptor = os.open(path, access | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError as error:
        raise MailboxError(
            f"{path}: {error.strerror}; no servo runs there, start one with `hapticd run`"
        ) from error
    try:
        found = os.fstat(descriptor).st_size
        if found != size:
            raise MailboxError(
                f"{path} has {found} bytes, this version expects {size}; restart servo and gateway"
                " together"
            )
        protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
        return mmap.mmap(descriptor, size, mmap.MAP_SHARED, protection)
    finally:
        os.close(descriptor)


# __ATOMIC_RELEASE, __ATOMIC_ACQUIRE
RELEASE = 3
ACQUIRE = 2
STRONGLY_ORDERED = frozenset({"x86_64", "amd64", "AMD64", "i686"})

Store = Callable[[int, int], None]
Load = Callable[[int], int]


def plain_store(machine: str | None = None) -> bool:
    """Return whether a plain assignment publishes on this (or the named) machine, without a call in
    a tick.
    """
    return (machine or os.uname().machine) in STRONGLY_ORDERED


def word_access(words: "memoryview[int]", machine: str | None = None) -> tuple[Store, Load]:
    """Return `(store(index, value), load(index))` for u64 `words`, with release and acquire order.

    They suit this (or the named) machine. MailboxError: the machine is weakly ordered and libatomic
    is missing.
    """
    if plain_store(machine):
        return words.__setitem__, words.__getitem__
    return _libatomic_access(words)


def _libatomic_access(words: "memoryview[int]") -> tuple[Store, Load]:
    import ctypes  # here: it takes milliseconds, and most commands do not need it

    try:
        library = ctypes.CDLL("libatomic.so.1")
    except OSError as error:
        raise MailboxError(
            f"this processor needs libatomic for ordered stores ({error}); install libatomic1"
        ) from error
    put = library.__atomic_store_8
    get = library.__atomic_load_8
    put.argtypes = (ctypes.c_void_p, ctypes.c_uint64, ctypes.c_int)
    put.restype = None
    get.argtypes = (ctypes.c_void_p, ctypes.c_int)
    get.restype = ctypes.c_uint64
    anchor = ctypes.c_char.from_buffer(words)  # holds the map; its address is the address of word 0
    base = ctypes.addressof(anchor)

    def store(index: int, value: int, _anchor: ctypes.c_char = anchor) -> None:
        put(base + 8 * index, value, RELEASE)

    def load(index: int, _anchor: ctypes.c_char = anchor) -> int:
        return int(get(base + 8 * index, ACQUIRE))

    return store, load
