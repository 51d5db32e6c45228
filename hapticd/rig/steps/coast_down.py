"""Momentum balance of pushes and free glides, from rest to rest: damping and its compensation.

A handle at rest is pushed with the impulse J, glides, and comes to rest again after the distance D
and the time T of motion. For any mass, and any delay or smoothing of the force,

    J = P + (b0 D + Fc T - s G T) (1 + g b)         P = integral of b dx

with the active damping b, the physical damping b0, Coulomb friction Fc, a constant force G
(gravity, the force at a count of 0) and the direction s of the motion: no momentum remains from
rest to rest. The mass need not be known. The lag of amplifier and circuit drops out as well. T
begins with the command and its delay, since friction absorbs the part of a smoothed force that acts
before it exceeds friction. b is the value sent to the damping DAC times an unknown gain. J is known
from the measured gain of the force, D from that of the encoder.

g b is the loop gain of the residual resistance. The circuit sees the velocity v + rho F_a, and the
motor produces F_a = (F - b v) / (1 + g b), with g = rho. It weakens force and damping alike. In J
alone it appears only as friction that seems to take more of J at higher b: slow pushes are mostly
friction, fast ones mostly damping. Where the board reports the motor's current, its integral Q
replaces the friction term,

    J = P + N Q (1 + g b)                           N: endpoint force per ampere

and friction need not be repeatable. N comes from the pushes at b = 0.

Least squares (Gauss-Newton) over all pushes, each weighted by its possible error: TIMING_S of
friction, and MODEL of the impulse. If the residuals are larger, they determine the interval
(Student's t).

The gain of the damping comes from all rows together. Its interval adds to that of the fit the
intervals of the scales of force and position (`half_width_95`; UNKNOWN without one), the scatter of
the levels about the line, and FLOOR.

The residual resistance is the loop gain per N s/m times the square of the force per ampere. Below 0
the circuit compensates more than the winding has, and at a loop gain of -1 it oscillates, so the
finding states the maximum permitted level.

The physical damping is the part proportional to speed without active damping. Friction is not
proportional, and is negligible at large motions. The device file gets LEAST_SHARE of the lower end
of its interval.

Limitations: a `half_width_95` that is kept although its scale was changed by hand. A handle that is
held or pushed by something else, or that has not come to rest (such a push gives no row). Friction
that depends on the level of damping (without a current).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats, Records
from hapticd.core.params import ScaleParams
from hapticd.core.units import US_PER_S, percent
from hapticd.render.winding import LEAST_LOOP_GAIN
from hapticd.rig.result import (
    FACTOR,
    Change,
    Finding,
    Fit,
    StepResult,
    Value,
    change_of,
    checked,
    least_squares,
    mean_half,
    relative_half,
    separable,
)
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST

STILL_COUNTS = 6.0  # peak to peak at rest, including noise
REST_S = 0.05  # at either end of a record
EDGE_COUNTS = 10.0  # from rest, where the motion is timed
LEAST_WAY_COUNTS = 10.0 * EDGE_COUNTS  # minimum distance of a usable push
GLIDE_EDGES = 20.0  # edges in a distance whose last nine are those of its glide
TIMING_S = 5e-4  # possible error of the time of motion
MODEL = 0.003  # share of the impulse that the equation may omit
ITERATIONS = 30
LOOP_STEP = 1e-3  # m/s per N, over which the loop gain is differentiated: it is linear
LEAST_AMPERE_COUNTS = 20.0  # mean current of the weakest push that is usable
EXPLAINED = 0.03  # of the impulse at count 0 that the current may leave unexplained
LEVELS = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1)  # of the limit
LEAST_LEVELS = 3
UNKNOWN = 0.01  # half of the interval of a scale whose table states none
FLOOR = 0.003  # of the gain, for any number of pushes
BY_FRICTION = 0.1  # of the residual back-EMF, if it is separated from friction without a current
BIAS = 0.01  # of the physical damping: friction appears to end sooner than it does
MOST_BESIDE = 0.1  # share of its impulse by which a push may deviate from the others
BESIDE = 0.03  # share by which a level may deviate from the line
REFUSE = LEAST_LOOP_GAIN
WARN = 0.5 * REFUSE  # loop gain
LEAST_SHARE = 2.0 / 3.0  # of the lower limit of the physical damping, for the fault `energy`


class Row(NamedTuple):
    """One push from rest to rest, in the direction of its motion."""

    impulse_ns: float  # J, commanded
    way_m: float  # D
    seconds: float  # T
    damped_ns: float  # P, with the damping according to the device file
    charge_as: float  # Q, of the current above that at rest
    level_ns_per_m: float  # b, steady; that of P / D otherwise
    direction: float  # +1 or -1


def row_of(records: Records, force: ScaleParams, m_per_count: float, rate_hz: float) -> Row | None:
    """Return the row of the `records` of a push. None if ticks are missing or were late by a
    period, or the push does not begin and end at rest.
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
    direction = float(np.sign(went))
    away = direction * (position - before.mean())
    period_s = 1.0 / rate_hz
    commanded = quantised(records["force_n"].astype(np.float64), force)
    edge = EDGE_COUNTS * m_per_count
    begin = _begin(records, commanded, away, edge, rate_hz)
    seconds = max(_end(away, abs(went), edge) - begin, 1.0) * period_s
    impulse = direction * float((commanded - commanded[0]).sum()) * period_s
    level = records["active_damping_effect_ns_per_m"][1:].astype(np.float64)
    damped = float(level @ np.diff(away))
    current = records["current_a"].astype(np.float64)
    charge = direction * float((current - current[:rest].mean()).sum()) * period_s
    return Row(impulse, abs(went), seconds, damped, charge, damped / abs(went), direction)


