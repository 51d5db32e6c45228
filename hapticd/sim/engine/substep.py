"""One sub-step of one lane: the exact map, then what is not linear.

    x  state   n  next state   d  what a state that keeps itself gains   b  what inputs add
    q  a body's velocity without its own friction   f  what friction takes from it [m/s]

Friction is solved once, as in `plant.friction`, but without branches and in velocities, f = W times
the force: for one contact f = clamp(v, W Fc), and v - f is left, which is 0 exactly where it
sticks; for two, f1 is first taken from the free solution of both and clamped, which decides its
side because W is a P-matrix, then f0 and f1 follow by clamping once each.

A body that stood at the start of the sub-step and sticks has not moved at all: its position, and no
other, is put back to where it was. Without that it keeps what the held force leaves: rounding, and
nanometres where a spring or a filter changes the force within the sub-step.
"""

from collections.abc import Iterator

from hapticd.sim.engine.rotor_laws import ROTOR_LAWS, Number
from hapticd.sim.engine.rows import Rows, clamped, total
from hapticd.sim.engine.shape import Shape


def step_arguments(shape: Shape) -> list[str]:
    """Of `step`: coefficients, states, and what the inputs add to these."""
    states = range(shape.states)
    coefficients = ["S", "l"] if shape.per_lane else ["C"]
    return [*coefficients, *(f"x{i}" for i in states), *(f"b{i}" for i in states if shape.fed(i))]


def step_results(shape: Shape) -> list[str]:
    """Of `step`: states, the recorded gain, what friction takes, the sum of the rotor forces."""
    forces = [f"f{c}" for c in range(len(shape.contacts))] + ["g"] * (shape.rotor is not None)
    return [
        *(f"x{i}" for i in range(shape.states)),
        *(["d"] * (shape.gaining is not None)),
        *forces,
    ]


def substep(shape: Shape, row: Rows) -> Iterator[str]:
    """The lines of `step`."""
    states = range(shape.states)
    for i in states:
        terms = [f"b{i}"] * shape.fed(i) + [
            f"{row.c(f'A{i}_{c}')} * x{c}" for c in _late_last(shape, i)
        ]
        yield from total(_target(shape, i), terms or ["ZERO"])
    if shape.rotor is not None:
        yield from _pulled(shape, row)
    yield from _friction(shape, row)
    yield from (f"n{i} = x{i} + d{i}" for i in states if shape.keeps[i])
    if shape.stops is not None:
        yield from _stops(*shape.stops, row)
    kept = {f"x{i}": f"n{i}" for i in states}
    if shape.gaining is not None:
        kept["d"] = (
            f"d{shape.gaining}" if shape.stops is None else f"n{shape.gaining} - x{shape.gaining}"
        )
    yield f"return {', '.join(kept.get(name, name) for name in step_results(shape))}"


def _friction(shape: Shape, row: Rows) -> Iterator[str]:
    free = [f"n{velocity}" for velocity, *_ in shape.contacts]
    if len(free) == 2:
        yield f"q1 = {free[0]} * {row.c('W10')} + {free[1]} * {row.c('W11')}"
        yield from clamped("f1", "q1", row.c("LEVEL1"))
        yield f"q0 = {free[0]} + {row.c(f'H1_{shape.contacts[0][0]}')} * f1"
    elif free:
        yield f"q0 = {free[0]}"
    if free:
        yield from clamped("f0", "q0", row.c("LEVEL0"))
    if len(free) == 2:
        yield f"q1 = {free[1]} + {row.c(f'H0_{shape.contacts[1][0]}')} * f0"
        yield from clamped("f1", "q1", row.c("LEVEL1"))
    for i in range(shape.states):
        yield from _rubbed(shape, row, i)
    for c in range(len(free)):
        yield from _held(shape, c)


def _rubbed(shape: Shape, row: Rows, i: int) -> Iterator[str]:
    """What friction does to state `i`."""
    contacts = enumerate(shape.contacts)
    pushes = [(c, velocity == i) for c, (velocity, _, column) in contacts if column[i]]
    target = _target(shape, i)
    slowed = [c for c, own in pushes if own]
    others = [f"{row.c(f'H{c}_{i}')} * f{c}" for c, own in pushes if not own]
    if slowed == [
        len(shape.contacts) - 1
    ]:  # its q has all of the other's push: what is left of it is exact
        yield f"{target} = q{slowed[0]} - f{slowed[0]}"
    elif slowed:
        yield f"{target} = ZERO if f0 == q0 else {' + '.join([target, *others])} - f0"
    elif others:
        yield f"{target} = {' + '.join([target, *others])}"


def _held(shape: Shape, c: int) -> Iterator[str]:
    """Where contact `c` stuck for the whole sub-step its body is where it was; the others are
    where they are.
    """
    velocity, position, _ = shape.contacts[c]
    stuck = f"(f{c} == q{c}) & (x{velocity} == ZERO)"
    if shape.keeps[position]:
        for i in shape.distances:
            yield f"n{i} = n{i} + d{position} if {stuck} else n{i}"
        yield f"d{position} = ZERO if {stuck} else d{position}"
    else:
        gone = f" - d{shape.origin}" if position in shape.distances else ""
        yield f"n{position} = x{position}{gone} if {stuck} else n{position}"


def _pulled(shape: Shape, row: Rows) -> Iterator[str]:
    """The forces on the rotor at the middle of the sub-step, and what their sum does."""
    assert shape.rotor is not None
    position, velocity, column = shape.rotor
    yield f"h = x{position} + x{velocity} * {row.c('REACH')}"
    for place, law in enumerate(shape.rotor_laws):
        yield from ROTOR_LAWS[law].lines(f"g{place}", "h", f"x{velocity}", _numbers(place, row))
    yield f"g = {' + '.join(f'g{place}' for place in range(len(shape.rotor_laws)))}"
    yield from (
        f"{_target(shape, i)} = {_target(shape, i)} + {row.c(f'Z{i}')} * g"
        for i, here in enumerate(column)
        if here
    )


def _numbers(place: int, row: Rows) -> Number:
    return lambda k: row.c(f"PULL{place}_{k}")


def _stops(position: int, velocity: int, row: Rows) -> Iterator[str]:
    for sign, stop in ((">", "STOP_UP"), ("<", "STOP_DOWN")):
        yield (
            f"n{velocity} = ZERO if (n{position} {sign} {row.c(stop)}) & (n{velocity} {sign} ZERO)"
            f" else n{velocity}"
        )
        yield f"n{position} = {row.c(stop)} if n{position} {sign} {row.c(stop)} else n{position}"


def _late_last(shape: Shape, i: int) -> list[int]:
    """States of this sum, those that wait for friction last: a shorter chain from sub-step to
    sub-step.
    """
    rubbed = {velocity for velocity, *_ in shape.contacts}
    return sorted(
        shape.feeds[i], key=lambda state: (state in rubbed) + 2 * (state in shape.distances)
    )


def _target(shape: Shape, i: int) -> str:
    return f"d{i}" if shape.keeps[i] else f"n{i}"
