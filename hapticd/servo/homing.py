"""Homing: finds the stop, or the encoder's index, as the origin, or reports why it failed.

The push p is a spring to a point that moves at the homing speed v, parallel to a damper:

    dp/dt = K (v - dx/dt),  -F <= p <= F       K = min(100 N/m, F / (0.1 s v))
    force = p - B dx/dt,  -F <= force <= F     B = 0.5 N s/m

While the handle follows, p equals the friction; while it is at rest, p grows to the homing force F.
A slip (friction falls as the handle starts to move) shortens the spring only by the motion of the
handle. The push therefore persists through stick-slip, and the mean speed is v. Above 10 v, p
is halved at every tick, so a handle that is suddenly released does not run away. With any obstacle,
force is bounded by F, and speed by 10 v plus the effect of F on the mass within two ticks. A few
grams render K and B stably with 5 ms of lag. dx/dt is the last difference of the encoder, not the
output of a filter that a client may have set.

A handle at rest under the full push may not be at a stop: a hand may hold it, a bearing may stick,
the motor may have no power. So each stop is tested, and found twice:

    approach  towards the stop, until the handle is at rest for 0.1 s under F
    press     p falls to F/2 and grows to F again; a stop that moves by more than the tolerance d
              meanwhile yields (softer than F / 2 d) and is approached further
    back off  away by L, with at most 3/4 F: a handle that cannot is held or stuck
    return    towards the stop again, with at most 3/4 F until 4 d before it
    confirm   pressed again; accepted within d of the first stop, if nothing else acts there

Friction hides a soft hand from `press`: the bearing holds the handle in it. The work of
back-off and return reveals it. Over a distance s and back, friction costs the same both ways, with
or without jerks, and another force on the handle does not. Its mean is

    (work of the return - work of the back-off) / 2 s

between 4 d and 4 d + L/4 from the stop. A stop exerts no force there. A hand exerts the force that
stopped the handle: more than F/8 is not a stop. A hand too stiff to be measured there does not let
the handle back off by L.

With `index` the mark takes the place of the stop: found, left behind by L, and passed again in the
same direction within d. An obstacle before the mark reverses the search, once.

Without torque authority the homing starts again, and the slow path ends it after some ticks. A
press counts only if the motor carried half the current of F (`current_n_per_a`; 0: not checked).
The true stop is at most F / k <= 2 d beyond the recorded one.

A sample that bends the motion too far waits for the next ones (`servo.samples`), and arrives here
only if they continue from it: `_ticks` counts the samples in between.

Limitations: friction above 3/4 F (reported), a stop softer than F / 2 d, play of the mechanism
beyond L, a hand that lets go and grasps again at the same place to within d.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams

STIFFNESS_N_PER_M = 100.0
DAMPING_NS_PER_M = 0.5
LOAD_S = 0.1  # at least, from no push to the full push
RELAX_S = 0.05  # from the full push to half of it
STILL_S = 0.1
FASTEST = 10.0  # times the homing speed
RESERVE = 0.75  # of the full push must be enough to move between stop and back-off
NEAR = 4.0  # times the tolerance: distance at which the stop or a yielding obstacle begins
WEIGHED = 0.25  # of the back-off
FOREIGN = 0.125  # of the full push: largest force of others where the handle stopped
RETREAT = 2.0  # times the back-off: limit of motion against the push


class Phase(IntEnum):
    """The phase of a homing."""

    APPROACH = 0
    PRESS = 1
    BACK_OFF = 2
    RETURN = 3
    CONFIRM = 4


class Homing(NamedTuple):
    """The progress of a homing. Counts are those of the encoder."""

    phase: int = int(Phase.APPROACH)
    since_tick: int = 0  # of the phase
    tick: int = 0  # of the sample before,
    encoder: int = 0  # and its count
    still_tick: int = 0  # start of the standstill,
    still_count: int = 0  # and its position
    reach_count: int = 0  # furthest along the direction of this phase
    found_count: int = 0  # stop or mark, the first time
    push_n: float = 0.0  # p, along the direction of this phase
    force_n: float = 0.0  # of the law, to positive x
    turned: bool = False  # searches against the direction of the device file
    work_j: float = 0.0  # return minus back-off, in the stretch of weighing


class HomingSample(NamedTuple):
    """One sample, with the fields for homing."""

    tick: int
    encoder: int
    granted: bool  # the board grants torque
    mark: int | None  # encoder count of the index, if it was passed
    current_a: float  # of the motor


class Origin(NamedTuple):
    """The end of a homing: the count of the stop or of the mark."""

    encoder: int


class Failed(NamedTuple):
    """The end of a homing: number of the fault."""

    fault: int


Next = Homing | Origin | Failed


def begin(tick: int, count: int) -> Homing:
    """Return a homing that starts at `tick` with the encoder at `count`."""
    return _entered(Homing(), Phase.APPROACH, tick, count, 0.0)


def force_limit_n(params: ServoParams) -> float:
    """Return the largest force of homing [N]."""
    return min(params.device.home.force_n, params.force_limit_n)


def _entered(homing: Homing, phase: Phase, tick: int, count: int, push_n: float) -> Homing:
    return homing._replace(
        phase=int(phase),
        since_tick=tick,
        tick=tick,
        encoder=count,
        still_tick=tick,
        still_count=count,
        reach_count=count,
        push_n=push_n,
    )


def _ticks(homing: Homing, seen: HomingSample) -> int:
    """Return the ticks since the sample before, at least 1."""
    return max(1, seen.tick - homing.tick)


def _pressed(passed_s: float) -> float:
    """Return the share of the full push: slowly down to half and back, so that a stop does not
    ring.
    """
    if passed_s < RELAX_S:
        return 1.0 - 0.5 * passed_s / RELAX_S
    return min(1.0, 0.5 + 0.5 * (passed_s - RELAX_S) / LOAD_S)


class HomingSearch:
    """The search on one device; `advance` is its only method for callers. It has no state between
    samples.
    """

    def __init__(self, params: ServoParams) -> None:
        home = params.device.home
        position = params.device.position
        self._home = home
        self._rate_hz = params.realtime.rate_hz
        self._force_n = force_limit_n(params)
        self._m_per_count = position.per_count * position.sign
        self._near_m = NEAR * home.tolerance_m
        self._weighed_m = WEIGHED * home.back_off_m
        self._tolerance_counts = home.tolerance_m / position.per_count
        self._stiffness = min(STIFFNESS_N_PER_M, self._force_n / (LOAD_S * home.speed_m_per_s))
        self._phases: tuple[Callable[[Homing, HomingSample], Next], ...] = (
            self._search,
            self._press,
            self._back_off,
            self._search,
            self._press,
        )

    def advance(self, homing: Homing, seen: HomingSample) -> Next:
        """Return `homing` after one sample, or its end."""
        if not seen.granted:
            return begin(seen.tick, seen.encoder)
        homing = self._weighed(self._noted(homing, seen), seen)
        speed_m_per_s = self._speed(homing, seen)
        found = self._phases[homing.phase](homing, seen)
        if not isinstance(found, Homing):
            return found
        force_n = self._way(found) * found.push_n - DAMPING_NS_PER_M * speed_m_per_s
        force_n = max(-self._force_n, min(self._force_n, force_n))
        return found._replace(tick=seen.tick, encoder=seen.encoder, force_n=force_n)

    def _noted(self, homing: Homing, seen: HomingSample) -> Homing:
        if abs(seen.encoder - homing.still_count) > self._tolerance_counts:
            homing = homing._replace(still_tick=seen.tick, still_count=seen.encoder)
        if self._along(homing, seen.encoder - homing.reach_count) > 0.0:
            homing = homing._replace(reach_count=seen.encoder)
        return homing

    def _speed(self, homing: Homing, seen: HomingSample) -> float:
        moved_m = self._m_per_count * (seen.encoder - homing.encoder)
        return moved_m * self._rate_hz / _ticks(homing, seen)

    def _way(self, homing: Homing) -> int:
        """Return +1 or -1: the direction of the push in this phase."""
        against = (homing.phase == Phase.BACK_OFF) != homing.turned
        return -self._home.direction if against else self._home.direction

    def _along(self, homing: Homing, counts: int) -> float:
        return self._way(homing) * self._m_per_count * counts

    def _weighed(self, homing: Homing, seen: HomingSample) -> Homing:
        """Return `homing` with the work of this tick, where the handle passes the stretch of
        weighing.
        """
        if self._home.method != "stop" or homing.phase not in (Phase.BACK_OFF, Phase.RETURN):
            return homing
        middle = 0.5 * (seen.encoder + homing.encoder)
        away_m = abs(middle - homing.found_count) * abs(self._m_per_count)
        start_m = self._near_m
        if not start_m <= away_m < start_m + self._weighed_m:
            return homing
        moved_m = self._m_per_count * (seen.encoder - homing.encoder)
        work_j = homing.force_n * moved_m
        sign = -1.0 if homing.phase == Phase.BACK_OFF else 1.0
        return homing._replace(work_j=homing.work_j + sign * work_j)

    def _pushed(self, homing: Homing, seen: HomingSample) -> Homing:
        """Return the push after this sample: a spring to a point that moves on."""
        ahead_m = self._home.speed_m_per_s * _ticks(homing, seen) / self._rate_hz
        moved_m = self._along(homing, seen.encoder - homing.encoder)
        push_n = homing.push_n + self._stiffness * (ahead_m - moved_m)
        if abs(moved_m) > FASTEST * ahead_m:
            push_n = 0.5 * homing.push_n
        return homing._replace(push_n=max(-self._force_n, min(self._force_n, push_n)))

    def _stands(self, homing: Homing, tick: int, part: float = 1.0) -> bool:
        """Return whether the handle has stood long enough under that part of the full push."""
        full = homing.push_n >= part * self._force_n
        return full and tick - homing.still_tick >= STILL_S * self._rate_hz

    def _search(self, homing: Homing, seen: HomingSample) -> Next:
        """APPROACH and RETURN."""
        again = homing.phase == Phase.RETURN
        if self._along(homing, homing.reach_count - seen.encoder) > RETREAT * self._home.back_off_m:
            return Failed(BY_CODE["home_wrong_way"].number)
        if self._home.method == "index":
            return self._search_mark(homing, seen, again)
        pushed = self._pushed(homing, seen)
        if again and self._short(pushed, seen) and pushed.push_n > RESERVE * self._force_n:
            return Failed(BY_CODE["home_not_confirmed"].number)
        if not self._stands(pushed, seen.tick):
            return pushed
        phase = Phase.CONFIRM if again else Phase.PRESS
        return _entered(pushed, phase, seen.tick, seen.encoder, pushed.push_n)

    def _short(self, homing: Homing, seen: HomingSample) -> bool:
        """Return whether the handle is still away from where it stopped before."""
        return self._along(homing, homing.found_count - seen.encoder) > self._near_m

    def _search_mark(self, homing: Homing, seen: HomingSample, again: bool) -> Next:
        if seen.mark is not None:
            return self._found(homing, seen, seen.mark, again)
        beyond_m = self._along(homing, seen.encoder - homing.found_count)
        if again and beyond_m > self._home.back_off_m:
            return Failed(BY_CODE["home_not_confirmed"].number)
        pushed = self._pushed(homing, seen)
        if not self._stands(pushed, seen.tick):
            return pushed
        if again or homing.turned:
            return Failed(BY_CODE["home_failed"].number)
        turned = pushed._replace(turned=True)
        return _entered(turned, Phase.APPROACH, seen.tick, seen.encoder, -pushed.push_n)

    def _press(self, homing: Homing, seen: HomingSample) -> Next:
        """PRESS and CONFIRM."""
        again = homing.phase == Phase.CONFIRM
        if homing.still_tick != homing.since_tick:  # it yields
            phase = Phase.RETURN if again else Phase.APPROACH
            return _entered(homing, phase, seen.tick, seen.encoder, homing.push_n)
        passed_s = (seen.tick - homing.since_tick) / self._rate_hz
        if passed_s < RELAX_S + LOAD_S + STILL_S:
            return homing._replace(push_n=_pressed(passed_s) * self._force_n)
        return (
            self._found(homing, seen, seen.encoder, again)
            if self._carries_current(seen)
            else Failed(BY_CODE["home_no_current"].number)
        )

    def _carries_current(self, seen: HomingSample) -> bool:
        n_per_a = self._home.current_n_per_a
        return not n_per_a or n_per_a * abs(seen.current_a) >= 0.5 * self._force_n

    def _found(self, homing: Homing, seen: HomingSample, count: int, again: bool) -> Next:
        if not again:
            away = homing._replace(found_count=count)
            return _entered(away, Phase.BACK_OFF, seen.tick, seen.encoder, -homing.push_n)
        elsewhere = abs(count - homing.found_count) > self._tolerance_counts
        if elsewhere or self._mean_n(homing) > FOREIGN * self._force_n:
            return Failed(BY_CODE["home_not_confirmed"].number)
        return Origin(count)

    def _mean_n(self, homing: Homing) -> float:
        return abs(homing.work_j) / (2.0 * self._weighed_m)

    def _back_off(self, homing: Homing, seen: HomingSample) -> Next:
        if self._along(homing, seen.encoder - homing.found_count) >= self._home.back_off_m:
            return _entered(homing, Phase.RETURN, seen.tick, seen.encoder, -homing.push_n)
        pushed = self._pushed(homing, seen)
        blocked = self._stands(pushed, seen.tick, RESERVE)
        return Failed(BY_CODE["home_blocked"].number) if blocked else pushed
