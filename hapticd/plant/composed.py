"""The composed device of a simulated board: its tables loaded, and its step written as straight-line
Python with nothing in it that the device does not have. Standard library alone.

    map        n rows of [Phi Gamma] for one sub-step, inputs held; exact at a node of the table
               (damping level, residual resistance), interpolated linearly between nodes
    sub-step   every state's new value in one expression; friction as a clamp on the velocity row
               (as `friction.stick_one`)
    leap       four or two sub-steps at once where nothing has to be decided in between: no
               friction, force that is not linear or heating, and no end of the workspace met

What is 0 at every node is left out of the rows. Of a device that floats freely only the difference
of its two positions appears (`stretch`). The forces on the rotor, perturbation, what is not linear
and its friction, have equal columns: they are added before they are multiplied (`push`).

Coefficients are cells of the closure, loaded when the damping level changes, with names made of the
letter of their block (`blocks`) and a number; between nodes there are no leaps. Everything that a
node needs is computed when the board is made, so a live change of damping costs one lookup, a level
between nodes one interpolation. A winding that heats up has its temperature as the last value of
the state. Views are the outputs as generated functions. Generated source stays in `linecache`, so
that a traceback shows it.

What would break it: friction on more than two bodies, or coefficients loaded in another order than
`RowTerms.flat`.
"""

import itertools
import linecache
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from math import sin, sqrt, tau
from random import Random
from typing import Any

from hapticd.errors import ConfigError
from hapticd.params import BoardParams, Contact, Ends, HeatingParams, Noise, OutputParams, PlantParams, RotorForce
from hapticd.plant.friction import stick_two
from hapticd.units import COPPER_PER_K

Row = tuple[float, ...]
Map = tuple[Row, ...]
Blocks = dict[str, Map]  # rows by the letter that names their coefficients in the source


def followed(first: Map, then: Map) -> Map:
    """`then` after `first`, with the same inputs."""
    n, width = len(first), len(first[0])
    return tuple(
        tuple(sum(row[k] * first[k][j] for k in range(n)) + (row[j] if j >= n else 0.0) for j in range(width)) for row in then
    )


def blocks(params: PlantParams, one: Map) -> Blocks:
    """The rows of a node: a over one sub-step; b and d over 2 and 4, if nothing has to be decided in between."""
    if params.contacts or params.rotor_forces or params.heating:
        return {"a": one}
    two = followed(one, one)
    return {"a": one, "b": two, "d": followed(two, two)}


class Lookup:
    """Maps of a device by damping level and residual resistance."""

    def __init__(self, params: PlantParams) -> None:
        self.levels, self.residuals = params.levels_ns_per_m, params.residuals_ohm
        n, width = len(params.states), len(params.states) + len(params.columns)
        self.nodes: list[Map] = [tuple(flat[i * width : (i + 1) * width] for i in range(n)) for flat in params.maps]

    def node(self, level: float, residual: float) -> int | None:
        """Number of the node that stands exactly there; None if there is none."""
        if level in self.levels and residual in self.residuals:
            return self.residuals.index(residual) * len(self.levels) + self.levels.index(level)
        return None

    def between(self, level: float, residual: float) -> Map:
        """The map there, linear between nodes on either axis; the outermost nodes are extended."""
        place, part = _bracket(self.levels, level)
        storey, height = _bracket(self.residuals, residual)
        lower = self._mixed(storey * len(self.levels) + place, part)
        return _blend(lower, self._mixed((storey + 1) * len(self.levels) + place, part), height) if height else lower

    def _mixed(self, index: int, part: float) -> Map:
        return _blend(self.nodes[index], self.nodes[index + 1], part) if part else self.nodes[index]


def _bracket(nodes: Sequence[float], value: float) -> tuple[int, float]:
    """(index of the node below, fraction of the way to the next)."""
    if len(nodes) == 1:
        return 0, 0.0
    low = min(max(bisect_right(nodes, value) - 1, 0), len(nodes) - 2)
    return low, (value - nodes[low]) / (nodes[low + 1] - nodes[low])


