"""Effects left out: what they change, and what is proposed, each against a closed form."""

from dataclasses import replace
from math import isnan

import numpy as np
import pytest
from support.measured_scenes import MASS_KG, MOTOR, PARTS, VISCOUS_NS_PER_M, scene, stopwatch

from hapticd.model.effects import Coupling, Viscous
from hapticd.studies.effects import (
    PREDICTED,
    SIMULATED,
    EffectsParams,
    limits,
    plan_effects,
    run_effects,
)


def test_question_without_an_answer_keeps_everything() -> None:
    bare = scene(
        (PARTS[0], MOTOR, Coupling(stiffness_n_per_m=1e5, damping_ns_per_m=0.0)), seconds=5.0
    )
    bare = replace(bare, effects=(replace(PARTS[0], slider_kg=0.001), *bare.effects[1:]))
    found = run_effects(plan_effects(EffectsParams(bare, "limits", 0.02, 5.0)), stopwatch())
    assert all(isnan(number) for number in found.whole[0].numbers.values())
    assert found.kept == ("coupling",)


def test_simulated_mass_limit_agrees_with_prediction() -> None:
    asked = EffectsParams(scene(), seconds=12.0)
    assert limits(asked, scene(), SIMULATED)[2] == pytest.approx(
        limits(asked, scene(), PREDICTED)[2], rel=0.08
    )


def test_cheapest_set_keeps_what_dissipates_and_drops_a_stiff_coupling() -> None:
    """A coupling of 1e6 N/m is not seen below 500 Hz; without viscous friction all of Z is the
    mass's, at 90 degrees.
    """
    stiff = replace(PARTS[0], slider_kg=0.001, rotor_kg=MASS_KG - 0.001)
    small = scene(
        (
            stiff,
            MOTOR,
            Coupling(stiffness_n_per_m=1e6, damping_ns_per_m=50.0),
            Viscous(rotor_ns_per_m=1.0),
        ),
        seconds=6.0,
    )
    heard: list[str] = []
    found = run_effects(
        plan_effects(EffectsParams(small, "phase", 0.05, 6.0)),
        stopwatch(),
        lambda what, done, total: heard.append(what),
    )
    by_effect = {row.effect: row for row in found.rows}
    turned = 90.0 - np.degrees(np.arctan(2.0 * np.pi * 2.9297 * MASS_KG / VISCOUS_NS_PER_M))
    assert by_effect["viscous"].change == pytest.approx(turned / 90.0, rel=1e-3)
    assert by_effect["coupling"].change < 0.05
    assert found.kept == ("viscous",)
    assert found.proposal.change <= 0.05
    assert heard[-1] == "done"
