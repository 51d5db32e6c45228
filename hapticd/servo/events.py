"""Events at the board's pins: a sync pulse or a code of a stimulus computer, an EEG amplifier or an
eye tracker, with its time on the clock of the samples.

Every frame shows one event: its number, its code, and its age at the latch. The board shows each
in two frames that were taken, so a lost frame loses no event. An event counts once, when its number
is first seen. A step of more than 1 tells how many events were lost between; the number has 8 bits,
so a loss of 256 events is not seen. The event in the first frame of a link, or of a life of the
board, happened before it and is not recorded.

The time is that of the change, by the board's clock, as `board_us` is that of the sample: the two
need no clock of the host. An age that has reached the end of its 16 bits gives no time.
"""

from typing import NamedTuple

from hapticd.link.device import Head
from hapticd.wire.codec import HEAD_EVENT_AGE, HEAD_EVENT_CODE, HEAD_EVENT_SEQ, U16_HIGHEST

NUMBERS = 256
NO_CODE = -1
NO_TIME_US = -1
LOST_MASK = 0xFFFFFFFF  # a count of the record


class Event(NamedTuple):
    """What a tick has to record."""

    time_us: int  # on the board's clock, NO_TIME_US: unknown
    code: int
    lost: int  # events just before this one


def event_in(head: Head, seen: int, board_us: int) -> Event:
    """The event of `head`, latched at `board_us`, after event number `seen`."""
    lost = (head[HEAD_EVENT_SEQ] - seen - 1) % NUMBERS
    age_us = head[HEAD_EVENT_AGE]
    known = age_us < U16_HIGHEST
    return Event(board_us - age_us if known else NO_TIME_US, head[HEAD_EVENT_CODE], lost)