def quantised(force_n: Floats, scale: ScaleParams) -> Floats:
    """Return `force_n` (n,) as quantised by the converter."""
    counts = np.floor(scale.sign * force_n / scale.per_count + scale.offset_count + 0.5)
    return np.asarray(scale.sign * (counts - scale.offset_count) * scale.per_count)


def _begin(records: Records, commanded: Floats, away: Floats, edge: float, rate_hz: float) -> float:
    """Return the period in which the push (n,) began to act: the command plus its measured delay.
    Without a known delay, the motion gives the begin. A smoothed force moves the handle later, but
    friction takes as much of the impulse before.
    """
    delay_us = records["delay_us"].astype(np.float64)
    told = delay_us[delay_us >= 0.0]
    if not told.size:
        return _rest(away, edge, 2)
    pushed = int(np.argmax(commanded != commanded[0]))
    return pushed + float(np.median(told)) * rate_hz / US_PER_S


def _end(away: Floats, way: float, edge: float) -> float:
    """Return the period in which the motion (n,) ended: `_rest` applied backwards. Damping brakes a
    fast handle more than a slow one, so a long glide uses the next order as well.
    """
    order = 3 if way > GLIDE_EDGES * edge else 2
    return len(away) - 1 - _rest((way - away)[::-1], edge, order)


def _rest(rising: Floats, edge: float, order: int) -> float:
    """Return the sample, interpolated, at which a motion (n,) from rest began. Near there the speed
    is proportional to time, so the root of the distance is a line. It takes as long to `edge` as
    from there to four times `edge`. With order 3 it is a parabola, which also uses nine times
    `edge`.
    """
    root = np.sqrt(np.maximum(rising, 0.0))
    one, two, *more = (_crossing(root, share * edge**0.5) for share in range(1, order + 1))
    return 2.0 * one - two if not more else 3.0 * one - 3.0 * two + more[0]


def _crossing(rising: Floats, level: float) -> float:
    """Return where (n,) rises above `level` for the last time, between samples."""
    place = int(np.flatnonzero(rising < level)[-1])
    if place + 1 >= len(rising):
        return float(place)
    step = float(rising[place + 1] - rising[place])
    return place + (level - float(rising[place])) / step


@dataclass(frozen=True)
class Momentum:
    """Result of the fit to all rows, each value with half of its 95 % interval."""

    gain: float  # of the damping, relative to the device file
    gain_half: float
    loop_per_ns_per_m: float  # g, per N s/m of the device file
    loop_half: float
    n_per_a: float  # 0 if friction was fitted in place of the current
    physical_ns_per_m: float
    physical_half: float
    coulomb_n: float
    coulomb_half: float
    braked_ns: Floats  # (n,) part of each impulse dissipated by active damping
    beside: Floats  # (n,) share of each impulse that is left over