def _blend(a: Map, b: Map, part: float) -> Map:
    return tuple(tuple(x + part * (y - x) for x, y in zip(p, q, strict=True)) for p, q in zip(a, b, strict=True))


Term = tuple[str, int, float]  # variable, column of the map, sign
ON_ROTOR = ("torque", "rotor_force", "friction_rotor")
SIGNALS = {"command": "force_n", "torque": "push", "estimate": "error", "friction_slider": "rub"}


class RowTerms:
    """Which products the rows of a device's maps need, over all of its nodes."""

    def __init__(self, params: PlantParams, nodes: list[Blocks]) -> None:
        self.params, self.n = params, len(params.states)
        self.positions = [i for i, name in enumerate(params.states) if name.endswith("_position")] if params.floating else []
        self.terms = {
            letter: [self._needed(i, [node[letter][i] for node in nodes]) for i in range(len(rows))]
            for letter, rows in nodes[0].items()
        }

    def flat(self, letter: str, rows: Map) -> Row:
        """Coefficients of the block `letter` in the order of its names."""
        return tuple(sign * row[j] for row, terms in zip(rows, self.terms[letter], strict=True) for _, j, sign in terms)

    def names(self, letter: str) -> list[str]:
        """Of the cells of the block `letter`."""
        return [f"{letter}{k}" for k in range(sum(map(len, self.terms[letter])))]

    def row(self, letter: str, i: int, **renamed: str) -> str:
        """The expression of row i of the block; variables may be renamed, to "" to leave them out."""
        first = sum(map(len, self.terms[letter][:i]))
        products = [(f"{letter}{first + k}", renamed.get(term[0], term[0])) for k, term in enumerate(self.terms[letter][i])]
        base = [f"x{i}"] if i in self.positions else []
        return " + ".join(base + [f"{cell} * {variable}" for cell, variable in products if variable]) or "0.0"

    def cell(self, letter: str, i: int, column: str) -> str:
        """The cell that holds the coefficient of the input `column` in row i."""
        j = self.n + self.params.columns.index("torque" if column in ON_ROTOR else column)
        first = sum(map(len, self.terms[letter][:i]))
        return f"{letter}{first + [term[1] for term in self.terms[letter][i]].index(j)}"

    def _needed(self, i: int, samples: list[Row]) -> list[Term]:
        return [term for term in self._candidates(i) if any(row[term[1]] for row in samples)]

    def _candidates(self, own: int) -> Iterable[Term]:
        for j in range(self.n):
            if j not in self.positions:
                yield f"x{j}", j, 1.0
        if len(self.positions) == 2:
            first, second = self.positions
            yield "stretch", (second if own == first else first), (-1.0 if own == first else 1.0)
        for column, name in enumerate(self.params.columns):
            if name in SIGNALS:
                yield SIGNALS[name], self.n + column, 1.0


State = tuple[float, ...]
View = Callable[[State, float, float], float]

_serial = itertools.count(1)


def viewer(shape: RowTerms, name: str) -> View:
    """`view(state, force_n, damping_ns_per_m)` of the output `name`."""
    state = ", ".join(f"x{i}" for i in range(shape.n)) + (", _" if shape.params.heating else "")
    source = f"def view(state, force_n, level):\n    {state}, = state\n    return {output_text(shape, name)}\n"
    picked = picked_state(getattr(shape.params, name))
    if picked is not None:
        source = f"def view(state, force_n, level):\n    return state[{picked}]\n"
    view: View = compiled(source, f"plant {name}")["view"]
    return view


def picked_state(output: OutputParams) -> int | None:
    """Index of the state that the output is, if it is nothing but one."""
    places = [i for i, c in enumerate(output.c0) if c]
    plain = not any(output.c1) and not any(output.d0) and not any(output.d1)
    return places[0] if plain and len(places) == 1 and output.c0[places[0]] == 1.0 else None


