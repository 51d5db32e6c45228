"""Start servo and gateway from their settings, keep them running, and end them in order.

Processes (`Supervisor`). Their order:

    servo started -> its mailbox is published -> gateway started -> it serves -> ready
    stop          -> servo ends (force fades to 0, files removed) -> gateway ends
                  -> own files removed

A child is started by exec, never forked from a process with threads or a large heap. It gets its
own process group, so that Ctrl-C in a terminal reaches only the supervisor and the shutdown is in
order. It dies with its parent.

The gateway survives the death of a servo, and vice versa. A servo is restarted up to 3 times within
60 s, and is then disabled, whatever its earlier state. A process that never became ready is not
restarted, nor a servo that reports a wrong configuration. A gateway that has served once is
restarted without limit, with growing pauses. An external cause must not end the servo, which is
safe without a gateway (ADR-0021). The first signal ends in order, a second one kills. The
supervisor prints nothing: progress goes to a callback.

The operators' page is a third child, started once the two serve. No safety function depends on it:
it is restarted like a gateway, and if it never served, this is reported and it is left out.

A second supervisor in the folder is refused (by its claim). Every wait must check signals: it is a
poll of POLL_NS.

Settings (`resolve`, `write`). They become servo.json, board.json, gateway.json and guard.json in
the runtime folder. The processes start from these files alone: they read no TOML and load no
pydantic.

`to_plain` and `from_plain` must preserve every parameter to the last bit.
"""

import json
import os
import signal
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from hapticd.core.errors import ConfigError, HapticdError, MailboxError
from hapticd.core.params import EnvironmentLimits, GatewaySetup, ServoParams, to_plain
from hapticd.core.process import launch
from hapticd.core.units import NS_PER_MS, NS_PER_S, Clock
from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import console_place
from hapticd.model.params import GuardSetup
from hapticd.protocol.limits import WIDEST, CommandLimits, environment_limits
from hapticd.settings.build import (
    board_params,
    gateway_params,
    guard_params,
    servo_params,
)
from hapticd.settings.load import Settings
from hapticd.settings.scene import guard_setup

__all__ = ["ProcessEvent", "Supervisor", "resolve", "write"]

# --- settings -------------------------------------------------------------------------------------
CONFIGURED = {
    "K": "environment.stiffness_n_per_m",
    "B": "environment.virtual_damping_ns_per_m",
    "M": "environment.mass_kg",
}
WRITTEN = (files.SERVO_JSON, files.BOARD_JSON, files.GATEWAY_JSON, files.GUARD_JSON)


def resolve(settings: Settings, instance: str) -> dict[str, Any]:
    """Return the content of each file, by its name. A real board has no board.json. ConfigError if
    the environment at start is beyond the limits for clients.
    """
    board = board_params(settings)
    unbounded = servo_params(settings, instance)
    guard = guard_setup(settings, unbounded, WIDEST)
    limits = _limits(settings, guard)
    _refuse_beyond(limits, settings, unbounded)
    servo = replace(unbounded, device=replace(unbounded.device, environment_limits=limits))
    setup = GatewaySetup(
        servo, gateway_params(settings), guard_params(settings), settings.config.lease
    )
    plain = {
        files.SERVO_JSON: to_plain(servo),
        files.GATEWAY_JSON: to_plain(setup),
        files.GUARD_JSON: to_plain(replace(guard, limits=limits)),
    }
    return plain if board is None else {**plain, files.BOARD_JSON: to_plain(board)}


def _limits(settings: Settings, guard: GuardSetup) -> EnvironmentLimits:
    """Return the limits of K, B and M for clients, from the [model] of the device file."""
    if settings.device.model is None:
        return environment_limits({})
    from hapticd.guard.safe_region import ranges_of  # numpy, already loaded for the guard's model

    return environment_limits(ranges_of(guard))


