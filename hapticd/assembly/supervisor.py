"""Starts servo and gateway in order, keeps them running, and ends them in order. Silent: progress
goes to a callback.

    servo started -> its mailbox is published -> gateway started -> it serves -> ready asked to end
    -> servo ends (force to 0, disabled, files removed) -> gateway ends -> our files removed

Rules. The gateway outlives a servo that dies and the other way round; each may come back 3 times
within 60 s, and a servo that comes back is disabled, whatever it was before. A process that never
became ready is not tried again, nor one that says its configuration is wrong. The first signal ends
in order, a second one kills.

What would break it: a second supervisor in the folder (its claim is refused), or waiting without
looking at signals: every wait here is a poll of POLL_NS.
"""

import signal
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hapticd.assembly import resolve
from hapticd.assembly.child import RESTARTS_MAX, WINDOW_NS, Child, Spawn, mailbox_served, spawn
from hapticd.clock import Clock
from hapticd.errors import ConfigError, HapticdError
from hapticd.mailbox import files
from hapticd.settings.load import Settings
from hapticd.units import NS_PER_MS, NS_PER_S

SUPERVISOR_LOCK = "supervisor.lock"
POLL_NS = 20 * NS_PER_MS
PATIENCE_NS = (
    5 * NS_PER_S
)  # until a missing readiness is told, and until an ending process is killed


class Event(NamedTuple):
    """Progress: `starting`, `waiting`, `ready`, `restart`, `ending`, `killed`, `ended`; which
    process, and what to say.
    """

    kind: str
    process: str
    text: str


class Supervisor:
    """The two processes of `instance` in the runtime folder `folder`, with the parameters that
    `settings` resolve to.
    """

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        instance: str,
        clock: Clock,
        tell: Callable[[Event], None],
        start: Spawn = spawn,
        served: Callable[[Path, int], bool] = mailbox_served,
    ) -> None:
        self.folder = folder
        self.clock = clock
        self.tell = tell
        self._served = served
        self._settings = settings
        self._instance = instance
        names = (
            [files.SERVO_JSON, files.BOARD_JSON]
            if settings.device.simulated
            else [files.SERVO_JSON]
        )
        self.servo = Child(
            "servo", ["hapticd.assembly.servo_main", *(str(folder / name) for name in names)], start
        )
        self.gateway = Child("gateway", ["hapticd.assembly.gateway_main", str(folder)], start)
        self.ready = False
        self._asked = 0
        self._impatient_ns: int | None = None

    def stop(self) -> None:
        """End in order; asked twice, kill. May be called from a signal handler."""
        self._asked += 1

    def run(self) -> None:
        """Serve until `stop`. MailboxError: someone else does; ConfigError or HapticdError: a
        process could not be kept.
        """
        files.prepare_folder(self.folder)
        claim = files.claim(
            self.folder, SUPERVISOR_LOCK
        )  # before a file is touched: they may be someone else's
        try:
            resolve.write(self.folder, self._settings, self._instance)
            while not self._asked:
                self._look(self.clock.now_ns())
                self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS)
        finally:
            self._end(self.servo)
            self._end(self.gateway)
            files.remove(self.folder, files.SERVO_JSON, files.BOARD_JSON, files.GATEWAY_JSON)
            files.release(self.folder, SUPERVISOR_LOCK, claim)
        self.tell(Event("ended", "", "ended: force 0, disabled, both processes gone"))

    def _look(self, now_ns: int) -> None:
        for child in (self.servo, self.gateway):
            if (code := child.died()) is not None:
                self._bury(child, code, now_ns)
        self._start_if_due(self.servo, now_ns)
        self.servo.note_ready(lambda process: self._served(self.folder, process.pid))
        if self.servo.was_ready:
            self._start_if_due(self.gateway, now_ns)
        self.gateway.note_ready(lambda _process: self.gateway.said_ready())
        self._tell_readiness(now_ns)

    def _start_if_due(self, child: Child, now_ns: int) -> None:
        if child.start_at_ns is not None and now_ns >= child.start_at_ns:
            self.tell(Event("starting", child.name, f"starting the {child.name}"))
            child.start()
            self._impatient_ns = now_ns + PATIENCE_NS

    def _tell_readiness(self, now_ns: int) -> None:
        ready = self.servo.ready and self.gateway.ready
        if ready and not self.ready:
            self.tell(Event("ready", "", "servo and gateway are ready"))
        elif not ready and self._impatient_ns is not None and now_ns >= self._impatient_ns:
            reason = (
                "the gateway"
                if self.servo.ready
                else "the servo (is the board plugged in and switched on?)"
            )
            self.tell(Event("waiting", "", f"still waiting for {reason}"))
            self._impatient_ns = None
        self.ready = ready

    def _bury(self, child: Child, code: int, now_ns: int) -> None:
        child.ready = False
        how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        if code == ConfigError.exit_code:
            raise ConfigError(
                f"the {child.name} refused its configuration ({how}); see its message above"
            )
        if not child.was_ready:
            raise HapticdError(f"the {child.name} could not start ({how}); see its message above")
        child.start_at_ns = child.restarts.next_ns(now_ns)
        if child.start_at_ns is None:
            within_s = WINDOW_NS // NS_PER_S
            raise HapticdError(
                f"the {child.name} died {RESTARTS_MAX + 1} times within {within_s} s ({how} at"
                " last); giving up"
            )
        wait_s = (child.start_at_ns - now_ns) / NS_PER_S
        again = f"restart {child.restarts.used} of {RESTARTS_MAX} in {wait_s} s, disabled"
        self.tell(Event("restart", child.name, f"the {child.name} died ({how}); {again}"))

    def _end(self, child: Child) -> None:
        process = child.process
        if process is not None and child.alive():
            self.tell(Event("ending", child.name, f"ending the {child.name}"))
            process.terminate()
            deadline_ns = self.clock.now_ns() + PATIENCE_NS
            while child.alive() and self._asked < 2 and self.clock.now_ns() < deadline_ns:
                self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS)
            if child.alive():
                process.kill()
                self.tell(
                    Event("killed", child.name, f"killed the {child.name}: it did not end in time")
                )
            while child.alive():
                self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS)
        child.forget()
