"""The environment in force, as the newest record and the last answer of the servo tell it.

`target` is where the ramps in force end, `now` what acts in the newest record. Of what no
record holds (the wall's damping while it moves, its side once it was rounded to none) the value
counts that may still act and is furthest from the target.

Limitations: record and answers may belong to different revisions for a moment (see `known`).
"""

from typing import Any

import numpy as np

from hapticd.core.environment import FIELDS, Environment
from hapticd.mailbox.layout import Flag, Value, newer
from hapticd.protocol.commands import rendered
from hapticd.protocol.view import ServoView

IN_MOTION = Flag.RAMPING | Flag.EASED | Flag.PAUSED
# columns that hold what acts; of a side and of active damping the record tells less
COLUMNS = {
    one.path: one.column
    for one in FIELDS
    if one.column and one.path not in ("wall.side", "active_damping_ns_per_m")
}


class WallDamping:
    """The wall's damping as it acts, which no record holds: where its ramp began, until it ends."""

    def __init__(self) -> None:
        self._life = 0
        self._begun = self._end = 0.0

    def follow(self, life: int, target: float, moving: bool) -> float:
        """The value furthest from `target` that may still act."""
        if life != self._life or (target == self._end and not moving):
            self._life = life
            self._begun = self._end = target
        if target != self._end:
            self._begun = self._end
            self._end = target
        return self._begun


class WallSide:
    """The side of a wall that may still act: it comes to 0 on a ramp, and a record rounds it."""

    def __init__(self) -> None:
        self.value = 0

    def follow(self, records: Any) -> None:
        """Look at `records`: a side counts until one of them says 0 and nothing moves."""
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
        """A new servo life."""
        self._side.value = 0

    def follow(self, records: Any) -> None:
        """Look at telemetry `records`, which come once each and in order."""
        self._side.follow(records)

    @property
    def known(self) -> bool:
        """Whether record and answers tell of the same environment."""
        same = self._answered_revision == self.revision
        return self._view.alive and not self._view.unsure and same

    @property
    def ahead_of_answers(self) -> bool:
        """Whether the servo has gone on to an environment of which no answer is known yet."""
        return self._view.alive and newer(self.revision, self._answered_revision)

    @property
    def _answered_revision(self) -> int:
        return int(self._view.targets[Value.ENVIRONMENT_REVISION])

    @property
    def revision(self) -> int:
        """Of the environment in the newest record; -1 before the first."""
        return int(self._view.record.get("environment_revision", -1))

    @property
    def controlled(self) -> bool:
        """Whether the servo's energy controller holds more damping, or less K and B, than asked."""
        return bool(int(self._view.record.get("flags", 0)) & Flag.CONTROLLED)

    def target(self) -> Environment:
        """Where the ramps in force end."""
        return rendered(self._view.targets)

    def now(self) -> Environment:
        """What acts in the newest record."""
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
                # NaN: the board did not say
                "active_damping_ns_per_m": max(effect, 0.0) if effect == effect else 0.0,
            }
        )

    @property
    def empty(self) -> bool:
        """Whether nothing is rendered: K, B, M and the wall are 0 and stay so."""
        return self.now().empty and self.target().empty

    @property
    def level(self) -> float:
        """Active damping that `damping on` would give, N s/m."""
        return float(self._view.targets[Value.ACTIVE_DAMPING])
