"""The shape of a kernel: all about a scene that decides its instructions.

Two scenes with the same shape share a kernel; their numbers are its arguments. An effect that is
absent leaves no trace here, so it costs nothing. Before a shape is read off a model (`shape_of`),
the model is brought to fewer coefficients for the same motion, exactly (`reduced`):

    z_i = x_i - x_rotor    for every other position, where nothing is fixed to ground: then no rate
                           depends on x_rotor, its column of the exact map is a unit vector, and
                           differences of positions keep their digits in single precision while the
                           device wanders off

    states that reach nothing that is asked for are left out (the velocity estimate of an undamped
    run)

What remains is judged by structure (which coefficient can be non-zero for any step length), so that
one kernel serves all devices of a kind. The structure of exp(A h) is the transitive closure of that
of A. Ends of the workspace and springs to ground need the positions themselves; such a device keeps
them.

A tick is counted from the moment a command takes effect, because then the command is held for all
of it; the encoder is read the rest of the delay before its end. With a delay of m + p periods (0 <=
p < 1) the sample lies (1 - p) of the tick in, possibly inside a sub-step (`sample_inside`: then an
exact output row leads to it), and the command waits m whole ticks. That is the order of lock-step
and of the hardware, and it needs no split input.

The state of a position must have a name that `_is_position` accepts.
"""

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from math import floor
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment
from hapticd.core.errors import ConfigError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.model import Model, Output, Outputs

__all__ = ["LANES"]

LANES = {"f32": 64, "f64": 32}  # trials side by side in a kernel: four cache lines of each row
# where records are kept: often of a few trials, for which most of a wide group would be empty
LANES_OF_RECORDS = {"f32": 16, "f64": 8}


@dataclass(frozen=True, slots=True)
class Term:
    """A state in a sum, with a coefficient of its own or with exactly 1."""

    state: int
    one: bool


class PushedBody(NamedTuple):
    """A body that a force acts on: its states, and which states the force reaches."""

    position: int
    velocity: int
    column: tuple[bool, ...]


class PartShape(NamedTuple):
    """A part of the law: its kind, and of how many values it and its memory consist."""

    kind: str
    numbers: int
    memory: int


class DriveStates(NamedTuple):
    """The states that limits of the amplifier look at, and which states these reach."""

    motor_force: int
    velocity: int
    column: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class Shape:
    """See the module. Tuples over states unless said otherwise."""

    dtype: str  # "f32" | "f64"
    lanes: int  # trials side by side
    samples: int  # 4 kHz samples in a tick
    substeps: int  # in a sample
    keeps: tuple[bool, ...]  # this state's own coefficient is 1 and no other state depends on it
    feeds: tuple[tuple[int, ...], ...]  # states with a coefficient in this state's sum
    command: tuple[bool, ...]  # the held command moves this state
    torque: tuple[bool, ...]  # the perturbation moves this state
    drift: tuple[bool, ...]  # a constant is added at every sub-step
    contacts: tuple[PushedBody, ...]  # with dry friction
    origin: int  # position state of the rotor
    distances: tuple[int, ...]  # position states that count from the rotor's, see the module
    rotor_laws: tuple[str, ...]  # forces on the rotor that are not linear
    rotor: PushedBody | None  # where there are such forces
    stops: tuple[int, int] | None  # position and velocity that the ends of the workspace hold
    sample_step: int  # sub-step at whose start, or in which, the encoder is read
    sample_inside: bool  # the encoder is read inside that sub-step
    sample: tuple[Term, ...]  # what the encoder reads
    travel: tuple[Term, ...]  # the integral of the recorded velocity
    impulse: tuple[Term, ...] | None  # the integral of the recorded torque, if it is filtered
    waits: int  # whole ticks that a command waits
    encoder_quantum: bool = False  # the encoder counts
    force_quantum: bool = False  # the command is rounded to counts
    limit: bool = False  # of the command
    wall: bool = False  # the law's wall
    ends: bool = False  # the law's soft ends
    parts: tuple[PartShape, ...] = ()  # of the law, beside K, B and M
    # where windings heat up: the motor force, and whether the command is in it
    heat: tuple[tuple[Term, ...], bool] | None = None
    drive: DriveStates | None = None  # where the amplifier has limits
    noise: tuple[bool, ...] | None = None  # the column of the velocity estimate's noise
    renders: bool = True  # the law is needed
    own_torque: bool = False  # a record for every trial
    ticks: bool = False  # keep position and force of every tick

    @property
    def per_lane(self) -> bool:
        """Whether coefficients differ between trials: where windings heat up."""
        return self.heat is not None

    @property
    def states(self) -> int:
        """How many."""
        return len(self.keeps)

    def fed(self, state: int) -> bool:
        """Whether an input moves this state within a sub-step."""
        columns = (self.command, self.torque, self.drift, self.noise)
        return any(column[state] for column in columns if column is not None)

    @property
    def gaining(self) -> int | None:
        """The state that is the recorded travel itself and only gains: its gains are the
        record, without a difference.
        """
        first = self.travel[0]
        alone = len(self.travel) == 1 and first.one and self.keeps[first.state]
        return first.state if alone else None

    @property
    def steps(self) -> int:
        """Sub-steps in a tick."""
        return self.samples * self.substeps

    @property
    def width(self) -> int:
        """Values that a tick leaves for each lane: velocities, torques if filtered, force,
        position if kept.
        """
        return self.samples * (1 if self.impulse is None else 2) + (2 if self.ticks else 1)


