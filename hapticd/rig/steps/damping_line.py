"""The line of the damping through its levels, and what else pushes and glides say.

The gain of the damping is that of all rows together (`coast_down`). Its interval adds to that of
the fit what the device file says of the scales of force and position (`half_width_95`; UNKNOWN
without one), what the levels scatter about the line, and FLOOR.

The residual resistance is the loop gain per N s/m times the square of the force per ampere. Below 0
the circuit compensates more than the winding has, and at a loop gain of -1 it oscillates, so the
greatest level that is allowed is named.

The physical damping is what is proportional to speed without active damping; friction is not, and
counts for nothing at large motions. The device file gets LEAST_SHARE of the least that it can be.

What would break it: a `half_width_95` that is kept although its scale was changed by hand.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import hypot
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats
from hapticd.core.units import percent
from hapticd.render.winding import LEAST_LOOP_GAIN
from hapticd.rig.estimate import mean_half
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
from hapticd.rig.steps.coast_down import Momentum, Row, fit_momentum
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST

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
        _gain(found.gain),
        _loop(found, top),
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
    remedy = (
        "a stop or a hand was in its way: leave the handle free, 10 mm to either side, and repeat"
    )
    what = f"the worst push lies {percent(worst)} beside the others"
    return checked(what, worst <= MOST_BESIDE, remedy, "refused")


def _line(levels: Floats, shares: Floats) -> Finding:
    """How far each level lies beside the line."""
    if len(levels) < LEAST_LEVELS:
        what = f"only {len(levels)} levels of damping were seen"
        remedy = "let go of the handle, leave it free to move, and repeat"
        return Finding(what, "refused", remedy)
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


def _gain(gain: float) -> Finding:
    remedy = "is full_scale_ns_per_m the hello's? Correct the device file, and repeat"
    likely = 1.0 / FACTOR <= gain <= FACTOR
    return checked(f"a commanded N s/m is {gain:.4g} N s/m", likely, remedy, "refused")


def _loop(found: Momentum, top: float) -> Finding:
    """The loop gain of the residual resistance at the limit."""
    loop = found.loop_per_ns_per_m * top
    what = f"loop gain {loop:+.2g} at {top:.3g} N s/m"
    if loop >= WARN:
        return Finding(what, "ok")
    greatest = REFUSE * top / loop
    remedy = f"too much is compensated: limits.active_damping_ns_per_m at most {greatest:.3g}"
    return Finding(what, "refused" if loop < REFUSE else "warning", remedy)
