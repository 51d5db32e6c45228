"""Tick records into the energy ledger: sums by cause, from the first record on.

`analysis.ledger` says what each cause means; here its samples are read off the records. A record
without a fresh sample adds nothing, the next one takes the whole way since the last. What was sent
is the record's `force_n`, and a force is taken to be in effect for the measured delay; what of it
the law, its limit and a push that is not of the law had asked for follows from the parts beside it.
The filters of a tick forget nothing here: a NaN or a fault leaves all sums as they were.

What would break it: records out of order, or a gap that is not told with `forget` (nothing is then
known of the motion across it).
"""

import numpy as np
from numpy.typing import NDArray

from hapticd.analysis.ledger import BOOKED, LONGEST, SAMPLE, Table, book
from hapticd.gateway.view import RECORD_DTYPE, Records
from hapticd.mailbox.layout import Flag
from hapticd.params import ServoParams

NAMES = BOOKED.names or ()
CONTEXT = 4 * LONGEST  # records that are looked at again: what is still on its way comes from them
LONGEST_GAP = 8  # periods without a sample across which motion is booked
DELAY = 0.125  # periods, where no board has measured it


class Ledger:
    """Follows the records of one servo life."""

    def __init__(self, servo: ServoParams) -> None:
        self._servo = servo
        self._smoothing_hz = servo.device.force_smoothing_hz
        self.begin()

    def begin(self) -> None:
        """A new life: all sums are 0."""
        self._sums = np.zeros(len(NAMES))
        self.forget()

    def forget(self) -> None:
        """Records were lost: of the motion across the gap nothing is known."""
        self._seen = np.empty(0, RECORD_DTYPE)
        self._motor_n = np.empty(0)

    def take(self, records: Records) -> NDArray[np.float64]:
        """Sums [J] after each of the next `records` (n,), by NAMES (n, causes)."""
        seen = np.concatenate((self._seen, records))
        usable = (seen["flags"] & Flag.MISSING_IN) == 0
        rows = np.flatnonzero(usable)
        found = np.zeros((len(seen), len(NAMES)))
        motor = np.zeros(len(seen))
        motor[: len(self._motor_n)] = self._motor_n
        if rows.size:
            ends = self._servo.environment.workspace
            booked, motor[rows] = book(
                samples(seen, rows, self._servo),
                1.0 / self._servo.realtime.rate_hz,
                (ends.lower_m, ends.upper_m),
                self._smoothing_hz,
                float(motor[rows[0]]),
            )
            found[rows] = _plain(booked)
        new = found[len(self._seen) :]
        new[:1] += self._sums
        sums = np.cumsum(new, axis=0)
        self._sums = sums[-1] if len(sums) else self._sums
        self._seen = seen[-CONTEXT:].copy()
        self._motor_n = motor[-CONTEXT:]
        return sums


def _plain(booked: Table) -> NDArray[np.float64]:
    return booked.view(np.float64).reshape(len(booked), -1)


def samples(records: Records, rows: NDArray[np.intp], servo: ServoParams) -> Table:
    """What the ledger reads off `records`: a row for each of `rows`, those with a fresh sample."""
    usable = records[rows]
    found = np.zeros(len(rows), SAMPLE)
    found["position_m"] = usable["position_m"]
    for part in ("stiffness", "damping", "mass"):
        found[f"{part}_n"] = usable[f"{part}_force_n"]
    found["periods"] = _periods(records, rows)
    _forces(found, usable, servo)
    found["delay"] = DELAY
    found["in_effect_n"] = records["force_n"][np.maximum(rows - 1, 0)]
    found["since"] = 1.0 - DELAY
    for name in ("added_ns_per_m", "added_asked_ns_per_m"):
        found[name] = usable["added_damping_ns_per_m"]
    found["mass_kg"] = usable["gain"] * usable["mass_kg"]
    found["end_n_per_m"] = usable["gain"] * servo.environment.workspace.stiffness_n_per_m
    return found


def _periods(records: Records, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Since the sample before, in periods; 0 where nothing is known of the motion."""
    usable = records[rows]
    ticks = np.diff(usable["tick"].astype(np.int64), prepend=0)
    passed = np.maximum(ticks, 1 + usable["arrival"].astype(np.int64)).astype(float)
    unknown = ((usable["flags"] & Flag.SEEDED) != 0) | (passed > 1 + LONGEST_GAP)
    passed[unknown] = 0.0
    passed[:1] = 0.0
    return passed


def _forces(found: Table, usable: Records, servo: ServoParams) -> None:
    """The law's field, what was left of its force by the limit, and what was sent."""
    sent = usable["force_n"]
    law = sum(found[f"{part}_n"] for part in ("stiffness", "damping", "mass"))
    law = law + usable["field_force_n"]
    clamped = (usable["flags"] & Flag.CLAMPED) != 0
    # the push of homing is not of the law: what rounding cannot explain
    rest = sent - law
    push = np.where(~clamped & (np.abs(rest) > servo.device.force.per_count), rest, 0.0)
    found["field_n"] = usable["field_force_n"] + push
    found["clamped_n"] = np.where(clamped, sent, law + push)
    found["sent_n"] = sent
