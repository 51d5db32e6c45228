"""Active damping where it is needed: at a wall, and not in free motion.

Rule (`ContactDamping`). Beyond `approach_m` before the surface of a wall the level of active
damping moves towards the one at the wall, on the other side back towards the one of free motion, by
no more than the slew of the servo. A hand may be faster than that. The wall is therefore rendered
only as far as its damping has been reached: stiffness and virtual damping times

    share = (level - level of free motion) / (level at the wall - level of free motion)

Free space and wall at the level in effect then always lie on one line, from nothing at the level of
free motion to the whole wall at its own level. The guard's criterion can judge that line before
anything moves, whatever the hand does. It says nothing about the change of the share itself. A wall
that stiffens while it is pressed stores more than the hand has put in, up to half of its stiffness
times the square of the depth at which it stiffens.

`AtContact` follows the rule in a batch; the servo does not have it (ADR-0035).
"""

from dataclasses import dataclass, replace

from hapticd.core.environment import WallParams
from hapticd.render.law import approach
from hapticd.zwidth.engine.job import Group, Job, rounded

__all__ = ["ContactDamping"]


@dataclass(frozen=True, slots=True)
class ContactDamping:
    """Levels of active damping [N s/m], and how the one becomes the other."""

    approach_m: float = 0.0  # distance before the wall at which the level begins to rise
    slew_ns_per_m_s: float = 20.0  # fastest change, [safety] active_damping_slew_ns_per_m_s
    free_ns_per_m: float = 0.0  # in free motion
    contact_ns_per_m: float = 0.0  # at the wall

    def at(self, level: float) -> "ContactDamping":
        """Return this rule with `level` [N s/m] at the wall."""
        return replace(self, contact_ns_per_m=level)

    def next_level(self, x: float, wall: WallParams, level: float, period_s: float) -> float:
        """Return the level [N s/m] after a sample at `x` [m], from the present `level`."""
        near = (x - wall.position_m) * wall.side > -self.approach_m
        target = self.contact_ns_per_m if near else self.free_ns_per_m
        return approach(level, target, self.slew_ns_per_m_s * period_s)

    def share(self, level: float) -> float:
        """Return the share of the wall that is rendered at a level in effect [N s/m], 0 to 1."""
        span = self.contact_ns_per_m - self.free_ns_per_m
        return (level - self.free_ns_per_m) / span if span else 1.0


class AtContact:
    """The level of active damping of a group of one trial by `rule`, and its wall, scaled with it.

    Both follow the sample of the tick before. The force of a sample has the share of the level that
    was in effect when it was computed. If the level rises, it is beyond that when the force acts.
    Limitations: a level that falls within the delay of a force of the wall, which no approach that
    is longer than the way of that delay permits.
    """

    def __init__(self, group: Group, job: Job, rule: ContactDamping) -> None:
        self._group = group
        self._rule = rule
        self._wall = job.environment.wall
        self._period_s = 1.0 / job.model.rate_hz
        self._quantum = job.model.active_damping_quantum_ns_per_m
        self._set(rule.free_ns_per_m)

    def follow(self) -> None:
        """Set level and wall of the next tick, by the last position that the law has seen."""
        x = float(self._group.rows["L0"][0])
        level = self._rule.next_level(x, self._wall, self._level, self._period_s)
        if level != self._level:
            self._set(level)

    def _set(self, level: float) -> None:
        self._level = level  # before its converter
        share = self._rule.share(level)
        numbers = self._group.made.numbers(rounded(level, self._quantum))
        scaled_wall = {
            "WALL_K": share * self._wall.stiffness_n_per_m,
            "WALL_B": share * self._wall.virtual_damping_ns_per_m,
        }
        self._group.set(numbers | scaled_wall)
