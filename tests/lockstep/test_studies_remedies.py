"""Remedies: each changes what it names, and what a row says agrees with independent theory."""

from dataclasses import replace
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.core.environment import FilterParams
from hapticd.model.effects import Delay, Encoder
from hapticd.model.loop import responses
from hapticd.model.scene import Scene
from hapticd.model.theorem import required_damping
from hapticd.render.law import design
from hapticd.settings.scene import load_scene
from hapticd.studies import remedies
from hapticd.studies.remedies import (
    REMEDIES,
    RENDERED_HZ,
    RemediesParams,
    Remedy,
    Row,
    run_remedies,
    treated,
)
from hapticd.zwidth import outcomes
from hapticd.zwidth.limits import predicted_limit
from hapticd.zwidth.sources import display
from hapticd.zwidth.store import TrialStore

PHYSICAL_NS_PER_M = 1.0  # of the scene `theory`
MASS_KG = 0.008
AS_IT_IS = REMEDIES[0]
COUPLING = Remedy("coupling", coupling=True)


def rigid(delay_periods: float = 0.0) -> Scene:
    """A mass of 8 g with 1 N s/m, whose active damping is ideal."""
    scene = load_scene("theory")
    return replace(scene, effects=(*scene.effects, Delay(periods=delay_periods)))


def rows(scene: Scene, *asked: Remedy, **more: Any) -> list[Row]:
    params = RemediesParams((scene,), asked, **{"quick": True, **more})
    return list(run_remedies(params, TrialStore(None)))


def row(scene: Scene, remedy: Remedy) -> Row:
    return rows(scene, AS_IT_IS, remedy)[1]


@pytest.mark.parametrize(
    "remedy",
    [
        AS_IT_IS,
        Remedy("rate", faster=2.0),
        Remedy("delay", delay_share=0.5),
        Remedy("no delay", delay_share=0.0),
        Remedy("circuit", active_damping_ns_per_m=0.87),
        Remedy("corner", best_corner=True),
        Remedy("pair", 4.0, 0.5, 1.74),
    ],
    ids=lambda remedy: remedy.name,
)
def test_stiffness_is_that_which_the_closed_form_asks_the_damping_for(remedy: Remedy) -> None:
    """Rate, delay, corner and level enter the theorem as they are named: it then asks a rigid
    device for all of its damping, and for none of it if one of them were not applied.
    """
    found = row(rigid(0.6875), remedy)
    point = (found.stiffness_n_per_m, found.virtual_damping_ns_per_m, 0.0)
    filters = (FilterParams(found.corner_hz), FilterParams(72.0))
    needed, _ = required_damping(
        [point],
        1000.0 * remedy.faster,
        0.6875 * remedy.delay_share * remedy.faster,
        filters,
    )
    own = PHYSICAL_NS_PER_M + remedy.active_damping_ns_per_m
    assert needed[0] == pytest.approx(own, rel=1e-3)


def test_a_rate_keeps_delay_in_seconds_and_filters_in_hertz() -> None:
    scene = rigid(0.5)
    faster = treated(scene, Remedy("", faster=4.0))
    assert display(faster).model.rate_hz == 4000.0
    assert display(faster).model.delay_periods == 2.0
    assert faster.environment.filters == scene.environment.filters
    found = row(scene, Remedy("", faster=4.0))
    assert (found.rate_hz, found.delay_s, found.corner_hz) == (4000.0, 0.5e-3, 100.0)


def test_rendered_at_low_frequency_is_what_is_asked_and_the_device_itself() -> None:
    found = row(rigid(), Remedy("", active_damping_ns_per_m=1.74))
    k, b = found.asked
    s = 2j * pi * RENDERED_HZ[0]
    device = MASS_KG * s + PHYSICAL_NS_PER_M + 1.74
    assert found.rendered[0] == pytest.approx((k / s + b + device) / (k / s + b), rel=0.02)


def test_environment_asked_of_all_remedies_is_half_of_what_the_first_row_renders() -> None:
    first, second = rows(rigid(0.6875), AS_IT_IS, REMEDIES[3])
    expected = (0.5 * first.stiffness_n_per_m, first.virtual_damping_ns_per_m)
    assert first.asked == second.asked == expected


def test_noise_at_rest_of_a_spring_is_that_of_a_rounded_position() -> None:
    scene = replace(rigid(), effects=(*rigid().effects, Encoder(quantum_m=1e-6)))
    spring, damper = (remedies.felt_law(asked, None) for asked in ((500.0, 0.0), (0.0, 1.0)))
    assert remedies.noise_at_rest(scene, spring) == pytest.approx(500e-6 / sqrt(12.0))
    corners = [treated(scene, AS_IT_IS, hz) for hz in (50.0, 100.0, 400.0)]
    noises = [remedies.noise_at_rest(one, damper) for one in corners]
    assert noises[0] < 0.5 * noises[1] < 0.25 * noises[2]