def _refuse_beyond(limits: EnvironmentLimits, settings: Settings, servo: ServoParams) -> None:
    known = CommandLimits(
        servo.realtime.rate_hz, servo.device.active_damping_limit_ns_per_m, limits
    )
    environment = servo.environment
    broken = [
        f"{settings.origins[place]}: {known.complaint(axis, value, place)}"
        for axis, place in CONFIGURED.items()
        if not known.allows(axis, value := getattr(environment, place.partition(".")[2]))
    ]
    if broken:
        raise ConfigError("\n".join(broken))


def write(folder: Path, settings: Settings, instance: str) -> dict[str, Path]:
    """Write the files into `folder`, which is created and checked; return the path of each file
    written.

    Each file is written completely or not at all, and is never missing: under systemd both units
    write before they start. An old board.json is removed if the board is now real. MailboxError if
    the folder belongs to another user or is full.
    """
    files.prepare_folder(folder)
    plain = resolve(settings, instance)
    if files.BOARD_JSON not in plain:
        files.remove(folder, files.BOARD_JSON)
    texts = {name: json.dumps(content, indent=1) + "\n" for name, content in plain.items()}
    return {name: files.write_whole(folder / name, text) for name, text in texts.items()}


# --- processes ------------------------------------------------------------------------------------
CONSOLE = ("hapticd", "console", "--instance")  # a verb, so that no web server is loaded here
SUPERVISOR_LOCK = "supervisor.lock"
POLL_NS = 20 * NS_PER_MS
# until a process that is not ready is reported, and until one that does not end is killed
PATIENCE_NS = 5 * NS_PER_S
RESTARTS_MAX = 3  # of the servo, within WINDOW_NS
WINDOW_NS = 60 * NS_PER_S
FIRST_PAUSE_NS = NS_PER_S // 2  # doubled with each restart within the window
LONGEST_PAUSE_NS = 8 * NS_PER_S


class Process(Protocol):
    """The part of subprocess.Popen used here."""

    pid: int

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""

    def terminate(self) -> None:
        """Ask it to end."""

    def kill(self) -> None:
        """End it at once."""


Spawn = Callable[[Sequence[str], int], Process]  # module and arguments, descriptor to inherit


def spawn(command: Sequence[str], ready: int) -> Process:
    """Start a child that inherits the descriptor `ready`."""
    return launch(*command, "--parent", str(os.getpid()), "--ready", str(ready), keep=(ready,))


class Restarts:
    """At most `most` restarts within 60 s (None: any number), after 0.5, 1, 2, 4 and then 8 s."""

    def __init__(self, most: int | None = RESTARTS_MAX) -> None:
        self.most = most
        self._times: deque[int] = deque()

    def next_ns(self, now_ns: int) -> int | None:
        """Return the time of the next permitted start after a death at `now_ns`; None: no more."""
        while self._times and now_ns - self._times[0] > WINDOW_NS:
            self._times.popleft()
        if self.most is not None and len(self._times) >= self.most:
            return None
        pause_ns = min(FIRST_PAUSE_NS << len(self._times), LONGEST_PAUSE_NS)
        self._times.append(now_ns)
        return now_ns + pause_ns

    @property
    def used(self) -> int:
        """Number of restarts within the window."""
        return len(self._times)


