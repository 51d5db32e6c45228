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

The batch engine follows the rule (`zwidth.engine.job.AtContact`); the servo does not have it.
"""

from dataclasses import dataclass

from hapticd.core.environment import WallParams
from hapticd.render.law import approach

__all__ = ["ContactDamping"]


@dataclass(frozen=True, slots=True)
class ContactDamping:
    """Levels of active damping [N s/m], and how the one becomes the other."""

    contact_ns_per_m: float  # at the wall
    approach_m: float = 0.0  # distance before the wall at which the level begins to rise
    slew_ns_per_m_s: float = 20.0  # fastest change, [safety] active_damping_slew_ns_per_m_s
    free_ns_per_m: float = 0.0  # in free motion

    def next_level(self, x: float, wall: WallParams, level: float, period_s: float) -> float:
        """Return the level [N s/m] after a sample at `x` [m], from the present `level`."""
        near = (x - wall.position_m) * wall.side > -self.approach_m
        target = self.contact_ns_per_m if near else self.free_ns_per_m
        return approach(level, target, self.slew_ns_per_m_s * period_s)

    def share(self, level: float) -> float:
        """Return the share of the wall that is rendered at a level in effect [N s/m], 0 to 1."""
        span = self.contact_ns_per_m - self.free_ns_per_m
        return (level - self.free_ns_per_m) / span if span else 1.0
