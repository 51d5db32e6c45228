"""The plant of a simulated board, and the step of one rigid mass as straight-line Python.

A simulated board advances its plant in pieces of whole sub-steps, sixteen to a servo tick.
`make_step` writes the source of one piece with every number of board.json as a literal and only the
effects that the numbers require (no stops: no comparison). It compiles the source and keeps it in
`linecache` so that tracebacks show it. The coefficients of a piece depend on its length and on the
damping level; they are computed on first use and dropped when the level changes.

The state is a tuple that is opaque outside the plant; the views of `Plant` are the board's access
to it. This module has the one rigid mass, exact at any damping level; `composed` provides devices
with more effects behind the same functions.

One rigid mass with viscous damping c under a force f that is held for a time h, a = c h / m:

    m dv/dt = f - c v,   dx/dt = v
    v(h) = v e^-a          + (h / m)   phi1(a) f         phi1(a) = (1 - e^-a) / a
    x(h) = x + h phi1(a) v + (h^2 / m) phi2(a) f         phi2(a) = (1 - phi1(a)) / a

With phi1 and phi2 nothing is divided by c, so c -> 0 is not a special case: phi1 comes from expm1,
phi2 (which would cancel) from its series below |a| = 1. At the servo's sub-steps a is about 0.003.

Standard library alone: the servo process runs it.

The force must be constant within h (hold it, as the amplifier does). Two boards must not share one
step (it caches the damping level). Limitations: with stops, a piece that is long compared with the
motion, because a stop is met at the end of a piece, inelastically.
"""

from collections.abc import Callable
from dataclasses import replace
from math import exp, expm1, factorial, inf, isfinite
from typing import NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.model.composed import (
    POSITION,
    VELOCITY,
    WINDING,
    Response,
    State,
    Step,
    View,
    compiled,
    composed_step,
    rest,
    rotor_response,
    viewer,
)
from hapticd.model.params import BoardParams, TouchParams
from hapticd.model.touch import touched_step

__all__ = ["SUBSTEPS_PER_TICK", "make_plant"]

# the last term is below 1e-17 at |a| = 1
_PHI2_SERIES = tuple((-1) ** k / factorial(k + 2) for k in reversed(range(18)))


def phi1(a: float) -> float:
    """(1 - e^-a) / a, 1 at a = 0."""
    return -expm1(-a) / a if a else 1.0


def phi2(a: float) -> float:
    """(a - 1 + e^-a) / a^2, 1/2 at a = 0."""
    if abs(a) >= 1.0:
        return (1.0 - phi1(a)) / a
    total = 0.0
    for coefficient in _PHI2_SERIES:
        total = total * a + coefficient
    return total


def held_force_response(
    mass_kg: float, damping_ns_per_m: float, duration_s: float
) -> tuple[float, float, float, float]:
    """Return the exact response of a mass to a held force f, as four coefficients.

        v' = decay v + velocity_per_n f
        x' = x + position_per_velocity v + position_per_n f

    Their order is decay [1], velocity_per_n [m/s/N], position_per_velocity [s], position_per_n
    [m/N].
    """
    a = damping_ns_per_m * duration_s / mass_kg
    reach_s = duration_s * phi1(a)
    return exp(-a), reach_s / mass_kg, reach_s, duration_s * duration_s / mass_kg * phi2(a)


SUBSTEPS_PER_TICK = 16

# bind() caches the rows of the present damping level in its closure: one lookup per piece
_SOURCE = """\
def bind(response):
    level, rows = None, {{}}

    def step(state, force_n, torque_n, active_damping_ns_per_m, n_substeps):
        nonlocal level
        if active_damping_ns_per_m != level:
            level = active_damping_ns_per_m
            rows.clear()
        try:
            decay, velocity_per_n, position_per_velocity, position_per_n = rows[n_substeps]
        except KeyError:
            viscous = {viscous_ns_per_m!r} + level
            row = response({mass_kg!r}, viscous, n_substeps / {substep_rate_hz!r})
            decay, velocity_per_n, position_per_velocity, position_per_n = rows[n_substeps] = row
        position, velocity = state
        force_n += torque_n
        position += position_per_velocity * velocity + position_per_n * force_n
        velocity = decay * velocity + velocity_per_n * force_n
{stops}        return position, velocity

    return step
"""

# an inelastic stop, met at the end of a piece
_STOP = """\
        if position {beyond} {stop_m!r}:
            position = {stop_m!r}
            if velocity {beyond} 0.0:
                velocity = 0.0
"""


def step_source(params: BoardParams) -> str:
    """Return the source text of the step for `params`. ConfigError if the numbers do not describe a
    device.
    """
    _check(params)
    return _SOURCE.format(
        mass_kg=params.mass_kg,
        viscous_ns_per_m=params.viscous_ns_per_m,
        substep_rate_hz=SUBSTEPS_PER_TICK * params.rate_hz,
        stops="".join(
            _STOP.format(stop_m=stop_m, beyond=beyond)
            for stop_m, beyond in ((params.upper_stop_m, ">"), (params.lower_stop_m, "<"))
            if isfinite(stop_m)
        ),
    )