# --- coordinates ----------------------------------------------------------------------------------

Mask = npt.NDArray[np.bool_]

REFERENCE = "rotor_position"
REDUCED = 4  # cached models: trials of one device share theirs, and with it their coefficients
CANCELLED = 1e-12  # relative size of a sum of coefficients that is zero but for rounding


@lru_cache(maxsize=REDUCED)
def reduced(model: Model, damped: bool) -> tuple[Model, Floats]:
    """`model` in relative positions without the states that do not matter here, and the matrix from
    its states to these.

    `damped`: active damping other than 0 occurs. A winding that heats up asks for the motor force.
    """
    forward, back, reference = _to_relative(model)

    def rates(a: Floats) -> Floats:
        moved = forward @ a @ back
        moved[:, reference] = 0.0  # what rounding left of coefficients that cancel
        return moved

    relative = _rebuilt(model, rates, lambda b: forward @ b, lambda c: c @ back)
    kept = [int(index) for index in np.flatnonzero(_needed(relative, damped))]
    return _chosen(relative, kept), forward[kept]


def structure(model: Model, damped: bool) -> tuple[Mask, Mask]:
    """Which entries of the exact map can differ from 0: (n, n) and (n, m)."""
    a = _entries(model, "a", damped)
    b = _entries(model, "b", damped)
    reach = np.eye(len(a), dtype=bool) | a
    for _ in range(len(a).bit_length()):
        reach = reach @ reach
    return reach, reach @ b


def keepers(model: Model, damped: bool) -> tuple[bool, ...]:
    """Which states drive nothing, themselves included: their column of the exact map is a unit
    vector.
    """
    entries = _entries(model, "a", damped)
    return tuple(not entries[:, column].any() for column in range(len(entries)))


def distances(model: Model, keeps: tuple[bool, ...]) -> tuple[int, ...]:
    """Position states of a `reduced` model that count from the rotor's: all others where
    nothing depends on that one.
    """
    names = [state.name for state in model.states]
    if not keeps[names.index(REFERENCE)]:
        return ()
    return tuple(
        index for index, name in enumerate(names) if _is_position(name) and name != REFERENCE
    )


def _is_position(name: str) -> bool:
    return name.endswith("_position")


def _entries(model: Model, letter: str, damped: bool) -> Mask:
    holders = [model, *([] if model.winding is None else [model.winding])]
    names = [f"{letter}0", f"{letter}1"] if damped else [f"{letter}0"]
    arrays = [getattr(holder, name) for holder in holders for name in names]
    return np.asarray(np.any(np.stack(arrays) != 0.0, axis=0))


def _needed(model: Model, damped: bool) -> Mask:
    reach, _ = structure(model, damped)
    outputs = model.outputs
    heated = outputs.motor_force if model.winding is not None else None
    asked = np.zeros(len(reach), dtype=bool)
    for row in (outputs.encoder, outputs.recorded_travel, outputs.recorded_impulse, heated):
        if row is not None:
            asked |= (row.c0 != 0.0) | (damped & (row.c1 != 0.0))
    for part in (*model.contacts, *model.rotor_forces, model.ends):
        if part is not None:
            asked[[part.position, part.velocity]] = True
    if model.drive is not None:
        asked[[model.drive.motor_force, model.drive.velocity]] = True
    return np.asarray(asked @ reach)


def _to_relative(model: Model) -> tuple[Floats, Floats, list[int]]:
    """Matrices to relative positions and back, and the reference; identities where something is
    fixed to ground.
    """
    names = [state.name for state in model.states]
    forward = np.eye(len(names))
    back = np.eye(len(names))
    places = np.array([_is_position(name) for name in names])
    if model.ends is not None or not _free(model, places):
        return forward, back, []
    reference = names.index(REFERENCE)
    others = places & (np.arange(len(names)) != reference)
    forward[others, reference] = -1.0
    back[others, reference] = 1.0
    return forward, back, [reference]


