"""Notifications to systemd, and the servo's watchdog feeder.

systemd receives one datagram on the socket that it provides; without systemd nothing is sent.

The feeder (`python -m hapticd.run.watchdog FOLDER --parent PID`) is a small process in the servo's
unit. systemd accepts WATCHDOG=1 only from processes of the unit, so the gateway cannot send it. The
servo's only thread must not send it, for a datagram costs more than a tick. This process reads the
head of the telemetry ring four times within the watchdog time and feeds the watchdog if the head
has advanced. This proves that ticks happen, not only that a process exists (ADR-0021).

It maps the ring for reading, starts before the servo takes real-time rights (so it has none), and
dies with the servo. It uses only the standard library.

The ring must not be replaced while the servo lives (a servo makes it once), and the unit must not
have NotifyAccess=main.
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path

from hapticd.core.errors import MailboxError
from hapticd.core.process import die_with_parent
from hapticd.core.units import NS_PER_US, Clock, MonotonicClock
from hapticd.mailbox import files, layout


def notify(*lines: str) -> None:
    """Send `lines` to $NOTIFY_SOCKET, if it is set.

    hapticd sends READY=1, STATUS=..., WATCHDOG=1 and STOPPING=1.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    import socket  # a process without systemd does not load it

    if address.startswith("@"):
        address = f"\0{address[1:]}"  # a socket in the abstract namespace
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as service:
        service.sendto("\n".join(lines).encode(), address)


def feeding_period_ns() -> int:
    """Return a quarter of the interval of systemd's watchdog between two WATCHDOG=1; 0
    without one.
    """
    return int(os.environ.get("WATCHDOG_USEC", "0")) * NS_PER_US // 4


class Feeder:
    """Feed the watchdog of a process that calls `feed` often, and no more often than needed."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._period_ns = feeding_period_ns()
        self._fed_ns = 0

    def feed(self) -> None:
        """Send WATCHDOG=1 if due; nothing without a watchdog."""
        now_ns = self._clock.now_ns()
        if self._period_ns and now_ns - self._fed_ns >= self._period_ns:
            self._fed_ns = now_ns
            notify("WATCHDOG=1")


def start_feeder(folder: Path) -> int | None:
    """Start the feeder of the servo in this process, whose ring is in `folder`.

    Return its pid; None if systemd announces no watchdog.
    """
    if not feeding_period_ns():
        return None
    command = [sys.executable, "-P", "-m", __name__, str(folder), "--parent", str(os.getpid())]
    return os.posix_spawn(sys.executable, command, os.environ)


def watch(
    head: Callable[[], int],
    feed: Callable[[], None],
    clock: Clock,
    period_ns: int,
    looks: int | None = None,
) -> None:
    """Read `head()` every `period_ns`, and call `feed()` whenever it has advanced.

    `looks` is the number of reads; None: endless.
    """
    last = head()
    while looks != 0:
        clock.sleep_until_ns(clock.now_ns() + period_ns)
        newest = head()
        if newest != last:
            feed()
        last = newest
        looks = None if looks is None else looks - 1


def main(arguments: list[str]) -> int:
    """Feed until the servo ends; return the exit code."""
    folder, _, parent = arguments
    die_with_parent(int(parent))
    try:
        ring = files.open_map(
            Path(folder) / files.TELEMETRY, layout.TELEMETRY_BYTES, writable=False
        )
    except MailboxError as error:
        os.write(2, f"hapticd watchdog: {error}\n".encode())
        return error.exit_code
    # reads need no ordering here: only the motion of the head matters
    words = memoryview(ring).cast("Q")
    watch(
        lambda: words[layout.TELEMETRY_HEAD_WORD],
        lambda: notify("WATCHDOG=1"),
        MonotonicClock(),
        feeding_period_ns(),
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
