"""The model in the coordinates of the engine: fewer coefficients for the same motion, exactly.

Two things are done before anything is generated:

    z_i = x_i - x_rotor    for every other position, where nothing is fixed to ground: then no rate
                           depends on x_rotor, its column of the exact map is a unit vector, and
                           differences of positions keep their digits in single precision while the
                           device wanders off
    states that reach nothing that is asked for are left out (the velocity estimate of an undamped
    run)

What remains is judged by structure (which coefficient can be non-zero for any step length), so that
one kernel serves all devices of a kind. The structure of exp(A h) is the transitive closure of that
of A.

Ends of the workspace and springs to ground need the positions themselves; such a device keeps them.
What would break it: a position whose state is not named so (`_position`).
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.plant.model import Array, Contact, Ends, Model, Output, Outputs, RotorForce

Mask = npt.NDArray[np.bool_]

REFERENCE = "rotor_position"
CANCELLED = 1e-12  # relative size of a sum of coefficients that is zero but for rounding


def reduced(model: Model, damped: bool) -> tuple[Model, Array]:
    """`model` in relative positions without the states that do not matter here, and the matrix from
    its states to these.

    `damped`: a damping level other than 0 occurs. A winding that heats up asks for the motor force.
    """
    forward, back, reference = _to_relative(model)

    def rates(a: Array) -> Array:
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
    holders: list[Any] = [model] if model.winding is None else [model, model.winding]
    found = np.zeros(getattr(model, f"{letter}0").shape, dtype=bool)
    for holder in holders:
        found |= getattr(holder, f"{letter}0") != 0.0
        if damped:
            found |= getattr(holder, f"{letter}1") != 0.0
    return found


def _needed(model: Model, damped: bool) -> Mask:
    reach, _ = structure(model, damped)
    outputs = model.outputs
    rows = [outputs.encoder, outputs.recorded_travel]
    rows += [outputs.recorded_impulse] if outputs.recorded_impulse is not None else []
    rows += [outputs.motor_force] if model.winding is not None else []
    asked = np.zeros(len(reach), dtype=bool)
    for row in rows:
        asked |= (row.c0 != 0.0) | (damped & (row.c1 != 0.0))
    parts: list[Contact | Ends | RotorForce] = [*model.contacts, *model.rotor_forces]
    for part in parts if model.ends is None else [*parts, model.ends]:
        asked[[part.position, part.velocity]] = True
    return np.asarray(asked @ reach)


def _to_relative(model: Model) -> tuple[Array, Array, list[int]]:
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
    forward[others, reference], back[others, reference] = -1.0, 1.0
    return forward, back, [reference]


def _free(model: Model, places: Mask) -> bool:
    return all(
        (abs(a @ places) <= CANCELLED * (abs(a) @ places)).all() for a in (model.a0, model.a1)
    )


def _chosen(model: Model, kept: list[int]) -> Model:
    if len(kept) == len(model.states):
        return model
    smaller = _rebuilt(model, lambda a: a[np.ix_(kept, kept)], lambda b: b[kept], lambda c: c[kept])
    place = {old: new for new, old in enumerate(kept)}

    def moved(part: Any) -> Any:
        return (
            None
            if part is None
            else replace(part, position=place[part.position], velocity=place[part.velocity])
        )

    return replace(
        smaller,
        states=tuple(model.states[index] for index in kept),
        contacts=tuple(moved(contact) for contact in model.contacts),
        ends=moved(model.ends),
        rotor_forces=tuple(moved(force) for force in model.rotor_forces),
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
