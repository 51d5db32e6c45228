"""
Measure a Z-width
=================

Is what the display renders passive, and how far do K, B and M go, with and without active damping?

On a rig ``hapticd zwidth trial live`` shakes the device for 90 s. Here the batch engine simulates
the same trials of the paper's device in milliseconds; everything behind the record is the same
code.
"""

import numpy as np

from hapticd.model.scene import Excitation
from hapticd.settings.scene import load_scene
from hapticd.zwidth.limits import AXES, predicted_limit
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.report.envelope import envelope_figure
from hapticd.zwidth.report.trial import trial_figure
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial

LEVELS = (0.0, 1.74)  # active damping, N s/m
scene = load_scene("fig4")

# %%
# One trial
# ---------
# K = 100 N/m, B = 1 N s/m, M = 10 g, undamped, as in the paper's Fig. 4. Noise at the probe, force
# and velocity at 4 kHz, spectra, Z = force over velocity. The display is passive if Re Z >= 0, that
# is if every phase lies within 90 degrees.


def judged(environment, damping: float = 0.0):
    """One trial of 90 s in K (N/m), B (N s/m), M (kg)."""
    asked = Trial(environment, damping, 90.0, Excitation("noise", seed=1))
    return run_trial(plan_trial(TrialParams(asked, scene)), engine_source(scene))


passive = judged((100.0, 1.0, 0.010))
print(passive.verdict.answer, passive.verdict.margin_ns_per_m)
figure = trial_figure(passive)

# %%
# The verdict is a sentence with all its conditions:

print(passive.verdict)

# %%
# Too stiff
# ---------
# A bare spring of 150 N/m is beyond the limit of the undamped display: the trial ended early.

active = judged((150.0, 0.0, 0.0))
print(active.verdict.answer)
print(active.recorded.ended)

# %%
# And with 1.74 N s/m of active damping:

damped = judged((150.0, 0.0, 0.0), 1.74)
print(damped.verdict.answer, damped.verdict.margin_ns_per_m)

# %%
# How far, without a trial
# ------------------------
# Prediction linearises the friction at the amplitude of a trial. It takes a moment for each limit.
# ``hapticd zwidth limits`` continues with trials until each limit is known to 1 %.

conditions = Conditions(scene, seconds=30.0)
limits = {
    level: [predicted_limit(conditions.display, level, axis) for axis in range(3)]
    for level in LEVELS
}
for level, found in limits.items():
    words = ", ".join(
        f"{name} {value:.3g} {unit}"
        for name, value, unit in zip(AXES, found, ("N/m", "N s/m", "kg"), strict=True)
    )
    print(f"{level:4.2f} N s/m of active damping: {words}")

# %%
# The Z-width
# -----------
# Random environments within those limits; some combinations fail although no single value does. The
# largest and the smallest \|Z\| of the passing ones at each frequency are the envelope: the range
# of this display. The paper's Fig. 8 has the same axes.

random = np.random.default_rng(1)
levels = []
for level, (stiffness, damping, mass) in limits.items():
    environments = random.uniform((0.0, 0.0, mass), (stiffness, damping, 0.010), (48, 3))
    outcomes = run_trials(conditions, level, environments)
    levels.append((level, outcomes))
    passed = sum(outcome.passes for outcome in outcomes)
    print(f"{level:4.2f} N s/m of active damping: {passed} of {len(outcomes)} pass")

envelopes = envelope_figure(conditions, levels)

# %%
# ``hapticd zwidth map`` and ``search`` choose the environments better: :doc:`/zwidth`. For the
# agreement with the paper, see :doc:`/reproduction`.
