"""From a model and an environment to the shape of their kernel.

A tick is counted from the moment a command takes effect, because then the command is held for all
of it; the encoder is read the rest of the delay before its end. With a delay of m + p periods (0 <=
p < 1) the sample lies (1 - p) of the tick in, possibly inside a sub-step (`sample_inside`: then an
exact output row leads to it), and the command waits m whole ticks. That is the order of lock-step
and of the hardware, and it needs no split input.
"""

from dataclasses import replace
from math import floor
from typing import Any

import numpy as np

from hapticd.errors import ConfigError
from hapticd.params import EnvironmentParams
from hapticd.plant.model import Array, Model
from hapticd.sim.engine.coordinates import REFERENCE, Mask, distances, keepers, structure
from hapticd.sim.engine.shape import LANES, Shape, Term
from hapticd.units import PROBE_RATE_HZ

SNAP = 1e-9  # of a sub-step: a sample this near to a border of sub-steps is on it
SUBSTEPS_MAX = 64


def shape_of(
    model: Model, environment: EnvironmentParams, damped: bool, substeps: int, dtype: str
) -> Shape:
    """The shape of `model` (as `coordinates.reduced` left it) under that environment, with
    everything it calls for.

    ConfigError for a rate that does not divide 4 kHz, an unknown dtype or a number of sub-steps
    outside 1..64.
    """
    samples = _samples(model.rate_hz)
    if dtype not in LANES:
        raise ConfigError(f"dtype {dtype!r}: the engine computes in {' or '.join(LANES)}")
    if not 1 <= substeps <= SUBSTEPS_MAX:
        raise ConfigError(
            f"{substeps} sub-steps per 4 kHz sample: must be 1..{SUBSTEPS_MAX}; 4 suits 90 s trials"
        )
    if not (model.contacts or model.ends or model.rotor_forces):
        substeps = 1  # nothing is decided within a sample, and the map over it is exact
    states, inputs = structure(model, damped)
    step, part, waits = sample_point(model.delay_periods, samples * substeps)
    keeps = keepers(model, damped)
    outputs = model.outputs
    place = model.inputs
    shape = Shape(
        dtype,
        LANES[dtype],
        samples,
        substeps,
        keeps,
        feeds=tuple(
            tuple(j for j in _where(row) if not (i == j and keeps[i]))
            for i, row in enumerate(states)
        ),
        command=_column(inputs, place.command),
        torque=_column(inputs, place.torque),
        drift=_column(inputs, place.estimate if model.estimate_offset_m_per_s else None),
        contacts=tuple((c.velocity, c.position, _column(inputs, c.column)) for c in model.contacts),
        origin=[state.name for state in model.states].index(REFERENCE),
        distances=distances(model, keeps),
        rotor_laws=(),
        rotor=None,
        stops=None if model.ends is None else (model.ends.position, model.ends.velocity),
        sample_step=step,
        sample_inside=part > 0.0,
        sample=_terms(outputs.encoder.c0, states, keeps) if part else _terms(outputs.encoder.c0),
        travel=_terms(outputs.recorded_travel.c0),
        impulse=None if outputs.recorded_impulse is None else _terms(outputs.recorded_impulse.c0),
        waits=waits,
        encoder_quantum=model.encoder_quantum_m is not None,
        force_quantum=model.force_quantum_n is not None,
        limit=model.force_limit_n is not None,
        wall=environment.wall.side != 0,
        ends=environment.workspace.stiffness_n_per_m != 0.0,
    )
    return _with_rare_effects(shape, model, inputs)


def sample_point(delay_periods: float, steps: int) -> tuple[int, float, int]:
    """Where in its tick the encoder is read, and how long the command waits.

    (sub-step, part of it that has passed or 0 at its start, whole ticks of waiting) for `steps`
    sub-steps in a tick.
    """
    waits = floor(delay_periods + SNAP / steps)
    place = (1.0 - max(0.0, delay_periods - waits)) * steps
    step = floor(place + SNAP)
    return step, place - step if place - step > SNAP else 0.0, waits


def _samples(rate_hz: float) -> int:
    samples = round(PROBE_RATE_HZ / rate_hz)
    if samples < 1 or abs(samples * rate_hz - PROBE_RATE_HZ) > 1e-9 * PROBE_RATE_HZ:
        raise ConfigError(
            f"servo rate {rate_hz:g} Hz: the engine needs {PROBE_RATE_HZ} Hz to be a whole multiple"
            " of it"
        )
    return samples


def _with_rare_effects(shape: Shape, model: Model, inputs: Mask) -> Shape:
    place = model.inputs
    for force in model.rotor_forces:
        rotor = (force.position, force.velocity, _column(inputs, place.rotor_force))
        shape = replace(shape, rotor_laws=(*shape.rotor_laws, force.law), rotor=rotor)
    noisy = _column(
        inputs, place.estimate if model.noise is not None and model.noise.estimate_psd else None
    )
    if any(noisy):
        shape = replace(shape, noise=noisy)
    if model.winding is not None:
        motor = model.outputs.motor_force
        direct = bool((abs(motor.d0) + abs(motor.d1))[place.command])
        shape = replace(shape, heat=(_plain(abs(motor.c0) + abs(motor.c1)), direct))
    return shape


def _where(row: Any) -> tuple[int, ...]:
    return tuple(int(index) for index in np.flatnonzero(row))


def _plain(row: Array) -> tuple[Term, ...]:
    return tuple(Term(index, False) for index in _where(row))


def _column(inputs: Mask, column: int | None) -> tuple[bool, ...]:
    return tuple(column is not None and bool(value) for value in inputs[:, column or 0])


def _terms(
    row: Array, states: Mask | None = None, keeps: tuple[bool, ...] = ()
) -> tuple[Term, ...]:
    """Terms of `row`, or of `row` after some time inside a sub-step."""
    if states is None:
        return tuple(Term(index, bool(row[index] == 1.0)) for index in _where(row))
    reached = (row != 0.0) @ states
    return tuple(Term(index, bool(keeps[index] and row[index] == 1.0)) for index in _where(reached))
