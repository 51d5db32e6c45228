"""Events at the board's pins, with their times on the clock of the samples.

An event is a sync pulse or a code of a stimulus computer, an EEG amplifier or an eye tracker. Every
frame contains one event: its number, its code, and its age at the latch. The board repeats each in
two frames, so a lost frame loses no event. An event counts once, when its number first appears. A
step of more than 1 gives the number of lost events; the number has 8 bits, so a loss of 256 events
is not detected. The event in the first frame of a life of the board happened before it and is not
recorded. A board that returns in the same life continues its numbers.

The time is that of the change, by the board's clock, like `board_us` of the sample: the two need no
clock of the host. An age at the end of its 16 bits gives no time.
"""

from hapticd.usb.codec import HEAD_EVENT_AGE, HEAD_EVENT_CODE, HEAD_EVENT_SEQ, U16_HIGHEST

__all__ = ["NO_CODE", "NO_TIME_US"]

NUMBERS = 256
NO_CODE = -1
NO_TIME_US = -1
LOST_MASK = 0xFFFFFFFF  # a count of the record
NO_EVENT = (NO_TIME_US, NO_CODE)


class PinEvents:
    """The events of one board. `seen` is the number of the newest one, `lost` the number of missed
    ones; a board that is not `able` has none.
    """

    __slots__ = ("able", "lost", "seen")

    def __init__(self) -> None:
        self.able = False
        self.seen = 0
        self.lost = 0

    def take(self, head: tuple[int, ...], board_us: int) -> tuple[int, int]:
        """Return time [us] and code of the event of `head`, latched at `board_us`, with a number
        other than `seen`.
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