def output_text(shape: RowTerms, name: str, level: str = "level") -> str:
    """The output `name` of `shape.params` as an expression in x0.., force_n and `level`."""
    output, parts = getattr(shape.params, name), []
    for c0, c1, variable in zip(output.c0, output.c1, (f"x{i}" for i in range(shape.n)), strict=True):
        parts += _scaled(c0, c1, variable, level)
    inputs = {"command": "force_n", "estimate": repr(shape.params.estimate_offset_m_per_s)}
    for d0, d1, column in zip(output.d0, output.d1, shape.params.columns, strict=True):
        parts += _scaled(d0, d1, inputs.get(column, "0.0"), level)
    return " + ".join(parts) or "0.0"


def _scaled(c0: float, c1: float, variable: str, level: str) -> list[str]:
    found = [] if not c0 else [variable if c0 == 1.0 else f"{c0!r} * {variable}"]
    return found + ([f"{c1!r} * {level} * {variable}"] if c1 else [])


def compiled(source: str, title: str) -> dict[str, Any]:
    """The names that `source` defines; `title` is what tracebacks call it."""
    name = f"<{title} {next(_serial)}>"
    linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
    namespace: dict[str, Any] = {}
    exec(compile(source, name, "exec"), namespace)
    return namespace


TOLERANCE_OHM = 1e-4  # drift of the winding before its maps are loaded anew: 0.02 K of 1.6 ohm
LEAPS = {4: "d", 2: "b"}  # sub-steps of a leap, and its block of coefficients


def composed_source(shape: RowTerms, substep_s: float, torque_constant_n_per_a: float) -> str:
    """Text of `bind(coefficients, gauss, sin, stick_two)`, which returns `step` as `plant.step.make_step` describes it."""
    params, leaps = shape.params, _leaps(shape)
    letters = list(shape.terms)
    cells = [name for letter in letters for name in shape.names(letter)]
    state = ", ".join([f"x{i}" for i in range(shape.n)] + (["celsius"] if params.heating else []))
    heat, drifted = params.heating, f" or not -{TOLERANCE_OHM!r} < ohm - residual < {TOLERANCE_OHM!r}"
    lines = [
        "def bind(coefficients, gauss, sin, stick_two):",
        f"    {' = '.join(cells)} = 0.0",
        "    level = residual = None",
        *(["    leaping = False"] if leaps else []),
        "",
        "    def load():",
        f"        nonlocal {'leaping, ' if leaps else ''}{', '.join(cells)}",
        "        rows = coefficients(level, residual)",
        f"        ({', '.join(shape.names('a'))},) = rows['a']",
        *(["        leaping = len(rows) > 1", "        if leaping:"] if leaps else []),
        *(f"            ({', '.join(shape.names(letter))},) = rows['{letter}']" for letter in letters[1:]),
        "",
        "    def step(state, force_n, torque_n, damping_ns_per_m, n_substeps):",
        "        nonlocal level, residual",
        f"        {state} = state",
        *(_ohms(heat) if heat else []),
        f"        if damping_ns_per_m != level{drifted if heat else ''}:",
        f"            level, residual = damping_ns_per_m, {'ohm' if heat else repr(params.residuals_ohm[0])}",
        "            load()",
        *(_error(params.noise, params.estimate_offset_m_per_s, substep_s) if "estimate" in params.columns else []),
        *(_leaping(leaps) if leaps else ["        for _ in range(n_substeps):"]),
        *(f"{' ' * (16 if leaps else 12)}{line}" for line in _substep(shape, substep_s)),
        *(_warmed(shape, heat, substep_s, torque_constant_n_per_a) if heat else []),
        f"        return {state}",
        "",
        "    return step",
    ]
    return "\n".join(lines) + "\n"


def _leaping(leaps: list[str]) -> list[str]:
    """The loop over pieces: leap while that is possible, else take `count` sub-steps one by one."""
    return [
        "        left = n_substeps",
        "        while left:",
        *leaps,
        "            else:",
        "                count = left",
        "            left -= count",
        "            for _ in range(count):",
    ]


