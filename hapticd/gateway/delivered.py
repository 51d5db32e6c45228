"""How much active damping the board really delivers, estimated slowly from what it measures.

The damping circuit drives the current of the motor. With F_r the commanded force as it arrives at
the circuit (late, and smoothed where the device smooths), and v^ the velocity that the circuit
makes of the back-EMF,

    F_a = F_r - b v^            F_a = current x force per ampere
    v^  = v + rho F_a           rho: what the resistance compensation leaves of the winding
    F_a = alpha (F_r - b v),    alpha = 1 / (1 + b rho)

so a winding hotter than its compensation weakens damping and force alike (Weir, Colgate and Peshkin
2008, section 5), and the back-EMF alone cannot show it: v^ and F_a agree. What is delivered is the
slope of F_a on the true velocity at equal F_r. It is found as a product,

    b      from  F_a = a F_r - b v^          sample by sample: all three are latched together
    p      from  v^  = p v + q F_r - p tau v'    v by the encoder, means over 8 periods
    delivered = b p

The first holds to a few counts of the current even in a limit cycle, where everything has one
frequency; the second says how much of the velocity the circuit sees. Without back-EMF the slope is
found in one step from the encoder, and without current from the voltage, V = R i + K_m v, where the
device file knows R. `basis` says which it was.

Means over 8 periods: the encoder's difference is the exact mean velocity, Simpson's rule gives the
other means (error (2 pi f T)^4 / 180). Whatever the motion does not tell is bounded by what is
known beforehand: a is 1 +- 0.5, b q 0 +- 0.15, tau 0.15 +- 0.15 ms and the amplifier's lag 0.05 +-
0.05 ms, each as one standard deviation; and 0.5 % of the variation of what is fitted is error of
the equations, which no number of samples averages. The last 4 s are kept in 16 blocks as sums of
products; the interval is Student's (95 %) of the estimates without each block in turn (jackknife:
Quenouille 1956, Tukey 1958), widened by those bounds, by what the encoder's counts take from a
slope, and by 3 % for the calibration of current and force. An interval wider than +- 25 % of what
is commanded is `unknown`: the handle rests, or force and velocity cannot be told apart.

What would break it: a damping circuit much slower than 0.3 ms, records that are not consecutive
without `forget`, a scale of current or position that is wrong (it is wrong by as much).
"""

from collections import deque
from collections.abc import Callable, Sequence
from math import hypot, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapticd.analysis.ledger import Table, smoothed
from hapticd.gateway.ledger import CONTEXT, samples
from hapticd.gateway.view import Records
from hapticd.mailbox.layout import Flag
from hapticd.params import DeviceParams, ScaleParams, ServoParams
from hapticd.units import COPPER_PER_K
from hapticd.wire.codec import I16_HIGHEST
from hapticd.wire.frames import StatusBit

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

BLOCK_S = 0.256
KEPT = 16  # blocks
LEAST = 8  # blocks from which an estimate is made
WINDOW = 8  # periods over which means are taken
SIMPSON = np.array([1.0, 4.0, 2.0, 4.0, 2.0, 4.0, 2.0, 4.0, 1.0]) / 24.0
STUDENT = (2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131)  # 97.5 %, LEAST to KEPT
CALIBRATION = 0.03  # of the scales of current and force
RESISTANCE = 0.05  # of what the device file says of it
WIDEST = 0.25  # of what is commanded: an interval of +- more says nothing
WIDEST_NS_PER_M = 0.1  # the same where little is commanded
LEAST_NS_PER_M = 1.0  # for which allowances are made, where less is commanded
UNEVEN = 0.05  # of a period, between samples that follow each other
STEADY = 0.02  # change of level beyond which the past is of another one
SETTLED = 5.0  # time constants of the smoothing until what was before is forgotten
MOST_ATTENUATED = 0.1  # share of counting noise in a velocity
LAG_S = 1.5e-4  # of the circuit, and how far it may be from that
AMPLIFIER_S = 5e-5  # the same of the amplifier
GAIN = 0.5  # how far the amplifier's gain may be from 1
RESIDUAL = 0.15  # what the residual resistance may take of the damping
MODEL = 0.005  # of the target's variation: what the equations leave out, however long it is seen
LOW = 0.8  # of what is commanded
LOW_BLOCKS = 12  # in a row: 3 s
NOT_BELIEVED = int(Flag.MISSING_IN | Flag.SEEDED | Flag.DOUBTED | Flag.GLITCH | Flag.INTERPOLATED)

