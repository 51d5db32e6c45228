"""What a failed USB transfer means: one table from errno to LinkError and remedy.

The numbers are those that pyusb reports on Linux; 5 (the bus failed) is what an unplug often looks like before the hub
has noticed, so it is treated as 19 (no such device). libusb's "not supported" has no number and counts as lost.
"""

import errno
from typing import NamedTuple

from hapticd.errors import LinkAccess, LinkError, LinkLost, LinkStalled, LinkTimeout


class Failure(NamedTuple):
    """What an errno means and what to do about it."""

    kind: type[LinkError]
    remedy: str


_AGAIN = "it is opened again when it comes back; check plug, cable and hub"
_RIGHTS = "install 70-hapticd.rules in /etc/udev/rules.d, join group plugdev and plug the board in again"
_OWNER = "another program has claimed the board: stop it and try again"

FAILURES: dict[int | None, Failure] = {
    errno.ETIMEDOUT: Failure(LinkTimeout, "the tick goes on without the frame"),
    errno.EPIPE: Failure(LinkStalled, "the halt is cleared once"),
    errno.EOVERFLOW: Failure(LinkStalled, "more than a packet came; the halt is cleared once, check the board's firmware"),
    errno.EIO: Failure(LinkLost, _AGAIN),
    errno.ENODEV: Failure(LinkLost, _AGAIN),
    errno.EACCES: Failure(LinkAccess, _RIGHTS),
    errno.EBUSY: Failure(LinkAccess, _OWNER),
}
OTHERWISE = Failure(LinkLost, _AGAIN)


def link_error(action: str, error: Exception) -> LinkError:
    """The LinkError for `error`, which pyusb raised while trying to `action`; to be raised from it."""
    number = getattr(error, "errno", None)
    kind, remedy = FAILURES.get(number, OTHERWISE)
    return kind(f"cannot {action}: {getattr(error, 'strerror', None) or error} (errno {number}); {remedy}")
