"""Having the operating system put a growing file on its disk, without waiting for it."""

import os
import threading


class Synchroniser:
    """A thread that has the operating system write a file to its disk; a request while it is busy is dropped."""

    def __init__(self) -> None:
        self._wanted, self._ending = threading.Event(), threading.Event()
        self._descriptor = -1
        self._thread: threading.Thread | None = None

    def request(self, descriptor: int) -> None:
        """Write `descriptor` out soon; it stays open until `stop` has returned."""
        self._descriptor = descriptor
        self._wanted.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run)
            self._thread.start()

    def _run(self) -> None:
        while self._wanted.wait() and not self._ending.is_set():
            self._wanted.clear()
            try:
                os.fdatasync(self._descriptor)
            except OSError:
                pass  # the next write says so, with a message

    def stop(self) -> None:
        """End the thread; may be called twice."""
        self._ending.set()
        self._wanted.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