# columns of the sums of products: of samples, and of means over WINDOW periods
COLUMNS = 8
FORCE = 0  # commanded, as it arrives at the circuit
ONE = 1
SEEN = 2  # velocity, by the back-EMF
MOTOR = 3  # force, by the current
VELOCITY = 4  # by the encoder
ACCELERATION = 5
VOLTAGE = 6
RATE = 7  # of FORCE

NO_DEVICE = "unknown: the device file does not say the force per ampere"
NO_CURRENT = "unknown: the board sends no current, and no voltage over a known resistance"
NO_MOTION = "unknown: the handle hardly moves"
TOO_LITTLE = "unknown: too little was seen under force at this level"
TOO_WIDE = "unknown: force and velocity cannot be told apart by this motion"


class Estimate(NamedTuple):
    """What is delivered; None where it is unknown, and then `basis` says why."""

    estimate_ns_per_m: float | None
    low: float | None
    high: float | None
    commanded: float
    ratio: float | None
    basis: str
    seconds: float  # of motion that it rests on


class Low(NamedTuple):
    """Too little is delivered: whether to warn, and whether to ask for the fault."""

    text: str
    warn: bool
    fault: bool


class Block(NamedTuple):
    """Sums of products over some records."""

    fine: Floats  # of samples (columns, columns)
    coarse: Floats  # of means


NO_BLOCK = Block(np.zeros((COLUMNS, COLUMNS)), np.zeros((COLUMNS, COLUMNS)))


class Path(NamedTuple):
    """The commanded force as it arrives at the circuit, at each sample (n,)."""

    force_n: Floats
    rate_n_per_s: Floats
    settled: Flags  # it is known


NOTHING = Estimate(None, None, None, 0.0, None, TOO_LITTLE, 0.0)


