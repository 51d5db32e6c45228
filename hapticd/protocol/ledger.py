"""The energy ledger: the work that each cause does on the device, tick by tick.

Work done on the device is positive. The law's force L_k belongs to the sample x_k. It takes effect
d_k periods later and is then held until the next one takes effect. The motion is known at the
samples and taken as straight between them. An ideal element would act at once and without steps.
Its work from sample to sample, (L_{k-1} + L_k) / 2 (x_k - x_{k-1}), is exact for a spring and
defines `stiffness`, `damping`, `mass` and `fields`. With b = x - x_p the deflection of the spring
from its proxy x_p, and p = -K b its force,

    stiffness   (p_k b_k - p_{k-1} b_{k-1}) / 2          = - change of the energy K b^2 / 2 stored
    ramp        (p_{k-1} b_k - p_k b_{k-1}) / 2          = energy added by a change of K
                + (p_{k-1} + p_k) (x_p,k - x_p,k-1) / 2  = energy added by a motion of the proxy;
                the same as for K for virtual mass, walls and ends, and for a wall that is moved
    damping, mass, fields    as above, without `ramp`

Summation by parts gives the work of the steps and their delay. An ideal step dL_k = L_k - L_{k-1}
would come gradually, between the samples k-1 and k. The real one comes late by half a sample, and
then by the d_k periods until it takes effect.

    hold_delay  - dL_k (x_k - x_{k-1}) / 2               for the hold, in the tick in which it is
                                                         computed
                - dL_k (x(t) - x_k)                      as long as it is on its way

For a spring this is K (T/2 + d T) int v^2 dt to the first order (Colgate and Schenkel 1997), and
more exact at every frequency. It is booked while it happens, so sums are right at every sample.
After a gap of n periods the step has been delayed (n - 1) / 2 periods longer:

    gap         - dL_k (x_k - x_{k-1}) (1 - 1/n) / 2

The sent force differs from the law's by the clamp and by rounding to counts. Each difference is a
force of its own that is held and comes late:

    clamp         work of clamped - L        quantisation   work of sent - clamped
    electrical    - b (x_k - x_{k-1})^2 / T of the active damping in effect, as the board reports
                  it: a lower bound of the dissipation (`electrical_commanded`: as sent; not part of
                  the sum)
    lag           (smoothed devices) - (1/w) dF v: work of the motor minus that of the held force,
                  for a motor force F that follows with a first-order corner w

The whole is computed independently, from the board's reports of the force in effect at each sample
and of its age. `unexplained` is the whole minus all causes: a frame that never arrived, a wrong
assumed delay, several forces between two samples.

The ledger of a servo life (`Ledger`) has the sums by cause, from the first record on. `samples`
extracts the samples from the records. A record without a fresh sample adds nothing, and the next
one covers the whole motion since the last sample: a NaN or a fault erases nothing. The sent force
is the record's `force_n`. The shares of the law, of its limit, and of a push from outside the law
follow from its other columns. The force in effect comes from the frames alone: the sequence number
that the board reports, and 0 without granted torque. Records must be in order, and `forget` must be
called at a gap, across which the motion is unknown.

Rows must be consecutive unless `periods` states otherwise, and SAMPLE must have all parts of a
force. Limitations: a delay beyond LONGEST periods (it becomes `unexplained`).
"""

from math import exp

import numpy as np
from numpy.typing import NDArray

from hapticd.core.arrays import Floats, Records
from hapticd.core.params import ServoParams
from hapticd.core.units import US_PER_S
from hapticd.mailbox.layout import Flag
from hapticd.protocol.view import joined
from hapticd.usb.codec import TORQUE_SEQUENCES
from hapticd.usb.frames import IN_EFFECT, IN_OFFSETS, StatusBit

__all__ = [
    "BOOKED",
    "CONTEXT",
    "LONGEST",
    "NAMES",
    "SAMPLE",
    "Ledger",
    "book",
    "samples",
    "smoothed",
]

