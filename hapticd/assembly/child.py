"""One child process of the supervisor: how it is started, when it counts as ready, how often it may
come back.

A child is started by exec, never forked from a process that has threads or a big heap. It gets a
process group of its own, so that Ctrl-C in a terminal reaches the supervisor alone and the end is
in order; it dies with its parent.
"""

import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import hapticd
from hapticd.errors import MailboxError
from hapticd.mailbox import files, layout
from hapticd.units import NS_PER_S

RESTARTS_MAX = 3
WINDOW_NS = 60 * NS_PER_S
FIRST_PAUSE_NS = NS_PER_S // 2  # doubled with each restart within the window


class Process(Protocol):
    """What is used of subprocess.Popen."""

    pid: int

    def poll(self) -> int | None: ...
    def terminate(self) -> None: ...
    def kill(self) -> None: ...


Spawn = Callable[[Sequence[str], int], Process]  # module and arguments, descriptor to hand down


def spawn(command: Sequence[str], ready: int) -> Process:
    """`python -m command` in a fresh interpreter; its messages go to our stderr, descriptor
    `ready` is handed down.
    """
    return subprocess.Popen(
        [
            sys.executable,
            "-X",
            "utf8",
            "-P",
            "-m",
            *command,
            "--parent",
            str(os.getpid()),
            "--ready",
            str(ready),
        ],
        stdin=subprocess.DEVNULL,
        stdout=2,
        pass_fds=(ready,),
        env={**os.environ, **_import_path(), "OPENBLAS_NUM_THREADS": "1"},
        process_group=0,
    )


def _import_path() -> dict[str, str]:
    """-P keeps the working folder out of the child's imports; a checkout that is not installed
    has to be named then.
    """
    root = Path(hapticd.__file__).parents[1]
    if root.name in ("site-packages", "dist-packages"):
        return {}
    return {"PYTHONPATH": os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH"))))}


class Restarts:
    """At most 3 restarts within 60 s, after 0.5, 1 and 2 s."""

    def __init__(self) -> None:
        self._times: deque[int] = deque()

    def next_ns(self, now_ns: int) -> int | None:
        """When the next start is allowed after a death at `now_ns`; None: no more."""
        while self._times and now_ns - self._times[0] > WINDOW_NS:
            self._times.popleft()
        if len(self._times) >= RESTARTS_MAX:
            return None
        pause_ns = FIRST_PAUSE_NS << len(self._times)
        self._times.append(now_ns)
        return now_ns + pause_ns

    @property
    def used(self) -> int:
        """Restarts within the window."""
        return len(self._times)


class Child:
    """The servo or the gateway."""

    def __init__(self, name: str, command: Sequence[str], start: Spawn) -> None:
        self.name = name
        self.command = command
        self._spawn = start
        self.process: Process | None = None
        self.restarts = Restarts()
        self.start_at_ns: int | None = 0  # None: running
        self.ready = self.was_ready = False  # in this life, in any
        self._pipe: int | None = None

    def start(self) -> None:
        """Start it now."""
        self._close_pipe()
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            self.process = self._spawn(self.command, theirs)
        finally:
            os.close(theirs)
        self.start_at_ns = None
        self.ready = False

    def died(self) -> int | None:
        """Exit code of a child that should run and does not."""
        return (
            self.process.poll() if self.process is not None and self.start_at_ns is None else None
        )

    def alive(self) -> bool:
        """Whether a process of it exists."""
        return self.process is not None and self.process.poll() is None

    def note_ready(self, is_ready: Callable[[Process], bool]) -> None:
        """Ask whether it serves, until it does."""
        if self.process is not None and self.start_at_ns is None and not self.ready:
            self.ready = is_ready(self.process)
            self.was_ready |= self.ready

    def said_ready(self) -> bool:
        """Whether it wrote its byte since it was started."""
        try:
            return self._pipe is not None and bool(os.read(self._pipe, 1))
        except BlockingIOError:
            return False

    def forget(self) -> None:
        """Free what is left of a child that ended."""
        self._close_pipe()
        self.process = None

    def _close_pipe(self) -> None:
        if self._pipe is not None:
            os.close(self._pipe)
        self._pipe = None


def mailbox_served(folder: Path, pid: int) -> bool:
    """Whether the servo process `pid` has published its mailbox in `folder`."""
    try:
        page = files.open_map(folder / files.MAILBOX, layout.MAILBOX_BYTES, writable=False)
    except MailboxError:
        return False
    header = layout.HEADER.unpack_from(page, 0)
    return memoryview(page).cast("Q")[layout.EPOCH_WORD] != 0 and header[2] == pid