class Delivered:
    """Follows the records of one servo life. `relied_on` says how much active damping [N s/m] the
    environment in force needs by the guard's verdict; None: nobody counts on it.
    """

    def __init__(self, servo: ServoParams, relied_on: Callable[[], float | None]) -> None:
        self._servo = servo
        self._relied_on = relied_on
        self._length = round(BLOCK_S * servo.realtime.rate_hz)  # of a block, in records
        self.begin()

    def begin(self) -> None:
        """A new life."""
        self._blocks: deque[Block] = deque(maxlen=KEPT)
        self.estimate = NOTHING
        self._levels = np.zeros(2)
        self._low = 0
        self._warned = False
        self._faulted = False
        self.forget()

    def forget(self) -> None:
        """Records were lost: the next ones stand alone."""
        self._pending: list[Records] = []
        self._count = 0
        self._seen: Records | None = None
        self._unsettle()

    def _unsettle(self) -> None:
        """Nothing is known of the smoothed force."""
        corner_hz = self._servo.device.force_smoothing_hz
        self._settling_s = SETTLED / (2.0 * np.pi * corner_hz) if corner_hz > 0.0 else 0.0
        self._motor_n = 0.0

    def take(self, records: Records) -> list[Low]:
        """The next `records`; what is to be said about them."""
        self._pending.append(records)
        self._count += len(records)
        if self._count < self._length:
            return []
        new = np.concatenate(self._pending)
        whole = len(new) - len(new) % self._length
        self._pending = [new[whole:]]
        self._count = len(new) - whole
        parts = np.split(new[:whole], range(self._length, whole, self._length))
        return [low for part in parts for low in self._block(part)]

    def plain(self) -> dict[str, Any]:
        """The estimate as a map of plain values, for messages."""
        return self.estimate._asdict()

    def _block(self, records: Records) -> list[Low]:
        commanded = float(records["added_damping_ns_per_m"][-1])
        if self._servo.device.motor_n_per_a <= 0.0:
            self.estimate = NOTHING._replace(basis=NO_DEVICE, commanded=commanded)
            return []
        seen = records if self._seen is None else np.concatenate((self._seen, records))
        self._seen = seen[-CONTEXT:].copy()
        block = self._sums(seen, len(seen) - len(records)) if self._steady(records) else None
        if block is None:
            self._unsettle()
        # what tells nothing takes its place too: what is known gets old
        self._blocks.append(block or NO_BLOCK)
        winding_c = float(records["winding_c"][-1])
        self.estimate = estimate(self._blocks, self._servo, commanded, winding_c)
        return self._judged()

    def _steady(self, records: Records) -> bool:
        """Whether one level was in force all the time; what was seen at another is forgotten."""
        levels = np.stack(
            [records["added_damping_ns_per_m"], records["damping_effect_ns_per_m"]]
        ).astype(float)
        latest = levels[:, -1]
        margin = STEADY * max(0.5, float(latest[0]))
        granted = bool((records["status"] & StatusBit.ENABLED).any())
        if not granted or not (np.abs(latest - self._levels) <= margin).all():
            self._blocks.clear()
            self._levels = latest
            self._low = 0
            self._faulted = self._faulted and granted
        return granted and bool((np.ptp(levels, axis=1) <= margin).all())

    def _sums(self, seen: Records, new: int) -> Block | None:
        """What `seen[new:]` adds; None if there is next to nothing in it."""
        rows = np.flatnonzero((seen["flags"] & NOT_BELIEVED) == 0)
        # the last sample before them begins the first of their periods
        begin = max(int(np.searchsorted(rows, new)) - 1, 0)
        if len(rows) - begin <= WINDOW:
            return None
        period_s = 1.0 / self._servo.realtime.rate_hz
        found = samples(seen, rows, self._servo)[begin:]
        at = seen[rows[begin:]]
        path = self._path(found, period_s)
        places = np.arange(0, len(at) - WINDOW, WINDOW)[:, None] + np.arange(WINDOW + 1)
        usable = path.settled & np.isfinite(path.force_n) & _measured(at, self._servo.device)
        even = np.abs(found["periods"] - 1.0) < UNEVEN
        whole = usable[places].all(axis=1) & even[places[:, 1:]].all(axis=1)
        motor_n = self._servo.device.motor_n_per_a * at["current_a"].astype(float)
        return _products(at, path, motor_n, places[whole], period_s)

    def _path(self, found: Table, period_s: float) -> Path:
        """The commanded force as it arrives at the circuit."""
        corner_hz = self._servo.device.force_smoothing_hz
        held_n = found["in_effect_n"]
        if corner_hz <= 0.0:
            return Path(held_n, np.zeros(len(found)), np.ones(len(found), bool))
        lasting_s = np.where(found["periods"] > 0.0, found["periods"], 1.0) * period_s
        path_n, _ = smoothed(found, lasting_s, period_s, 2.0 * np.pi * corner_hz, self._motor_n)
        settled = np.cumsum(lasting_s) > self._settling_s
        self._settling_s = max(self._settling_s - float(lasting_s[1:].sum()), 0.0)
        self._motor_n = float(path_n[-1])
        if not np.isfinite(self._motor_n):
            self._unsettle()
        return Path(path_n, 2.0 * np.pi * corner_hz * (held_n - path_n), settled)

    def _judged(self) -> list[Low]:
        """Low for some seconds: a warning once, and the fault where it is counted on."""
        found = self.estimate
        if found.high is None:
            return []
        if found.high >= LOW * found.commanded:
            self._low = 0
            self._warned = False
            return []
        self._low += 1
        if self._low < LOW_BLOCKS:
            return []
        relied_on = self._relied_on()
        fault = relied_on is not None and found.high < relied_on and not self._faulted
        warn = not self._warned
        self._warned = True
        self._faulted = self._faulted or fault
        return [Low(told(found), warn, fault)] if warn or fault else []


def told(found: Estimate) -> str:
    """That too little is delivered, in words."""
    percent = 100.0 * (found.ratio or 0.0)
    return (
        f"active damping: {found.estimate_ns_per_m:.3g} N s/m ({found.low:.3g} to {found.high:.3g})"
        f" delivered of {found.commanded:.3g} N s/m commanded, {percent:.0f} %, by {found.basis};"
        " look at the amplifier, its supply and the resistance compensation"
    )