def _leaps(shape: RowTerms) -> list[str]:
    """An `if` over the pieces that can be leapt, each left by `continue` or with `count` sub-steps to take one by one."""
    lines: list[str] = []
    for count, letter in LEAPS.items() if len(shape.terms) > 1 else ():
        lines += [
            f"            {'elif' if lines else 'if'} leaping and left >= {count}:",
            *(f"                {line}" for line in _leap(shape, count, letter)),
            f"                count = {count}",
        ]
    return lines


def _leap(shape: RowTerms, count: int, letter: str) -> list[str]:
    rows, ends = [shape.row(letter, i, push="torque_n") for i in range(shape.n)], shape.params.ends
    stretch = [_stretch(shape)] if len(shape.positions) == 2 else []
    if ends is None:
        return [*stretch, *_assigned(shape, rows), f"left -= {count}", "continue"]
    check = f"if {ends.lower_m!r} <= (end := {rows[ends.position]}) <= {ends.upper_m!r}:"
    rows[ends.position] = "end"
    return [*stretch, check, *(f"    {line}" for line in [*_assigned(shape, rows), f"left -= {count}", "continue"])]


def _substep(shape: RowTerms, substep_s: float) -> list[str]:
    params = shape.params
    lines = [_stretch(shape)] if len(shape.positions) == 2 else []
    lines += _pulled(params.rotor_forces, substep_s)
    push = "pull" if params.rotor_forces else "torque_n"
    if not params.contacts:
        rows = [shape.row("a", i, push=push) for i in range(shape.n)]
    elif len(params.contacts) == 1:
        more, rows = _one_contact(shape, params.contacts[0], push)
        lines += more
    else:
        more, rows = _two_contacts(shape, push)
        lines += more
    lines += _assigned(shape, rows)
    return lines + ([] if params.ends is None else _stopped(params.ends))


def _one_contact(shape: RowTerms, contact: Contact, push: str) -> tuple[list[str], list[str]]:
    response, level = shape.cell("a", contact.velocity, f"friction_{contact.body}"), repr(contact.level_n)
    lines = [
        f"v = {shape.row('a', contact.velocity, push=push, rub='')}",
        f"friction = -v / {response}",
        f"if friction > {level}:",
        f"    friction = {level}",
        f"    v += {response} * friction",
        f"elif friction < -{level}:",
        f"    friction = -{level}",
        f"    v += {response} * friction",
        "else:",
        "    v = 0.0",
    ]
    if contact.body == "rotor":
        lines.append(f"push = {push} + friction")
    renamed = {} if contact.body == "rotor" else {"push": push, "rub": "friction"}
    rows = [shape.row("a", i, **renamed) for i in range(shape.n)]
    rows[contact.velocity] = "v"
    return lines, rows


def _two_contacts(shape: RowTerms, push: str) -> tuple[list[str], list[str]]:
    first, second = shape.params.contacts
    names = [f"friction_{contact.body}" for contact in (first, second)]
    w = [[shape.cell("a", contact.velocity, name) for name in names] for contact in (first, second)]
    free = [shape.row("a", contact.velocity, push=push, rub="") for contact in (first, second)]
    lines = [
        f"v = {free[0]}",
        f"u = {free[1]}",
        f"friction, rub = stick_two(v, u, {w[0][0]}, {w[0][1]}, {w[1][0]}, {w[1][1]}, {first.level_n!r}, {second.level_n!r})",
        f"v = 0.0 if -{first.level_n!r} < friction < {first.level_n!r} else v + {w[0][0]} * friction + {w[0][1]} * rub",
        f"u = 0.0 if -{second.level_n!r} < rub < {second.level_n!r} else u + {w[1][0]} * friction + {w[1][1]} * rub",
        f"push = {push} + friction",
    ]
    rows = [shape.row("a", i) for i in range(shape.n)]
    rows[first.velocity], rows[second.velocity] = "v", "u"
    return lines, rows


