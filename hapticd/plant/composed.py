"""The composed device of a simulated board, ready to be played: its tables loaded, its step compiled. Standard library alone.

Everything that a node of the table needs is computed when the board is made; a live change of damping costs one lookup, a
level between nodes one interpolation.
"""

from collections.abc import Callable
from math import sin
from random import Random

from hapticd.errors import ConfigError
from hapticd.params import BoardParams, PlantParams
from hapticd.plant.friction import stick_two
from hapticd.plant.lookup import Lookup, Row, blocks
from hapticd.plant.shape import Shape
from hapticd.plant.straight import step_source
from hapticd.plant.views import State, compiled

Step = Callable[[State, float, float, float, int], State]


def composed_step(params: PlantParams, board: BoardParams, substep_s: float) -> tuple[Step, Shape]:
    """The step of the composed device, as `plant.step.make_step` describes it, and its shape."""
    _check(params)
    lookup = Lookup(params)
    nodes = [blocks(params, node) for node in lookup.nodes]
    shape = Shape(params, nodes)
    ready = [{letter: shape.flat(letter, rows) for letter, rows in node.items()} for node in nodes]

    def coefficients(level: float, residual: float) -> dict[str, Row]:
        node = lookup.node(level, residual)
        return {"a": shape.flat("a", lookup.between(level, residual))} if node is None else ready[node]

    bind = compiled(step_source(shape, substep_s, board.torque_constant_n_per_a), "plant step")["bind"]
    return bind(coefficients, Random(board.seed).gauss, sin, stick_two), shape


def rest(params: PlantParams, position_m: float) -> State:
    """Everything still, every body at `position_m`, the winding as warm as it starts."""
    state = tuple(position_m if name.endswith("_position") else 0.0 for name in params.states)
    return state if params.heating is None else (*state, params.heating.start_c)


def _check(params: PlantParams) -> None:
    n, m = len(params.states), len(params.columns)
    nodes = len(params.levels_ns_per_m) * len(params.residuals_ohm)
    if len(params.maps) != nodes or any(len(flat) != n * (n + m) for flat in params.maps):
        raise ConfigError(
            f"the plant's table has not {nodes} maps of {n} x {n + m} numbers; resolve the configuration again to make board.json"
        )
    if len(params.contacts) > 2:
        raise ConfigError(f"friction at {len(params.contacts)} bodies: at most 2 can be solved; leave some out")
