"""Active damping at a wall: how far it lets K go, what it gives out, and the kept numbers."""

from types import ModuleType

import numpy as np
import pytest
from test_docs_contact import EARLY, LATE, contact, judged
from test_studies_remedies import rigid

from hapticd.settings.scene import load_scene
from hapticd.zwidth.walls import hit

__all__ = ["contact"]  # a fixture

# of a family of hands the one that a late wall gives most: 73 g, held firmly
FIRM = np.log([1.19e-4, 0.0728, 1.66e4, 65.8, 5.66, 0.258])


def test_wall_that_follows_its_level_is_permitted_as_if_the_level_were_everywhere(
    contact: ModuleType,
) -> None:
    scene = rigid(0.6875)
    stiffest = [
        judged(contact, scene, level, rule).stiffest(0.5, 6000.0)
        for level, rule in ((0.0, None), (1.74, None), (1.74, EARLY))
    ]
    assert stiffest[2] == pytest.approx(stiffest[1])
    assert stiffest[2] > 2.0 * stiffest[0]


def test_wall_that_swings_without_active_damping_stands_with_it_at_the_wall(
    contact: ModuleType,
) -> None:
    scene = load_scene("fig4")
    stands = []
    for level, rule in ((0.0, None), (1.74, None), (1.74, EARLY)):
        plan = judged(contact, scene, level, rule).walls(np.array([400.0]), np.array([2.0]))
        stands.append(hit(plan, level, 400.0, 2.0).stable)
    assert stands == [False, True, True]


def test_wall_whose_damping_is_late_pumps_a_hand(
    contact: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contact, "drawn", lambda seed, count: FIRM[np.newaxis])
    scene = load_scene("fig4")
    late, early, everywhere = (
        judged(contact, scene, 1.74, rule).given_out_j((846.0, 3.25), 1)
        for rule in (LATE, EARLY, None)
    )
    assert late > 1e-3
    assert max(early, everywhere) < 1e-5


@pytest.mark.parametrize("place", range(10))
def test_kept_stiffness_is_that_of_the_guard(contact: ModuleType, place: int) -> None:
    row = contact.kept()[place]
    variant = contact.VARIANTS[place % len(contact.VARIANTS)]
    level = contact.LEVEL_NS_PER_M * variant.on
    one = judged(contact, load_scene(row["device"]), level, variant.rule)
    b, k = (row[name][row["best"]] for name in ("virtual_damping_ns_per_m", "permitted_n_per_m"))
    points = np.array([[0.99 * k, b, 0.0], [1.01 * k, b, 0.0]])
    assert one.permitted(points).tolist() == [True, False]
