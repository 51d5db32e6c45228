"""Events at the board's pins: a sync pulse or a code of a stimulus computer, an EEG amplifier or an
eye tracker, with its time on the clock of the samples.

Every frame shows one event: its number, its code, and its age at the latch. The board shows each
in two frames that were taken, so a lost frame loses no event. An event counts once, when its number
is first seen. A step of more than 1 tells how many events were lost between; the number has 8 bits,
so a loss of 256 events is not seen. The event in the first frame of a life of the board
happened before it and is not recorded. A board that was lost and comes back in the same life goes
on with its numbers.

The time is that of the change, by the board's clock, as `board_us` is that of the sample: the two
need no clock of the host. An age that has reached the end of its 16 bits gives no time.
"""

from hapticd.usb.codec import HEAD_EVENT_AGE, HEAD_EVENT_CODE, HEAD_EVENT_SEQ, U16_HIGHEST

__all__ = ["NO_CODE", "NO_TIME_US"]

NUMBERS = 256
NO_CODE = -1
NO_TIME_US = -1
LOST_MASK = 0xFFFFFFFF  # a count of the record
NO_EVENT = (NO_TIME_US, NO_CODE)


class PinEvents:
    """The events of one board. `seen` is the number of the newest one that was taken, `lost` how
    many were missed; a board that is not `able` has none.
    """

    __slots__ = ("able", "lost", "seen")

    def __init__(self) -> None:
        self.able = False
        self.seen = 0
        self.lost = 0

    def take(self, head: tuple[int, ...], board_us: int) -> tuple[int, int]:
        """Time [us] and code of the event of `head`, latched at `board_us`; its number is not
        `seen`.
        """
        number = head[HEAD_EVENT_SEQ]
        missed = (number - self.seen - 1) % NUMBERS
        self.seen = number
        if not self.able:
            return NO_EVENT
        self.lost = self.lost + missed & LOST_MASK
        age_us = head[HEAD_EVENT_AGE]
        time_us = board_us - age_us if age_us < U16_HIGHEST else NO_TIME_US
        return time_us, head[HEAD_EVENT_CODE]