def _assigned(shape: RowTerms, rows: list[str]) -> list[str]:
    """All states at once, a row to a line."""
    return [f"{', '.join(f'x{i}' for i in range(shape.n))} = (", *(f"    {row}," for row in rows), ")"]


def _stretch(shape: RowTerms) -> str:
    first, second = shape.positions
    return f"stretch = x{first} - x{second}"


def _sine(x: str, v: str, amplitude_n: float, pitch_m: float, phase_rad: float) -> str:
    return f"{amplitude_n!r} * sin({tau / pitch_m!r} * {x} + {phase_rad!r})"


# a force on the rotor [N] as an expression in the names of position [m] and velocity [m/s] and the law's numbers
ROTOR_LAWS: dict[str, Callable[..., str]] = {"sine": _sine}


def _pulled(forces: Sequence[RotorForce], substep_s: float) -> list[str]:
    """At the middle of the sub-step, so that a conservative force stays nearly so."""
    if not forces:
        return []
    x, v = f"x{forces[0].position}", f"x{forces[0].velocity}"
    texts = [ROTOR_LAWS[force.law]("where", v, *force.numbers) for force in forces]
    return [f"where = {x} + {0.5 * substep_s!r} * {v}", f"pull = {' + '.join(['torque_n', *texts])}"]


def _stopped(ends: Ends) -> list[str]:
    x, v = f"x{ends.position}", f"x{ends.velocity}"
    lines = []
    for stop_m, beyond in ((ends.upper_m, ">"), (ends.lower_m, "<")):
        lines += [f"if {x} {beyond} {stop_m!r}:", f"    {x} = {stop_m!r}", f"    if {v} {beyond} 0.0:", f"        {v} = 0.0"]
    return lines


def _error(noise: Noise | None, offset_m_per_s: float, substep_s: float) -> Iterable[str]:
    density = 0.0 if noise is None else noise.estimate_psd
    random = f" + {sqrt(density / (2.0 * substep_s))!r} / n_substeps**0.5 * gauss(0.0, 1.0)" if density else ""
    return [f"        error = {offset_m_per_s!r}{random}"]


def _ohms(heat: HeatingParams) -> list[str]:
    cold, reference = heat.resistance_ohm, heat.reference_c
    return [
        f"        hot = {cold!r} * (1.0 + {COPPER_PER_K!r} * (celsius - {reference!r}))",
        f"        ohm = hot - {heat.compensated_ohm!r}",
    ]


def _warmed(shape: RowTerms, heat: HeatingParams, substep_s: float, torque_constant_n_per_a: float) -> list[str]:
    """Copper loss of the motor force at the end of the piece; a piece is a ten-thousandth of the time constant."""
    force = output_text(shape, "motor_force", "damping_ns_per_m")
    per_w = heat.thermal_resistance_k_per_w / torque_constant_n_per_a**2
    return [
        f"        force = {force}",
        f"        rise = {heat.ambient_c!r} + {per_w!r} * hot * force * force - celsius",
        f"        celsius += {substep_s / heat.time_constant_s!r} * n_substeps * rise",
    ]


Step = Callable[[State, float, float, float, int], State]


def composed_step(params: PlantParams, board: BoardParams, substep_s: float) -> tuple[Step, RowTerms]:
    """The step of the composed device, as `plant.step.make_step` describes it, and its shape."""
    _check(params)
    lookup = Lookup(params)
    nodes = [blocks(params, node) for node in lookup.nodes]
    shape = RowTerms(params, nodes)
    ready = [{letter: shape.flat(letter, rows) for letter, rows in node.items()} for node in nodes]

    def coefficients(level: float, residual: float) -> dict[str, Row]:
        node = lookup.node(level, residual)
        return {"a": shape.flat("a", lookup.between(level, residual))} if node is None else ready[node]

    bind = compiled(composed_source(shape, substep_s, board.torque_constant_n_per_a), "plant step")["bind"]
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
