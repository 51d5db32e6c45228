"""A composed model as the numbers of board.json: exact maps at a grid of damping levels. A map
covers one sub-step.

The levels that a configuration uses are nodes, so a board at one of them is exact. Between nodes,
while the servo slews, maps are interpolated linearly. With `GRID` nodes over 10 Ns/m the error of
an interpolated sub-step is below 1e-6 of the velocity. A winding that heats up adds a second axis,
its residual resistance.

Limitations: a highest level far above 10 Ns/m with the same grid, or a winding hotter than
`HOTTEST_C` (the outermost maps are extrapolated linearly).
"""

from collections.abc import Iterable
from dataclasses import asdict
from math import floor
from typing import Any

import numpy as np

from hapticd.core.params import PlantParams
from hapticd.model.discrete import discretise, drive_response_s
from hapticd.model.effects import copper_ohm
from hapticd.model.model import Model
from hapticd.model.step import SUBSTEPS_PER_TICK

__all__ = ["board_fields"]

GRID = 21  # damping levels from 0 to the highest
RESIDUALS = 9  # residual resistances, when the winding heats up
TRIMMED_RESIDUALS = 33  # the same, if the host compensates it as well
HOTTEST_C = 180.0  # upper end of that axis
FAR_M = 1e3  # where a device without ends would stop; JSON has no infinity


def plant_params(
    model: Model,
    duration_s: float,
    exact_levels: Iterable[float],
    highest_ns_per_m: float,
    trim_ohm: float = 0.0,
) -> PlantParams:
    """Return tables of `model` for sub-steps of `duration_s`, up to `highest_ns_per_m`, for a board
    that compensates at most `trim_ohm` beyond the nominal.

    They are exact at `exact_levels` [Ns/m], which are rounded to counts as the DAC rounds them.
    """
    quantum = model.active_damping_quantum_ns_per_m
    levels = {float(level) for level in np.linspace(0.0, highest_ns_per_m, GRID)}
    levels |= {
        level if quantum is None else floor(level / quantum + 0.5) * quantum
        for level in exact_levels
    }
    residuals = _residuals(model, trim_ohm)
    variants = [
        model.at_residual(residual_ohm) if model.winding else model for residual_ohm in residuals
    ]
    maps = [
        discretise(variant, duration_s, level) for variant in variants for level in sorted(levels)
    ]
    if model.drive is not None:
        for one in maps:  # each must be able to limit the force
            drive_response_s(model.drive, model.inputs.amplifier, one)
    out = model.outputs
    return PlantParams(
        states=tuple(state.name for state in model.states),
        columns=_columns(model),
        floating=model.drifts(),
        levels_ns_per_m=tuple(sorted(levels)),
        residuals_ohm=residuals,
        maps=tuple(tuple(np.hstack([found.a, found.b]).ravel().tolist()) for found in maps),
        encoder=out.encoder.params(),
        travel=out.recorded_travel.params(),
        impulse=None if out.recorded_impulse is None else out.recorded_impulse.params(),
        motor_force=out.motor_force.params(),
        estimate=out.estimate.params(),
        contacts=model.contacts,
        ends=model.ends,
        rotor_forces=model.rotor_forces,
        drive=model.drive,
        noise=model.noise,
        estimate_offset_m_per_s=model.estimate_offset_m_per_s,
        heating=None if model.winding is None else model.winding.heating,
    )


def board_fields(
    model: Model,
    exact_levels: Iterable[float],
    highest_ns_per_m: float,
    trim_ohm: float = 0.0,
) -> dict[str, Any]:
    """Return the fields of BoardParams that describe `model`; arguments as for `plant_params`.

    They are the tables, and the values of a rigid mass that firmware and pages show.
    """
    substep_s = 1.0 / (SUBSTEPS_PER_TICK * model.rate_hz)
    return {
        "mass_kg": model.mass_kg,
        "viscous_ns_per_m": model.viscous_ns_per_m,
        "lower_stop_m": model.ends.lower_m if model.ends else -FAR_M,
        "upper_stop_m": model.ends.upper_m if model.ends else FAR_M,
        "torque_constant_n_per_a": model.torque_constant_n_per_a,
        "winding_ohm": model.resistance_ohm,
        "ambient_c": model.temperature_c,
        "plant": plant_params(model, substep_s, [0.0, *exact_levels], highest_ns_per_m, trim_ohm),
    }


def _columns(model: Model) -> tuple[str, ...]:
    inputs = asdict(model.inputs)
    del inputs["width"]
    names = {column: name for name, column in inputs.items() if column is not None}
    names |= {contact.column: f"friction_{contact.body}" for contact in model.contacts}
    return tuple(names[column] for column in range(model.inputs.width))


def _residuals(model: Model, trim_ohm: float) -> tuple[float, ...]:
    if model.winding is None:
        return (model.residual_ohm,)
    winding = model.winding.heating
    low, high = (
        copper_ohm(winding.resistance_ohm, winding.reference_c, end_c) - winding.compensated_ohm
        for end_c in (min(winding.start_c, winding.ambient_c), HOTTEST_C)
    )
    count = TRIMMED_RESIDUALS if trim_ohm else RESIDUALS
    return tuple(float(residual_ohm) for residual_ohm in np.linspace(low - trim_ohm, high, count))
