"""One control period of one lane as straight-line code.

    x  state   b  what the inputs add   t  perturbation   e  noise of the estimate
    u  held command   y  encoder sample   c  new command
    w, v  recorded travel and velocity   p  recorded torque

Rows and coefficients are upper case; `group` fills them. The law stands after the last sub-step:
nothing in the tick waits for it.
"""

from collections.abc import Iterator
from itertools import pairwise

from hapticd.sim.engine.rows import Rows, term, total, weighted
from hapticd.sim.engine.shape import Shape
from hapticd.sim.engine.substep import step_arguments, step_results

LAW_STATE = tuple(f"L{i}" for i in range(6))
FILTERS = tuple(f"FILTER{i}" for i in range(10))
WALL = ("WALL_K", "WALL_B", "WALL_X", "WALL_SIDE")
ENDS = ("LOWER", "UPPER", "END_K")


def tick(shape: Shape, row: Rows) -> Iterator[str]:
    """The lines of the lane loop."""
    states = range(shape.states)
    yield from (f"x{i} = {row(f'X{i}')}" for i in states)
    yield f"u = {row('U')}"
    if shape.own_torque:
        yield from (f"t{j} = {row(f'TT{j}')}" for j in range(shape.samples))
    for j in range(shape.samples):
        yield from _sample(shape, row, j)
    if shape.renders and shape.sample_step == shape.steps:
        yield f"y = {weighted(shape.sample, 'R', row)}"
    yield from (f"{row(f'X{i}')} = x{i}" for i in states)
    if shape.renders:
        yield from _command(shape, row)
    yield from _tally(shape, row)


def _sample(shape: Shape, row: Rows, j: int) -> Iterator[str]:
    """One 4 kHz interval: its sub-steps, then what the record gets."""
    for i in range(shape.states):
        same = term(shape.torque[i], f"T{i}", f" * t{j}", row) + term(
            shape.drift[i], f"D{i}", "", row
        )
        same += term(shape.noise is not None and shape.noise[i], f"E{i}", f" * e{j}", row)
        yield from total(f"b{i}", [*same, *term(shape.command[i], f"G{i}", " * u", row)])
    yield (
        "w = ZERO" if shape.gaining is not None else f"w = {weighted(shape.travel, 'TRAVEL', row)}"
    )
    if shape.impulse is not None:
        yield f"p = {weighted(shape.impulse, 'IMPULSE', row)}"
    for k in range(j * shape.substeps, (j + 1) * shape.substeps):
        yield from _substep(shape, row, j, k)
    yield from _record(shape, row, j)


def _substep(shape: Shape, row: Rows, j: int, k: int) -> Iterator[str]:
    sampled = shape.renders and k == shape.sample_step
    if sampled:
        yield f"y = {weighted(shape.sample, 'R', row)}"
    yield f"{', '.join(step_results(shape))} = step({', '.join(step_arguments(shape))})"
    if sampled and shape.sample_inside:
        yield f"y = y + {_inside(shape, row, j)}"
    if shape.gaining is not None:
        yield "w = w + d"


def _inside(shape: Shape, row: Rows, j: int) -> str:
    """What inputs held through this sub-step add to the encoder somewhere inside it: exact."""
    terms = [f"{row.c('RU')} * u", f"{row.c('RT')} * t{j}"]
    terms += term(any(shape.drift), "RD", "", row) + term(
        shape.noise is not None, "RE", f" * e{j}", row
    )
    terms += term(shape.rotor is not None, "RZ", " * g", row)
    return " + ".join(terms + [f"{row.c(f'RH{c}')} * f{c}" for c in range(len(shape.contacts))])


def _record(shape: Shape, row: Rows, j: int) -> Iterator[str]:
    if shape.gaining is None:
        yield f"w = {weighted(shape.travel, 'TRAVEL', row)} - w"
    yield f"v{j} = w * RATE"
    yield f"{row(f'O{j}')} = v{j}"
    if shape.impulse is not None:
        yield f"p{j} = t{j} + ({weighted(shape.impulse, 'IMPULSE', row)} - p) * RATE"
        yield f"{row(f'O{shape.samples + 1 + j}')} = p{j}"
    if shape.heat is not None:
        terms, direct = shape.heat
        force = [weighted(terms, "MOTOR", row), *term(direct, "MOTOR_U", " * u", row)]
        yield f"m = {' + '.join(force)}"
        yield f"{row('HEAT')} = {row('HEAT')} + m * m"


def _command(shape: Shape, row: Rows) -> Iterator[str]:
    """Encoder, law, DAC, and the queue of a delay of whole periods."""
    if shape.encoder_quantum:
        yield f"y = np.floor(y * {row.c('COUNTS')} + HALF) * {row.c('COUNT')}"
    limit = row.c("LIMIT") if shape.limit else "INF"
    wall = [row.c(name) if shape.wall else "ZERO" for name in WALL]
    ends = [row.c(name) for name in ENDS] if shape.ends else ["-INF", "INF", "ZERO"]
    environment = ", ".join([row("K"), row("B"), row("M"), "ZERO", limit, *wall, *ends])
    state = ", ".join(row(name) for name in LAW_STATE)
    filters = ", ".join(row.c(name) for name in FILTERS)
    yield f"c, _, _, _, _, _, _, _, state = law(y, ({state}), ({environment}), ({filters}))"
    yield from (f"{row(name)} = state[{i}]" for i, name in enumerate(LAW_STATE))
    if shape.force_quantum:
        yield f"c = np.floor(c * {row.c('FORCE_COUNTS')} + HALF) * {row.c('FORCE_COUNT')}"
    queue = ["U", *(f"WAIT{i}" for i in range(shape.waits))]
    yield from (f"{row(earlier)} = {row(later)}" for earlier, later in pairwise(queue))
    yield f"{row(queue[-1])} = c"
    yield f"{row(f'O{shape.samples}')} = c"
    if shape.ticks:
        yield f"{row(f'O{shape.width - 1}')} = y"


def _tally(shape: Shape, row: Rows) -> Iterator[str]:
    """Sums up to the tick in which the motion is too fast or no number: squared velocity, work,
    its lowest, largest command.
    """
    samples = range(shape.samples)
    torque = "t" if shape.impulse is None else "p"
    yield f"s2 = {' + '.join(f'v{j} * v{j}' for j in samples)}"
    yield f"e = {' + '.join(f'v{j} * {torque}{j}' for j in samples)}"
    yield f"a = {row('ALIVE')} if s2 < TOO_FAST else ZERO"
    yield "s2, e = s2 if a > ZERO else ZERO, e if a > ZERO else ZERO"
    yield "c = c if c > ZERO else -c" if shape.renders else "c = ZERO"
    yield "c = c if a > ZERO else ZERO"
    yield f"work, low, most = {row('WORK')} + e, {row('LOWEST')}, {row('FORCE')}"
    yield f"{row('ALIVE')} = a"
    yield f"{row('TICKS')} = {row('TICKS')} + a"
    yield f"{row('SPEED2')} = {row('SPEED2')} + s2"
    yield f"{row('WORK')} = work"
    yield f"{row('LOWEST')} = work if work < low else low"
    yield f"{row('FORCE')} = c if c > most else most"