# one row per usable sample
SAMPLE = np.dtype(
    [
        ("position_m", "f8"),
        ("proxy_m", "f8"),  # anchor of the virtual spring
        ("stiffness_n", "f8"),  # parts of the law's force
        ("virtual_damping_n", "f8"),
        ("mass_n", "f8"),
        ("field_n", "f8"),  # walls, ends, and any force outside the law
        ("clamped_n", "f8"),  # their sum inside the limit
        ("sent_n", "f8"),
        ("delay", "f8"),  # periods from its sample to its effect, of the force in effect now
        ("periods", "f8"),  # since the sample before; 0: the motion before is unknown
        ("in_effect_n", "f8"),  # as the board reports at this sample
        ("since", "f8"),  # periods that this force had been in effect, at this sample
        ("active_damping_ns_per_m", "f8"),  # active damping in effect, as the board reports
        ("active_damping_asked_ns_per_m", "f8"),  # as sent
        ("mass_kg", "f8"),  # virtual mass
        ("wall_n_per_m", "f8"),
        ("wall_m", "f8"),
        ("wall_side", "f8"),
        ("end_n_per_m", "f8"),
    ]
)
CAUSES = (
    "stiffness",
    "virtual_damping",
    "mass",
    "fields",
    "hold_delay",
    "quantisation",
    "clamp",
    "ramp",
    "gap",
    "electrical",
    "lag",
)
BOOKED = np.dtype(
    [(name, "f8") for name in (*CAUSES, "unexplained", "whole", "electrical_commanded")]
)
LONGEST = 8  # periods for which a pending force is followed


def book(
    samples: Records,
    period_s: float,
    ends_m: tuple[float, float] = (-np.inf, np.inf),
    smoothing_hz: float = 0.0,
    motor_n: float = 0.0,
) -> tuple[Records, Floats]:
    """Return the work [J] between each of `samples` (n,) of SAMPLE and the one before, as BOOKED
    (n,), and the force [N] of a smoothed motor at each (n,). The first row is 0.

    `ends_m`: where the springs at the ends of the workspace begin. `smoothing_hz`: corner of the
    device's force, 0 for none; `motor_n`: its force at the first sample.
    """
    way = _difference(samples["position_m"])
    way[samples["periods"] == 0.0] = 0.0
    periods = np.where(samples["periods"] > 0.0, samples["periods"], 1.0)
    whole_periods = np.maximum(np.rint(periods), 1.0)  # clock jitter is not a gap
    lead = _ways_before_effect(samples["delay"], periods, way)
    found = np.zeros(len(samples), BOOKED)
    _book_ideal(found, samples, way, periods, period_s, ends_m)
    step = _difference(_law(samples))
    found["gap"] = -0.5 * step * way * (1.0 - 1.0 / whole_periods)
    found["hold_delay"] = -0.5 * step * way / whole_periods - _late(step, lead)
    found["clamp"] = _held(samples["clamped_n"] - _law(samples), way, lead)
    found["quantisation"] = _held(samples["sent_n"] - samples["clamped_n"], way, lead)
    dissipated = -(way**2) / (periods * period_s)
    for name, level in (
        ("electrical", "active_damping"),
        ("electrical_commanded", "active_damping_asked"),
    ):
        found[name] = _mean(samples[f"{level}_ns_per_m"]) * dissipated
    motor = np.zeros(len(samples))
    done = _reported(samples, way, periods)
    if smoothing_hz > 0.0:
        w = 2.0 * np.pi * smoothing_hz
        motor, mean = smoothed(samples, periods * period_s, period_s, w, motor_n)
        found["lag"] = -way / (periods * period_s) * _difference(motor) / w
        done = mean * way
    found["whole"] = done + found["electrical"]
    found["unexplained"] = found["whole"] - sum(found[name] for name in CAUSES)
    return found, motor


