"""The stop word: a file of eight bytes. Any process that may write it can stop the servo, and
nothing more.

Zero bytes mean not pressed. Everything else is a stop: another content, a file that is shorter or
longer, one that was removed or replaced. Eight bytes that are the number of a client
(little-endian, from FIRST_CLIENT on) make it that client's stop. That client may reset it at once,
as after a stop through the gateway. Every other press is ACTOR_STOP_WORD's. A process that writes
another client's number gives away its own stop, and takes no other.

The servo reads the word in every tick with `pread`, from a descriptor that it opened itself. This
takes 0.4 us and maps no page of a file that others may cut short (a load beyond its end kills with
SIGBUS). A read of a regular file in memory does not wait for writers or locks, and no name is
opened in a tick.

A write would wait: a process that writes or reserves 100 MB in the file holds its inode meanwhile.
So the servo never writes the word that others have, nor cuts it short. A press stops in every tick
until no force acts. Then `take_back` creates a new file under another name and renames it over the
old one, which needs no access to the old one. That is the acknowledgement: a process that has
pressed and reads zero again under the name knows that the servo has read the press and that the
force is off. The old file lives as long as a process has it open. If it is large, the process that
closes it last frees it; if that is the servo it may miss ticks (0.1 s for 1 GB), without force.

Every 256 ticks `mend` compares the file under the name with the one that the servo made. If they
differ, the loop's file becomes an empty one: a press, which is taken back like any other.

The file is created under another name and locked before the rename, so every word under the name is
locked by its owner: the lock shows a client that a servo is there. A client that opened the word
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
ACTOR_STOP_WORD = 2  # of a press that names no client
FIRST_CLIENT = 16  # below are the daemon's own parts
LAST_CLIENT = (1 << 32) - 1  # that a tick's record can name
UNNAMED = 1  # a press that names no client
READ_BYTES = len(NOT_PRESSED) + 1  # one more shows that the file has grown
MODE = 0o660  # its owner, and under systemd every member of group hapticd


class StopWord:
    """The servo's end. `descriptor` stays the same number while this lives."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / files.STOP
        self._empty = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
        self._word = self._made()
        self.descriptor = os.dup(self._word)

    @property
    def pressed(self) -> bool:
        """Whether a stop is asked for; the loop asks the same question in place."""
        return os.pread(self.descriptor, READ_BYTES, 0) != NOT_PRESSED

    @property
    def presser(self) -> int:
        """The actor whose press it is."""
        found = os.pread(self.descriptor, READ_BYTES, 0)
        number = int.from_bytes(found, "little")
        whole = len(found) == len(NOT_PRESSED)
        return number if whole and _is_client(number) else ACTOR_STOP_WORD

    def take_back(self) -> bool:
        """Zero again, in a new file; a press from here on is another one. Not while force acts:
        the old file may be large, and it goes. False where none can be made.
        """
        try:
            fresh = self._made()
        except MailboxError:
            return False  # no room, or something is in the way: it stays a stop
        os.dup2(fresh, self.descriptor, inheritable=False)
        os.close(self._word)
        self._word = fresh
        return True

    def mend(self) -> None:
        """Press the word if what stands under its name is not as it was made. Waits for nobody."""
        if not self._as_made():
            os.dup2(self._empty, self.descriptor, inheritable=False)

    def close(self) -> None:
        """Give up the lock: nobody takes this word back any more."""
        for descriptor in (self.descriptor, self._word, self._empty):
            os.close(descriptor)

    def _made(self) -> int:
        """Descriptor of a new file in place of whatever has the name; locked before it has it."""
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
    MailboxError: no servo is there (any more), or what stands there is no stop word.
    """
    path = folder / files.STOP
    number = actor if _is_client(actor) else UNNAMED
    current = held = False
    while not current:  # the servo takes other presses back, once a tick at most
        current, held = _pressed(path, number)
    if not held:
        raise MailboxError(
            f"{path}: its servo has ended, and the board stopped with it; start one with `hapticd"
            " run`"
        )


def _is_client(actor: int) -> bool:
    return FIRST_CLIENT <= actor <= LAST_CLIENT


def _pressed(path: Path, number: int) -> tuple[bool, bool]:
    """Press once: whether what was written still has the name, and a living servo holds it."""
    word = number.to_bytes(8, "little")
    with _opened(path, os.O_RDWR) as descriptor:
        try:
            # the servo may not have read another's press yet: then it is of both, so of neither
            alone = os.pread(descriptor, READ_BYTES, 0) in (NOT_PRESSED, word)
            os.pwrite(descriptor, word if alone else UNNAMED.to_bytes(8, "little"), 0)
            held = files.is_locked(descriptor)
            return _is_there(path, descriptor), held
        except OSError as error:
            raise MailboxError(f"{path}: {error.strerror}; the stop was not written") from error


def _is_there(path: Path, descriptor: int) -> bool:
    """Whether the open file `descriptor` has the name `path`."""
    try:
        return os.path.samestat(os.lstat(path), os.fstat(descriptor))
    except OSError:
        return False


def stop_taken(folder: Path) -> bool:
    """Whether the servo of `folder` has taken a press back: obeyed it, and no force acts."""
    with suppress(MailboxError), _opened(folder / files.STOP, os.O_RDONLY) as descriptor:
        return os.pread(descriptor, READ_BYTES, 0) == NOT_PRESSED
    return False


def servo_lives(folder: Path) -> bool:
    """Whether a servo holds the stop word of `folder`."""
    with suppress(MailboxError), _opened(folder / files.STOP, os.O_RDONLY) as descriptor:
        return files.is_locked(descriptor)
    return False


@contextmanager
def _opened(path: Path, access: int) -> Iterator[int]:
    """Descriptor of the stop word `path`, opened without waiting whatever it is."""
    try:
        # a pipe of that name would wait for its other end
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
