"""The tables of docs/remedies.md are those of its kept rows, and the rows those of the study."""

import importlib
import json
from types import ModuleType

import numpy as np
import pytest
from support.tree import ROOT

from hapticd.settings.scene import load_scene
from hapticd.studies import port_energy
from hapticd.studies.remedies import (
    REMEDIES,
    SCENES,
    largest_stiffness,
    passive_by_theorem,
    treated,
)

PAGE = ROOT / "docs" / "remedies.md"


@pytest.fixture
def remedies(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which is no part of the package."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("remedies")


def test_page_has_the_tables_of_the_kept_rows(remedies: ModuleType) -> None:
    page = PAGE.read_text()
    assert remedies.filled(page, remedies.kept(), remedies.kept("energy")) == page


def test_kept_rows_are_every_remedy_on_every_device(remedies: ModuleType) -> None:
    found = [(row["device"], row["remedy"]) for row in remedies.kept()]
    assert found == [(name, remedy.name) for name in SCENES for remedy in REMEDIES]
    assert json.loads(remedies.KEPT.read_text())["quick"] is False


@pytest.mark.parametrize("place", range(0, 65, 7))
def test_kept_stiffness_is_that_of_the_theorem(remedies: ModuleType, place: int) -> None:
    row = remedies.kept()[place]
    remedy = next(one for one in REMEDIES if one.name == row["remedy"])
    scene = treated(load_scene(row["device"]), remedy, row["corner_hz"])
    passive = passive_by_theorem(scene)
    for b, kept in (
        (0.0, row["stiffness_alone_n_per_m"]),
        (row["virtual_damping_ns_per_m"], row["stiffness_n_per_m"]),
    ):
        if kept is not None:
            assert largest_stiffness(passive, b) == pytest.approx(kept, rel=1e-6)


def test_kept_energies_are_every_remedy_that_is_judged_by_them(remedies: ModuleType) -> None:
    found = [(row["device"], row["remedy"]) for row in remedies.kept("energy")]
    assert found == [(name, remedy) for name in SCENES for remedy in port_energy.BASES]


def test_no_drawn_hand_gets_too_much_at_a_kept_stiffness(remedies: ModuleType) -> None:
    row = next(one for one in remedies.kept("energy") if one["device"] == "light")
    assert row["remedy"] == REMEDIES[0].name
    hands = np.random.default_rng(1).uniform(
        port_energy.LEAST, port_energy.MOST, (port_energy.HANDS[False], 6)
    )
    point = [row["stiffness_n_per_m"], row["virtual_damping_ns_per_m"]]
    scene = treated(load_scene("light"), REMEDIES[0])
    given = port_energy.given_out(scene, (), hands, np.array([point, [1.5 * point[0], point[1]]]))
    kept, beyond = given.max(axis=0)
    assert kept <= port_energy.GIVEN_J < beyond


def test_gain_is_that_of_each_draw_and_leaves_out_draws_without_a_first_row(
    remedies: ModuleType,
) -> None:
    first = {"draws_n_per_m": [100.0, 200.0, 0.0]}
    row = {"draws_n_per_m": [300.0, 600.0, 50.0]}
    assert remedies.gains(row, first) == (3.0, 3.0, 3.0)


def test_trials_are_kept_for_rows_of_the_same_environment_only(remedies: ModuleType) -> None:
    def row(k: float, trials: str | None) -> dict[str, object]:
        named = {"device": "light", "remedy": "2 x rate", "virtual_damping_ns_per_m": 0.1}
        return named | {"stiffness_n_per_m": k, "trials": trials}

    before = [row(100.0, "earlier")]
    after = [row(100.0, None), row(101.0, None), row(100.0, "new")]
    found = [one["trials"] for one in remedies.with_trials(after, before)]
    assert found == ["earlier", None, "new"]