def _book_ideal(
    found: Records,
    samples: Records,
    way: Floats,
    periods: Floats,
    period_s: float,
    ends_m: tuple[float, float],
) -> None:
    """Book the ideal elements, and the energy added by changes of their settings."""
    moving = samples["periods"] > 0.0
    x = samples["position_m"]
    spring = samples["stiffness_n"]
    bent = x - samples["proxy_m"]
    found["stiffness"] = 0.5 * _difference(spring * bent) * moving
    from_spring = 0.5 * (_before(spring) * bent - spring * _before(bent)) * moving
    from_spring += _ideal(spring, _difference(samples["proxy_m"])) * moving
    speed = way / (periods * period_s)
    from_mass = 0.5 * _difference(samples["mass_kg"]) * speed**2
    middle = 0.5 * (x + _before(x))
    from_fields = (
        _stored_in_fields(samples, middle, ends_m)
        - _stored_in_fields(samples[_rows_before(len(samples), 1)], middle, ends_m)
    ) * moving
    found["ramp"] = from_spring + from_mass + from_fields
    found["virtual_damping"] = _ideal(samples["virtual_damping_n"], way)
    found["mass"] = _ideal(samples["mass_n"], way) - from_mass
    found["fields"] = _ideal(samples["field_n"], way) - from_fields


def _law(samples: Records) -> Floats:
    """The law's force before its limit."""
    parts = ("stiffness_n", "virtual_damping_n", "mass_n", "field_n")
    return np.asarray(sum(samples[name] for name in parts))


def _stored_in_fields(samples: Records, x: Floats, ends_m: tuple[float, float]) -> Floats:
    """Energy [J] in the springs of wall and ends at `x` (n,) [m], with the settings of each row."""
    depth = np.maximum((x - samples["wall_m"]) * samples["wall_side"], 0.0)
    lower, upper = ends_m
    beyond = np.maximum(x - upper, 0.0) + np.maximum(lower - x, 0.0)
    stored = samples["wall_n_per_m"] * depth**2 + samples["end_n_per_m"] * beyond**2
    return np.asarray(0.5 * stored)


def _ways_before_effect(delay: Floats, periods: Floats, way: Floats) -> list[Floats]:
    """Return the part of each interval's way before the force of q + 1 samples ago took effect, for
    q = 0, 1, ..., as long as a force is pending.
    """
    time = np.cumsum(periods)
    found = []
    for q in range(LONGEST):
        # that force's delay is reported by the sample after it
        left = _shifted(delay, q) - (_shifted(time, 1) - _shifted(time, 1 + q))
        if q and not np.any(left > 0.0):
            break
        found.append(way * np.clip(left / periods, 0.0, 1.0))
    return found


def _late(step: Floats, lead: list[Floats]) -> Floats:
    """Return the work in each interval that steps of a force would have done while pending."""
    return np.asarray(sum(_shifted(step, q + 1) * gone for q, gone in enumerate(lead)))


def _held(force: Floats, way: Floats, lead: list[Floats]) -> Floats:
    """Return the work in each interval of a force that is held and comes late."""
    return np.asarray(_before(force) * way - _late(_difference(force), lead))


def _reported(samples: Records, way: Floats, periods: Floats) -> Floats:
    """Work in each interval of the force in effect, as the board reports it."""
    after = np.clip(samples["since"] / periods, 0.0, 1.0)
    now = samples["in_effect_n"]
    return np.asarray(way * (now * after + _before(now) * (1.0 - after)))


def smoothed(
    samples: Records, lasting_s: Floats, period_s: float, w: float, motor_n: float
) -> tuple[Floats, Floats]:
    """Return the force [N] of the motor at each of `samples` (n,), and its mean since the one
    before: the force in effect behind a first-order low-pass of corner `w` [rad/s]. Each sample
    came `lasting_s` (n,) after the one before; `motor_n` is the force at the first.
    """
    after_s = np.minimum(samples["since"] * period_s, lasting_s)
    force = samples["in_effect_n"].tolist()
    at = [motor_n]
    mean = [motor_n]
    for k, (before, after) in enumerate(
        zip((lasting_s - after_s).tolist(), after_s.tolist(), strict=True)
    ):
        if k == 0:
            continue
        area = 0.0
        for held, seconds in ((force[k - 1], before), (force[k], after)):
            left = (motor_n - held) * exp(-w * seconds)
            area += held * seconds + (motor_n - held - left) / w
            motor_n = held + left
        at.append(motor_n)
        mean.append(area / (before + after))
    return np.array(at), np.array(mean)