def _measured(records: Records, device: DeviceParams) -> Flags:
    """Where the board grants torque and measures finite values inside its converters."""
    granted = (records["status"] & StatusBit.ENABLED) != 0
    clamped = (records["status"] & StatusBit.FORCE_CLAMPED) != 0
    inside = granted & ~clamped & np.isfinite(records["position_m"])
    for name, scale in (
        ("current_a", device.current),
        ("voltage_v", device.voltage),
        ("emf_velocity_m_per_s", device.emf_velocity),
    ):
        inside &= _inside(records[name], scale)
    return np.asarray(inside)


def _inside(values: NDArray[np.float32], scale: ScaleParams) -> Flags:
    """False for NaN too."""
    counts = scale.sign * values.astype(float) / scale.per_count + scale.offset_count
    return np.asarray(np.abs(counts) < I16_HIGHEST - 0.5)


def _products(
    records: Records,
    path: Path,
    motor_n: Floats,
    places: NDArray[np.intp],
    period_s: float,
) -> Block:
    """Sums of products of samples, and of means over the windows at `places` (n, WINDOW + 1)."""
    fine = np.zeros((len(places) * WINDOW, COLUMNS))
    coarse = np.zeros((len(places), COLUMNS))
    for column, values in (
        (FORCE, path.force_n),
        (RATE, path.rate_n_per_s),
        (ONE, np.ones(len(records))),
        (SEEN, records["emf_velocity_m_per_s"].astype(float)),
        (MOTOR, motor_n),
        (VOLTAGE, records["voltage_v"].astype(float)),
    ):
        fine[:, column] = values[places[:, 1:]].ravel()
        coarse[:, column] = values[places] @ SIMPSON
    x = records["position_m"][places]
    coarse[:, VELOCITY] = (x[:, -1] - x[:, 0]) / (WINDOW * period_s)
    faster_m = (x[:, -1] - x[:, -2]) - (x[:, 1] - x[:, 0])
    coarse[:, ACCELERATION] = faster_m / ((WINDOW - 1) * period_s**2)
    return Block(fine.T @ fine, coarse.T @ coarse)


# --- from sums of products to an interval ---------------------------------------------------------


class Slope(NamedTuple):
    """Delivered damping by one route."""

    values: Floats  # N s/m (1 + blocks,): by all blocks, then without each in turn
    deviation: float  # N s/m of the first, by what is known beforehand
    allowance: float  # N s/m of calibration
    attenuation: float  # share of it that counting noise may take away
    basis: str


def estimate(
    blocks: Sequence[Block], servo: ServoParams, commanded: float, winding_c: float
) -> Estimate:
    """What `blocks` say is delivered, with `commanded` [N s/m] in force."""
    nothing = NOTHING._replace(commanded=commanded)
    telling = [block for block in blocks if block.coarse[ONE, ONE]]
    if len(telling) < LEAST:
        return nothing._replace(basis=TOO_LITTLE)
    fine = _with_and_without([block.fine for block in telling])
    coarse = _with_and_without([block.coarse for block in telling])
    seconds = float(coarse[0, ONE, ONE]) * WINDOW / servo.realtime.rate_hz
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
    """Of the interval [N s/m]: 95 %, and what is not by chance."""
    without = slope.values[1:]
    count = len(without)
    by_chance = sqrt((count - 1) * float(np.var(without)))
    known = hypot(STUDENT[count - LEAST] * by_chance, 2.0 * slope.deviation)
    return known + slope.allowance + slope.attenuation * abs(float(slope.values[0]))


def _with_and_without(sums: list[Floats]) -> Floats:
    """All together, and without each in turn (1 + blocks, columns, columns)."""
    each = np.array(sums)
    whole = each.sum(axis=0)
    return np.concatenate((whole[None], whole - each))


