"""Distinguish true motion of the handle from a glitch of the encoder.

A sample bends the motion by its second difference x_n - 2 x_{n-1} + x_{n-2}. A sample is doubted if
that exceeds limits.acceleration_m_per_s2. The law then gets the straight continuation, its state
stays as it was, and the next samples decide:

    it returned    the newest sample is on the straight line from before the doubt, or on a curve of
                   plausible acceleration: a glitch. Doubted samples count as lost, and the filters
                   get the positions between.
    it moved       the newest sample continues the doubted ones, bent little (a hand, a wall), or
                   bent the same way (a tap that lasts): true motion. The filters get every sample.
    still open     neither: it is doubted too.

A glitch ends soon, so its bends change sign: +g, -2g, +g. A tap bends one way for as long as it
lasts, whatever its strength; the speed limit bounds its total effect. A position that jumps and
stays bends by +g, -g: no handle moves like that either, and the doubt is not resolved.

Limitations: samples that are not one period apart (then all doubted samples are lost), or a handle
that is so light or struck so hard that it reverses within a period.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Final

from hapticd.core.params import ServoParams
from hapticd.render.law import LawState

MOST_DOUBTED: Final = 2  # samples in a row; one more is a fault
# times the bend that is accepted at once; forces at 500 m/s^2 on 8 g
ONE_WAY: Final = 2.0  # largest bend after one doubted sample; beyond it, only one way: 8 N
TAP: Final = 7.5  # after two, if all bend one way: 30 N
LEAST_SHARE: Final = 0.25  # first bend over the bend back; 0.5 without other motion
LEAST_COUNTS: Final = 8


class GlitchVerdict(Enum):
    """The nature of the doubted samples."""

    RETURNED = 1
    MOVED = 2
    OPEN = 3


def believed_bend_m(params: ServoParams) -> float:
    """Return the second difference of position [m] that is accepted at once. It is that of the
    device's limit, and at least some counts of the encoder at high rates.
    """
    device = params.device
    of_motion_m = device.acceleration_limit_m_per_s2 / params.realtime.rate_hz**2
    return max(of_motion_m, LEAST_COUNTS * device.position.per_count)


def verdict(law: LawState, doubted: Sequence[float], x: float, bend_m: float) -> GlitchVerdict:
    """Classify the positions `doubted` [m], now that `x` [m] follows them.

    `law` is from before them; `bend_m` [m] is the second difference that is accepted at once.
    """
    start, moved, *_ = law
    bends = []
    last = start
    step = moved
    for position in (*doubted, x):
        bends.append(position - last - step)
        step = position - last
        last = position
    newest = abs(bends[-1])
    away = abs(x - start - len(bends) * moved)
    # a hand deviates from the straight line by less than that
    if away <= len(bends) * bend_m and away < newest:
        return GlitchVerdict.RETURNED
    most = TAP if len(doubted) == MOST_DOUBTED else ONE_WAY
    if newest <= most * bend_m and one_way(bends, bend_m):
        return GlitchVerdict.MOVED
    return GlitchVerdict.OPEN


def stuck_out(before: LawState, law: LawState, x: float, bend_m: float) -> bool:
    """Return whether the sample before `x` [m] was a glitch too small to be doubted then.

    It bent the motion one way; this one bends it twice as much the other way and lies where
    `before` led. `law` includes that sample, `before` does not.
    """
    bent = law[1] - before[1]
    bends = x - law[0] - law[1]
    back = bent * bends < 0.0 and abs(bent) >= LEAST_SHARE * abs(bends)
    return back and verdict(before, (law[0],), x, bend_m) is GlitchVerdict.RETURNED


def one_way(bends: Sequence[float], bend_m: float) -> bool:
    """Return whether all `bends` that are clearly beyond `bend_m` have one sign."""
    signs = {bend > 0.0 for bend in bends if abs(bend) > ONE_WAY * bend_m}
    return len(signs) < 2
