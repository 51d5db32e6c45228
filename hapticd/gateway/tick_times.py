"""Numbers of a servo life for the status: its tick times, and the compensation of the winding.

Tick times (`TickTimes`). Late ticks are counted by cause. The duration of each stage is counted in
a histogram with logarithmic bins: 40 bins a decade from 10 ns to 100 ms, so a percentile is exact
to 6 %, whatever its size. A record contains the cause if the tick before it was late
(`mailbox.layout.LateCause`). The first seconds after the start (`grace_s`) are left out. Late
events and lost slots are counters of the servo; a histogram cannot show missing ticks.

Room (`room_of`). The duration of a tick is the sum of the medians of its stages without the
wake-up, transfers included. If less than a quarter of its period is left, the daemon warns once per
servo life, with the highest rate that leaves it.

Compensation (`compensation`). The newest record contains the count of the resistance compensation
and the temperature of the sensor. The compensated resistance is base + trim. The actual resistance
is known only with a sensor; without one the residual, and with it the loop gain, is unknown (the
servo then compensates the minimum resistance of the winding). The physics is in `render.winding`.

The servo keeps the count of a board without the DAC at 0.
"""

from collections.abc import Mapping
from math import isfinite, nan
from typing import Any

import numpy as np

from hapticd.core.arrays import Records
from hapticd.core.params import LEAST_IDLE_SHARE, DeviceParams
from hapticd.core.units import NS_PER_S, NS_PER_US, US_PER_S
from hapticd.mailbox.layout import STAGES, LateCause
from hapticd.protocol.answers import Room
from hapticd.protocol.view import joined
from hapticd.render.winding import LEAST_LOOP_GAIN, loop_gain, ohm

PER_DECADE = 40
DECADES = 7
LOWEST_NS = 10.0
EDGES_NS = LOWEST_NS * 10.0 ** (np.arange(PER_DECADE * DECADES + 1) / PER_DECADE)
BINS = len(EDGES_NS) + 1  # below the lowest edge, between edges, above the highest
COUNTED_AT_ONCE = 500  # records: a numpy call costs more than the few records of one batch
PERCENTILES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999}
ENOUGH = 1000  # ticks before the room is judged
WORK = STAGES[1:]
RATE_STEP_HZ = 10.0
CAUSES = max(LateCause) + 1  # places by number; 0: on time


class TickTimes:
    """The ticks of one servo life after its grace period."""

    def __init__(self, grace_s: float, rate_hz: float) -> None:
        self._grace_ns = round(grace_s * NS_PER_S)
        self._rate_hz = rate_hz
        self.begin(0)

    def begin(self, start_ns: int) -> None:
        """Start again, for a servo life that began at `start_ns`."""
        self._settled_ns = start_ns + self._grace_ns
        self._pending: list[Records] = []
        self._counts = np.zeros((len(STAGES), BINS), np.int64)
        self._max_ns = np.zeros(len(STAGES), np.int64)
        self._late = np.zeros(CAUSES, np.int64)
        self._latest_ns = np.zeros(CAUSES, np.int64)

    def add(self, records: Records) -> None:
        """Take the next `records`."""
        self._pending.append(records)
        if sum(map(len, self._pending)) >= COUNTED_AT_ONCE:
            self._count()

    def _count(self) -> None:
        if not self._pending:
            return
        records = joined(self._pending)
        self._pending = []
        settled = records[records["time_ns"] >= self._settled_ns]
        if settled.size:
            self._count_stages(settled)
            self._count_late(settled)

    def _count_stages(self, records: Records) -> None:
        times_ns = np.stack([records[f"{stage}_ns"] for stage in STAGES])
        # each stage has separate bins, so that one bincount serves all
        bins = (
            np.searchsorted(EDGES_NS, times_ns, side="right")
            + np.arange(len(STAGES))[:, None] * BINS
        )
        self._counts += np.bincount(bins.ravel(), minlength=self._counts.size).reshape(
            self._counts.shape
        )
        np.maximum(self._max_ns, times_ns.max(axis=1), out=self._max_ns)

    def _count_late(self, records: Records) -> None:
        late = records[records["late_cause"] < CAUSES]
        self._late += np.bincount(late["late_cause"], minlength=CAUSES)
        np.maximum.at(self._latest_ns, late["late_cause"], late["late_ns"])

    @property
    def count(self) -> int:
        """Ticks counted so far."""
        return int(self._counts[0].sum())

    def stages(self) -> dict[str, dict[str, float]]:
        """Return {stage: {count, p50_us, p99_us, p999_us, max_us}}.

        A percentile is the upper edge of its bin, at most the maximum.
        """
        self._count()
        return {stage: self._one(row) for row, stage in enumerate(STAGES)}

    def _one(self, row: int) -> dict[str, float]:
        below = np.cumsum(self._counts[row])
        highest_us = self._max_ns[row] / NS_PER_US
        found: dict[str, float] = {"count": int(below[-1])}
        for name, share in PERCENTILES.items():
            place = min(int(np.searchsorted(below, share * below[-1])), len(EDGES_NS) - 1)
            found[name] = min(float(EDGES_NS[place]) / NS_PER_US, float(highest_us))
        return found | {"max_us": float(highest_us)}

    def late(self) -> dict[str, dict[str, Any]]:
        """Return {cause: {count, latest_us}}; `latest_us` is the largest delay of an end after its
        deadline.
        """
        self._count()
        return {
            cause.name.lower(): {
                "count": int(self._late[cause]),
                "latest_us": float(self._latest_ns[cause] / NS_PER_US),
            }
            for cause in LateCause
            if cause
        }

    @property
    def room(self) -> Room:
        """Share of the period that a tick takes."""
        return room_of(self.stages(), self._rate_hz)