def _slope(
    fine: Floats, coarse: Floats, servo: ServoParams, scale_ns_per_m: float, winding_c: float
) -> Slope | str:
    """The route that the board's signals allow; why none does."""
    device = servo.device
    current_n = device.motor_n_per_a * device.current.per_count
    counted_m_per_s = device.position.per_count * servo.realtime.rate_hz / WINDOW
    noise = counted_m_per_s**2 / 6.0  # of the difference of two counts
    if not _varies(coarse[0], VELOCITY, counted_m_per_s):
        return NO_MOTION
    if not _varies(fine[0], MOTOR, current_n):
        if not _varies(fine[0], VOLTAGE, device.voltage.per_count) or device.winding_ohm <= 0.0:
            return NO_CURRENT
        return _by_voltage(coarse, device, scale_ns_per_m, winding_c, noise)
    if not _varies(fine[0], SEEN, device.emf_velocity.per_count):
        return _by_encoder(coarse, current_n, scale_ns_per_m, noise)
    return _by_emf(fine, coarse, current_n, device, scale_ns_per_m, noise)


def _varies(sums: Floats, column: int, quantum: float) -> bool:
    """Whether a signal is more than one count."""
    return _variance(sums, column) > 1e-3 * quantum**2


def _variance(sums: Floats, column: int) -> float:
    count = sums[ONE, ONE]
    return float(sums[column, column] / count - (sums[column, ONE] / count) ** 2)


def _by_emf(
    fine: Floats,
    coarse: Floats,
    current_n: float,
    device: DeviceParams,
    scale_ns_per_m: float,
    noise: float,
) -> Slope:
    counted = device.emf_velocity.per_count**2 / 12.0
    of_force = (Known(FORCE, 1.0, GAIN), Known(RATE, -AMPLIFIER_S, AMPLIFIER_S))
    of_seen = fit(fine, MOTOR, (Known(SEEN), *of_force, Known(ONE)), current_n)
    residual = Known(FORCE, 0.0, RESIDUAL / scale_ns_per_m)
    lag = Known(ACCELERATION, -LAG_S, LAG_S)
    sees = fit(
        coarse,
        SEEN,
        (Known(VELOCITY), residual, lag, Known(ONE)),
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
    lag = Known(ACCELERATION, scale_ns_per_m * LAG_S, scale_ns_per_m * LAG_S)
    late = Known(RATE, -AMPLIFIER_S, AMPLIFIER_S)
    known = (Known(VELOCITY), Known(FORCE, 1.0, GAIN), late, lag, Known(ONE))
    found = fit(coarse, MOTOR, known, current_n / sqrt(WINDOW))
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
        Known(VELOCITY),
        Known(FORCE, volt_per_n, GAIN * volt_per_n),
        Known(ACCELERATION, lag, lag),
        Known(ONE),
    )
    found = fit(coarse, VOLTAGE, known, device.voltage.per_count / sqrt(WINDOW))
    crowbar = device.motor_n_per_a / volt_per_n
    return Slope(
        crowbar - found.values / volt_per_n,
        found.deviation / volt_per_n,
        CALIBRATION * (scale_ns_per_m + 2.0 * crowbar) + RESISTANCE * scale_ns_per_m,
        found.attenuated(noise),
        "voltage, resistance and encoder, no current",
    )


class Known(NamedTuple):
    """A column of a fit, and what is known of its coefficient beforehand."""

    column: int
    mean: float = 0.0
    deviation: float = inf


class Fit(NamedTuple):
    """The first coefficient of a fit."""

    values: Floats  # (1 + blocks,)
    deviation: float
    information: float  # squares of its column that the others do not explain
    rows: float

    def attenuated(self, noise: float) -> float:
        """Share of the slope that noise of variance `noise` in its column takes away."""
        return self.rows * noise / self.information if self.information > 0.0 else inf


def fit(sums: Floats, target: int, known: tuple[Known, ...], quantum: float) -> Fit:
    """Least squares of column `target` on those of `known`, for each of `sums` (n, columns,
    columns), with what is known beforehand as further observations of the residual's weight; that
    is at least counting noise, `quantum`.
    """
    columns = [one.column for one in known]
    normal = sums[:, columns][:, :, columns]
    right = sums[:, columns, target]
    size = np.sqrt(np.diagonal(normal[0]))
    size = np.where(size > 0.0, size, 1.0)
    normal = normal / np.outer(size, size)
    right = right / size
    count = float(sums[0, ONE, ONE])
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
