"""`hapticd stop` reaches what moves: every live daemon of this user and the service, past
leftovers, strangers and whatever hangs; and it says whom it has stopped.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hapticd.mailbox.servo_side import ServoMailbox


@contextmanager
def servo(folder: Path, device: str = "", simulated: bool = True) -> Iterator[ServoMailbox]:
    """A live servo that has said what it drives; nobody runs its loop."""
    mailbox = ServoMailbox(folder, 1000.0, "", simulated, 5)
    mailbox.report({"device": device, "simulated": simulated})
    mailbox.publish()
    try:
        yield mailbox
    finally:
        mailbox.close()
