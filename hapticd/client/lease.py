"""A lease from the view of its holder: exclusive control of a part of the display.

    with client.lease("environment", ttl_s=5) as lease:
        client.set(K=100)
        lease.sleep(60)
        client.set(K=200)

Every request renews it; `renew` and `sleep` cover periods without requests. A client that hangs
loses its lease after `ttl_s`, one that dies at once.

With `keep_alive=True` a thread also renews it, over the same connection, so that the body may wait
for a person. Such a lease ends only with its process or its connection: a deadlocked main thread
keeps it. It is intended for the environment and the damping, never for a program that moves the
handle by itself.

Limitations: without `keep_alive`, `time.sleep` for longer than `ttl_s` loses the lease.

An exception that ends the context, such as Ctrl-C, triggers the action `at_end` at once.
"""

import threading
import time
from collections.abc import Callable
from typing import Any, Self

from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.protocol.answers import LeaseHeld, LeaseReleased, answer_of

__all__ = ["ClientLease"]

RENEWALS = 3  # within the time after which it would end
KEPT_ALIVE = ("environment", "active_damping")


def lost_error(text: str) -> CommandError:
    """Return the error for a lost lease; `text` gives the cause."""
    return CommandError("leased", f"{text}; changes since then were not excluded")


def renews_again(error: HapticdError) -> bool:
    """Return whether another renewal may succeed: no answer in time, or no room."""
    code = error.code if isinstance(error, CommandError) else ""
    return isinstance(error, DaemonDown) or code in ("timeout", "busy")


class ClientLease:
    """A lease of `what`, taken at the begin of the context and released at its end.

    `call` is Client.call; `pause` waits for seconds; `asked` are the other fields of the command. A
    lost lease raises a CommandError: at the next change of the leased part, in `renew` and `sleep`,
    and at the end of the context.
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
        """Renew until the context ends. The holder's next change reports a lost lease."""
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
            return  # the exception in the context has precedence
        if lost and kind is None:
            raise lost_error(lost)

    def take(self) -> LeaseHeld:
        """Take the lease. CommandError if another client holds it."""
        held = answer_of(LeaseHeld, self._call("lease", what=self._what, **self._asked)["result"])
        self._ttl_s = held.ttl_s
        self._released = False
        return held

    def renew(self) -> None:
        """Keep the lease for another `ttl_s`. CommandError if it is lost."""
        self._call("lease", what=self._what, action="renew")

    def sleep(self, seconds: float) -> None:
        """Wait at least `seconds`, and keep the lease. CommandError as soon as it is lost."""
        self.renew()
        while seconds > 0.0:
            slice_s = min(seconds, self._ttl_s / RENEWALS)
            self._pause(slice_s)
            seconds -= slice_s
            self.renew()

    def release(self, failed: bool = False) -> str:
        """Release the lease; return the cause if it was lost before, otherwise "". `failed`: also
        perform `at_end`. CommandError if there is no such lease.
        """
        reply = self._call("lease", what=self._what, action="fail" if failed else "release")
        ended = answer_of(LeaseReleased, reply["result"])
        self._released = True
        return "" if ended.released else ended.text
