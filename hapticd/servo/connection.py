"""The connection to the board: loss, search, return, and the check of a board that has restarted.

A missing board is searched for with back-off (`usb.search`). Once it answers it is checked as at
the start (`servo.board_check`). A board that has restarted without leaving the bus may have been
flashed, and may make no force until it has been checked again. That check waits for a tick without
force, because each of its requests may take 100 ms. All results are written to servo.report.

No check may run in a tick that renders.
"""

from math import nan
from typing import Any

from hapticd.core.clock import Clock
from hapticd.core.errors import LinkError, MailboxError
from hapticd.core.params import ServoParams
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.servo.board_check import STARTED_ANEW, check_again, check_board
from hapticd.servo.inbox import Inbox
from hapticd.servo.plan import GATEWAY_ALIVE, LINK_UP, NO_TEMPERATURE, TickConstants
from hapticd.servo.watchdog_trial import ENABLE, WITHHELD
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST, backoff_s
from hapticd.usb.device import Device
from hapticd.usb.frames import OutFlag
from hapticd.usb.search import BoardSearch, Tell


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
