"""The energy ledger from tick records: sums by cause, from the first record on.

`signal.ledger` defines the causes; this module extracts their samples from the records. A record
without a fresh sample adds nothing, and the next one covers the whole motion since the last sample:
a NaN or a fault erases nothing. The sent force is the record's `force_n`. The shares of the law, of
its limit, and of a push from outside the law follow from its other columns. The force in effect
comes from the frames alone: the sequence number that the board reports, and 0 without granted
torque.

Records must be in order, and `forget` must be called at a gap, across which the motion is unknown.
"""

import numpy as np
from numpy.typing import NDArray

from hapticd.core.params import ServoParams
from hapticd.core.units import US_PER_S
from hapticd.mailbox.layout import Flag
from hapticd.protocol.view import Records, joined
from hapticd.signal.ledger import BOOKED, LONGEST, SAMPLE, Table, book
from hapticd.usb.codec import TORQUE_SEQUENCES
from hapticd.usb.frames import IN_EFFECT, IN_OFFSETS, StatusBit

__all__ = ["CONTEXT", "NAMES", "Ledger", "samples"]

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


def _plain(booked: Table) -> NDArray[np.float64]:
    return booked.view(np.float64).reshape(len(booked), -1)


def samples(records: Records, rows: NDArray[np.intp], servo: ServoParams) -> Table:
    """Return the ledger's samples of `records`: a row for each of `rows`, those with a fresh
    sample.
    """
    usable = records[rows]
    found = np.zeros(len(rows), SAMPLE)
    found["position_m"] = usable["position_m"]
    for part in ("stiffness", "virtual_damping", "mass"):
        found[f"{part}_n"] = usable[f"{part}_force_n"]
    rate_hz = servo.realtime.rate_hz
    found["periods"] = _periods(usable, rate_hz)
    _forces(found, usable, servo)
    found["wall_n_per_m"] = usable["gain"] * usable["wall_stiffness_n_per_m"]
    found["wall_m"] = usable["wall_position_m"]
    found["wall_side"] = usable["wall_side"]
    _reported(found, records, rows, rate_hz)
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


def _reported(found: Table, records: Records, rows: NDArray[np.intp], rate_hz: float) -> None:
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


def _forces(found: Table, usable: Records, servo: ServoParams) -> None:
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
