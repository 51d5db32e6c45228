"""What pushes and free glides say of damping: the balance of momentum from rest to rest.

A handle at rest is pushed with the impulse J, glides, and comes to rest again after the way D and
the time T of motion. Whatever its mass, and however the force was delayed or smoothed on its way,

    J = P + (b0 D + Fc T - s G T) (1 + g b)         P = integral of b dx

with the active damping b, the physical damping b0, Coulomb friction Fc, a constant force G
(gravity, what is left at a count of 0) and the direction s of the motion: nothing is kept from rest
to rest. Nothing has to be known of the mass, and the lag of amplifier and circuit drops out as
well: T begins with the command and its delay, since what a smoothed force has before it overcomes
friction goes into friction. b is what the damping DAC was told, times a gain that is sought; J is
known by the measured gain of the force, D by that of the encoder.

g b is the loop gain of the residual resistance: the circuit sees the velocity v + rho F_a, and what
the motor does is F_a = (F - b v) / (1 + g b), with g = rho. It weakens force and damping alike, so
from J alone it is seen in how much more of J friction seems to take at higher b: slow pushes are
mostly friction, fast ones mostly damping. Where the board reports the motor's current, its integral
Q stands for what friction took,

    J = P + N Q (1 + g b)                           N: endpoint force per ampere

and no friction has to be the same twice. N comes from the pushes at b = 0.

Least squares (Gauss-Newton) over all pushes, each weighted by what may be wrong in it: TIMING_S of
friction, and MODEL of the impulse; where the residuals say more, they count (Student's t).

The gain of the damping is that of all rows together. Its interval adds to that of
the fit what the device file says of the scales of force and position (`half_width_95`; UNKNOWN
without one), what the levels scatter about the line, and FLOOR.

The residual resistance is the loop gain per N s/m times the square of the force per ampere. Below 0
the circuit compensates more than the winding has, and at a loop gain of -1 it oscillates, so the
greatest level that is allowed is named.

The physical damping is what is proportional to speed without active damping; friction is not, and
counts for nothing at large motions. The device file gets LEAST_SHARE of the least that it can be.

What would break it: a `half_width_95` that is kept although its scale was changed by hand,
a handle that is held or pushed by something else meanwhile, or that has not
come to rest (such a push is no row), friction that depends on the level of damping (without a
current).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import Records
from hapticd.core.arrays import Floats
from hapticd.core.params import ScaleParams
from hapticd.core.units import US_PER_S, percent
from hapticd.render.winding import LEAST_LOOP_GAIN
from hapticd.rig.estimate import Fit, least_squares, mean_half, separable
from hapticd.rig.result import (
    FACTOR,
    Change,
    Finding,
    StepResult,
    Value,
    change_of,
    checked,
    relative_half,
)
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST

STILL_COUNTS = 6.0  # peak to peak at rest, beside the noise
REST_S = 0.05  # at either end of a record
EDGE_COUNTS = 10.0  # from rest, where the motion is timed
LEAST_WAY_COUNTS = 10.0 * EDGE_COUNTS  # of a way that says something
GLIDE_EDGES = 20.0  # edges in a way whose last nine are those of its glide
TIMING_S = 5e-4  # by which the time of motion may be wrong
MODEL = 0.003  # share of the impulse that the equation may leave out
ITERATIONS = 30
LOOP_STEP = 1e-3  # m/s per N, over which the loop gain is differentiated: it is linear
LEAST_AMPERE_COUNTS = 20.0  # mean current of the weakest push that is believed
EXPLAINED = 0.03  # of the impulse at count 0 that the current may leave unexplained
LEVELS = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1)  # of the limit
LEAST_LEVELS = 3
UNKNOWN = 0.01  # half of the interval of a scale whose table states none
FLOOR = 0.003  # of the gain, however many pushes there were
BY_FRICTION = 0.1  # of the residual back-EMF, where friction has to be told from it without current
BIAS = 0.01  # of the physical damping: friction seems to end sooner than it does
MOST_BESIDE = 0.1  # share of its impulse by which a push may lie beside the others
BESIDE = 0.03  # share by which a level may lie beside the line
REFUSE = LEAST_LOOP_GAIN
WARN = 0.5 * REFUSE  # loop gain
LEAST_SHARE = 2.0 / 3.0  # of the least physical damping, for the fault `energy`


class Row(NamedTuple):
    """One push from rest to rest, in the direction of its motion."""

    impulse_ns: float  # J, commanded
    way_m: float  # D
    seconds: float  # T
    damped_ns: float  # P, with the damping as the device file has it
    charge_as: float  # Q, of the current above that at rest
    level_ns_per_m: float  # b, steady; that of P / D otherwise
    direction: float  # +1 or -1


def row_of(records: Records, force: ScaleParams, m_per_count: float, rate_hz: float) -> Row | None:
    """What the `records` of a push tell; None where ticks are missing or were late by a period,
    or it does not begin and end at rest.
    """
    position = records["position_m"].astype(np.float64)
    rest = round(REST_S * rate_hz)
    if len(records) < 4 * rest or (np.diff(records["slot"].astype(np.int64)) != 1).any():
        return None
    before = position[:rest]
    after = position[-rest:]
    if max(np.ptp(before), np.ptp(after)) > STILL_COUNTS * m_per_count:
        return None
    went = float(after.mean() - before.mean())
    if abs(went) < LEAST_WAY_COUNTS * m_per_count:
        return None
    direction = 1.0 if went > 0.0 else -1.0
    away = direction * (position - before.mean())
    period_s = 1.0 / rate_hz
    commanded = quantised(records["force_n"].astype(np.float64), force)
    edge = EDGE_COUNTS * m_per_count
    begin = _begin(records, commanded, away, edge, rate_hz)
    seconds = max(_end(away, abs(went), edge) - begin, 1.0) * period_s
    impulse = direction * float((commanded - commanded[0]).sum()) * period_s
    level = records["active_damping_effect_ns_per_m"].astype(np.float64)
    damped = float(level[1:] @ np.diff(away))
    current = records["current_a"].astype(np.float64)
    charge = direction * float((current - current[:rest].mean()).sum()) * period_s
    steady = damped / abs(went)
    return Row(impulse, abs(went), seconds, damped, charge, steady, direction)


def quantised(force_n: Floats, scale: ScaleParams) -> Floats:
    """`force_n` (n,) as the converter makes it."""
    counts = np.floor(scale.sign * force_n / scale.per_count + scale.offset_count + 0.5)
    return np.asarray(scale.sign * (counts - scale.offset_count) * scale.per_count)


def _begin(records: Records, commanded: Floats, away: Floats, edge: float, rate_hz: float) -> float:
    """Period in which the push (n,) began to act: by the command and its delay, as the board's
    clock tells it; by the motion where that is not told. A force that is smoothed moves the handle
    later, but friction takes as much of the impulse before.
    """
    delay_us = records["delay_us"].astype(np.float64)
    told = delay_us[delay_us >= 0.0]
    if not told.size:
        return _rest(away, edge, 2)
    pushed = int(np.argmax(commanded != commanded[0]))
    return pushed + float(np.median(told)) * rate_hz / US_PER_S


def _end(away: Floats, way: float, edge: float) -> float:
    """Period in which the motion (n,) ended, that of its beginning backwards. Damping brakes a fast
    handle more than a slow one, so where a glide is long enough the next order is taken as well.
    """
    order = 3 if way > GLIDE_EDGES * edge else 2
    return len(away) - 1 - _rest((way - away)[::-1], edge, order)


def _rest(rising: Floats, edge: float, order: int) -> float:
    """Where a motion (n,) from rest began, between samples. Near there the speed is proportional to
    time, so the root of the way is a line: it takes as long to `edge` as from there to four times
    that. With order 3 it is a parabola, through nine times that as well.
    """
    root = np.sqrt(np.maximum(rising, 0.0))
    one, two, *more = (_crossing(root, share * edge**0.5) for share in range(1, order + 1))
    return 2.0 * one - two if not more else 3.0 * one - 3.0 * two + more[0]


def _crossing(rising: Floats, level: float) -> float:
    """Where (n,) comes above `level` for the last time from below, between samples."""
    place = int(np.flatnonzero(rising < level)[-1])
    if place + 1 >= len(rising):
        return float(place)
    step = float(rising[place + 1] - rising[place])
    return place + (level - float(rising[place])) / step


@dataclass(frozen=True)
class Momentum:
    """What the rows say together, each with half of its 95 % interval."""

    gain: float  # of the damping: what it is over what the device file says
    gain_half: float
    loop_per_ns_per_m: float  # g, per N s/m of the device file
    loop_half: float
    n_per_a: float  # 0 where friction was taken in place of the current
    physical_ns_per_m: float
    physical_half: float
    coulomb_n: float
    coulomb_half: float
    by_current: bool
    loads_ns: Floats  # (n,) what friction took of each impulse
    beside: Floats  # (n,) share of each impulse that is left over

    def impulses_of_damping(self, rows: Sequence[Row]) -> Floats:
        """(n,) what is left of each impulse for the active damping."""
        level = _column(rows, "level_ns_per_m")
        taken = self.loads_ns * (1.0 + self.loop_per_ns_per_m * level)
        return np.asarray(_column(rows, "impulse_ns") - taken)


def fit_momentum(rows: Sequence[Row], a_per_count: float) -> Momentum:
    """The fit to `rows`, at least eight; some at level 0, and at two or more others for the loop
    gain, which is taken as 0 else.
    """
    impulse = _column(rows, "impulse_ns")
    damped = _column(rows, "damped_ns")
    level = _column(rows, "level_ns_per_m")
    friction = _friction(rows)
    weight = _weights(rows, friction)
    by_current = _current_tells(rows, a_per_count)
    loads = _column(rows, "charge_as")[:, None] if by_current else friction
    loops = len(np.unique(np.round(np.log2(level[level > 0.0])))) > 1
    found = _fit(impulse, damped, loads, level, weight, loops)
    gain, *coefficients = found.values[: 1 + loads.shape[1]]
    loop = float(found.values[-1]) if loops else 0.0
    loop_half = float(found.halves[-1]) if loops else 0.0
    took = (impulse - gain * damped) / (1.0 + loop * level)
    mechanics = least_squares(friction, took, weight * (1.0 + loop * level), least=1.0)
    physical, coulomb_n, _ = mechanics.values.tolist()
    physical_half, coulomb_half, _ = mechanics.halves.tolist()
    # an error of all times of motion takes of friction, or adds to it; damping loses as much
    seconds = _column(rows, "seconds")
    mistimed_n = coulomb_n * TIMING_S / float(np.median(seconds))
    slowness = float(np.median(seconds / _column(rows, "way_m")))
    lost = loads @ np.array(coefficients)
    left = impulse - gain * damped - lost * (1.0 + loop * level)
    return Momentum(
        float(gain),
        float(found.halves[0]),
        loop,
        loop_half,
        float(coefficients[0]) if by_current else 0.0,
        physical,
        hypot(physical_half, mistimed_n * slowness),
        coulomb_n,
        hypot(coulomb_half, mistimed_n),
        by_current,
        lost,
        np.asarray(left / impulse),
    )


def _column(rows: Sequence[Row], name: str) -> Floats:
    """The field `name` of all rows (n,)."""
    return np.array([getattr(row, name) for row in rows], np.float64)


def _friction(rows: Sequence[Row]) -> Floats:
    """Columns (n, 3) of b0, Fc and G."""
    seconds = _column(rows, "seconds")
    sides = _column(rows, "direction")
    return np.column_stack([_column(rows, "way_m"), seconds, -sides * seconds])


def _weights(rows: Sequence[Row], friction: Floats) -> Floats:
    """One over what may be wrong in each impulse (n,)."""
    impulse = _column(rows, "impulse_ns")
    free = _column(rows, "damped_ns") < 0.05 * impulse
    guess = np.linalg.lstsq(friction[free], impulse[free], rcond=None)[0]
    return np.asarray(1.0 / np.hypot(TIMING_S * abs(float(guess[1])), MODEL * impulse))


def _current_tells(rows: Sequence[Row], a_per_count: float) -> bool:
    """Whether the current of pushes at level 0 is proportional to their impulse."""
    impulse = _column(rows, "impulse_ns")
    charge = _column(rows, "charge_as")
    lasting = np.maximum(_column(rows, "seconds"), 1e-3)
    if not (np.abs(charge) / lasting > LEAST_AMPERE_COUNTS * a_per_count).all():
        return False
    free = _column(rows, "damped_ns") < 1e-3 * impulse
    ratio = impulse[free] / charge[free]
    return bool(free.sum() >= 2 and np.ptp(ratio) <= 2.0 * EXPLAINED * abs(ratio.mean()))


def _fit(
    impulse: Floats, damped: Floats, loads: Floats, level: Floats, weight: Floats, loops: bool
) -> Fit:
    """J = k P + (loads a) (1 + g b): (k, a.., g), without g unless `loops`."""

    def columns_of(loop: Floats) -> Floats:
        return np.column_stack([damped, loads * (1.0 + loop * level)[:, None]])

    if not loops:
        return least_squares(columns_of(np.zeros(1)), impulse, weight, least=1.0)
    return separable(columns_of, impulse, np.zeros(1), LOOP_STEP, ITERATIONS, weight)


def analyse(
    rows: Sequence[Row],
    device: Mapping[str, Any],
    findings: Sequence[Finding] = (),
    arrays: Mapping[str, npt.NDArray[Any]] | None = None,
) -> StepResult:
    """What `rows` say on a device whose file says `device` (as the servo's hello has it)."""
    found = fit_momentum(rows, float(device["current"]["per_count"]))
    # newtons and metres as the device file has them
    scales = hypot(*(relative_half(device[name], UNKNOWN) for name in ("force", "position")))
    levels, gains = by_level(rows, found)
    full = found.gain * float(device["active_damping"]["per_count"]) * U16_HIGHEST
    scatter = mean_half(gains) if len(gains) > 2 else 0.0
    relative = hypot(found.gain_half / found.gain, scatter / found.gain, scales, FLOOR)
    gain = Value.around("active_damping.full_scale_ns_per_m", full, "N s/m", relative * full)
    top = float(device["active_damping_limit_ns_per_m"])
    own = found.physical_ns_per_m
    own_half = hypot(found.physical_half, BIAS * own, scales * own)
    physical = Value.around("physical damping", own, "N s/m", own_half)
    friction_half = hypot(found.coulomb_half, scales * found.coulomb_n)
    values = [
        gain,
        *_residual(found, float(device["motor_n_per_a"]), scales),
        physical,
        Value.around("friction seen", found.coulomb_n, "N", friction_half),
    ]
    said = [
        *findings,
        _together(found),
        _line(levels, gains / found.gain),
        _believable(found.gain),
        _margin(found, top),
    ]
    with_n = float(device["force"]["per_count"]) * I16_HIGHEST
    resting = Change("active_damping", "with_force_full_scale_n", float(f"{with_n:.6g}"))
    changes = [*_changes(gain, physical, top), resting]
    return StepResult("damping", values, said, changes, arrays or {})


def _changes(gain: Value, physical: Value, top: float) -> list[Change]:
    """What is written, with the limit `top` [N s/m] of the device file."""
    changes = [change_of(gain)]
    if gain.rounded < top:  # no more than the converter makes
        changes.append(Change("limits", "active_damping_ns_per_m", gain.rounded))
    if physical.low > 0.0:
        least = float(f"{LEAST_SHARE * physical.low:.2g}")
        changes.append(Change("limits", "physical_damping_ns_per_m", least))
    return changes


def by_level(rows: Sequence[Row], found: Momentum) -> tuple[Floats, Floats]:
    """The levels (k,) [N s/m, of the device file] of the rows, and the gain by each (k,)."""
    left = found.impulses_of_damping(rows)
    damped = np.array([row.damped_ns for row in rows])
    level = np.array([row.level_ns_per_m for row in rows])
    octave = np.full(len(rows), -np.inf)
    np.log2(level, where=level > 0.0, out=octave)
    steady = level >= 0.9 * LEVELS[0] * level.max()
    groups = np.round(octave[steady])
    each = [steady.nonzero()[0][groups == one] for one in np.unique(groups)]
    levels = [float(level[at].mean()) for at in each]
    # of the line through the origin
    gains = [float(damped[at] @ left[at] / (damped[at] @ damped[at])) for at in each]
    return np.array(levels), np.array(gains)


def _residual(found: Momentum, known_n_per_a: float, scales: float) -> Iterator[Value]:
    """What the compensation leaves of the winding, in ohm where the force of an ampere is known."""
    rho = found.loop_per_ns_per_m / found.gain
    half = found.loop_half / abs(found.gain)
    if found.by_current:
        n_per_a = abs(found.n_per_a)
        yield Value.around("force per ampere", n_per_a, "N/A", hypot(scales, FLOOR) * n_per_a)
    else:
        half = hypot(half, BY_FRICTION * rho)
    half = hypot(half, 2.0 * scales * rho)
    if n_per_a := found.n_per_a or known_n_per_a:
        ohm = n_per_a**2
        yield Value.around("residual resistance", ohm * rho, "ohm", ohm * half)
    else:
        yield Value.around("residual back-EMF", rho, "m/s per N", half)


def _together(found: Momentum) -> Finding:
    """Whether every push fits the others."""
    worst = float(np.abs(found.beside).max())
    return checked(
        f"the worst push lies {percent(worst)} beside the others",
        worst <= MOST_BESIDE,
        "a stop or a hand was in its way: leave the handle free, 10 mm to either side, and repeat",
        "refused",
    )


def _line(levels: Floats, shares: Floats) -> Finding:
    """How far each level lies beside the line."""
    if len(levels) < LEAST_LEVELS:
        return Finding(
            f"only {len(levels)} levels of damping were seen",
            "refused",
            "let go of the handle, leave it free to move, and repeat",
        )
    told = ", ".join(
        f"{level:.3g}: {100.0 * (share - 1.0):+.2g} %"
        for level, share in zip(levels, shares, strict=True)
    )
    remedy = (
        "is the multiplier offset or at its end? Keep limits.active_damping_ns_per_m where it is"
        " straight"
    )
    straight = bool((np.abs(shares - 1.0) <= BESIDE).all())
    return checked(f"levels beside the line: {told}", straight, remedy)


def _believable(gain: float) -> Finding:
    remedy = "is full_scale_ns_per_m the hello's? Correct the device file, and repeat"
    likely = 1.0 / FACTOR <= gain <= FACTOR
    return checked(f"a commanded N s/m is {gain:.4g} N s/m", likely, remedy, "refused")


def _margin(found: Momentum, top: float) -> Finding:
    """The loop gain of the residual resistance at the limit."""
    loop = found.loop_per_ns_per_m * top
    what = f"loop gain {loop:+.2g} at {top:.3g} N s/m"
    if loop >= WARN:
        return Finding(what, "ok")
    greatest = REFUSE * top / loop
    return Finding(
        what,
        "refused" if loop < REFUSE else "warning",
        f"too much is compensated: limits.active_damping_ns_per_m at most {greatest:.3g}",
    )
