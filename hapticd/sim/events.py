"""The event pins of the simulated firmware: a code of 16 bits, whose changes are events.

Every change is an event, also the one back to 0; a constant code is none. Events are numbered
modulo 256 and shown to the host one at a time, oldest first. The next one follows when the host has
taken EVENT_FRAMES frames with the one before, so a lost frame loses no event. Of more than
EVENT_DEPTH events the oldest are lost; the step of the number gives their count. The last one
stays.

A frame that is counted as taken must show its event.
"""

from collections import deque
from typing import NamedTuple

from hapticd.usb.frames import EVENT_DEPTH, EVENT_FRAMES

LONG_AGO = -(1 << 62)  # substep of the code present at power-up
NUMBERS = 256


class PinEvent(NamedTuple):
    """A change of the code."""

    number: int
    code: int
    substep: int  # at which it happened


class EventPins:
    """State of the pins, and the events not yet shown to the host."""

    __slots__ = ("_code", "_taken", "_waiting")

    def __init__(self) -> None:
        self._code = 0
        self.power_up()

    def power_up(self) -> None:
        """Restart the numbering, from the present code."""
        self._waiting = deque([PinEvent(0, self._code, LONG_AGO)], maxlen=EVENT_DEPTH)
        self._taken = 0

    def change(self, code: int, substep: int) -> None:
        """Set the pins to `code` from `substep` on."""
        if code == self._code:
            return
        self._code = code
        if len(self._waiting) == EVENT_DEPTH:
            self._taken = 0  # the shown event is lost
        self._waiting.append(PinEvent((self._waiting[-1].number + 1) % NUMBERS, code, substep))

    def forget(self) -> None:
        """Drop all events but the newest: no host saw them."""
        while len(self._waiting) > 1:
            self._advance()

    def shown(self) -> PinEvent:
        """Return the event for a frame latched now."""
        if self._taken >= EVENT_FRAMES and len(self._waiting) > 1:
            self._advance()
        return self._waiting[0]

    def taken(self, number: int) -> None:
        """Note that the host took a frame with event `number`."""
        if number == self._waiting[0].number:
            self._taken += 1

    def _advance(self) -> None:
        self._waiting.popleft()
        self._taken = 0
