"""Estimate the active damping that the board delivers, and report a shortfall.

The records of the last 4 s are reduced to 16 blocks of sums of products. `delivered_estimate` makes
an estimate with an interval from them. A sample counts only if the board latched it itself, inside
the range of its converters, while it grants torque. All samples belong to one level of damping. A
block without information replaces an old one too, so the estimate ages.

A shortfall is an interval whose upper end stays below 80 % of the commanded active damping for 3 s.
It causes one warning, until the active damping is sufficient again. It causes a fault if the
environment in force needs more of it.

Records must be consecutive, or `forget` called between them.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapticd.core.arrays import Flags, Floats, Records
from hapticd.core.params import DeviceParams, ScaleParams, ServoParams
from hapticd.guard.delivered_estimate import (
    SIMPSON,
    WINDOW,
    Block,
    Column,
    Estimate,
    estimate,
)
from hapticd.mailbox.layout import Flag
from hapticd.protocol.ledger import CONTEXT, samples, smoothed
from hapticd.protocol.view import joined
from hapticd.usb.codec import I16_HIGHEST
from hapticd.usb.frames import StatusBit

__all__ = ["Delivered"]

BLOCK_S = 0.256
KEPT = 16  # blocks
UNEVEN = 0.05  # of a period: tolerance of the interval between consecutive samples
STEADY = 0.02  # relative change of level beyond which earlier samples do not count
SETTLED = 5.0  # time constants of the smoothing until the initial value is forgotten
LOW = 0.8  # of the commanded active damping
LOW_BLOCKS = 12  # consecutive: 3 s
NOT_BELIEVED = int(Flag.MISSING_IN | Flag.SEEDED | Flag.DOUBTED | Flag.GLITCH | Flag.INTERPOLATED)

NO_DEVICE = "unknown: the device file has no force per ampere"
NO_BLOCK = Block(np.zeros((len(Column), len(Column))), np.zeros((len(Column), len(Column))))


class Shortfall(NamedTuple):
    """A shortfall: whether it warrants a warning, and whether it warrants the fault."""

    estimate: Estimate
    warn: bool
    fault: bool


class CommandedForce(NamedTuple):
    """The commanded force at the input of the circuit, at each sample (n,)."""

    force_n: Floats
    rate_n_per_s: Floats
    settled: Flags  # where the smoothed force is known


class Delivered:
    """The estimate over the records of one servo life.

    `relied_on` returns the active damping [N s/m] that the environment in force needs according to
    the guard's verdict; None: no environment depends on it.
    """

    def __init__(self, servo: ServoParams, relied_on: Callable[[], float | None]) -> None:
        self._servo = servo
        self._relied_on = relied_on
        self._length = round(BLOCK_S * servo.realtime.rate_hz)  # of a block, in records
        self.begin()

    def begin(self) -> None:
        """Start again, for a new servo life."""
        self._blocks: deque[Block] = deque(maxlen=KEPT)
        self.estimate = Estimate()
        self._levels = np.zeros(2)
        self._low = 0
        self._warned = False
        self._faulted = False
        self.forget()

    def forget(self) -> None:
        """Note that records were lost: the next ones do not continue the previous ones."""
        self._pending: list[Records] = []
        self._count = 0
        self._seen: Records | None = None
        self._unsettle()

    def _unsettle(self) -> None:
        corner_hz = self._servo.device.force_smoothing_hz
        self._settling_s = SETTLED / (2.0 * np.pi * corner_hz) if corner_hz > 0.0 else 0.0
        self._motor_n = 0.0

    def take(self, records: Records) -> list[Shortfall]:
        """Take the next `records`; return the shortfalls to report."""
        self._pending.append(records)
        self._count += len(records)
        if self._count < self._length:
            return []
        new = joined(self._pending)
        whole = len(new) - len(new) % self._length
        self._pending = [new[whole:]]
        self._count = len(new) - whole
        parts = np.split(new[:whole], range(self._length, whole, self._length))
        return [low for part in parts for low in self._block(part)]

    def _block(self, records: Records) -> list[Shortfall]:
        commanded = float(records["active_damping_ns_per_m"][-1])
        if self._servo.device.motor_n_per_a <= 0.0:
            self.estimate = Estimate(basis=NO_DEVICE, commanded=commanded)
            return []
        seen = records if self._seen is None else joined((self._seen, records))
        self._seen = seen[-CONTEXT:].copy()
        block = self._sums(seen, len(seen) - len(records)) if self._steady(records) else None
        if block is None:
            self._unsettle()
        # a block without information counts too: the estimate ages
        self._blocks.append(block or NO_BLOCK)
        winding_c = float(records["winding_c"][-1])
        self.estimate = estimate(self._blocks, self._servo, commanded, winding_c)
        return self._judged()

    def _steady(self, records: Records) -> bool:
        """Return whether one level was in force throughout; forget samples of any other level."""
        levels = np.stack(
            [records["active_damping_ns_per_m"], records["active_damping_effect_ns_per_m"]]
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
        """Return the sums of `seen[new:]`; None if they contain too few samples."""
        rows = np.flatnonzero((seen["flags"] & NOT_BELIEVED) == 0)
        # the last sample before the new ones starts the first of their periods
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

    def _path(self, found: Records, period_s: float) -> CommandedForce:
        corner_hz = self._servo.device.force_smoothing_hz
        held_n = found["in_effect_n"]
        if corner_hz <= 0.0:
            return CommandedForce(held_n, np.zeros(len(found)), np.ones(len(found), bool))
        lasting_s = np.where(found["periods"] > 0.0, found["periods"], 1.0) * period_s
        path_n, _ = smoothed(found, lasting_s, period_s, 2.0 * np.pi * corner_hz, self._motor_n)
        settled = np.cumsum(lasting_s) > self._settling_s
        self._settling_s = max(self._settling_s - float(lasting_s[1:].sum()), 0.0)
        self._motor_n = float(path_n[-1])
        if not np.isfinite(self._motor_n):
            self._unsettle()
        return CommandedForce(path_n, 2.0 * np.pi * corner_hz * (held_n - path_n), settled)

    def _judged(self) -> list[Shortfall]:
        """Return a shortfall once it has lasted for 3 s: one warning, and the fault if the damping
        is needed.
        """
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
        return [Shortfall(found, warn, fault)] if warn or fault else []


def _measured(records: Records, device: DeviceParams) -> Flags:
    """Return where the board grants torque and measures finite values inside its
    converter ranges.
    """
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
    path: CommandedForce,
    motor_n: Floats,
    places: NDArray[np.intp],
    period_s: float,
) -> Block:
    """Return sums of products of samples, and of means over the windows at `places` (n, WINDOW +
    1).
    """
    fine = np.zeros((len(places) * WINDOW, len(Column)))
    coarse = np.zeros((len(places), len(Column)))
    for column, values in (
        (Column.FORCE, path.force_n),
        (Column.RATE, path.rate_n_per_s),
        (Column.ONE, np.ones(len(records))),
        (Column.SEEN, records["emf_velocity_m_per_s"].astype(float)),
        (Column.MOTOR, motor_n),
        (Column.VOLTAGE, records["voltage_v"].astype(float)),
    ):
        fine[:, column] = values[places[:, 1:]].ravel()
        coarse[:, column] = values[places] @ SIMPSON
    x = records["position_m"][places]
    coarse[:, Column.VELOCITY] = (x[:, -1] - x[:, 0]) / (WINDOW * period_s)
    faster_m = (x[:, -1] - x[:, -2]) - (x[:, 1] - x[:, 0])
    coarse[:, Column.ACCELERATION] = faster_m / ((WINDOW - 1) * period_s**2)
    return Block(fine.T @ fine, coarse.T @ coarse)
