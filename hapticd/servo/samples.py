"""Lost and doubted samples: their replacement for the law, and the verdict on a glitch.

Replacement (`Samples`). The law's filters see every period. Up to `missing_frames_limit` lost
samples are replaced by positions on the straight line between the samples on either side of them.
The last force was held meanwhile. The first sample after lost ones is doubted if its distance from
the straight continuation exceeds the limit of one bend. The module also keeps the state of the
origin after lost samples.

Glitch of the encoder, or true motion (`verdict`). A sample bends the motion by its second
difference x_n - 2 x_{n-1} + x_{n-2}. It is doubted if that exceeds limits.acceleration_m_per_s2.
The law then gets the straight continuation, its state stays as it was, and the next samples decide:

    it returned    the newest sample is on the straight line from before the doubt, or on a curve of
                   plausible acceleration: a glitch. Doubted samples count as lost, and the filters
                   get the positions between.
    it moved       the newest sample continues the doubted ones, bent little (a hand, a wall), or
                   bent the same way (a tap that lasts): true motion. The filters get every sample.
    still open     neither: it is doubted too.

A glitch ends soon, so its bends change sign: +g, -2g, +g. A tap bends one way for as long as it
lasts, whatever its strength; the speed limit bounds its total effect. A position that jumps and
stays bends by +g, -g: no handle moves like that either, and the doubt is not resolved.

Lost samples before a doubted one count as on the line between their neighbours. Doubted samples
before lost ones count as lost. The sample after the gap is not judged with them: the gap hides how
motion bends.

Limitations: a handle that is so light or struck so hard that it reverses within a period, and a bad
sample that hides the acceleration of a handle during several lost ones.
"""

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from itertools import pairwise
from typing import Final

from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox.layout import Flag, following
from hapticd.render.law import FORCE, LIMIT, MASS, LawState, Ledger, book, clamp, render
from hapticd.servo.plan import Plan, Sample, ServoState, TickConstants, without_origin
from hapticd.servo.safety import bounds
from hapticd.usb.codec import ENCODER_BITS
from hapticd.usb.device import SEED
from hapticd.usb.frames import StatusBit

# --- verdict on a glitch --------------------------------------------------------------------------

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
    most = TAP if len(doubted) >= MOST_DOUBTED else ONE_WAY
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


# --- replacement ----------------------------------------------------------------------------------


