"""The connection to the board: checks before it may make force, loss, search, and return.

Checks (`check_board`). All run once at every connection. The board's identity is read again
whenever its firmware has restarted, because the board may have been flashed. No check may run
between two ticks of a servo that renders: it exchanges frames, and each request may take 100 ms.

Two results bar force as long as this board is connected. The hello contradicts the device file, or
the bus is too slow for the rate of the servo (both: `usb.search`). Each is reported by name. Every
sample carries them as host flags, so a replay has them too. The daemon keeps running, so that you
can read the results. A check that fails, or that has not run yet, bars force as well, and is
repeated.

Loss and return (`BoardConnection`). A missing board is searched for with back-off (`usb.search`).
Once it answers it is checked as at the start. A board that has restarted without leaving the bus
may make no force until it has been checked again. That check waits for a tick without force. All
results are written to servo.report.
"""

from math import nan
from typing import Any, Final, NamedTuple

from hapticd.core.errors import LinkError, MailboxError, WireError
from hapticd.core.params import ServoParams
from hapticd.core.units import NS_PER_S, Clock
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.servo.inbox import Inbox
from hapticd.servo.plan import (
    AMPLIFIER_TOLD,
    COMPENSATES,
    DEVICE_DIFFERS,
    GATEWAY_ALIVE,
    LINK_UP,
    NO_TEMPERATURE,
    RATE_NOT_HELD,
    TickConstants,
)
from hapticd.servo.watchdog_trial import ENABLE, WITHHELD
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST, backoff_s
from hapticd.usb.device import Device
from hapticd.usb.frames import Capability, HelloFrame, OutFlag
from hapticd.usb.search import (
    BoardSearch,
    Tell,
    Transport,
    differences,
    probe_shortage,
    settle_transport,
)

# --- checks ---------------------------------------------------------------------------------------

NOT_LOOKED_AT: Final = -1  # in place of the number of a life
STARTED_ANEW: Final = "the board has restarted and is not yet identified"

UNMEASURED: Final = "the bus could not be measured, so its maximum rate is unknown: {}"


class BoardCheck(NamedTuple):
    """The result of a check."""

    differences: tuple[str, ...] = ()  # between hello and device file, in words
    transport: Transport | None = None  # None: the link failed during the measurement
    host: int = 0  # host flags of every sample
    uncompensated: str = ""  # why a configured compensation of the winding's resistance is off
    hello: HelloFrame | None = None  # None: no board
    unsampled: str = ""  # why samples of probe and perturbation are lost at this rate
    lives: int = NOT_LOOKED_AT  # number of the board's life that was checked

    def barred(self, reason: str) -> "BoardCheck":
        """Return the check of a board that may make no force until it is identified, for that
        `reason`.
        """
        host = self.host | DEVICE_DIFFERS
        return self._replace(differences=(reason,), host=host, lives=NOT_LOOKED_AT)

    def report(self) -> dict[str, Any]:
        """Return the content for servo.report."""
        transport = None if self.transport is None else self.transport._asdict()
        board = {} if self.hello is None else self.hello._asdict()
        if self.hello is not None:
            board |= {
                "protocol_hash": self.hello.protocol_hash.hex(),
                "firmware": self.hello.firmware,
            }
        return {
            "board": board,
            "differences": list(self.differences),
            "transport": transport,
            "uncompensated": self.uncompensated,
            "unsampled": self.unsampled,
        }


def check_board(device: Device, params: ServoParams, clock: Clock) -> BoardCheck:
    """Check the board that `device` has greeted; the result is empty without one."""
    hello = device.hello
    if hello is None:
        return BoardCheck()
    lives = device.counts["lives"]
    try:
        transport = settle_transport(device, clock)
    except LinkError as error:
        return compared(hello, params, None).barred(UNMEASURED.format(error))
    return compared(hello, params, transport)._replace(lives=lives)


def check_again(
    device: Device, params: ServoParams, clock: Clock, before: BoardCheck
) -> BoardCheck:
    """Check the board of `before` again, after it has restarted or was not checked yet. Its bus is
    measured if that failed before.
    """
    lives = device.counts["lives"]
    try:
        hello = device.greet()
        device.keep_phase()
        if before.transport is None:
            device.begin()
            return check_board(device, params, clock)
    except (LinkError, WireError) as error:
        return before.barred(str(error))
    return compared(hello, params, before.transport)._replace(lives=lives)


def compared(hello: HelloFrame, params: ServoParams, transport: Transport | None) -> BoardCheck:
    """Return the check of a board with this `hello`, on a bus with that `transport`, against
    `params`.
    """
    found = differences(hello, params.device)
    host = DEVICE_DIFFERS if found else 0
    if transport is not None and transport.rate_hz < params.realtime.rate_hz:
        host |= RATE_NOT_HELD
    if hello.capabilities & Capability.AMPLIFIER_READY:
        host |= AMPLIFIER_TOLD
    if not hello.capabilities & Capability.TEMPERATURE:
        host |= NO_TEMPERATURE
    reason = uncompensated(hello.capabilities)
    if not reason:
        host |= COMPENSATES
    uncompensated_for = reason if params.device.resistance else ""
    probes = hello.capabilities & Capability.PROBE
    unsampled = probe_shortage(params.realtime.rate_hz) if probes else ""
    return BoardCheck(found, transport, host, uncompensated_for, hello, unsampled)


