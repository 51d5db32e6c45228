"""Active damping at a wall: what is judged, at which level, and what it costs and gives out. The
section of docs/remedies.md has these numbers.
"""

import importlib
import json
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from support.tree import ROOT
from test_studies_remedies import rigid

from hapticd.core.environment import Environment
from hapticd.guard.safe_region import SafeRegion
from hapticd.model.bases import Theorem
from hapticd.model.scene import Scene
from hapticd.settings.scene import load_scene
from hapticd.zwidth.engine.contact import ContactDamping
from hapticd.zwidth.sources import display

PAGE = ROOT / "docs" / "remedies.md"
EARLY = ContactDamping(approach_m=0.001, slew_ns_per_m_s=2000.0)
LATE = ContactDamping(approach_m=0.005, slew_ns_per_m_s=20.0)


@pytest.fixture
def contact(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which is no part of the package."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("contact")


def judged(
    contact: ModuleType, scene: Scene, level: float, rule: ContactDamping | None = None
) -> Any:
    model = display(scene).model
    return contact.Judged(
        scene, level, rule, SafeRegion(Theorem(model), (model.delay_periods,), 0.0)
    )


def test_every_share_of_the_wall_is_judged_at_its_level(contact: ModuleType) -> None:
    seen: list[Environment] = []

    class Region:
        def safe(self, environments: list[Environment]) -> list[bool]:
            seen.extend(environments)
            return [one.wall.stiffness_n_per_m != 50.0 for one in environments]

    region: Any = Region()
    one = contact.Judged(rigid(), 1.6, ContactDamping(free_ns_per_m=0.8), region)
    assert one.permitted(np.array([[100.0, 2.0, 0.0]])).tolist() == [False]  # at half of it
    assert one.permitted(np.array([[110.0, 2.0, 0.0]])).tolist() == [True]
    shares = np.linspace(0.0, 1.0, contact.WAY)
    for place, share in enumerate(shares):
        at = seen[place]
        assert at.wall.stiffness_n_per_m == pytest.approx(100.0 * share)
        assert at.wall.virtual_damping_ns_per_m == pytest.approx(2.0 * share)
        assert at.active_damping_ns_per_m == pytest.approx(0.8 + 0.8 * share)


def test_a_level_that_is_unsafe_in_free_motion_permits_no_wall(contact: ModuleType) -> None:
    """`light` is active by itself with 1.74 N s/m, and passive with half of it."""
    point = np.array([[100.0, 0.05, 0.0]])
    scene = load_scene("light")
    assert judged(contact, scene, 0.87).permitted(point).all()
    assert (
        not judged(contact, scene, 0.87, ContactDamping(free_ns_per_m=1.74)).permitted(point).any()
    )


def test_free_motion_is_as_free_as_without_active_damping(contact: ModuleType) -> None:
    scene = load_scene("fig4")
    none, everywhere, early = (
        judged(contact, scene, level, rule).drag()
        for level, rule in ((0.0, None), (1.74, None), (1.74, EARLY))
    )
    assert early == none
    assert everywhere[0] > none[0] + 1.5


def test_page_has_the_tables_of_the_kept_rows(contact: ModuleType) -> None:
    page = PAGE.read_text()
    assert contact.filled(page, contact.kept()) == page


def test_kept_rows_are_every_variant_on_every_device(contact: ModuleType) -> None:
    found = [(row["device"], row["variant"]) for row in contact.kept()]
    assert found == [(name, one.name) for name in contact.SCENES for one in contact.VARIANTS]
    about = json.loads(contact.KEPT.read_text())
    assert about["level_ns_per_m"] == contact.LEVEL_NS_PER_M


def test_scene_of_the_impact_keeps_the_device(contact: ModuleType) -> None:
    scene = load_scene("median")
    plan = judged(contact, scene, 1.74, LATE).walls(np.array([100.0]), np.array([0.0]))
    found = plan.params.scene
    assert found.effects == scene.effects
    assert found.environment.filters == scene.environment.filters
    assert plan.params.contact == LATE
