"""The stop word: a file of eight bytes with which any process that may write it can stop the servo,
and do nothing else.

Zero bytes mean not pressed. Everything else is a stop: other content, a shorter or longer file, a
removed or replaced one. Eight bytes that are the number of a client (little-endian, from
FIRST_CLIENT on) make it that client's stop. That client may reset it at once, as after a stop
through the gateway. Every other press belongs to ACTOR_STOP_WORD. A process that writes another
client's number gives away its own stop, and takes no other.

The servo reads the word in every tick with `pread`, from a descriptor that it opened itself. This
takes 0.4 us and maps no page of a file that another process may truncate (a load beyond its end
kills with SIGBUS). A read of a regular file in memory does not wait for writers or locks, and no
name is opened in a tick.

A write could wait: a process that writes or reserves 100 MB in the file holds its inode meanwhile.
So the servo never writes or truncates a word that other processes can open. A press stops in every
tick until no force acts. Then `take_back` creates a new file under another name and renames it over
the old one, which needs no access to the old one. That is the acknowledgement: a process that has
pressed and reads zero again under the name knows that the servo has read the press and that the
force is off. The old file lives as long as a process has it open. If it is large, the last process
that closes it frees it; if that is the servo, it may miss ticks (0.1 s for 1 GB), without force.

Every 256 ticks `mend` compares the file under the name with the one that the servo made. If they
differ, the loop's file becomes an empty one: a press, which is taken back like any other.

The file is created under another name and locked before the rename, so every word under the name is
locked by its owner: the lock shows a client that a servo is alive. A client that opened the word
just before the rename presses once more (`press_stop`).

Limitations: a runtime folder on a file system where `pread` waits for a writer (XFS does, tmpfs and
ext4 do not), or a group that may write the folder.
"""

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hapticd.core.errors import MailboxError
from hapticd.mailbox import files

__all__ = [
    "ACTOR_STOP_WORD",
    "FIRST_CLIENT",
    "NOT_PRESSED",
    "READ_BYTES",
    "press_stop",
    "servo_lives",
    "stop_taken",
]

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
