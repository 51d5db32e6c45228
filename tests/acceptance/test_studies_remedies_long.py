"""Remedies: each changes what it names, and what a row says agrees with independent theory."""

import json
from functools import partial
from itertools import pairwise
from math import pi
from pathlib import Path

import numpy as np
import pytest
from support.cli_sim import MINE, spoken
from test_studies_remedies import (
    AS_IT_IS,
    COUPLING,
    MASS_KG,
    PHYSICAL_NS_PER_M,
    rigid,
    row,
    rows,
)

from hapticd.settings.scene import load_scene
from hapticd.studies import port_energy, remedies
from hapticd.studies.remedies import (
    REMEDIES,
    RENDERED_HZ,
    SCENES,
    RemediesParams,
    Remedy,
    treated,
)


@pytest.mark.parametrize("times", [1.0, 2.0, 4.0])
def test_without_delay_stiffness_is_twice_damping_times_rate(times: float) -> None:
    """Colgate and Schenkel: b > K T / 2."""
    found = row(rigid(), Remedy("", faster=times))
    closed = 2.0 * PHYSICAL_NS_PER_M * times * 1000.0
    assert found.stiffness_alone_n_per_m == pytest.approx(closed, rel=1e-3)


GAINING = [remedy for remedy in REMEDIES[1:] if not remedy.coupling]


@pytest.mark.parametrize("remedy", GAINING, ids=lambda remedy: remedy.name)
def test_every_remedy_lets_a_rigid_device_with_a_delay_render_more(remedy: Remedy) -> None:
    before, after = rows(rigid(0.6875), AS_IT_IS, remedy)
    assert after.stiffness_n_per_m > 1.001 * before.stiffness_n_per_m


def test_no_other_damping_of_the_virtual_kind_goes_farther() -> None:
    scene = rigid(0.6875)
    found = row(scene, Remedy("corner", best_corner=True))
    own = treated(scene, AS_IT_IS, found.corner_hz)
    passive = remedies.passive_by_theorem(own)
    others = [remedies.largest_stiffness(passive, b) for b in np.linspace(0.0, 3.0, 25)]
    assert found.stiffness_n_per_m >= np.nanmax(others) * 0.995
    assert found.virtual_damping_ns_per_m > 0.0


def test_volume_grows_with_damping_and_hardly_with_the_grid() -> None:
    levels = [Remedy("", active_damping_ns_per_m=level) for level in (0.0, 0.87, 1.74, 3.48)]
    volumes = [found.volume for found in rows(rigid(0.6875), *levels)]
    assert volumes[0] > 0.0
    assert all(after > 1.5 * before for before, after in pairwise(volumes))
    passive = remedies.passive_by_theorem(treated(rigid(0.6875), AS_IT_IS))
    best = remedies.stiffest(passive)
    coarse, fine = (remedies.set_volume(passive, best, (n, n, n)) for n in (12, 24))
    assert coarse == pytest.approx(fine, rel=0.1)


def test_shipped_devices_differ_and_are_passive_without_a_remedy() -> None:
    found = [rows(load_scene(name), AS_IT_IS)[0] for name in SCENES]
    assert [one.device for one in found] == list(SCENES)
    assert all(one.stiffness_n_per_m > 50.0 for one in found)


def test_largest_coupling_is_the_stiffness_that_a_wall_may_have() -> None:
    first, coupled = rows(rigid(0.6875), AS_IT_IS, COUPLING)
    assert coupled.stiffness_n_per_m == first.stiffness_n_per_m
    assert coupled.virtual_damping_ns_per_m == first.virtual_damping_ns_per_m
    assert np.isnan(coupled.volume)


def test_felt_through_a_coupling_is_both_in_series_and_the_device() -> None:
    first, coupled = rows(rigid(), AS_IT_IS, COUPLING)
    k, b = coupled.asked
    s = 2j * pi * RENDERED_HZ[0]
    asked = k / s + b
    between = first.stiffness_n_per_m / s + first.virtual_damping_ns_per_m
    series = asked * between / (asked + between)
    device = MASS_KG * s + PHYSICAL_NS_PER_M
    assert coupled.rendered[0] == pytest.approx((series + device) / asked, rel=0.02)
    assert abs(coupled.rendered[0]) < 0.8 * abs(first.rendered[0])


def test_a_coupling_has_no_trials() -> None:
    """Its law is no sum of K, B and M."""
    (found,) = rows(rigid(), COUPLING, quick=False, seeds=1)
    assert found.trials is None


def test_verb_prints_keeps_and_returns_the_rows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    few = partial(RemediesParams, remedies=REMEDIES[:3])
    monkeypatch.setattr(remedies, "RemediesParams", few)
    monkeypatch.setattr(port_energy, "BASES", {"as it is": "as it is"})
    monkeypatch.setattr(port_energy, "HANDS", (4, 4))
    monkeypatch.setattr(port_energy, "CHILDREN", (2, 2))
    mine = tmp_path / "mine.toml"
    mine.write_text(MINE)
    words = ("studies", "remedies", str(mine), "--quick", "--out", str(tmp_path / "run"))
    code, out, _ = spoken(capsys, *words)
    assert code == 0
    for expected in ("K at B = 0", "as it is", "best corner", "2 x rate", "K in every hand"):
        assert expected in out
    code, out, _ = spoken(capsys, *words, "--json")
    told = json.loads(out)
    assert (code, told["ok"], told["simulated"], told["quick"]) == (0, True, True, True)
    assert [one["remedy"] for one in told["rows"]] == ["as it is", "best corner", "2 x rate"]
    assert told["rows"][0]["trials"] is None
    (energy,) = told["energy"]
    assert energy["remedy"] == "as it is"
    assert energy["asked_n_per_m"] == 2.0 * told["rows"][0]["stiffness_n_per_m"]
    kept = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (kept["rows"], kept["energy"]) == (told["rows"], told["energy"])
