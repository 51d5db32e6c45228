"""The stop word: a file of eight bytes by which whoever may write it stops the servo, and no more.

Zero bytes mean that nobody has pressed it. Everything else is a stop: another content, a file that
is shorter or longer, one that was removed or replaced. The servo reads it in every tick with
`pread`, from a descriptor that it opened itself: 0.4 us, and no page of a file that others may cut
short is mapped (a load beyond its end kills with SIGBUS). Nothing here waits: a read of a regular
file in memory does not block, whoever holds locks on it, and no name is opened in a tick.

The servo takes the word back to zero as it obeys. That is the acknowledgement: who has pressed and
reads zero again knows that the servo has seen it. Every 256 ticks `mend` compares what stands under
the name with what the servo made; if it differs, the file is made anew and counts as pressed.

The file is made under another name and locked before it gets its own, so that nobody finds a word
whose owner does not hold it yet: the lock tells who presses that someone is there.

What would break it: a runtime folder on a file system where `pread` waits for a writer (XFS does,
tmpfs and ext4 do not), or a group that may write the folder.
"""

import fcntl
import os
import stat
from pathlib import Path

from hapticd.errors import MailboxError
from hapticd.mailbox import files

NOT_PRESSED = bytes(8)
PRESSED = (1).to_bytes(8, "little")
READ_BYTES = len(NOT_PRESSED) + 1  # one more shows that the file has grown
MODE = 0o660  # its owner, and under systemd every member of group hapticd


class StopWord:
    """The servo's end. `descriptor` stays the same number while this lives."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / files.STOP
        self.descriptor = self._made()

    @property
    def pressed(self) -> bool:
        """Whether a stop is asked for; the loop asks the same question in place."""
        return os.pread(self.descriptor, READ_BYTES, 0) != NOT_PRESSED

    def take_back(self) -> None:
        """Zero again; a press from here on is another one."""
        self._write(NOT_PRESSED)

    def mend(self) -> None:
        """Make the file anew, pressed, if what stands under its name is not as it was made."""
        if self._as_made():
            return
        try:
            fresh = self._made()
        except MailboxError:
            pass  # whatever is in the way stays a stop
        else:
            os.dup2(fresh, self.descriptor, inheritable=False)  # the lock goes along
            os.close(fresh)
        self._write(PRESSED)

    def close(self) -> None:
        """Give up the lock: nobody takes this word back any more."""
        os.close(self.descriptor)

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
        try:
            there = os.lstat(self._path)
        except OSError:
            return False
        ours = os.fstat(self.descriptor)
        same = (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino)
        return same and ours.st_size == len(NOT_PRESSED) and stat.S_IMODE(ours.st_mode) == MODE

    def _write(self, word: bytes) -> None:
        try:
            os.pwrite(self.descriptor, word, 0)
        except OSError:
            pass  # a file that was cut short, and no room for its page: it stays pressed


def press_stop(folder: Path) -> None:
    """Latch STOP in the servo of `folder` without the gateway. MailboxError: no servo is there
    (any more), or what stands there is no stop word.
    """
    path = folder / files.STOP
    descriptor = _opened(path, os.O_RDWR)
    try:
        os.pwrite(descriptor, PRESSED, 0)
        held = files.is_locked(descriptor)
    except OSError as error:
        raise MailboxError(f"{path}: {error.strerror}; the stop was not written") from error
    finally:
        os.close(descriptor)
    if not held:
        raise MailboxError(
            f"{path}: its servo has ended, and the board stopped with it; start one with `hapticd"
            " run`"
        )


def stop_taken(folder: Path) -> bool:
    """Whether the servo of `folder` has taken a press back, which it does as it obeys it."""
    try:
        descriptor = _opened(folder / files.STOP, os.O_RDONLY)
    except MailboxError:
        return False
    try:
        return os.pread(descriptor, READ_BYTES, 0) == NOT_PRESSED
    finally:
        os.close(descriptor)


def servo_lives(folder: Path) -> bool:
    """Whether a servo holds the stop word of `folder`."""
    try:
        descriptor = _opened(folder / files.STOP, os.O_RDONLY)
    except MailboxError:
        return False
    try:
        return files.is_locked(descriptor)
    finally:
        os.close(descriptor)


def _opened(path: Path, access: int) -> int:
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
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise MailboxError(f"{path} is no file; remove it, the next servo makes it again")
    return descriptor
