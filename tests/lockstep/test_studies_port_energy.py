"""Energy at the port: the record is that of the port, a passive display gives nothing out, and
what the measure finds agrees with the theorem where there is one.
"""

from dataclasses import replace
from math import inf, isnan, nan

import numpy as np
import pytest
from support.devices import rigid
from support.passive_hands import random_hands

from hapticd.model.coupled import at_port, held_by
from hapticd.model.effects import Delay
from hapticd.settings.scene import load_scene
from hapticd.studies import port_energy
from hapticd.studies.port_energy import (
    GIVEN_J,
    LEAST,
    MOST,
    EnergyRow,
    Tried,
    first_failures,
    given_out,
    hand_of,
    run_port_energy,
)
from hapticd.studies.remedies import REMEDIES, RemediesParams, run_remedies
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.store import TrialStore, to_json

PUSH_N = np.repeat([1.0, 0.0], 1000)
HANDS = np.random.default_rng(7).uniform(LEAST, MOST, (6, 6))
PHYSICAL_NS_PER_M = 1.0


def bench(delay_periods=0.25):
    """A mass of 8 g with 1 N s/m."""
    scene = load_scene("theory")
    return replace(scene, effects=(*scene.effects, Delay(periods=delay_periods)))


def played(model):
    return simulate(model, [[0.0, 0.0, 0.0]], 0.5, excitation=PUSH_N, keep="records")


@pytest.mark.parametrize("seed", [1, 4])
def test_a_port_changes_nothing_of_the_motion(seed):
    hand = random_hands(5, seed + 1)[seed]
    held, port = (of(rigid(PHYSICAL_NS_PER_M), hand) for of in (held_by, at_port))
    one, other = played(held), played(port)
    scale = abs(one.velocity_m_per_s).max()
    assert other.velocity_m_per_s == pytest.approx(one.velocity_m_per_s, abs=1e-9 * scale)


@pytest.mark.parametrize("sizes", HANDS)
def test_force_at_the_port_moves_the_display(sizes):
    """Newton's law of the display alone: m v' + b v is the recorded force."""
    result = played(at_port(rigid(PHYSICAL_NS_PER_M), hand_of(sizes)))
    force, velocity = result.record(0)
    moved = np.cumsum(velocity) / 4000.0
    impulse = np.cumsum(force) / 4000.0
    # at the end all is slow: the momentum is that of the mean velocity of the last intervals
    late = slice(1900, 2000)
    momentum = impulse[late] - PHYSICAL_NS_PER_M * moved[late]
    assert momentum.mean() == pytest.approx(0.008 * velocity[late].mean(), abs=1e-6)


def test_energy_at_the_port_is_stored_or_spent_in_the_display():
    """In a hand whose modes are slow against 4 kHz: kinetic energy and what the damper takes."""
    sizes = np.log([0.01, 0.3, 500.0, 2.0, 200.0, 1.0])
    result = played(at_port(rigid(PHYSICAL_NS_PER_M), hand_of(sizes)))
    force, velocity = result.record(0)
    assert result.work_j[0] == pytest.approx(float(force @ velocity) / 4000.0)
    spent = PHYSICAL_NS_PER_M * float(velocity @ velocity) / 4000.0
    kinetic = 0.5 * 0.008 * velocity[-1] ** 2
    assert result.work_j[0] == pytest.approx(spent + kinetic, rel=1e-3)


def test_a_display_without_a_law_gives_nothing_out():
    given = given_out(bench(), (), HANDS, np.array([[0.0, 0.0]]))
    assert given.max() < 0.01 * GIVEN_J


def test_below_the_theorem_no_hand_gets_anything_and_far_above_it_one_does():
    """Colgate and Schenkel: 1 N s/m pay for 2 kN/m at 1 kHz without delay."""
    scene = load_scene("theory")
    points = np.array([[0.98 * 2000.0, 0.0], [4.0 * 2000.0, 0.0]])
    below, above = given_out(scene, (), HANDS, points).T
    assert below.max() < GIVEN_J
    assert above.max() > 10.0 * GIVEN_J


