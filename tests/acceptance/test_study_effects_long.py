"""Effects left out: what they change, and what is proposed, each against a closed form."""

from dataclasses import replace
from math import isnan

from support.measured_scenes import MOTOR, PARTS, scene, stopwatch

from hapticd.model.effects import Coupling
from hapticd.studies.effects import EffectsParams, plan_effects, run_effects


def test_question_without_an_answer_keeps_everything() -> None:
    bare = scene(
        (PARTS[0], MOTOR, Coupling(stiffness_n_per_m=1e5, damping_ns_per_m=0.0)), seconds=5.0
    )
    bare = replace(bare, effects=(replace(PARTS[0], slider_kg=0.001), *bare.effects[1:]))
    found = run_effects(plan_effects(EffectsParams(bare, "limits", 0.02, 5.0)), stopwatch())
    assert all(isnan(number) for number in found.whole[0].numbers.values())
    assert found.kept == ("coupling",)