def _ideal(force: Floats, way: Floats) -> Floats:
    return _mean(force) * way


def _mean(values: Floats) -> Floats:
    return np.asarray(0.5 * (values + _before(values)))


def _difference(values: Floats) -> Floats:
    return np.asarray(values - _before(values))


def _before(values: Floats) -> Floats:
    return _shifted(values, 1)


def _shifted(values: Floats, rows: int) -> Floats:
    """Return row k - rows at row k; rows before the first repeat it."""
    return np.asarray(values[_rows_before(len(values), rows)])


def _rows_before(count: int, rows: int) -> NDArray[np.intp]:
    return np.maximum(np.arange(count) - rows, 0)


# --- the ledger of a life -------------------------------------------------------------------------

NAMES = BOOKED.names or ()
CONTEXT = 4 * LONGEST  # records kept for forces that are not yet in effect
MANY = 500  # records
LONGEST_GAP = 8  # periods without a sample across which motion is booked
_EFFECT_PLACE = IN_OFFSETS["torque_age_us"]
_SEQ_PLACE = IN_EFFECT.size - 1


class Ledger:
    """The ledger over the records of one servo life."""

    def __init__(self, servo: ServoParams) -> None:
        self._servo = servo
        self._smoothing_hz = servo.device.force_smoothing_hz
        self.begin()

    def begin(self) -> None:
        """Start a new life: all sums are 0."""
        self._sums = np.zeros(len(NAMES))
        self._pending: list[Records] = []
        self._clear()

    def forget(self) -> None:
        """Note that records were lost: the motion across the gap is unknown."""
        if self._pending:
            self.take(self._pending.pop())
        self._clear()

    def _clear(self) -> None:
        self._seen: Records | None = None
        self._motor_n = np.empty(0)

    def defer(self, records: Records) -> None:
        """Take the next `records` without returning sums: many are booked at once."""
        self._pending.append(records)
        if sum(map(len, self._pending)) >= MANY:
            self.take(self._pending.pop())

    def take(self, records: Records) -> NDArray[np.float64]:
        """Return the sums [J] after each of the next `records` (n,), by NAMES (n, causes)."""
        new = joined((*self._pending, records)) if self._pending else records
        self._pending = []
        return self._booked(new)[len(new) - len(records) :]

    def _booked(self, records: Records) -> NDArray[np.float64]:
        seen = records if self._seen is None else joined((self._seen, records))
        rows = np.flatnonzero((seen["flags"] & Flag.MISSING_IN) == 0)
        found = np.zeros((len(seen), len(NAMES)))
        motor = np.zeros(len(seen))
        motor[: len(self._motor_n)] = self._motor_n
        if rows.size:
            ends = self._servo.soft_ends
            booked, motor[rows] = book(
                samples(seen, rows, self._servo),
                1.0 / self._servo.realtime.rate_hz,
                (ends.lower_m, ends.upper_m),
                self._smoothing_hz,
                float(motor[rows[0]]),
            )
            found[rows] = _plain(booked)
        new = found[len(seen) - len(records) :]
        new[:1] += self._sums
        sums = np.cumsum(new, axis=0)
        self._sums = sums[-1] if len(sums) else self._sums
        self._seen = seen[-CONTEXT:].copy()
        self._motor_n = motor[-CONTEXT:]
        return sums


def _plain(booked: Records) -> NDArray[np.float64]:
    return booked.view(np.float64).reshape(len(booked), -1)


