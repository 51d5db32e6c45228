"""
Write a scene
=============

A scene is a TOML file of about twenty lines: a device, its effects, what it renders, and what moves
it. This tutorial writes, reads, simulates and changes one. See also :doc:`/scenes`.
"""

import tempfile
from pathlib import Path

from hapticd.core.errors import ConfigError
from hapticd.model.compose import compose
from hapticd.settings.scene import load_scene
from hapticd.studies.report import scene_figure
from hapticd.studies.scene import plan_scene, run_scene

folder = Path(tempfile.mkdtemp(prefix="scenes-"))

# %%
# The file
# --------
# A wall at 2 mm. The handle arrives with 0.1 m/s, a hand pushes it with half a newton, and the
# active damping is on.

WALL = """
title = "a stiff wall, damped"
device = "weir2008"
effects = ["viscous", "coulomb", "delay", "smoothing", "damping_circuit", "encoder", "saturation"]
seconds = 1.0

[environment.wall]
stiffness_n_per_m = 1000.0      # N/m
virtual_damping_ns_per_m = 1.0          # N s/m
position_m = 0.002              # m
side = 1                        # solid beyond it

[[active_damping]]
level_ns_per_m = 1.74           # N s/m

[excitation]
kind = "push"
force_n = 0.5                   # N

[start]
velocity_m_per_s = 0.1          # m/s
"""
path = folder / "wall.toml"
path.write_text(WALL)
scene = load_scene(path)
print(scene.title, "|", ", ".join(effect.key for effect in scene.effects))

# %%
# Look at the model
# -----------------
# The model contains only the listed effects and the masses of the device.

model = compose(scene)
for state in model.states:
    print(f"{state.name:20} {state.unit:4} from {state.effect}")

# %%
# Run it
# ------
# Once with the damping that the file asks for and once without, under the same push.

result = run_scene(plan_scene(scene))
figure = scene_figure(result)
for trial in result.trials:
    print(f"{trial.case.name}: at most {trial.numbers['max_force_n']:.2f} N of the wall's force")

# %%
# Without damping the handle bounces off the wall again and again; with it the handle comes to rest.
#
# Change the device
# -----------------
# ``[model.KEY]`` replaces single numbers of the device. Here its dry friction is ten times as large
# and has the effect of the active damping: a stiff wall is easy on a device that is hard to move.

(folder / "rough.toml").write_text(WALL + "\n[model.coulomb]\nrotor_n = 0.293\n")
rough = run_scene(plan_scene(load_scene(folder / "rough.toml")))
for name, found in (("as it is", result), ("with ten times the friction", rough)):
    speeds = [1e3 * trial.numbers["velocity_sd_m_per_s"] for trial in found.trials]
    print(f"{name}: {speeds[0]:.0f} mm/s rms without damping, {speeds[1]:.0f} mm/s with it")

# %%
# Read an error
# -------------
# A message contains file, line, key and limit, and suggests the likely name for a misspelt key.

(folder / "wrong.toml").write_text(WALL.replace("side = 1", "side = 2").replace("force_n", "force"))
try:
    load_scene(folder / "wrong.toml")
except ConfigError as error:
    print(str(error).replace(f"{folder}/", ""))