def test_first_failure_is_that_of_the_ascending_grid():
    k = np.array([500.0, 1900.0, 9000.0, 12000.0])
    failed = first_failures(load_scene("theory"), (), HANDS, k, np.array([0.0]))
    assert failed.shape == (6, 1)
    assert failed.min() == 9000.0


def test_a_device_that_renders_nothing_has_no_row():
    params = RemediesParams((load_scene("literal"),), REMEDIES[:1], quick=True)
    rows = run_remedies(params, TrialStore(None))
    assert isnan(rows[0].stiffness_n_per_m)
    assert run_port_energy(params, rows, TrialStore(None)) == ()


def test_runaway_is_reported_as_such():
    scene = bench()
    wild = given_out(scene, (), HANDS[:1], np.array([[1e6, 0.0]]))
    assert np.isinf(wild).all()


def pool(monkeypatch, failures, limit=1000.0):
    """Draws from hands that fail at those K [N/m] over the K of the search."""
    fails = iter([limit * np.array(failures)[:, None], np.array([[0.9 * limit]])])
    monkeypatch.setattr(port_energy, "first_failures", lambda *given: next(fails))
    one = Tried(bench(), (), np.zeros(1), HANDS[:1], np.array([[limit]]), inf)
    return port_energy.draws(one, True)


def test_each_draw_ends_before_the_first_failure_in_its_own_hands(monkeypatch):
    """A quarter of the pool is in a draw: the worst of its 24 hands in about a quarter of them."""
    k = port_energy.AROUND
    found, first = pool(monkeypatch, [k[9], *[k[25]] * 23])
    assert set(found) == {1000.0 * k[8], 1000.0 * k[24]}
    assert 3 <= (found < 1000.0).sum() <= 13
    assert found.shape == (32,)
    assert first == 900.0


def test_draws_without_a_failure_reach_the_largest_stiffness_tried(monkeypatch):
    found, _ = pool(monkeypatch, [inf] * 24)
    assert found == pytest.approx(3000.0)


def test_draws_in_which_every_stiffness_fails_allow_none(monkeypatch):
    found, _ = pool(monkeypatch, [port_energy.AROUND[0]] * 24)
    assert (found == 0.0).all()


@pytest.fixture
def small(monkeypatch):
    """A study of two remedies and FOAW that takes seconds."""
    few = dict(list(port_energy.BASES.items())[:4])
    monkeypatch.setattr(port_energy, "BASES", few)
    for name, value in (("HANDS", (4, 4)), ("CHILDREN", (2, 2)), ("ROUNDS", (1, 1))):
        monkeypatch.setattr(port_energy, name, value)
    monkeypatch.setattr(port_energy, "STIFFNESS", np.geomspace(0.5, 8.0, 8))
    monkeypatch.setattr(port_energy, "VIRTUAL_DAMPING", np.array([0.0, 1.0]))
    return RemediesParams((bench(),), (REMEDIES[0], REMEDIES[7]), quick=True)


def test_rows_are_kept_and_agree_with_the_theorem(small, tmp_path, monkeypatch):
    store = TrialStore(tmp_path / "kept.jsonl")
    rows = run_remedies(small, store)
    found = run_port_energy(small, rows, store)
    names = ["as it is", "1.74 N s/m", "FOAW"]
    assert [row.remedy for row in found] == names
    for row, theory in zip(found, rows, strict=False):
        assert row.stiffness_n_per_m > 0.95 * theory.stiffness_n_per_m
        assert row.draws_n_per_m.min() > 0.9 * row.stiffness_n_per_m
        assert row.asked_n_per_m == 2.0 * rows[0].stiffness_n_per_m
        assert isnan(row.given_out_j) == row.diverged
        assert row.draws_n_per_m.shape == (port_energy.DRAWS,)
    for row, theory in zip(found[:2], rows, strict=True):  # linear: felt as the theory says
        assert row.rendered == pytest.approx(theory.rendered, rel=0.01)
    monkeypatch.setattr(port_energy, "judged", None)  # every row is in the store
    again = run_port_energy(small, rows, TrialStore(tmp_path / "kept.jsonl"))
    assert to_json(again) == to_json(found)


