"""The tick law as tests call it."""

from hapticd.params import EnvironmentParams
from hapticd.render.law import Environment


def environment_tuple(params: EnvironmentParams, limit_n: float) -> Environment:
    """`params` as the law takes them, without bias."""
    wall = params.wall
    ends = params.workspace
    kbm = (params.stiffness_n_per_m, params.damping_ns_per_m, params.mass_kg)
    solid = (wall.stiffness_n_per_m, wall.damping_ns_per_m, wall.position_m, float(wall.side))
    return (*kbm, 0.0, limit_n, *solid, ends.lower_m, ends.upper_m, ends.stiffness_n_per_m)
