"""A lease as its holder sees it: to be the only one who changes a part of the display.

    with client.lease("environment", ttl_s=5) as lease:
        client.set(K=100)
        lease.sleep(60)
        client.set(K=200)

Every request renews it; `renew` and `sleep` are for the time in which the client asks nothing. A
client that hangs loses its lease after `ttl_s`, one that dies at once.

With `keep_alive=True` a thread renews it as well, over the same connection, so that the body may
wait for a person. Such a lease ends with its process or its connection alone: a deadlocked main
thread keeps it. It is for the environment and the damping, never for what moves the handle by
itself.

Limitations: without `keep_alive`, `time.sleep` for longer than `ttl_s` loses the lease.

An exception that ends the context, Ctrl-C among them, does at once what `at_end` says.
"""

import threading
import time
from collections.abc import Callable
from typing import Any, Self

from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.protocol.answers import LeaseHeld, LeaseReleased, answer_of

__all__ = ["ClientLease"]

RENEWALS = 3  # in the time after which it would end
KEPT_ALIVE = ("environment", "active_damping")


def lost_error(text: str) -> CommandError:
    """The error for a lease that was lost as `text` says."""
    return CommandError("leased", f"{text}; changes since then were not excluded")


def renews_again(error: HapticdError) -> bool:
    """Whether another renewal may succeed: there was no answer in time, or no room."""
    code = error.code if isinstance(error, CommandError) else ""
    return isinstance(error, DaemonDown) or code in ("timeout", "busy")


class ClientLease:
    """A lease of `what`, taken when the context begins and released when it ends.

    `call` is Client.call; `pause` lets seconds pass; `asked` are the fields of the command beside
    `what`. Losing it is told by a
    CommandError: of the next change of what it covered, of `renew` and `sleep`, and at the end of
    the context.
    """

    def __init__(
        self,
        call: Callable[..., dict[str, Any]],
        what: str,
        keep_alive: bool = False,
        pause: Callable[[float], None] = time.sleep,
        **asked: Any,
    ) -> None:
        if keep_alive and what not in KEPT_ALIVE:
            names = " and ".join(KEPT_ALIVE)
            text = f"lease of {what}: keep_alive is for {names}; renew it while you work"
            raise CommandError("invalid", text)
        self._call = call
        self._pause = pause
        self._keep_alive = keep_alive
        self._left = threading.Event()  # the context has ended, or the lease is lost
        self._keeper: threading.Thread | None = None
        self._what = what
        self._asked = asked
        self._ttl_s = 0.0
        self._released = False  # by the body of the context

    def __enter__(self) -> Self:
        self.take()
        if self._keep_alive:
            self._left.clear()
            self._keeper = threading.Thread(target=self._keep, name="hapticd-lease", daemon=True)
            self._keeper.start()
        return self

    def _keep(self) -> None:
        """Renew until the context ends. A lease that is lost shows in the holder's next change."""
        while not self._left.wait(self._ttl_s / RENEWALS):
            try:
                self.renew()
            except HapticdError as error:
                if not renews_again(error):
                    return

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._left.set()
        if self._keeper is not None:
            self._keeper.join()
        if self._released:
            return
        try:
            lost = self.release(failed=kind is not None)
        except Exception:
            if kind is None:
                raise
            return  # what happened inside matters more
        if lost and kind is None:
            raise lost_error(lost)

    def take(self) -> LeaseHeld:
        """Take it. CommandError: another holds it."""
        held = answer_of(LeaseHeld, self._call("lease", what=self._what, **self._asked)["result"])
        self._ttl_s = held.ttl_s
        self._released = False
        return held

    def renew(self) -> None:
        """Keep it for another `ttl_s`. CommandError: it is lost."""
        self._call("lease", what=self._what, action="renew")

    def sleep(self, seconds: float) -> None:
        """Wait at least `seconds`, and keep it meanwhile. CommandError as soon as it is lost."""
        self.renew()
        while seconds > 0.0:
            slice_s = min(seconds, self._ttl_s / RENEWALS)
            self._pause(slice_s)
            seconds -= slice_s
            self.renew()

    def release(self, failed: bool = False) -> str:
        """Give it up; how it was lost before, "" if it was not. `failed`: and do what `at_end`
        says. CommandError: there is no such lease.
        """
        reply = self._call("lease", what=self._what, action="fail" if failed else "release")
        ended = answer_of(LeaseReleased, reply["result"])
        self._released = True
        return "" if ended.released else ended.text