def _free(model: Model, places: Mask) -> bool:
    """Whether moving all bodies together changes no rate: nothing is fixed to ground."""
    return all(
        (abs(a @ places) <= CANCELLED * (abs(a) @ places)).all() for a in (model.a0, model.a1)
    )


def _chosen(model: Model, kept: list[int]) -> Model:
    if len(kept) == len(model.states):
        return model
    smaller = _rebuilt(model, lambda a: a[np.ix_(kept, kept)], lambda b: b[kept], lambda c: c[kept])
    place = {old: new for new, old in enumerate(kept)}

    def moved(part: Any, first: str = "position") -> Any:
        if part is None:
            return None
        here = {name: place[getattr(part, name)] for name in (first, "velocity")}
        return replace(part, **here)

    return replace(
        smaller,
        states=tuple(model.states[index] for index in kept),
        contacts=tuple(moved(contact) for contact in model.contacts),
        ends=moved(model.ends),
        rotor_forces=tuple(moved(force) for force in model.rotor_forces),
        drive=moved(model.drive, "motor_force"),
    )


def _rebuilt(model: Model, a: Any, b: Any, c: Any) -> Model:
    """`model` with its arrays mapped: `a` on (n, n), `b` on (n, m), `c` on rows (n,)."""

    def output(row: Output | None) -> Any:
        return None if row is None else replace(row, c0=c(row.c0), c1=c(row.c1))

    def arrays(holder: Any) -> dict[str, Any]:
        return {"a0": a(holder.a0), "a1": a(holder.a1), "b0": b(holder.b0), "b1": b(holder.b1)}

    seen = {item.name: output(getattr(model.outputs, item.name)) for item in fields(Outputs)}
    winding = None if model.winding is None else replace(model.winding, **arrays(model.winding))
    return replace(model, **arrays(model), outputs=Outputs(**seen), winding=winding)


# --- from a model to a shape ----------------------------------------------------------------------

SNAP = 1e-9  # of a sub-step: a sample this near to a border of sub-steps is on it
SUBSTEPS_MAX = 64


def shape_of(
    model: Model, environment: Environment, damped: bool, substeps: int, dtype: str
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
    if not (model.contacts or model.ends or model.rotor_forces or model.drive):
        substeps = 1  # nothing is decided within a sample, and the map over it is exact
    states, inputs = structure(model, damped)
    step, part, waits = sample_point(model.delay_periods, samples * substeps)
    keeps = keepers(model, damped)
    outputs = model.outputs
    place = model.inputs
    drive = model.drive
    noisy = model.noise is not None and model.noise.estimate_psd
    noise = _column(inputs, place.estimate if noisy else None)
    return Shape(
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
        contacts=tuple(
            PushedBody(c.position, c.velocity, _column(inputs, c.column)) for c in model.contacts
        ),
        origin=[state.name for state in model.states].index(REFERENCE),
        distances=distances(model, keeps),
        rotor_laws=tuple(force.law for force in model.rotor_forces),
        rotor=next(
            (
                PushedBody(force.position, force.velocity, _column(inputs, place.rotor_force))
                for force in model.rotor_forces
            ),
            None,
        ),
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
        heat=None if model.winding is None else _heat(model),
        drive=None
        if drive is None
        else DriveStates(drive.motor_force, drive.velocity, _column(inputs, place.amplifier)),
        noise=noise if any(noise) else None,
    )


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


def _heat(model: Model) -> tuple[tuple[Term, ...], bool]:
    """The motor force, and whether the command is in it."""
    motor = model.outputs.motor_force
    terms = tuple(Term(index, False) for index in _where(abs(motor.c0) + abs(motor.c1)))
    return terms, bool((abs(motor.d0) + abs(motor.d1))[model.inputs.command])


def _where(row: Any) -> tuple[int, ...]:
    return tuple(int(index) for index in np.flatnonzero(row))


def _column(inputs: Mask, column: int | None) -> tuple[bool, ...]:
    return tuple(column is not None and bool(value) for value in inputs[:, column or 0])


def _terms(
    row: Floats, states: Mask | None = None, keeps: tuple[bool, ...] = ()
) -> tuple[Term, ...]:
    """Terms of `row`, or of `row` after some time inside a sub-step."""
    if states is None:
        return tuple(Term(index, bool(row[index] == 1.0)) for index in _where(row))
    reached = (row != 0.0) @ states
    return tuple(Term(index, bool(keeps[index] and row[index] == 1.0)) for index in _where(reached))