def fit_momentum(rows: Sequence[Row], a_per_count: float) -> Momentum:
    """Fit at least eight `rows`, some at level 0. The loop gain needs two or more other levels, and
    is taken as 0 otherwise.
    """
    every = _columns(rows)
    # of b0, Fc and G
    friction = np.column_stack([every.way_m, every.seconds, -every.direction * every.seconds])
    weight = _weights(every, friction)
    by_current = _current_tells(every, a_per_count)
    loads = every.charge_as[:, None] if by_current else friction
    level = every.level_ns_per_m
    loops = len(np.unique(np.round(np.log2(level[level > 0.0])))) > 1
    found = _fit(every, loads, weight, loops)
    gain, *coefficients = found.values[: 1 + loads.shape[1]]
    loop, loop_half = (found.values[-1], found.halves[-1]) if loops else (0.0, 0.0)
    weaker = 1.0 + loop * level
    took = (every.impulse_ns - gain * every.damped_ns) / weaker
    mechanics = least_squares(friction, took, weight * weaker, least=1.0)
    physical, coulomb_n, _ = mechanics.values.tolist()
    physical_half, coulomb_half, _ = mechanics.halves.tolist()
    # a timing error common to all pushes shifts friction; damping changes by the opposite amount
    mistimed_n = coulomb_n * TIMING_S / float(np.median(every.seconds))
    slowness = float(np.median(every.seconds / every.way_m))
    braked = every.impulse_ns - loads @ np.array(coefficients) * weaker
    return Momentum(
        float(gain),
        float(found.halves[0]),
        float(loop),
        float(loop_half),
        float(coefficients[0]) if by_current else 0.0,
        physical,
        hypot(physical_half, mistimed_n * slowness),
        coulomb_n,
        hypot(coulomb_half, mistimed_n),
        braked,
        (braked - gain * every.damped_ns) / every.impulse_ns,
    )


def _columns(rows: Sequence[Row]) -> Any:
    """Return all rows as a record array (n,) with the names of their fields."""
    return np.rec.array(list(rows), dtype=[(name, np.float64) for name in Row._fields])


def _weights(every: Any, friction: Floats) -> Floats:
    """Return 1 / the possible error of each impulse (n,)."""
    free = every.damped_ns < 0.05 * every.impulse_ns
    guess = np.linalg.lstsq(friction[free], every.impulse_ns[free], rcond=None)[0]
    return np.asarray(1.0 / np.hypot(TIMING_S * abs(float(guess[1])), MODEL * every.impulse_ns))


def _current_tells(every: Any, a_per_count: float) -> bool:
    """Return whether the current of pushes at level 0 is proportional to their impulse."""
    mean_a = np.abs(every.charge_as) / np.maximum(every.seconds, 1e-3)
    if not (mean_a > LEAST_AMPERE_COUNTS * a_per_count).all():
        return False
    free = every[every.damped_ns < 1e-3 * every.impulse_ns]
    ratio = free.impulse_ns / free.charge_as
    return bool(len(free) >= 2 and np.ptp(ratio) <= 2.0 * EXPLAINED * abs(ratio.mean()))


def _fit(every: Any, loads: Floats, weight: Floats, loops: bool) -> Fit:
    """Fit J = k P + (loads a) (1 + g b): (k, a.., g), without g unless `loops`."""

    def columns_of(loop: Floats) -> Floats:
        weaker = 1.0 + loop * every.level_ns_per_m
        return np.column_stack([every.damped_ns, loads * weaker[:, None]])

    if not loops:
        return least_squares(columns_of(np.zeros(1)), every.impulse_ns, weight, least=1.0)
    return separable(columns_of, every.impulse_ns, np.zeros(1), LOOP_STEP, ITERATIONS, weight)