class Child:
    """A child process: servo, gateway or console."""

    def __init__(self, name: str, command: Sequence[str], start: Spawn, restarts: Restarts) -> None:
        self.name = name
        self.command = command
        self._spawn = start
        self.process: Process | None = None
        self.restarts = restarts
        self.start_at_ns: int | None = 0  # time of its start; None: it runs
        self.ready = False  # since its last start
        self.was_ready = False  # ever
        self._pipe: int | None = None

    def start(self) -> None:
        """Start the process now."""
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
        """Return the exit code of a child that died; None if it runs or a start is planned."""
        if self.process is None or self.start_at_ns is not None:
            return None
        return self.process.poll()

    def alive(self) -> bool:
        """Return whether its process exists."""
        return self.process is not None and self.process.poll() is None

    def note_ready(self, is_ready: Callable[[Process], bool]) -> None:
        """Call `is_ready` until it returns True, and note the result."""
        if self.process is not None and self.start_at_ns is None and not self.ready:
            self.ready = is_ready(self.process)
            self.was_ready |= self.ready

    def said_ready(self) -> bool:
        """Return whether it wrote its byte to the pipe since its start."""
        try:
            return self._pipe is not None and bool(os.read(self._pipe, 1))
        except BlockingIOError:
            return False

    def forget(self) -> None:
        """Free the resources of a child that ended."""
        self._close_pipe()
        self.process = None

    def _close_pipe(self) -> None:
        if self._pipe is not None:
            os.close(self._pipe)
        self._pipe = None


def mailbox_served(folder: Path, pid: int) -> bool:
    """Return whether the servo process `pid` has published its mailbox in `folder`."""
    try:
        page = files.open_map(folder / files.MAILBOX, layout.MAILBOX_BYTES, writable=False)
    except MailboxError:
        return False
    header = layout.HEADER.unpack_from(page, 0)
    return memoryview(page).cast("Q")[layout.EPOCH_WORD] != 0 and header[layout.HEADER_PID] == pid


class ProcessEvent(NamedTuple):
    """Argument of a progress callback."""

    kind: str  # starting | waiting | ready | restart | page | failed | ending | killed | ended
    process: str  # servo | gateway | console; empty for both
    text: str  # one line for a user


