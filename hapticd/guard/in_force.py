"""Determine the environment in force from the newest record and the last answer of the servo.

`target` is the end of the ramps in progress, `now` the environment that acts in the newest record.
Records do not contain the wall's damping during a ramp, nor its side once it is rounded to 0. For
these the value counts that may still act and is furthest from the target.

Limitations: record and answers may belong to different revisions for a moment (see `known`).
"""

from typing import Any

import numpy as np

from hapticd.core.environment import FIELDS, Environment
from hapticd.mailbox.layout import Flag, Value, newer
from hapticd.protocol.commands import rendered
from hapticd.protocol.view import ServoView

IN_MOTION = Flag.RAMPING | Flag.EASED | Flag.PAUSED
# columns with the acting values; side and active damping need more than the record
COLUMNS = {
    one.path: one.column
    for one in FIELDS
    if one.column and one.path not in ("wall.side", "active_damping_ns_per_m")
}


class WallDamping:
    """The damping of the wall, which no record contains: the start of its ramp, until the ramp
    ends.
    """

    def __init__(self) -> None:
        self._life = 0
        self._begun = self._end = 0.0

    def follow(self, life: int, target: float, moving: bool) -> float:
        """Return the value that may still act and is furthest from `target`."""
        if life != self._life or (target == self._end and not moving):
            self._life = life
            self._begun = self._end = target
        if target != self._end:
            self._begun = self._end
            self._end = target
        return self._begun


class WallSide:
    """The side of a wall that may still act: it ramps to 0, and records round it."""

    def __init__(self) -> None:
        self.value = 0

    def follow(self, records: Any) -> None:
        """Take `records`: a side counts until a record shows 0 without motion."""
        walled = np.flatnonzero(records["wall_side"])
        if walled.size:
            self.value = int(records["wall_side"][walled[-1]])
        after = records[walled[-1] + 1 :] if walled.size else records
        if after.size and not bool((after["flags"] & int(IN_MOTION)).all()):
            self.value = 0


class EnvironmentInForce:
    """The environment in force at the servo of `view`."""

    def __init__(self, view: ServoView) -> None:
        self._view = view
        self._wall_damping = WallDamping()
        self._side = WallSide()

    def begin(self) -> None:
        """Start a new servo life."""
        self._side.value = 0

    def follow(self, records: Any) -> None:
        """Take telemetry `records`, each once and in order."""
        self._side.follow(records)

    @property
    def known(self) -> bool:
        """Whether record and answers belong to the same environment."""
        same = self._answered_revision == self.revision
        return self._view.alive and not self._view.unsure and same

    @property
    def ahead_of_answers(self) -> bool:
        """Whether the newest record has an environment whose answer is not yet known."""
        return self._view.alive and newer(self.revision, self._answered_revision)

    @property
    def _answered_revision(self) -> int:
        return int(self._view.targets[Value.ENVIRONMENT_REVISION])

    @property
    def revision(self) -> int:
        """Revision of the environment in the newest record; -1 before the first."""
        return int(self._view.record.get("environment_revision", -1))

    @property
    def controlled(self) -> bool:
        """Whether the energy controller of the servo holds more damping, or less K and B, than
        requested.
        """
        return bool(int(self._view.record.get("flags", 0)) & Flag.CONTROLLED)

    def target(self) -> Environment:
        """Return the end of the ramps in progress."""
        return rendered(self._view.targets)

    def now(self) -> Environment:
        """Return the environment that acts in the newest record."""
        record = self._view.record
        target = self.target()
        moving = bool(int(record["flags"]) & IN_MOTION)
        wall_damping = self._wall_damping.follow(
            self._view.life, target.wall.virtual_damping_ns_per_m, moving
        )
        effect = record["active_damping_effect_ns_per_m"]
        return target.with_values(
            {path: record[column] for path, column in COLUMNS.items()}
            | {
                "wall.virtual_damping_ns_per_m": wall_damping,
                "wall.side": record["wall_side"] or (self._side.value if moving else 0),
                # NaN: the board did not report it
                "active_damping_ns_per_m": max(effect, 0.0) if effect == effect else 0.0,
            }
        )

    @property
    def empty(self) -> bool:
        """Whether nothing is rendered: K, B, M and the wall are 0, now and at the end of
        the ramps.
        """
        return self.now().empty and self.target().empty

    @property
    def level(self) -> float:
        """Active damping that `damping on` would set, N s/m."""
        return float(self._view.targets[Value.ACTIVE_DAMPING])
