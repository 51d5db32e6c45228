"""Simulate scenes: run them, explain them, ask which effects they need and how much damping they bear."""

import typer

from hapticd.cli import scene_ceiling, scene_effects, scene_explain, scene_run

app = typer.Typer(no_args_is_help=True, help=__doc__)
for name, verb in {"run": scene_run, "explain": scene_explain, "effects": scene_effects, "ceiling": scene_ceiling}.items():
    app.command(name)(verb.command)