class Supervisor:
    """The processes of `instance`, in the runtime folder `folder`, with `settings`; `console`: with
    the operators' page.
    """

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        instance: str,
        clock: Clock,
        tell: Callable[[ProcessEvent], None],
        start: Spawn = spawn,
        served: Callable[[Path, int], bool] = mailbox_served,
        console: bool = False,
    ) -> None:
        self.folder = folder
        self.clock = clock
        self.tell = tell
        self._served = served
        self._settings = settings
        self._instance = instance
        paths = [str(folder / files.SERVO_JSON)]
        if settings.device.simulated:
            paths.append(str(folder / files.BOARD_JSON))
        self.servo = Child("servo", ["hapticd.run.servo_main", *paths], start, Restarts())
        self.gateway = Child(
            "gateway", ["hapticd.run.gateway_main", str(folder)], start, Restarts(None)
        )
        self.console = (
            Child("console", [*CONSOLE, instance], start, Restarts(None)) if console else None
        )
        self.ready = False
        self._asked = 0
        self._impatient_ns: int | None = None

    def stop(self) -> None:
        """End in order; kill on the second call. May be called from a signal handler."""
        self._asked += 1

    def run(self) -> None:
        """Serve until `stop`.

        MailboxError if another supervisor has the folder; ConfigError or HapticdError if a process
        could not be kept running.
        """
        files.prepare_folder(self.folder)
        # before any file is touched, since the files may belong to another supervisor
        claim = files.claim(self.folder, SUPERVISOR_LOCK)
        try:
            write(self.folder, self._settings, self._instance)
            while not self._asked:
                self._look(self.clock.now_ns())
                self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS)
        finally:
            for child in filter(None, (self.servo, self.gateway, self.console)):
                self._end(child)
            files.remove(self.folder, *WRITTEN, files.CONSOLE, files.GUARD_TERMS)
            files.release(self.folder, SUPERVISOR_LOCK, claim)
        self.tell(ProcessEvent("ended", "", "ended: no force, both processes gone"))

    def _look(self, now_ns: int) -> None:
        """Poll once: dead children, due starts, readiness."""
        for child in (self.servo, self.gateway):
            if (code := child.died()) is not None:
                self._bury(child, code, now_ns)
        self._start_if_due(self.servo, now_ns)
        self.servo.note_ready(lambda process: self._served(self.folder, process.pid))
        if self.servo.was_ready:
            self._start_if_due(self.gateway, now_ns)
        self.gateway.note_ready(lambda _process: self.gateway.said_ready())
        self._tell_readiness(now_ns)
        if self.console is not None:
            self._look_after_page(self.console, now_ns)

    def _look_after_page(self, page: Child, now_ns: int) -> None:
        if (code := page.died()) is not None and not page.was_ready:
            text = f"no operators' page (exit code {code}); the daemon runs without it"
            self.tell(ProcessEvent("failed", "console", text))
            page.forget()
            self.console = None
        elif code is not None:
            self._bury(page, code, now_ns)
        elif self.gateway.was_ready and page.start_at_ns is not None:
            if now_ns >= page.start_at_ns:
                page.start()
        elif not page.ready:
            page.note_ready(lambda _process: page.said_ready())
            self._tell_page(page)

    def _tell_page(self, page: Child) -> None:
        place = console_place(self.folder) if page.ready else None
        if place is not None:
            self.tell(ProcessEvent("page", "console", f"operators' page: {place['url']}"))

    def _start_if_due(self, child: Child, now_ns: int) -> None:
        if child.start_at_ns is not None and now_ns >= child.start_at_ns:
            self.tell(ProcessEvent("starting", child.name, f"starting the {child.name}"))
            child.start()
            self._impatient_ns = now_ns + PATIENCE_NS

    def _tell_readiness(self, now_ns: int) -> None:
        ready = self.servo.ready and self.gateway.ready
        if ready and not self.ready:
            self.tell(ProcessEvent("ready", "", "servo and gateway are ready"))
        elif not ready and self._impatient_ns is not None and now_ns >= self._impatient_ns:
            board = "the servo (is the board plugged in and switched on?)"
            missing = "the gateway" if self.servo.ready else board
            self.tell(ProcessEvent("waiting", "", f"still waiting for {missing}"))
            self._impatient_ns = None
        self.ready = ready

    def _bury(self, child: Child, code: int, now_ns: int) -> None:
        """Plan the restart of a child that died, or raise with the reason against it."""
        child.ready = False
        how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        # a later failure of a gateway or page (keys, a port) does not come from these files
        served = child is not self.servo and child.was_ready
        if code == ConfigError.exit_code and not served:
            raise ConfigError(
                f"the {child.name} refused its configuration ({how}); see its message above"
            )
        if not child.was_ready:
            raise HapticdError(f"the {child.name} could not start ({how}); see its message above")
        child.start_at_ns = child.restarts.next_ns(now_ns)
        if child.start_at_ns is None:
            raise HapticdError(
                f"the {child.name} died {RESTARTS_MAX + 1} times within {WINDOW_NS // NS_PER_S} s"
                f" ({how} at last); giving up"
            )
        count = f" of {child.restarts.most}" if child.restarts.most else ""
        outlook = "disabled" if child is self.servo else "the servo stays"
        text = (
            f"the {child.name} died ({how}); restart {child.restarts.used}{count} in"
            f" {(child.start_at_ns - now_ns) / NS_PER_S} s, {outlook}"
        )
        self.tell(ProcessEvent("restart", child.name, text))

    def _end(self, child: Child) -> None:
        """End a child in order; kill it if it does not end in time or `stop` was called twice."""
        process = child.process
        if process is not None and child.alive():
            self.tell(ProcessEvent("ending", child.name, f"ending the {child.name}"))
            process.terminate()
            self._await_end(child, self.clock.now_ns() + PATIENCE_NS)
            if child.alive():
                process.kill()
                text = f"killed the {child.name}: it did not end in time"
                self.tell(ProcessEvent("killed", child.name, text))
            while child.alive():
                self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS)
        child.forget()

    def _await_end(self, child: Child, deadline_ns: int) -> None:
        while child.alive() and self._asked < 2 and self.clock.now_ns() < deadline_ns:
            self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS)
