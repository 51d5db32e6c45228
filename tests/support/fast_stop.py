"""`hapticd stop` reaches everything that moves: every live daemon of this user and the service.
Stale files, other users' daemons and hung processes do not prevent it. It names the daemons it
stopped.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hapticd.mailbox.servo_side import ServoMailbox


@contextmanager
def servo(folder: Path, device: str = "", simulated: bool = True) -> Iterator[ServoMailbox]:
    """Yield a live servo that has reported its device; its loop does not run."""
    mailbox = ServoMailbox(folder, 1000.0, "", simulated, 5)
    mailbox.report({"device": device, "simulated": simulated})
    mailbox.publish()
    try:
        yield mailbox
    finally:
        mailbox.close()
