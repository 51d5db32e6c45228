"""A trial in which the amplifier reaches a limit names it, with a number, and decides nothing."""

import json
from dataclasses import replace

import pytest

from hapticd.cli.app import main
from hapticd.model.effects import AmplifierLimits
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial, device_scene
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial, summary

POINT = (50.0, 1.0, 0.0)
LEVEL = 1.74
SECONDS = 12.0


def scene_with(current_a):
    """The Weir display with that limit of current, or with none."""
    scene = device_scene("weir2008")
    if current_a is None:
        return scene
    limits = AmplifierLimits(max_current_a=current_a, max_voltage_v=15.8, inductance_h=1e-4)
    return replace(scene, effects=(*scene.effects, limits))


@pytest.mark.parametrize(("current_a", "voids"), [(6.0, None), (0.03, True)])
def test_trial_names_the_share_of_ticks_at_a_limit(current_a, voids):
    scene = scene_with(current_a)
    plan = plan_trial(TrialParams(Trial(POINT, LEVEL, SECONDS), scene))
    result = run_trial(plan, engine_source(scene))
    found = [one for one in result.verdict.findings if one.code == "amplifier_limited"]
    kept = summary(result)

    assert [one.voids for one in found] == ([] if voids is None else [voids])
    assert kept["ticks"] == 12_000
    assert (kept["limited_ticks"] > 120) is bool(voids)
    assert (result.verdict.answer == "passive") is not bool(voids)


def test_many_trials_leave_one_at_a_limit_undecided():
    answers = [
        run_trials(Conditions(scene_with(current_a), SECONDS), LEVEL, [POINT])[0].answer
        for current_a in (None, 0.03)
    ]

    assert answers == ["passive", "undecided"]


def test_prediction_states_what_it_does_not_cover(tmp_path, capsys):
    path = tmp_path / "limited.toml"
    path.write_text(
        'title = "limits"\ndevice = "weir2008"\n'
        'effects = ["viscous", "amplifier", "amplifier_limits"]\n'
    )
    assert main(["zwidth", "predict", "--scene", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])

    assert told["amplifier_limit_n"] == pytest.approx(6.0 * 1.649242, rel=1e-6)