# --- rows, without their trials -------------------------------------------------------------------


@pytest.fixture(scope="module")
def theory():
    """A study of two remedies, and its rows by the theorem."""
    params = RemediesParams((bench(),), (REMEDIES[0], REMEDIES[7]), quick=True)
    return params, run_remedies(params, TrialStore(None))


@pytest.fixture
def asked(monkeypatch):
    """What is asked of each row: its name, and its active damping. The fourth is interrupted."""
    asked = []

    def judged(name, scene, first, quick):
        asked.append((name, scene.level_ns_per_m))
        if len(asked) == 4:
            raise KeyboardInterrupt
        numbers = (nan, 0.5, 100.0, 200.0, False, 0.0)
        draws = np.full(port_energy.DRAWS, 100.0)
        return EnergyRow(first.device, name, *numbers, draws, np.array([1.0, 1j, 2.0]), 1e-5)

    monkeypatch.setattr(port_energy, "judged", judged)
    return asked


def test_interrupted_rows_continue_with_those_that_are_missing(asked, theory, tmp_path):
    params, rows = theory
    path = tmp_path / "kept.jsonl"
    told = []
    names = [name for name, base in port_energy.BASES.items() if base != "best corner"]
    with pytest.raises(KeyboardInterrupt):
        run_port_energy(params, rows, TrialStore(path), lambda *step: told.append(step))
    assert [step[1:] for step in told] == [(done, len(names)) for done in range(4)]
    found = run_port_energy(params, rows, TrialStore(path))
    assert [name for name, _ in asked] == [*names[:4], *names[3:]]
    assert [row.remedy for row in found] == names


def test_pairs_have_active_damping(asked, theory):
    asked.extend([None] * 4)
    run_port_energy(*theory, TrialStore(None))
    levels = dict(asked[4:])
    pairs = [f"{part}, 1.74 N s/m" for part in ("FOAW", "PO/PC", "tank")]
    assert [levels["FOAW"], *(levels[name] for name in pairs)] == [0.0, 1.74, 1.74, 1.74]


@pytest.mark.parametrize("part", ["FOAW", "PO/PC", "tank"])
def test_a_pair_searches_with_the_part_of_its_name(part, theory, monkeypatch):
    """And with no other: the first search ends here."""

    def ends(scene, parts, first, quick):
        raise StopIteration(parts)

    monkeypatch.setattr(port_energy, "tried", ends)
    scene, first = load_scene("fig4"), theory[1][0]
    ((_, expected),) = port_energy.laws(part, scene, first)
    with pytest.raises(StopIteration) as end:
        port_energy.judged(f"{part}, 1.74 N s/m", scene, first, True)
    assert end.value.value == expected


def test_a_number_that_the_row_before_has_tried_is_not_tried_again(theory, monkeypatch):
    searched = []

    def failures(scene, parts, hands, k, b):
        searched.append(parts)
        return np.full((len(hands), b.size), inf)

    monkeypatch.setattr(port_energy, "first_failures", failures)
    scene, first = bench(), theory[1][0]
    for name in ("Levant", "Levant, best C"):
        for _, parts in port_energy.laws(name, scene, first):
            port_energy.worsened(port_energy.tried(scene, parts, first, True), True)
    assert len(set(searched)) == len(port_energy.ACCELERATIONS)
    assert len(searched) == 2 * len(set(searched))  # on the coarse grid, and on the fine one