def make_step(params: BoardParams) -> Step:
    """Return `step(state, force_n, torque_n, active_damping_ns_per_m, n_substeps) -> state`, inputs
    held.

    force_n is the motor force, torque_n the perturbation torque as endpoint force, both towards
    positive x; n_substeps is a whole number of T / 16. ConfigError if the numbers do not describe a
    device.
    """
    step: Step = compiled(step_source(params), "plant step")["bind"](held_force_response)
    return step


class Plant(NamedTuple):
    """The plant of a board, and the outputs that the board measures.

    A view is called with (state, force_n, active_damping_ns_per_m).
    """

    rest: Callable[[float], State]  # state of everything still at a position, m
    step: Step
    encoder: View  # m
    travel: View  # m; differences over an interval are the recorded velocity
    impulse: View | None  # N s; differences over an interval are added to the recorded torque
    motor_force: View  # N
    estimate: View  # m/s, back-EMF velocity
    celsius: Callable[[State], float] | None  # temperature of a winding that heats up
    # sets the compensated resistance [ohm] beyond that of count 0; None: no compensation
    compensate: Callable[[float], None] | None = None


def make_plant(params: BoardParams) -> Plant:
    """Return the plant of `params`: composed if they contain one, otherwise the rigid mass.
    ConfigError if the numbers do not describe a plant.
    """
    if params.touch is not None:
        return _touched(params, params.touch)
    if params.plant is None:
        return Plant(
            rest=lambda position_m: (position_m, 0.0),
            step=make_step(params),
            encoder=lambda state, force_n, level: state[POSITION],
            travel=lambda state, force_n, level: state[POSITION],
            impulse=None,
            motor_force=lambda state, force_n, level: force_n - level * state[VELOCITY],
            estimate=lambda state, force_n, level: state[VELOCITY],
            celsius=None,
        )
    plant = params.plant
    step, terms, compensate = composed_step(
        plant, params, 1.0 / (SUBSTEPS_PER_TICK * params.rate_hz)
    )
    views = {name: viewer(terms, name) for name in ("encoder", "travel", "motor_force", "estimate")}
    return Plant(
        rest=lambda position_m: rest(plant, position_m),
        step=step,
        impulse=None if plant.impulse is None else viewer(terms, "impulse"),
        celsius=None if plant.heating is None else lambda state: state[WINDING],
        compensate=compensate,
        **views,
    )


def _touched(params: BoardParams, touch: TouchParams) -> Plant:
    """Return the plant with `touch` on its rotor, which takes over stops and friction there."""
    substep_s = 1.0 / (SUBSTEPS_PER_TICK * params.rate_hz)
    bare = replace(params, touch=None)
    stops_m = (-inf, inf)
    if touch.stop_stiffness_n_per_m:
        stops_m = _stops(params)
        endless = bare.plant and replace(bare.plant, ends=None)
        bare = replace(bare, lower_stop_m=-inf, upper_stop_m=inf, plant=endless)
    if bare.plant is not None:
        level_n = sum(one.level_n for one in bare.plant.contacts if one.body == "rotor")
        kept = tuple(one for one in bare.plant.contacts if one.body != "rotor")
        bare = replace(bare, plant=replace(bare.plant, contacts=kept))
        touch = replace(
            touch, coulomb_n=touch.coulomb_n + level_n, static_n=touch.static_n + level_n
        )
    plant = make_plant(bare)
    step = touched_step(
        plant.step, _response(bare, substep_s), touch, stops_m, substep_s, params.seed
    )
    return plant._replace(step=step)


def _stops(params: BoardParams) -> tuple[float, float]:
    if params.plant is None:
        return params.lower_stop_m, params.upper_stop_m
    ends = params.plant.ends
    return (-inf, inf) if ends is None else (ends.lower_m, ends.upper_m)


def _response(params: BoardParams, substep_s: float) -> Callable[[float], Response]:
    """Return the response of the rotor to a force held for a sub-step, by the level of damping."""
    if params.plant is not None:
        return rotor_response(params.plant)

    def rigid(level: float) -> Response:
        _, velocity_per_n, _, position_per_n = held_force_response(
            params.mass_kg, params.viscous_ns_per_m + level, substep_s
        )
        return Response(position_per_n, velocity_per_n)

    return rigid


def _check(params: BoardParams) -> None:
    if not (isfinite(params.mass_kg) and params.mass_kg > 0.0):
        raise ConfigError(
            f"plant mass {params.mass_kg} kg must be positive; correct mass_kg in the device file"
        )
    if not (isfinite(params.viscous_ns_per_m) and params.viscous_ns_per_m >= 0.0):
        raise ConfigError(
            f"plant damping {params.viscous_ns_per_m} Ns/m must be 0 or more; correct"
            " viscous_ns_per_m"
        )
    if not (isfinite(params.rate_hz) and params.rate_hz > 0.0):
        raise ConfigError(f"servo rate {params.rate_hz} Hz must be positive; correct rate_hz")
    if not params.lower_stop_m < params.upper_stop_m:
        raise ConfigError(
            f"stops at {params.lower_stop_m} m and {params.upper_stop_m} m leave no travel; lower"
            " must be below upper"
        )