def samples(records: Records, rows: NDArray[np.intp], servo: ServoParams) -> Records:
    """Return the ledger's samples of `records`: a row for each of `rows`, those with a fresh
    sample.
    """
    usable = records[rows]
    found = np.zeros(len(rows), SAMPLE)
    found["position_m"] = usable["position_m"]
    found["proxy_m"] = usable["proxy_m"]
    for part in ("stiffness", "virtual_damping", "mass"):
        found[f"{part}_n"] = usable[f"{part}_force_n"]
    rate_hz = servo.realtime.rate_hz
    found["periods"] = _periods(usable, rate_hz)
    _forces(found, usable, servo)
    found["wall_n_per_m"] = usable["gain"] * usable["wall_stiffness_n_per_m"]
    found["wall_m"] = usable["wall_position_m"]
    found["wall_side"] = usable["wall_side"]
    _in_effect(found, records, rows, rate_hz)
    found["active_damping_asked_ns_per_m"] = usable["active_damping_ns_per_m"]
    found["mass_kg"] = usable["gain"] * usable["mass_kg"]
    found["end_n_per_m"] = usable["gain"] * servo.soft_ends.stiffness_n_per_m
    return found


def _periods(usable: Records, rate_hz: float) -> NDArray[np.float64]:
    """Return the periods since the sample before, by the board's clock; 0 if the motion
    is unknown.
    """
    passed = np.diff(usable["board_us"], prepend=usable["board_us"][:1]) * (rate_hz / US_PER_S)
    seeded = (usable["flags"] & Flag.SEEDED) != 0
    return np.where(seeded | (passed > 1.5 + LONGEST_GAP) | (passed < 0.0), 0.0, passed)


def _in_effect(found: Records, records: Records, rows: NDArray[np.intp], rate_hz: float) -> None:
    usable = records[rows]
    effect = _bytes(usable["in_frame"])[:, _EFFECT_PLACE:][:, : IN_EFFECT.size]
    age_us = effect[:, 0] + 256.0 * effect[:, 1]
    found["since"] = age_us * (rate_hz / US_PER_S)
    sent_seq = _bytes(records["out_frame"])[:, 0].astype(np.intp)
    back = (sent_seq[rows] - effect[:, _SEQ_PLACE]) % TORQUE_SEQUENCES
    reported = sent_seq[np.maximum(rows - back, 0)] == effect[:, _SEQ_PLACE]
    force = records["force_n"][np.maximum(rows - back, 0)]
    granted = (usable["status"] & StatusBit.ENABLED) != 0
    found["in_effect_n"] = np.where(granted, _last_known(force, reported & (rows >= back)), 0.0)
    delay = usable["delay_us"] * (rate_hz / US_PER_S)
    found["delay"] = _last_known(delay, delay >= 0.0)
    found["active_damping_ns_per_m"] = usable["active_damping_effect_ns_per_m"]


def _bytes(frames: NDArray[np.void]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(frames).view(np.uint8).reshape(len(frames), -1)


def _last_known(values: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return `values` with each unknown one replaced by the last known before it; 0 before the
    first.
    """
    places = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(places >= 0, values[np.maximum(places, 0)], 0.0)


def _forces(found: Records, usable: Records, servo: ServoParams) -> None:
    """Set the law's field, its force after the limit, and the sent force."""
    sent = usable["force_n"]
    law = sum(found[f"{part}_n"] for part in ("stiffness", "virtual_damping", "mass"))
    law = law + usable["field_force_n"]
    clamped = (usable["flags"] & Flag.CLAMPED) != 0
    # a difference beyond rounding is the push of homing, which is not part of the law
    rest = sent - law
    push = np.where(~clamped & (np.abs(rest) > servo.device.force.per_count), rest, 0.0)
    found["field_n"] = usable["field_force_n"] + push
    found["clamped_n"] = np.where(clamped, sent, law + push)
    found["sent_n"] = sent
