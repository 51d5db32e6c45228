"""How much active damping a board delivers, from sums of products of its measurements.

The damping circuit drives the current of the motor. F_r is the commanded force as it arrives at the
circuit (late, and smoothed if the device smooths). v^ is the velocity that the circuit derives from
the back-EMF:

    F_a = F_r - b v^            F_a = current x force per ampere
    v^  = v + rho F_a           rho: resistance of the winding left by the compensation
    F_a = alpha (F_r - b v),    alpha = 1 / (1 + b rho)

A winding hotter than its compensation therefore weakens damping and force alike (Weir, Colgate and
Peshkin 2008, section 5). The back-EMF alone cannot show this, because v^ and F_a agree. The
delivered damping is the slope of F_a on the true velocity at equal F_r. It is estimated as a
product,

    b      from  F_a = a F_r - b v^          sample by sample: all three are latched together
    p      from  v^  = p v + q F_r - p tau v'    v by the encoder, means over 8 periods
    delivered = b p

The first fit is accurate to a few counts of the current even in a limit cycle, where all signals
have one frequency. The second measures the share of the velocity that the circuit sees. Without
back-EMF the slope comes in one step from the encoder. Without current it comes from the voltage, V
= R i + K_m v, if the device file gives R. `basis` names the route.

Means over 8 periods: the encoder's difference is the exact mean velocity, and Simpson's rule gives
the other means (error (2 pi f T)^4 / 180). Prior knowledge bounds what the motion does not
determine: a is 1 +- 0.5, b q 0 +- 0.15, tau 0.15 +- 0.15 ms and the amplifier's lag 0.05 +- 0.05
ms, each as one standard deviation. The equations have an error of 0.5 % of the variation of the
fitted signal, which no number of samples averages.

The interval is Student's (95 %) of the estimates without each block in turn (jackknife: Quenouille
1956, Tukey 1958). It is widened by those bounds, by the attenuation of a slope by the encoder's
counts, and by 3 % for the calibration of current and force. An interval wider than +- 25 % of the
commanded active damping gives `unknown`: the handle rests, or force and velocity are collinear.

Limitations: a damping circuit much slower than 0.3 ms; a wrong scale of current or position (an
equal error in the result); sums over more than one level of damping.
"""

from collections.abc import Sequence
from enum import IntEnum
from math import hypot, inf, sqrt
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.params import DeviceParams, ServoParams
from hapticd.core.units import COPPER_PER_K

__all__ = [
    "CALIBRATION",
    "LAG_S",
    "SIMPSON",
    "WINDOW",
    "Block",
    "Column",
    "Estimate",
    "estimate",
]

LEAST = 8  # blocks from which an estimate is made
WINDOW = 8  # periods over which means are taken
SIMPSON = np.array([1.0, 4.0, 2.0, 4.0, 2.0, 4.0, 2.0, 4.0, 1.0]) / 24.0
STUDENT = (2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131)  # 97.5 %, LEAST to 16
CALIBRATION = 0.03  # of the scales of current and force
RESISTANCE = 0.05  # relative uncertainty of the device file's resistance
WIDEST = 0.25  # of the command: a wider interval is `unknown`
WIDEST_NS_PER_M = 0.1  # the same at low commanded active damping
LEAST_NS_PER_M = 1.0  # minimum damping for which allowances are made
MOST_ATTENUATED = 0.1  # share of counting noise in a velocity
LAG_S = 1.5e-4  # of the circuit, and its uncertainty
AMPLIFIER_S = 5e-5  # the same of the amplifier
GAIN = 0.5  # uncertainty of the amplifier's gain about 1
RESIDUAL = 0.15  # share of the damping that residual resistance may remove
MODEL = 0.005  # of the target's variation: error of the equations


class Column(IntEnum):
    """Columns of the sums of products: of samples, and of means over WINDOW periods."""

    FORCE = 0  # commanded, as it arrives at the circuit
    ONE = 1
    SEEN = 2  # velocity, by the back-EMF
    MOTOR = 3  # force, by the current
    VELOCITY = 4  # by the encoder
    ACCELERATION = 5
    VOLTAGE = 6
    RATE = 7  # of FORCE


NO_CURRENT = "unknown: the board sends no current, and no voltage over a known resistance"
NO_MOTION = "unknown: the handle hardly moves"
TOO_LITTLE = "unknown: too little was seen under force at this level"
TOO_WIDE = "unknown: this motion cannot separate force and velocity"


class Estimate(NamedTuple):
    """The delivered damping; None if unknown, with the reason in `basis`."""

    estimate_ns_per_m: float | None = None
    low: float | None = None
    high: float | None = None
    commanded: float = 0.0
    ratio: float | None = None
    basis: str = TOO_LITTLE
    seconds: float = 0.0  # of motion used


