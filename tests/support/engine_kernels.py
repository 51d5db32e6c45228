"""Kernels as text, as files and as machine code."""

from hapticd.core.environment import Environment, WallParams
from hapticd.zwidth.engine.shape import reduced, shape_of
from support.devices import COUNTS, DRY, LIMIT, TWO_MASSES, device

ALL = device(*TWO_MASSES, DRY, COUNTS, LIMIT)
WALL = Environment(wall=WallParams(stiffness_n_per_m=1000.0, position_m=0.001, side=1))


def shape(model, damped=False, substeps=1, dtype="f64", environment=None):
    return shape_of(
        reduced(model, damped)[0], environment or Environment(), damped, substeps, dtype
    )
