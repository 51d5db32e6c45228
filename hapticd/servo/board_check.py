"""Checks of a board before it may make force.

All checks run once at every connection. The board's identity is read again whenever its firmware
has restarted, because the board may have been flashed.

Two results bar force as long as this board is connected, and each is reported by name: the hello
contradicts the device file (`usb.search`), or the bus is too slow for the rate of the servo
(`usb.search`). Every sample carries them as host flags, so a replay has them too. The daemon
keeps running, so that you can read the results. A check that fails, or that has not run yet, bars
force as well, and is repeated.

No call may come between two ticks of a servo that renders (a check exchanges frames, and a request
may take 100 ms).
"""

from typing import Any, Final, NamedTuple

from hapticd.core.clock import Clock
from hapticd.core.errors import LinkError, WireError
from hapticd.core.params import ServoParams
from hapticd.servo.plan import (
    AMPLIFIER_TOLD,
    COMPENSATES,
    DEVICE_DIFFERS,
    NO_TEMPERATURE,
    RATE_NOT_HELD,
)
from hapticd.usb.device import Device
from hapticd.usb.frames import Capability, HelloFrame
from hapticd.usb.search import Transport, differences, probe_shortage, settle_transport

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