class Block(NamedTuple):
    """Sums of products over some records."""

    fine: Floats  # of samples (columns, columns)
    coarse: Floats  # of means


class Slope(NamedTuple):
    """Delivered damping by one route."""

    values: Floats  # N s/m (1 + blocks,): by all blocks, then without each in turn
    deviation: float  # N s/m of the first, from prior knowledge
    allowance: float  # N s/m of calibration
    attenuation: float  # share of it that counting noise may remove
    basis: str


def estimate(
    blocks: Sequence[Block], servo: ServoParams, commanded: float, winding_c: float
) -> Estimate:
    """Estimate the delivered damping from `blocks` (LEAST to 16 with motion), with `commanded` [N
    s/m] in effect and the winding at `winding_c` [degC, NaN: not known].
    """
    nothing = Estimate(commanded=commanded)
    telling = [block for block in blocks if block.coarse[Column.ONE, Column.ONE]]
    if len(telling) < LEAST:
        return nothing._replace(basis=TOO_LITTLE)
    fine = _with_and_without([block.fine for block in telling])
    coarse = _with_and_without([block.coarse for block in telling])
    seconds = float(coarse[0, Column.ONE, Column.ONE]) * WINDOW / servo.realtime.rate_hz
    try:
        slope = _slope(fine, coarse, servo, max(commanded, LEAST_NS_PER_M), winding_c)
    except np.linalg.LinAlgError:
        slope = TOO_WIDE
    if isinstance(slope, str):
        return nothing._replace(basis=slope, seconds=seconds)
    if slope.attenuation > MOST_ATTENUATED:
        return nothing._replace(basis=NO_MOTION, seconds=seconds)
    middle = float(slope.values[0])
    half = _half_width(slope)
    if not half <= max(WIDEST * commanded, WIDEST_NS_PER_M):
        return nothing._replace(basis=TOO_WIDE, seconds=seconds)
    ratio = middle / commanded if commanded > 0.0 else None
    return Estimate(middle, middle - half, middle + half, commanded, ratio, slope.basis, seconds)


def _half_width(slope: Slope) -> float:
    """Return the half-width of the interval [N s/m]: 95 %, plus systematic errors."""
    without = slope.values[1:]
    count = len(without)
    by_chance = sqrt((count - 1) * float(np.var(without)))
    known = hypot(STUDENT[count - LEAST] * by_chance, 2.0 * slope.deviation)
    return known + slope.allowance + slope.attenuation * abs(float(slope.values[0]))


def _with_and_without(sums: list[Floats]) -> Floats:
    """Return the sum of all, and the sums without each in turn (1 + blocks, columns, columns)."""
    each = np.array(sums)
    whole = each.sum(axis=0)
    return np.concatenate((whole[None], whole - each))


def _slope(
    fine: Floats, coarse: Floats, servo: ServoParams, scale_ns_per_m: float, winding_c: float
) -> Slope | str:
    """Return the slope by the route that the board's signals allow, or the reason why none does."""
    device = servo.device
    current_n = device.motor_n_per_a * device.current.per_count
    counted_m_per_s = device.position.per_count * servo.realtime.rate_hz / WINDOW
    noise = counted_m_per_s**2 / 6.0  # of the difference of two counts
    if not _varies(coarse[0], Column.VELOCITY, counted_m_per_s):
        return NO_MOTION
    if not _varies(fine[0], Column.MOTOR, current_n):
        if (
            not _varies(fine[0], Column.VOLTAGE, device.voltage.per_count)
            or device.winding_ohm <= 0.0
        ):
            return NO_CURRENT
        return _by_voltage(coarse, device, scale_ns_per_m, winding_c, noise)
    if not _varies(fine[0], Column.SEEN, device.emf_velocity.per_count):
        return _by_encoder(coarse, current_n, scale_ns_per_m, noise)
    return _by_emf(fine, coarse, current_n, device, scale_ns_per_m, noise)


def _varies(sums: Floats, column: int, quantum: float) -> bool:
    """Whether a signal is more than one count."""
    return _variance(sums, column) > 1e-3 * quantum**2


def _variance(sums: Floats, column: int) -> float:
    count = sums[Column.ONE, Column.ONE]
    return float(sums[column, column] / count - (sums[column, Column.ONE] / count) ** 2)