def room_of(stages: Mapping[str, Mapping[str, Any]], rate_hz: float) -> Room:
    """Return the room at `rate_hz` from the percentiles of `stages`."""
    period_us = US_PER_S / rate_hz
    if stages[WORK[0]]["count"] < ENOUGH:
        return Room(0.0, period_us, 0.0)
    tick_us = sum(stages[stage]["p50_us"] for stage in WORK)
    highest_hz = (1.0 - LEAST_IDLE_SHARE) * US_PER_S / max(tick_us, 1.0)
    return Room(tick_us, period_us, highest_hz // RATE_STEP_HZ * RATE_STEP_HZ)


# --- the winding ----------------------------------------------------------------------------------


def compensation(record: dict[str, Any], device: DeviceParams) -> dict[str, Any] | None:
    """Return compensated and actual resistance [ohm], the residual, and the damping circuit's loop
    gain.

    The loop gain is given at the level in effect and at the device's maximum; unknown values are
    None. Return None before the first record, and for a device file without [resistance].

    `residual_ohm` > 0: the actual resistance exceeds the compensated one, so damping and force are
    weaker; < 0: they are stronger, and the circuit oscillates at a loop gain of -1.
    """
    table = device.resistance
    if table is None or not record:
        return None
    compensated_ohm = table.base_ohm + table.trim.to_value(record["resistance_count"])
    winding_c = float(record["winding_c"])
    found: dict[str, Any] = {
        "compensated_ohm": compensated_ohm,
        "tolerance_ohm": table.tolerance_ohm,
        "least_loop_gain": LEAST_LOOP_GAIN,
        **dict.fromkeys(("winding_c", "winding_ohm", "residual_ohm")),
        **dict.fromkeys(("loop_gain", "loop_gain_at_ceiling")),
    }
    if not isfinite(winding_c):
        return found
    residual_ohm = ohm(table, winding_c) - compensated_ohm
    effect = float(record.get("active_damping_effect_ns_per_m", nan))
    ceiling = device.active_damping_limit_ns_per_m
    return found | {
        "winding_c": winding_c,
        "winding_ohm": ohm(table, winding_c),
        "residual_ohm": residual_ohm,
        "loop_gain": loop_gain(table, residual_ohm, effect) if isfinite(effect) else None,
        "loop_gain_at_ceiling": loop_gain(table, residual_ohm, ceiling),
    }