class Samples:
    """The samples of the device of `params`, prepared for its law."""

    def __init__(self, params: ServoParams) -> None:
        position = params.device.position
        self._params = params
        self._rate_hz = params.realtime.rate_hz
        self._m_per_count = position.per_count * position.sign
        self._own = bounds(params)
        self._bend_m = believed_bend_m(params)
        self._first_origin = round_half_up(position.offset_count)

    def position_m(self, plan: Plan, encoder: int) -> float:
        """Return the position [m] at an encoder count."""
        return (encoder - plan.origin) * self._m_per_count

    def unwrapped(self, state: ServoState, encoder: int) -> ServoState:
        """Return `state` with its origin corrected if the encoder's counter wrapped during lost or
        doubted samples. The tick itself detects a wrap after a regular sample.
        """
        settled, law, ledger, held, signs = state
        plan = settled.plan
        turns = round((encoder - plan.origin - law[0] / self._m_per_count) / (1 << ENCODER_BITS))
        if not turns:
            return state
        ahead = turns << ENCODER_BITS
        doubted = tuple(None if one is None else one + ahead for one in plan.doubted)
        plan = plan._replace(origin=plan.origin + ahead, doubted=doubted)
        settled = replace(settled, origin=plan.origin, plan=plan)
        return settled, law, ledger, held, signs

    def filled(
        self, plan: Plan, law: LawState, sample: Sample, tick: int
    ) -> tuple[Plan, tuple[float, ...], int]:
        """Return `plan` for a usable sample, the positions [m] in place of doubted or lost samples
        before it, and record flags. With flag DOUBTED the sample is in `plan.doubted`.
        """
        encoder, _, _, arrival, _, _, _, _, _ = sample
        trusting = plan._replace(doubted=()) if plan.doubted else plan
        if arrival > self._params.safety.missing_frames_limit:
            return trusting, (), 0
        waiting = plan.doubted + (None,) * arrival
        if not waiting:
            return plan, (), 0
        x = self.position_m(plan, encoder)
        straight = _line(law[0], x, len(waiting))
        if arrival and self.believable(plan, law, encoder, arrival):
            return trusting, straight, int(Flag.INTERPOLATED)
        if arrival:  # the next sample decides about this one; those before the gap are lost
            return plan._replace(doubted=(None,) * len(waiting)), (), int(Flag.DOUBTED)
        seen = [None if one is None else self.position_m(plan, one) for one in waiting]
        positions = _without_gaps(law[0], [*seen, x])[:-1]
        found = verdict(law, positions, x, self._bend_m)
        if found is GlitchVerdict.OPEN:
            return plan, (), int(Flag.DOUBTED)
        if found is GlitchVerdict.MOVED:
            return trusting, tuple(positions), int(Flag.BELIEVED)
        recent = tuple(one for one in plan.glitches if tick - one < self._rate_hz)
        bad = (tick,) * (len(waiting) - waiting.count(None))
        return trusting._replace(glitches=recent + bad), straight, int(Flag.GLITCH)

    def believable(self, plan: Plan, law: LawState, encoder: int, arrival: int) -> bool:
        """Return whether a sample continues those before it, over a gap of lost ones too."""
        x = self.position_m(plan, encoder)
        periods = len(plan.doubted) + arrival + 1
        return 0 <= arrival < SEED and abs(x - law[0] - periods * law[1]) <= self._bend_m

    def located(self, plan: Plan, sample: Sample, usable: bool) -> Plan:
        """Return `plan` with its origin, or without it if the sample shows that it is lost."""
        _, status, _, arrival, _, _, _, _, _ = sample
        # the board has restarted: its counter begins again at an unknown position, and requests
        # from before no longer apply
        if arrival == SEED:
            revision = following(plan.revision) if plan.revision else 0
            plan = without_origin(plan)._replace(origin=self._first_origin, revision=revision)
        if usable and status & StatusBit.ENCODER_FAULT:  # counts may have been missed
            plan = without_origin(plan)
        return plan

    def bridged(
        self,
        law: LawState,
        ledger: Ledger,
        positions: Sequence[float],
        settled: TickConstants,
        effect: int,
    ) -> tuple[LawState, Ledger]:
        """Feed the filters the `positions` [m] of samples without a tick. The last force was held
        meanwhile, and the board reported `effect` [counts] of active damping.
        """
        level = self._params.device.active_damping.to_value(effect)
        resistance = self._own.resistance + level * self._rate_hz
        environment = settled.environment
        mass = environment[MASS]
        for position in positions:
            _, _, v, _, spring, _, _, field, law = render(
                position, law, environment, settled.coefficients
            )
            elastic = clamp(spring + settled.proxy_n + field, environment[LIMIT])
            ledger = book(
                ledger, law[1], ledger[FORCE], 0.0, elastic, mass, v, resistance, self._own.kept
            )
        return law, ledger


def _without_gaps(start: float, positions: Sequence[float | None]) -> list[float]:
    """Return `positions` after `start` with each None on the line between its neighbours."""
    known = [(place, x) for place, x in enumerate((start, *positions)) if x is not None]
    return [
        x
        for (before, one), (place, other) in pairwise(known)
        for x in (*_line(one, other, place - before - 1), other)
    ]


def _line(start: float, end: float, lost: int) -> tuple[float, ...]:
    return tuple(start + (end - start) * index / (lost + 1) for index in range(1, lost + 1))
