"""Active damping at a wall: its level follows the place at its slew, and the wall its level."""

import pytest

from hapticd.core.environment import WallParams
from hapticd.zwidth.engine.contact import ContactDamping

PERIOD_S = 1e-3
RULE = ContactDamping(
    contact_ns_per_m=1.74, approach_m=0.001, slew_ns_per_m_s=200.0, free_ns_per_m=0.24
)


def levels(positions: list[float], wall: WallParams, level: float = 0.24) -> list[float]:
    found = []
    for x in positions:
        level = RULE.next_level(x, wall, level, PERIOD_S)
        found.append(level)
    return found


@pytest.mark.parametrize("side", [1, -1])
def test_level_rises_at_its_slew_from_the_approach_on_and_falls_before_it(side: int) -> None:
    wall = WallParams(1000.0, 1.0, position_m=0.0, side=side)
    before, near, inside = -0.0011 * side, -0.0009 * side, 0.002 * side
    assert levels([before] * 3, wall) == [0.24] * 3
    rising = levels([near] * 4 + [inside] * 6, wall)
    assert rising[:7] == pytest.approx([0.44 + 0.2 * place for place in range(7)])
    assert rising[7:] == [1.74] * 3
    assert levels([before] * 2, wall, level=1.74) == pytest.approx([1.54, 1.34])


def test_wall_is_rendered_as_far_as_its_level_is_reached() -> None:
    assert [RULE.share(level) for level in (0.24, 0.99, 1.74)] == pytest.approx([0.0, 0.5, 1.0])
    assert (
        ContactDamping(contact_ns_per_m=1.0, free_ns_per_m=1.0).share(1.0) == 1.0
    )  # the same level everywhere
