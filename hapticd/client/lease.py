"""A lease as its holder sees it: to be the only one who changes a part of the display.

    with client.lease("environment", ttl_s=5) as lease:
        client.set(K=100)
        lease.sleep(60)
        client.set(K=200)

Whatever the client asks renews it; `renew` and `sleep` are for the time in which it asks nothing. A
client has one thread, and none in the background says that it lives: one that hangs loses its lease
after `ttl_s`, one that dies at once.

What would break it: `time.sleep` for longer than `ttl_s` while it is held.
"""

import time
from collections.abc import Callable
from typing import Any, Self

from hapticd.errors import CommandError

RENEWALS = 3  # in the time after which it would end


def lost_error(text: str) -> CommandError:
    """The error for a lease that was lost as `text` says."""
    return CommandError("leased", f"{text}; what was done since then was not excluded")


class ClientLease:
    """A lease of `what`, taken when the context begins and released when it ends.

    `call` is Client.call; `asked` the fields of the command beside `what`. Losing it is told by a
    CommandError: of the next change of what it covered, of `renew` and `sleep`, and at the end of
    the context.
    """

    def __init__(self, call: Callable[..., dict[str, Any]], what: str, **asked: Any) -> None:
        self._call = call
        self._what = what
        self._asked = asked
        self._ttl_s = 0.0
        self._released = False  # by the body of the context

    def __enter__(self) -> Self:
        self.take()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._released:
            return
        try:
            lost = self.release()
        except Exception:
            if kind is None:
                raise
            return  # what happened inside matters more
        if lost and kind is None:
            raise lost_error(lost)

    def take(self) -> dict[str, Any]:
        """Take it: {what, name, actor, left_s, ttl_s, at_end}. CommandError: another holds it."""
        held: dict[str, Any] = self._call("lease", what=self._what, **self._asked)["result"]
        self._ttl_s = held["ttl_s"]
        self._released = False
        return held

    def renew(self) -> None:
        """Keep it for another `ttl_s`. CommandError: it is lost."""
        self._call("lease", what=self._what, action="renew")

    def sleep(self, seconds: float) -> None:
        """Wait, and keep it meanwhile. CommandError as soon as it is lost."""
        end_s = time.monotonic() + seconds
        self.renew()
        while (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, self._ttl_s / RENEWALS))
            self.renew()

    def release(self) -> str:
        """Give it up; how it was lost before, "" if it was not. CommandError: nobody knows it."""
        result = self._call("lease", what=self._what, action="release")["result"]
        self._released = True
        return "" if result["released"] else str(result["text"])
