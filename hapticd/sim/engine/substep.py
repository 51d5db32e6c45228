"""One sub-step of one lane: the exact map, then what is not linear.

    x  state   n  next state   d  what a state that keeps itself gains   b  what inputs add   q  free friction   f  friction

Friction is solved once, as in `plant.friction` but without branches: for one contact clamp(-v / W);
for two, f1 is first taken from the free solution of both and clamped, which decides its side
because W is a P-matrix, then f0 and f1 follow by clamping once each. A contact that sticks gets v =
0, not v + W f.
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
    """Of `step`: states, the recorded gain, friction forces, the sum of the rotor forces."""
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
    free = [f"n{velocity}" for velocity, _ in shape.contacts]
    if len(free) == 2:
        yield f"q1 = {free[0]} * {row.c('W10')} + {free[1]} * {row.c('W11')}"
        yield from clamped("f1", "q1", row.c("LEVEL1"))
        yield f"q0 = ({free[0]} + {row.c(f'H1_{shape.contacts[0][0]}')} * f1) * {row.c('W0')}"
    elif free:
        yield f"q0 = {free[0]} * {row.c('W0')}"
    if free:
        yield from clamped("f0", "q0", row.c("LEVEL0"))
    if len(free) == 2:
        yield f"q1 = ({free[1]} + {row.c(f'H0_{shape.contacts[1][0]}')} * f0) * {row.c('W1')}"
        yield from clamped("f1", "q1", row.c("LEVEL1"))
    for i in range(shape.states):
        yield from _rubbed(shape, row, i)


def _rubbed(shape: Shape, row: Rows, i: int) -> Iterator[str]:
    """What friction does to state `i`."""
    pushes = [
        f"{row.c(f'H{c}_{i}')} * f{c}" for c, (_, column) in enumerate(shape.contacts) if column[i]
    ]
    if pushes:
        target = _target(shape, i)
        slid = " + ".join([target, *pushes])
        stuck = [f"f{c} == q{c}" for c, (velocity, _) in enumerate(shape.contacts) if velocity == i]
        yield f"{target} = ZERO if {stuck[0]} else {slid}" if stuck else f"{target} = {slid}"


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
    rubbed = {velocity for velocity, _ in shape.contacts}
    return sorted(shape.feeds[i], key=lambda state: state in rubbed)


def _target(shape: Shape, i: int) -> str:
    return f"d{i}" if shape.keeps[i] else f"n{i}"
