"""The plant as straight-line Python, generated from the numbers of board.json.

A simulated board advances its plant in pieces of whole sub-steps, sixteen to a servo tick. `make_step` writes the source
of one piece with every number as a literal and only the effects that the numbers call for (no stops: no comparison),
compiles it, and leaves the source in `linecache` so that a traceback shows it. The coefficients of a piece depend on its
length and on the damping level; they are made when first needed and forgotten when the level changes.

The state is a tuple that only the plant understands; what a board sees of it are the views of `Plant`. Here is the one
rigid mass, exact at any damping level; a device with more effects comes from `composed` behind the same functions.

What would break it: calling one step from two boards (it remembers the damping level), or a piece that is long against
the motion when there are stops: a stop is met at the end of a piece, inelastically.
"""

from collections.abc import Callable
from math import isfinite
from typing import NamedTuple

from hapticd.errors import ConfigError
from hapticd.params import BoardParams
from hapticd.plant.composed import Step, composed_step, rest
from hapticd.plant.mechanics import held_force_response
from hapticd.plant.views import State, View, compiled, viewer

SUBSTEPS_PER_TICK = 16

_SOURCE = """\
def bind(response):
    level, rows = None, {{}}

    def step(state, force_n, torque_n, damping_ns_per_m, n_substeps):
        nonlocal level
        if damping_ns_per_m != level:
            level = damping_ns_per_m
            rows.clear()
        try:
            decay, velocity_per_n, position_per_velocity, position_per_n = rows[n_substeps]
        except KeyError:
            row = response({mass_kg!r}, {viscous_ns_per_m!r} + level, n_substeps / {substep_rate_hz!r})
            decay, velocity_per_n, position_per_velocity, position_per_n = rows[n_substeps] = row
        position, velocity = state
        force_n += torque_n
        position += position_per_velocity * velocity + position_per_n * force_n
        velocity = decay * velocity + velocity_per_n * force_n
{stops}        return position, velocity

    return step
"""

_STOP = """\
        if position {beyond} {stop_m!r}:
            position = {stop_m!r}
            if velocity {beyond} 0.0:
                velocity = 0.0
"""


def rest_state(params: BoardParams, position_m: float = 0.0) -> State:
    """State of the plant of `params` at rest at `position_m`."""
    return position_m, 0.0


def step_source(params: BoardParams) -> str:
    """Source text of the step for `params`. Raises ConfigError if the numbers describe no device."""
    _check(params)
    ends = ((params.upper_stop_m, ">"), (params.lower_stop_m, "<"))
    return _SOURCE.format(
        mass_kg=params.mass_kg,
        viscous_ns_per_m=params.viscous_ns_per_m,
        substep_rate_hz=SUBSTEPS_PER_TICK * params.rate_hz,
        stops="".join(_STOP.format(stop_m=stop_m, beyond=beyond) for stop_m, beyond in ends if isfinite(stop_m)),
    )


def make_step(params: BoardParams) -> Step:
    """`step(state, force_n, torque_n, damping_ns_per_m, n_substeps) -> state`, exact for held inputs.

    force_n: motor force, torque_n: perturbation torque as endpoint force, both to positive x; damping_ns_per_m: added
    electrical damping; n_substeps: whole number of T/16. Raises ConfigError if the numbers describe no device.
    """
    step: Step = compiled(step_source(params), "plant step")["bind"](held_force_response)
    return step


class Plant(NamedTuple):
    """What a board moves and how it sees it. A view is called with (state, force_n, damping_ns_per_m)."""

    rest: Callable[[float], State]  # at a position
    step: Step
    encoder: View  # m
    travel: View  # m; differences over an interval are the recorded velocity
    impulse: View | None  # N s; differences over an interval are added to the recorded torque
    motor_force: View  # N
    estimate: View  # m/s, back-EMF velocity
    celsius: Callable[[State], float] | None  # of a winding that heats up


def make_plant(params: BoardParams) -> Plant:
    """The plant of `params`: composed if they bring one, else the rigid mass. ConfigError if the numbers describe none."""
    if params.plant is None:
        return Plant(
            rest=lambda position_m: rest_state(params, position_m),
            step=make_step(params),
            encoder=lambda state, force_n, level: state[0],
            travel=lambda state, force_n, level: state[0],
            impulse=None,
            motor_force=lambda state, force_n, level: force_n - level * state[1],
            estimate=lambda state, force_n, level: state[1],
            celsius=None,
        )
    plant = params.plant
    step, shape = composed_step(plant, params, 1.0 / (SUBSTEPS_PER_TICK * params.rate_hz))
    views = {name: viewer(shape, name) for name in ("encoder", "travel", "motor_force", "estimate")}
    return Plant(
        rest=lambda position_m: rest(plant, position_m),
        step=step,
        impulse=None if plant.impulse is None else viewer(shape, "impulse"),
        celsius=None if plant.heating is None else lambda state: state[-1],
        **views,
    )


def _check(params: BoardParams) -> None:
    if not (isfinite(params.mass_kg) and params.mass_kg > 0.0):
        raise ConfigError(f"plant mass {params.mass_kg} kg must be positive; correct mass_kg in the device file")
    if not (isfinite(params.viscous_ns_per_m) and params.viscous_ns_per_m >= 0.0):
        raise ConfigError(f"plant damping {params.viscous_ns_per_m} Ns/m must be 0 or more; correct viscous_ns_per_m")
    if not (isfinite(params.rate_hz) and params.rate_hz > 0.0):
        raise ConfigError(f"servo rate {params.rate_hz} Hz must be positive; correct rate_hz")
    if not params.lower_stop_m < params.upper_stop_m:
        raise ConfigError(
            f"stops at {params.lower_stop_m} m and {params.upper_stop_m} m leave no travel; lower must be below upper"
        )