def uncompensated(capabilities: int) -> str:
    """Return why a board with these capabilities gets resistance count 0; empty if it accepts
    others.
    """
    if capabilities & Capability.RESISTANCE_TRACKED:
        return "the board follows the winding's resistance by itself"
    if not capabilities & Capability.RESISTANCE:
        return (
            "the board has no resistance DAC: damping and force get weaker as the winding warms up"
        )
    return ""


# --- loss and return ------------------------------------------------------------------------------


class BoardConnection:
    """The board of `device`: `linked` while it is there, and the result of its last `check`. `tell`
    is called with the reason why it is not back, and with "" once it is.
    """

    def __init__(
        self,
        params: ServoParams,
        device: Device,
        mailbox: ServoMailbox,
        clock: Clock,
        inbox: Inbox,
        tell: Tell,
    ) -> None:
        self._params = params
        self._device = device
        self._mailbox = mailbox
        self._clock = clock
        self._inbox = inbox
        self.tell = tell
        self._search = BoardSearch(device, self._told)
        self._looks = 0  # consecutive failed checks of this board
        self._look_ns = 0  # time of the next check
        self.linked = device.hello is not None
        self.check = check_board(device, params, clock)
        self._note_look()

    @property
    def host(self) -> int:
        """The host flags without a fault."""
        return LINK_UP | GATEWAY_ALIVE | self.check.host

    def sensor_lines(self) -> tuple[tuple[float, float], ...]:
        """Return slope and intercept of value = count * slope + intercept, for temperature,
        current, voltage and back-EMF velocity. NaN where the board does not measure.
        """
        device = self._params.device
        scales = (device.temperature, device.current, device.voltage, device.emf_velocity)
        heat, *others = (
            (scale.to_value(1.0) - scale.to_value(0.0), scale.to_value(0.0)) for scale in scales
        )
        return (0.0, nan) if self.check.host & NO_TEMPERATURE else heat, *others

    def lose(self, now_ns: int) -> None:
        """Release a lost board, and start the search for it."""
        self.linked = False
        self._device.close()
        self._search.begin(now_ns)

    def look_for(self, now_ns: int) -> bool:
        """Search for the board when due; return whether it answers again. Its filters restart with
        the next frame, and the state stays latched.
        """
        hello = self._search.look(now_ns)
        if hello is None:
            return False
        self.linked = True
        self._mailbox.count("reconnects")
        self.check = check_board(self._device, self._params, self._clock)
        self._note_look()
        self._report({"reconnected": hello.serial, **self.check.report()})
        return True

    def seed(self) -> None:
        """Note the first frame of a link, or of a board that has restarted on the bus and may have
        been flashed.
        """
        self._note_look()
        if self._inbox.unlooked:
            self.check = self.check.barred(STARTED_ANEW)

    def look_again(self, out_flags: int, period_ns: int) -> bool:
        """Check the board again unless force acts, because each request may take 100 ms. Return
        whether it took longer than a tick; `out_flags` are those of the last one.
        """
        began_ns = self._clock.now_ns()
        if out_flags & (ENABLE | WITHHELD) or not self.linked or began_ns < self._look_ns:
            return False
        self.check = check_again(self._device, self._params, self._clock, self.check)
        now_ns = self._clock.now_ns()
        self._note_look()
        self._looks = self._looks + 1 if self._inbox.unlooked else 0
        self._look_ns = now_ns + int(backoff_s(self._looks) * NS_PER_S) if self._looks else 0
        self._report(self.check.report())
        return now_ns - began_ns > period_ns

    def let_go(self, settled: TickConstants) -> None:
        """Send a frame without torque that keeps the damping, and release the board. Its watchdog
        holds the damping and releases it, as after a crash.
        """
        zero = self._params.device.force.to_count(0.0, I16_LOWEST, I16_HIGHEST)
        try:
            if self.linked:
                self._device.link.drain()  # the transfer of the last tick
                self._device.send(
                    OutFlag.FIFO_CLEAR.value, zero, settled.damping_count, settled.resistance_count
                )
        except LinkError:
            pass  # it is gone; its watchdog does the same
        self._device.close()

    def _note_look(self) -> None:
        self._inbox.unlooked = self.check.lives != self._device.counts["lives"]
        self._inbox.waiting |= self._inbox.unlooked

    def _told(self, reason: str) -> None:
        """Report why the board is not back, "" once it is."""
        self._report({"waiting_for": reason})
        self.tell(reason)

    def _report(self, news: dict[str, Any]) -> None:
        try:
            self._mailbox.report(self._mailbox.last_report | news)
        except MailboxError:
            pass  # no room for the report: the counters show that a board came back