def _by_emf(
    fine: Floats,
    coarse: Floats,
    current_n: float,
    device: DeviceParams,
    scale_ns_per_m: float,
    noise: float,
) -> Slope:
    counted = device.emf_velocity.per_count**2 / 12.0
    of_force = (Known(Column.FORCE, 1.0, GAIN), Known(Column.RATE, -AMPLIFIER_S, AMPLIFIER_S))
    of_seen = fit(fine, Column.MOTOR, (Known(Column.SEEN), *of_force, Known(Column.ONE)), current_n)
    residual = Known(Column.FORCE, 0.0, RESIDUAL / scale_ns_per_m)
    sees = fit(
        coarse,
        Column.SEEN,
        (
            Known(Column.VELOCITY),
            residual,
            Known(Column.ACCELERATION, -LAG_S, LAG_S),
            Known(Column.ONE),
        ),
        device.emf_velocity.per_count / sqrt(WINDOW),
    )
    return Slope(
        -of_seen.values * sees.values,
        hypot(of_seen.deviation * sees.values[0], sees.deviation * of_seen.values[0]),
        CALIBRATION * scale_ns_per_m,
        of_seen.attenuated(counted) + sees.attenuated(noise),
        "current, back-EMF and encoder",
    )


def _by_encoder(coarse: Floats, current_n: float, scale_ns_per_m: float, noise: float) -> Slope:
    lag = Known(Column.ACCELERATION, scale_ns_per_m * LAG_S, scale_ns_per_m * LAG_S)
    late = Known(Column.RATE, -AMPLIFIER_S, AMPLIFIER_S)
    known = (Known(Column.VELOCITY), Known(Column.FORCE, 1.0, GAIN), late, lag, Known(Column.ONE))
    found = fit(coarse, Column.MOTOR, known, current_n / sqrt(WINDOW))
    return Slope(
        -found.values,
        found.deviation,
        CALIBRATION * scale_ns_per_m,
        found.attenuated(noise),
        "current and encoder, no back-EMF",
    )


def _by_voltage(
    coarse: Floats, device: DeviceParams, scale_ns_per_m: float, winding_c: float, noise: float
) -> Slope:
    """V = R i + K v, and so R / K times the force of the motor, and K v."""
    warmer_k = winding_c - device.winding_reference_c if np.isfinite(winding_c) else 0.0
    volt_per_n = device.winding_ohm * (1.0 + COPPER_PER_K * warmer_k) / device.motor_n_per_a
    lag = scale_ns_per_m * LAG_S * volt_per_n
    known = (
        Known(Column.VELOCITY),
        Known(Column.FORCE, volt_per_n, GAIN * volt_per_n),
        Known(Column.ACCELERATION, lag, lag),
        Known(Column.ONE),
    )
    found = fit(coarse, Column.VOLTAGE, known, device.voltage.per_count / sqrt(WINDOW))
    crowbar = device.motor_n_per_a / volt_per_n
    return Slope(
        crowbar - found.values / volt_per_n,
        found.deviation / volt_per_n,
        CALIBRATION * (scale_ns_per_m + 2.0 * crowbar) + RESISTANCE * scale_ns_per_m,
        found.attenuated(noise),
        "voltage, resistance and encoder, no current",
    )


class Known(NamedTuple):
    """A column of a fit, and the prior knowledge of its coefficient."""

    column: int
    mean: float = 0.0
    deviation: float = inf


class Fit(NamedTuple):
    """The first coefficient of a fit."""

    values: Floats  # (1 + blocks,)
    deviation: float
    information: float  # sum of squares of its column that the others do not explain
    rows: float

    def attenuated(self, noise: float) -> float:
        """Share of the slope removed by noise of variance `noise` in its column."""
        return self.rows * noise / self.information if self.information > 0.0 else inf


def fit(sums: Floats, target: int, known: tuple[Known, ...], quantum: float) -> Fit:
    """Least squares of column `target` on those of `known`, for each of `sums` (n, columns,
    columns). Prior knowledge enters as further observations with the residual's weight, which is at
    least counting noise, `quantum`.
    """
    columns = [one.column for one in known]
    normal = sums[:, columns][:, :, columns]
    right = sums[:, columns, target]
    size = np.sqrt(np.diagonal(normal[0]))
    size = np.where(size > 0.0, size, 1.0)
    normal = normal / np.outer(size, size)
    right = right / size
    count = float(sums[0, Column.ONE, Column.ONE])
    plainly = np.linalg.lstsq(normal[0], right[0], rcond=1e-10)[0]
    unexplained = sums[0, target, target] - right[0] @ plainly
    variance = max(
        float(unexplained) / max(count - len(known), 1.0),
        quantum**2 / 12.0,
        MODEL**2 * count * _variance(sums[0], target),
    )
    weight = variance / (np.array([one.deviation for one in known]) * size) ** 2
    means = np.array([one.mean for one in known]) * size
    together = normal + np.diag(weight + 1e-13)
    found = np.linalg.solve(together, (right + weight * means)[:, :, None])[:, 0, 0]
    spread = float(np.linalg.inv(together[0])[0, 0])
    return Fit(
        found / size[0],
        sqrt(variance * spread) / float(size[0]),
        float(size[0]) ** 2 / spread,
        count,
    )