def analyse(
    rows: Sequence[Row],
    device: Mapping[str, Any],
    findings: Sequence[Finding] = (),
    arrays: Mapping[str, npt.NDArray[Any]] | None = None,
) -> StepResult:
    """Return the result of `rows` on a device with the parameters `device` (as in the servo's
    hello).
    """
    found = fit_momentum(rows, float(device["current"]["per_count"]))
    # newtons and metres by the scales of the device file
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
        checked(
            f"a commanded N s/m is {found.gain:.4g} N s/m",
            1.0 / FACTOR <= found.gain <= FACTOR,
            "is full_scale_ns_per_m the hello's? Correct the device file, and repeat",
            "refused",
        ),
        margin(found.loop_per_ns_per_m * top, top, "limits.active_damping_ns_per_m at most {:.3g}"),
    ]
    with_n = float(device["force"]["per_count"]) * I16_HIGHEST
    changes = [
        *_changes(gain, physical, top),
        Change("active_damping", "with_force_full_scale_n", float(f"{with_n:.6g}")),
    ]
    return StepResult("damping", values, said, changes, arrays or {})


def _changes(gain: Value, physical: Value, top: float) -> Iterator[Change]:
    """Yield the changes to write, with the limit `top` [N s/m] of the device file."""
    yield change_of(gain)
    if gain.rounded < top:  # no more than the converter makes
        yield Change("limits", "active_damping_ns_per_m", gain.rounded)
    if physical.low > 0.0:
        least = float(f"{LEAST_SHARE * physical.low:.2g}")
        yield Change("limits", "physical_damping_ns_per_m", least)


def by_level(rows: Sequence[Row], found: Momentum) -> tuple[Floats, Floats]:
    """Return the levels (k,) of the rows [N s/m, of the device file], and the gain at each (k,)."""
    level = _columns(rows).level_ns_per_m
    steady = np.flatnonzero(level >= 0.9 * LEVELS[0] * level.max())
    octave = np.round(np.log2(level[steady]))
    each = [steady[octave == one] for one in np.unique(octave)]
    damped = _columns(rows).damped_ns
    # of the line through the origin
    gains = [damped[at] @ found.braked_ns[at] / (damped[at] @ damped[at]) for at in each]
    return np.array([level[at].mean() for at in each]), np.array(gains)


def _residual(found: Momentum, known_n_per_a: float, scales: float) -> Iterator[Value]:
    """Residual of the compensation, in ohm where the force per ampere is known."""
    rho = found.loop_per_ns_per_m / found.gain
    n_per_a = abs(found.n_per_a)
    if n_per_a:
        yield Value.around("force per ampere", n_per_a, "N/A", hypot(scales, FLOOR) * n_per_a)
    model = 0.0 if n_per_a else BY_FRICTION * rho
    half = hypot(found.loop_half / abs(found.gain), model, 2.0 * scales * rho)
    if ohm := (n_per_a or known_n_per_a) ** 2:
        yield Value.around("residual resistance", ohm * rho, "ohm", ohm * half)
    else:
        yield Value.around("residual back-EMF", rho, "m/s per N", half)


def _together(found: Momentum) -> Finding:
    """Check that every push fits the others."""
    worst = float(np.abs(found.beside).max())
    return checked(
        f"the worst push lies {percent(worst)} beside the others",
        worst <= MOST_BESIDE,
        "a stop or a hand was in its way: leave the handle free, 10 mm to either side, and repeat",
        "refused",
    )


def _line(levels: Floats, shares: Floats) -> Finding:
    """Check how far each level deviates from the line."""
    if len(levels) < LEAST_LEVELS:
        remedy = "let go of the handle, leave it free to move, and repeat"
        return Finding(f"only {len(levels)} levels of damping were seen", "refused", remedy)
    told = ", ".join(
        f"{level:.3g}: {100.0 * (share - 1.0):+.2g} %"
        for level, share in zip(levels, shares, strict=True)
    )
    return checked(
        f"levels that deviate from the line: {told}",
        bool((np.abs(shares - 1.0) <= BESIDE).all()),
        "is the multiplier offset or at its end? Keep limits.active_damping_ns_per_m where it is"
        " straight",
    )


def margin(loop: float, top_ns_per_m: float, remedy: str) -> Finding:
    """Judge a `loop` gain of the residual resistance at the damping `top_ns_per_m`. `remedy` has a
    placeholder for the maximum permitted damping.
    """
    return checked(
        f"loop gain {loop:+.2g} at {top_ns_per_m:.3g} N s/m",
        loop >= WARN,
        f"too much is compensated: {remedy.format(REFUSE * top_ns_per_m / min(loop, WARN))}",
        "refused" if loop < REFUSE else "warning",
    )