def test_a_spring_behind_a_coupling_may_need_more_than_a_wall() -> None:
    """With more virtual than physical damping. The share s of the motion in the coupling makes K s
    of it and B s^2: b + B s^2 >= K s T at every s needs K T <= 2 sqrt(b B), less than b + B.
    """
    scene = treated(load_scene("fig4"), AS_IT_IS, 450.0)
    physical, virtual = 0.365, 1.0
    wall = remedies.largest_stiffness(remedies.passive_by_theorem(scene), virtual)
    coupling = remedies.largest_stiffness(remedies.couplings(scene), virtual)
    ratio = 2.0 * sqrt(physical * virtual) / (physical + virtual)
    assert coupling / wall == pytest.approx(ratio, rel=0.03)
    assert ratio < 0.9


def test_a_device_that_is_active_by_itself_has_no_stiffness_and_no_volume() -> None:
    """Two lags in its damping circuit: 1.74 N s/m damp `light` at 100 Hz and drive it at 4 kHz."""
    scene = load_scene("light")
    velocity = responses(display(scene).model, np.array([100.0, 4000.0]), 1.74).velocity[0, 1]
    slow, fast = (1.0 / velocity).real
    assert fast < 0.0 < 1.5 < slow
    found = row(scene, Remedy("", active_damping_ns_per_m=1.74))
    assert np.isnan([found.stiffness_n_per_m, found.stiffness_alone_n_per_m]).all()
    assert found.volume == 0.0
    assert np.isfinite(found.rendered).all()


def test_an_environment_that_cannot_be_asked_gives_no_number() -> None:
    """The printed numbers alone dissipate nothing: only active damping makes room for any K."""
    damped_too = Remedy("", active_damping_ns_per_m=1.74)
    none, coupled, damped = rows(load_scene("literal"), AS_IT_IS, COUPLING, damped_too)
    for found in (none, coupled):
        assert np.isnan([found.stiffness_n_per_m, found.noise_n]).all()
        assert np.isnan(found.rendered).all()
    assert damped.stiffness_n_per_m > 1000.0


def test_mode_of_the_flexible_device_is_at_140_hz() -> None:
    poles = np.linalg.eigvals(display(load_scene("flexible")).model.a())
    slow = poles[(poles.imag > 0.0) & (poles.imag < 2.0 * pi * 500.0)]
    assert slow.imag / (2.0 * pi) == pytest.approx([140.0], rel=0.01)


def test_steady_kalman_estimator_is_the_low_pass_of_a_difference() -> None:
    """White acceleration of density q, white noise r of the position: corner (q / r)^(1/4)."""
    rate_hz = 1000.0
    step = 1.0 / rate_hz
    corner_hz = 30.0
    q = (2.0 * pi * corner_hz) ** 4 * 1e-12
    a = np.array([[1.0, step], [0.0, 1.0]])
    drive = q * np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
    spread = np.eye(2)
    for _ in range(5000):
        spread = a @ spread @ a.T + drive
        gain = spread[:, 0] / (spread[0, 0] + 1e-12 * rate_hz)
        spread = spread - np.outer(gain, spread[0])
    turn = np.exp(2j * pi * np.array([1.0, 10.0, 30.0, 60.0]) * step)
    kept = (np.eye(2) - np.outer(gain, [1.0, 0.0])) @ a
    kalman = np.array([np.linalg.solve(np.eye(2) - kept / z, gain)[1] for z in turn])
    b0, b1, b2, a1, a2 = design(corner_hz, sqrt(0.5), "matched", rate_hz)
    low_pass = (b0 + b1 / turn + b2 / turn**2) / (1.0 + a1 / turn + a2 / turn**2)
    assert kalman == pytest.approx(rate_hz * (1.0 - 1.0 / turn) * low_pass, rel=0.02)


# --- by trials, and the verb ----------------------------------------------------------------------


@pytest.mark.slow
def test_trials_search_the_stiffness_that_is_predicted_and_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = rigid(0.25)
    remedy = Remedy("level", active_damping_ns_per_m=0.87)
    path = tmp_path / "trials.jsonl"
    params = RemediesParams((scene,), (AS_IT_IS, remedy), seconds=5.0, seeds=2)
    _, found = run_remedies(params, TrialStore(path))
    assert found.trials is not None
    base = (0.0, found.virtual_damping_ns_per_m, 0.0)
    predicted = predicted_limit(display(treated(scene, remedy)), 0.87, 0, base)
    assert found.trials.scan.predicted == predicted
    assert found.trials.scan.active_damping_ns_per_m == 0.87
    assert found.trials.value == pytest.approx(predicted, rel=0.05)
    assert found.trials.lower <= found.trials.value <= found.trials.upper
    assert len(found.trials.values) == 2
    monkeypatch.setattr(outcomes, "run_trials", None)  # every trial is in the store
    _, again = run_remedies(params, TrialStore(path))
    assert again.trials is not None
    assert again.trials.values == found.trials.values
