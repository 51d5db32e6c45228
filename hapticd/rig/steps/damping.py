"""Scale and polarity of the damping DAC, and the residual of the winding's compensation.

The handle is pushed and glides until it rests, to either side, at several levels of the damping.
`coast_down` turns each push into an equation that does not contain the mass. Strong pushes are
short and fast, gentle ones (twice the friction) slow. This separates damping from friction, and
both from the effect of the residual resistance of the winding.

Polarity comes first. A board whose count reduces damping could be unstable at any larger count. So
a small count is tried, 1/64 of the device's limit, for a short time. It is switched on at rest just
before a push and off 12 ms after its begin. Both are scheduled in the servo before the motion. Any
growth lasts 20 ms (12, and up to 8 for the slew). If these pushes and those without damping do not
determine the sign, twice as much is tried, and twice as much again.

Then the levels rise to the limit, each by a factor of two. The rise ends, with a finding, if the
handle rings at rest, if less than half of the damping predicted by smaller levels is delivered, or
if the loop gain approaches -1.

`coast_down` also evaluates all pushes together, with intervals.

Limitations: a hand on the handle (its push gives no row, or deviates from the line).
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.client.client import Client
from hapticd.core.arrays import Records
from hapticd.core.errors import AnalysisError
from hapticd.core.params import ScaleParams
from hapticd.rig.experiment import (
    begin_step,
    collect,
    push,
    ready,
    require_force,
    servo_rate_hz,
    undamped,
)
from hapticd.rig.result import FACTOR, Ask, Finding, Request, StepResult, settled
from hapticd.rig.steps.coast_down import (
    LEVELS,
    REFUSE,
    Momentum,
    Row,
    analyse,
    fit_momentum,
    row_of,
)
from hapticd.rig.steps.motor import allowed_n, await_rest

__all__ = ["measure"]

# --- pushes ---------------------------------------------------------------------------------------
FIRST_SHARE = 0.05  # of the permitted force
STRONGER = 1.4
SHORT_S = 0.02
LONGEST_S = 1.0
AFTER_S = 0.5  # for the glide
MOST_AFTER_S = 4.0
WAY_M = 4e-3  # intended distance of a strong push
GENTLE_WAY_M = 2e-3
LEAST_WAY_M = 3e-4
FASTEST_M_PER_S = 0.2
GENTLE = 2.0  # times the friction
STRAYED_M = 6e-3  # from the first position of the handle; pushes then go back
LOST_M = 0.015  # from there: something else moves it
MISSES = 6  # pushes in a row without a row

# --- levels ---------------------------------------------------------------------------------------
TRIED = (1 / 64, 1 / 32, 1 / 16)  # of the limit, for the polarity
LEAD_S = 0.02  # time that the count is on before a push
ON_S = 0.012  # and after its begin
TRIALS = 4  # pushes at a count whose sign is not known
QUIET_COUNTS = 6.0  # peak to peak that a level may add at rest
DELIVERS = 0.5  # share of the damping predicted by smaller levels: less ends the rise
NEARLY = -0.8  # loop gain that the next level may reach
RECORDED = (
    "slot",
    "position_m",
    "force_n",
    "active_damping_effect_ns_per_m",
    "current_a",
    "delay_us",
)


Stimulus = tuple[float, float]  # a push: magnitude of its force [N], and its length [s]


class Pushing:
    """A device under pushes, and their results."""

    def __init__(self, bench: Client, servo: dict[str, Any]) -> None:
        self.bench = bench
        self.rate_hz = servo_rate_hz(bench)
        self.most_n = allowed_n(servo)
        self.force = ScaleParams(**servo["device"]["force"])
        self.m_per_count = float(servo["device"]["position"]["per_count"])
        self.a_per_count = float(servo["device"]["current"]["per_count"])
        self.slew = float(servo["safety"]["active_damping_slew_ns_per_m_s"])
        self.rows: list[Row] = []
        self.parts: list[Records] = []
        self.after_s = AFTER_S
        self.side = 1.0
        self.home_m: float | None = None

    def stimulate(self, stimulus: Stimulus, trial: float = 0.0) -> float:
        """Push once, with the level `trial` [N s/m] on for ON_S; return the signed distance [m]."""
        force_n, seconds = stimulus
        schedule = partial(self._schedule, trial)
        found = push(self.bench, self.side * force_n, seconds, self.after_s, schedule)
        require_force(self.bench.status())
        self.parts.append(found.records)
        row = row_of(found.records, self.force, self.m_per_count, self.rate_hz)
        position_m = found.records["position_m"]
        if row is not None:
            self.rows.append(row)
        elif np.ptp(position_m[-round(0.05 * self.rate_hz) :]) > 1e-5:
            self.after_s = min(2.0 * self.after_s, MOST_AFTER_S)
        self._turn(float(position_m[-1]))
        return found.moved_m

    def row(self, stimulus: Stimulus) -> None:
        """Push until it gives a row, or the handle hardly moves. AnalysisError after MISSES pushes
        that did not end at rest.
        """
        known = len(self.rows)
        for _ in range(MISSES):
            way = self.stimulate(stimulus)
            if len(self.rows) > known or abs(way) < LEAST_WAY_M:
                return
        raise AnalysisError(
            f"{MISSES} pushes in a row did not begin and end at rest; take your hand off the"
            " handle, keep the table still, and repeat"
        )

    def _schedule(self, level: float, begin: int) -> None:
        """Schedule a trial's `level` around a push that begins at the tick `begin`."""
        if level:
            off = begin + round(ON_S * self.rate_hz)
            on = begin - round((LEAD_S + level / self.slew) * self.rate_hz)
            self.bench.set(active_damping=level, at_tick=on, until_tick=off)

    def _turn(self, at_m: float) -> None:
        """Direct the next push to the other side, or back if the handle strayed."""
        if self.home_m is None:
            self.home_m = at_m
        strayed = at_m - self.home_m
        if abs(strayed) > LOST_M:
            raise AnalysisError(
                f"the handle is {1e3 * strayed:+.3g} mm from where it was: something moves it; take"
                " your hand off, lay the axis level, and repeat"
            )
        self.side = -self.side if abs(strayed) < STRAYED_M else -1.0 if strayed > 0.0 else 1.0

    def noise(self) -> float:
        """Return the counts peak to peak at rest."""
        return float(np.ptp(collect(self.bench, 0.1).records["position_m"])) / self.m_per_count

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the raw record: commands and signals of every push, and the computed rows."""
        raw = {name: np.concatenate([part[name] for part in self.parts]) for name in RECORDED}
        rows = zip(Row._fields, np.array(self.rows).reshape(-1, len(Row._fields)).T, strict=True)
        return raw | {f"row_{name}": column for name, column in rows}


def measure(bench: Client, ask: Ask) -> StepResult:
    """Push at rising levels of damping. CommandError unless disabled; AnalysisError if the signs
    are not verified, the handle does not come to rest, or force ends.
    """
    servo = begin_step(bench, "damping is measured")
    device = servo["device"]
    top = float(device["active_damping_limit_ns_per_m"])
    if top <= 0.0:
        why = "limits.active_damping_ns_per_m is 0: there is no active damping to measure"
        return StepResult("damping", findings=[Finding("active damping", "not done", why)])
    ask(Request("let go", "let go of the handle in the middle of its travel; it is pushed"))
    with undamped(bench):
        await_rest(bench)
        with ready(bench):
            rig = Pushing(bench, servo)
            findings = _all_pushes(rig, top)
    if not settled(findings):
        return StepResult("damping", (), findings, (), rig.arrays())
    return analyse(rig.rows, device, findings, rig.arrays())


def _all_pushes(rig: Pushing, top: float) -> list[Finding]:
    """Push without damping, at a small count for its polarity, then level by level."""
    stimulus = _first_pushes(rig)
    if stimulus is None:
        remedy = "no authority: check emergency stop, amplifier and motor, and release the handle"
        return [Finding(f"{rig.most_n:.3g} N do not move the handle", "refused", remedy)]
    polarity = _polarity(rig, stimulus, top)
    if polarity.verdict == "refused":
        return [polarity]
    return [polarity, _levels(rig, top)]


def _first_pushes(rig: Pushing) -> Stimulus | None:
    """Push without damping until the distance is WAY_M: raise the force to its limit, then the
    time. Then repeat with similar and weaker pushes. Return the push that goes WAY_M, or None if
    nothing moves.
    """
    force_n = FIRST_SHARE * rig.most_n
    seconds = SHORT_S
    while abs(way := rig.stimulate((force_n, seconds))) < WAY_M / STRONGER:
        if force_n < rig.most_n:
            force_n = min(rig.most_n, STRONGER * force_n)
        elif seconds < 5.0 * SHORT_S:
            seconds *= STRONGER
        else:
            break
    if abs(way) < LEAST_WAY_M:
        return None
    for share in (1.0, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5):
        rig.row((share * force_n, seconds))
    return force_n, seconds


def _polarity(rig: Pushing, stimulus: Stimulus, top: float) -> Finding:
    """Determine whether a small count damps."""
    for share in TRIED:
        for _ in range(TRIALS):
            rig.stimulate(stimulus, share * top)
            rig.row(stimulus)  # without it as well, alternating
        if not any(row.damped_ns for row in rig.rows):
            break
        # a trial's level is a mean over its push, and unusable for the loop gain
        rows = [row._replace(level_ns_per_m=0.0) for row in rig.rows]
        found = fit_momentum(rows, rig.a_per_count)
        if found.gain - found.gain_half > 0.0:
            return Finding(f"{share * top:.3g} N s/m make the handle heavier", "ok")
        if found.gain + found.gain_half < 0.0:
            return Finding(
                f"damping polarity: {share * top:.3g} N s/m make the handle lighter",
                "refused",
                "swap the leads of the back-EMF, or the sign of the multiplier",
            )
    return Finding(
        f"no damping is seen up to {TRIED[-1] * top:.3g} N s/m",
        "refused",
        "check the damping DAC, its multiplier and the back-EMF leads",
    )


def _levels(rig: Pushing, top: float) -> Finding:
    """Rise to `top`, with strong and gentle pushes at each level."""
    quiet = rig.noise()
    for level in (share * top for share in LEVELS):
        known = fit_momentum(rig.rows, rig.a_per_count)
        loop = known.loop_per_ns_per_m
        if (loop + known.loop_half) * level < NEARLY:
            return Finding(
                f"the loop gain would come to {loop * level:.2g} at {level:.3g} N s/m",
                "warning",
                f"too much is compensated: {REFUSE / loop:.3g} N s/m is the greatest damping"
                " allowed",
            )
        rig.bench.damping(level)
        collect(rig.bench, level / rig.slew + 0.1)
        if rig.noise() > quiet + QUIET_COUNTS:
            return Finding(
                f"the handle trembles at rest with {level:.3g} N s/m",
                "warning",
                "the analog circuit rings: keep limits.active_damping_ns_per_m below",
            )
        if weak := _pushed_at(rig, known, level):
            return weak
    return Finding(f"levels up to {top:.3g} N s/m were seen", "ok")


def _pushed_at(rig: Pushing, known: Momentum, level: float) -> Finding | None:
    """Push strongly and gently to both sides; return a finding, and drop the rows, if it damps too
    little.
    """
    before = len(rig.rows)
    for stimulus in _stimuli(rig, known, level):
        for _ in range(2):
            rig.row(stimulus)
    rows = rig.rows[before:]
    if not rows:
        return Finding(
            f"pushes of {rig.most_n:.3g} N hardly move the handle at {level:.3g} N s/m",
            "warning",
            "the line ends below",
        )
    share = float(np.median([_delivered(row, known) for row in rows]))
    if share >= DELIVERS * (known.gain - known.gain_half):
        return None
    del rig.rows[before:]
    return Finding(
        f"{level:.3g} N s/m damp {share:.2g} of what they should",
        "warning",
        "the line saturates below that: check the range of the damping circuit",
    )


def _delivered(row: Row, known: Momentum) -> float:
    """Return the gain of the damping from one row and the known friction."""
    took = known.physical_ns_per_m * row.way_m + known.coulomb_n * row.seconds
    return (row.impulse_ns - took) / row.damped_ns


def _stimuli(rig: Pushing, known: Momentum, level: float) -> Iterator[Stimulus]:
    """Yield a strong and a gentle push: with F - Fc = c v the distance is v times their length."""
    friction = max(known.coulomb_n, 2.0 * rig.force.per_count)
    damping = level * max(known.gain, 1.0 / FACTOR) + max(known.physical_ns_per_m, 0.0)
    strong_n = min(rig.most_n, friction + damping * FASTEST_M_PER_S)
    gentle_n = min(GENTLE * friction, rig.most_n)
    for force_n, way_m in ((strong_n, WAY_M), (gentle_n, GENTLE_WAY_M)):
        speed = max(force_n - friction, 0.1 * force_n) / damping
        yield force_n, float(np.clip(way_m / speed, SHORT_S / 2.0, LONGEST_S))
