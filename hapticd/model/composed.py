"""The composed device of a simulated board: its tables, and its step as generated straight-line
Python with only the terms that the device has. Standard library alone.

    map        n rows of [Phi Gamma] for one sub-step, inputs held; exact at a node of the table
               (damping level, residual resistance), interpolated linearly between nodes
    sub-step   every state's new value in one expression; friction as a clamp on the velocity row
               (as `friction.stick_one`)
    leap       four or two sub-steps at once if nothing has to be decided in between: no friction,
               nonlinear force or heating, and no end of the workspace met

Terms that are 0 at every node are omitted from the rows. For a device that floats freely only the
difference of its two positions appears (`stretch`). The forces on the rotor (perturbation,
nonlinear forces and its friction) have equal columns, so they are added before multiplication
(`push`).

Coefficients are cells of the closure, loaded when the damping level changes. Their names are the
letter of their block (`blocks`) and a number; between nodes there are no leaps. Everything that a
node needs is computed when the board is made. A live change of damping costs one lookup, a level
between nodes one interpolation. For a winding that heats up, its temperature is the last value of
the state. Views are the outputs as generated functions. Generated source stays in `linecache`, so
that tracebacks show it.

Limitations: friction on more than two bodies. Coefficients must be loaded in the order of
`RowTerms.flat`.
"""

import itertools
import linecache
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from math import sin, sqrt, tau
from random import Random
from typing import Any, Final, NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.core.units import COPPER_PER_K
from hapticd.model.friction import reach, stick_two
from hapticd.model.params import (
    BoardParams,
    Contact,
    DriveLimits,
    Ends,
    HeatingParams,
    Noise,
    OutputParams,
    PlantParams,
    RotorForce,
)

__all__ = ["VELOCITY", "State"]

Row = tuple[float, ...]
Rows = tuple[Row, ...]  # [Phi Gamma] of a piece, a row for each state
Blocks = dict[str, Rows]  # rows by the letter that names their coefficients in the source
State = tuple[float, ...]  # argument and result of a step; opaque outside the plant
# indices into a State: the rotor, always first, and a winding that heats up
POSITION: Final = 0
VELOCITY: Final = 1
WINDING: Final = -1
Step = Callable[[State, float, float, float, int], State]  # as `model.step.make_step` returns it
View = Callable[[State, float, float], float]  # of (state, force_n, active_damping_ns_per_m)

TOLERANCE_OHM = 1e-4  # drift of the winding before its maps are reloaded: 0.02 K of 1.6 ohm
LEAPS = {4: "d", 2: "b"}  # sub-steps of a leap, and its block of coefficients
ON_ROTOR = ("torque", "rotor_force", "friction_rotor")  # inputs with equal columns
# name of an input in the generated text; those on the rotor are added up in `push` beforehand
SIGNALS = {
    "command": "force_n",
    "torque": "push",
    "estimate": "error",
    "amplifier": "over",
    "friction_slider": "rub",
}

_serial = itertools.count(1)  # of generated sources, so that tracebacks find their own


class Response(NamedTuple):
    """Change of the rotor's motion by a force held for one sub-step, at its end."""

    position_m_per_n: float
    velocity_m_per_s_per_n: float


class Product(NamedTuple):
    """One product of a row: a coefficient of the map times a variable of the generated text."""

    variable: str
    column: int  # of the map
    sign: float  # +1 or -1, taken into the coefficient


def followed(first: Rows, then: Rows) -> Rows:
    """Return the map of `then` after `first`, with the same inputs."""
    n = len(first)
    width = len(first[0])
    return tuple(
        tuple(
            sum(row[k] * first[k][j] for k in range(n)) + (row[j] if j >= n else 0.0)
            for j in range(width)
        )
        for row in then
    )


def blocks(params: PlantParams, one: Rows) -> Blocks:
    """Return the rows of a node: a over one sub-step, b and d over two and four if that is exact.

    It is exact if nothing has to be decided in between: no friction, no nonlinear force on the
    rotor, no limit of the amplifier, no heating.
    """
    if params.contacts or params.rotor_forces or params.drive or params.heating:
        return {"a": one}
    two = followed(one, one)
    return {"a": one, "b": two, "d": followed(two, two)}


class Lookup:
    """Maps of a device by damping level [Ns/m] and residual resistance [ohm]."""

    def __init__(self, params: PlantParams) -> None:
        self.levels = params.levels_ns_per_m
        self.residuals = params.residuals_ohm
        n = len(params.states)
        width = len(params.states) + len(params.columns)
        self.nodes: list[Rows] = [
            tuple(flat[i * width : (i + 1) * width] for i in range(n)) for flat in params.maps
        ]

    def node(self, level: float, residual: float) -> int | None:
        """Number of the node at exactly these values; None if there is none."""
        if level in self.levels and residual in self.residuals:
            return self.residuals.index(residual) * len(self.levels) + self.levels.index(level)
        return None

    def between(self, level: float, residual: float) -> Rows:
        """Return the map there, linear between nodes on either axis; the outermost nodes are
        extrapolated.
        """
        place, part = _bracket(self.levels, level)
        layer, height = _bracket(self.residuals, residual)
        lower = self._mixed(layer * len(self.levels) + place, part)
        if not height:
            return lower
        return _blend(lower, self._mixed((layer + 1) * len(self.levels) + place, part), height)

    def _mixed(self, index: int, part: float) -> Rows:
        return _blend(self.nodes[index], self.nodes[index + 1], part) if part else self.nodes[index]


def _bracket(nodes: Sequence[float], value: float) -> tuple[int, float]:
    """(index of the node below, fraction of the way to the next)."""
    if len(nodes) == 1:
        return 0, 0.0
    low = min(max(bisect_right(nodes, value) - 1, 0), len(nodes) - 2)
    return low, (value - nodes[low]) / (nodes[low + 1] - nodes[low])


def _blend(a: Rows, b: Rows, part: float) -> Rows:
    return tuple(
        tuple(x + part * (y - x) for x, y in zip(p, q, strict=True))
        for p, q in zip(a, b, strict=True)
    )


class RowTerms:
    """The products that the rows of a device's maps need, over all of its nodes."""

    def __init__(self, params: PlantParams, nodes: list[Blocks]) -> None:
        self.params = params
        self.n = len(params.states)
        positions = [i for i, name in enumerate(params.states) if name.endswith("_position")]
        # in a device that floats freely nothing depends on a position itself
        self.positions = positions if params.floating else []
        self.by_letter = {
            letter: [self._needed(i, [node[letter][i] for node in nodes]) for i in range(len(rows))]
            for letter, rows in nodes[0].items()
        }

    def flat(self, letter: str, rows: Rows) -> Row:
        """Return the coefficients of the block `letter` in the order of its names."""
        pairs = zip(rows, self.by_letter[letter], strict=True)
        return tuple(sign * row[column] for row, terms in pairs for _, column, sign in terms)

    def names(self, letter: str) -> list[str]:
        """Return the names of the cells of the block `letter`."""
        return [f"{letter}{k}" for k in range(sum(map(len, self.by_letter[letter])))]

    def row(self, letter: str, i: int, **renamed: str) -> str:
        """Return the expression of row i of the block. `renamed` maps variables; "" omits one."""
        first = sum(map(len, self.by_letter[letter][:i]))
        factors = [renamed.get(term.variable, term.variable) for term in self.by_letter[letter][i]]
        products = [f"{letter}{first + k} * {factor}" for k, factor in enumerate(factors) if factor]
        base = [f"x{i}"] if i in self.positions else []
        return " + ".join(base + products) or "0.0"

    def cell(self, letter: str, i: int, column: str) -> str:
        """Return the cell that holds the coefficient of the input `column` in row i."""
        j = self.n + self.params.columns.index("torque" if column in ON_ROTOR else column)
        first = sum(map(len, self.by_letter[letter][:i]))
        return f"{letter}{first + [term.column for term in self.by_letter[letter][i]].index(j)}"

    def _needed(self, i: int, samples: list[Row]) -> list[Product]:
        return [term for term in self._candidates(i) if any(row[term.column] for row in samples)]

    def _candidates(self, own: int) -> Iterable[Product]:
        for j in range(self.n):
            if j not in self.positions:
                yield Product(f"x{j}", j, 1.0)
        if len(self.positions) == 2:
            first, second = self.positions
            other, sign = (second, -1.0) if own == first else (first, 1.0)
            yield Product("stretch", other, sign)  # stretch = first - second
        for column, name in enumerate(self.params.columns):
            if name in SIGNALS:
                yield Product(SIGNALS[name], self.n + column, 1.0)


def viewer(terms: RowTerms, name: str) -> View:
    """Return `view(state, force_n, active_damping_ns_per_m)` of the output `name`."""
    picked = picked_state(getattr(terms.params, name))
    if picked is None:
        state = ", ".join(f"x{i}" for i in range(terms.n)) + (", _" if terms.params.heating else "")
        lines = [f"    {state}, = state", f"    return {output_text(terms, name)}"]
    else:
        lines = [f"    return state[{picked}]"]
    source = "\n".join(["def view(state, force_n, level):", *lines, ""])
    view: View = compiled(source, f"plant {name}")["view"]
    return view


def picked_state(output: OutputParams) -> int | None:
    """Return the index of the state that equals the output; None if no state does."""
    places = [i for i, c in enumerate(output.c0) if c]
    plain = not any(output.c1) and not any(output.d0) and not any(output.d1)
    return places[0] if plain and len(places) == 1 and output.c0[places[0]] == 1.0 else None


def output_text(terms: RowTerms, name: str, level: str = "level") -> str:
    """Return the output `name` of `terms.params` as an expression in x0.., force_n and `level`."""
    output = getattr(terms.params, name)
    parts = []
    for c0, c1, variable in zip(
        output.c0, output.c1, (f"x{i}" for i in range(terms.n)), strict=True
    ):
        parts += _scaled(c0, c1, variable, level)
    inputs = {"command": "force_n", "estimate": repr(terms.params.estimate_offset_m_per_s)}
    for d0, d1, column in zip(output.d0, output.d1, terms.params.columns, strict=True):
        parts += _scaled(d0, d1, inputs.get(column, "0.0"), level)
    return " + ".join(parts) or "0.0"


def _scaled(c0: float, c1: float, variable: str, level: str) -> list[str]:
    found = [] if not c0 else [variable if c0 == 1.0 else f"{c0!r} * {variable}"]
    return found + ([f"{c1!r} * {level} * {variable}"] if c1 else [])


def compiled(source: str, title: str) -> dict[str, Any]:
    """Return the names that `source` defines; `title` is its name in tracebacks."""
    name = f"<{title} {next(_serial)}>"
    linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
    namespace: dict[str, Any] = {}
    exec(compile(source, name, "exec"), namespace)
    return namespace


def composed_source(terms: RowTerms, substep_s: float, torque_constant_n_per_a: float) -> str:
    """Return the text of `bind(coefficients, gauss, sin, stick_two)`, which returns the step, and
    for a winding that heats up also `compensate(trim_ohm)`, otherwise None.

    The step is that of `model.step.make_step`. The cells of the closure are the coefficients. They
    are reloaded only when the level, the winding or its compensation changes.
    """
    heat = terms.params.heating
    lines = [
        "def bind(coefficients, gauss, sin, stick_two):",
        (
            f"    {' = '.join(name for letter in terms.by_letter for name in terms.names(letter))}"
            " = 0.0"
        ),
        "    level = residual = None",
        *_load(terms),
        *(_compensate(heat) if heat else []),
        *_step(terms, substep_s, torque_constant_n_per_a),
        f"    return step, {'compensate' if heat else None}",
    ]
    return "\n".join(lines) + "\n"


def _load(terms: RowTerms) -> list[str]:
    """Write `load()`, which sets the cells for level and residual; no leaps between nodes."""
    first, *leaps = terms.by_letter
    cells = [name for letter in terms.by_letter for name in terms.names(letter)]
    return [
        *(["    leaping = False"] if leaps else []),
        "",
        "    def load():",
        f"        nonlocal {'leaping, ' if leaps else ''}{', '.join(cells)}",
        "        rows = coefficients(level, residual)",
        f"        ({', '.join(terms.names(first))},) = rows['{first}']",
        *(["        leaping = len(rows) > 1", "        if leaping:"] if leaps else []),
        *(
            f"            ({', '.join(terms.names(letter))},) = rows['{letter}']"
            for letter in leaps
        ),
        "",
    ]


def _step(terms: RowTerms, substep_s: float, torque_constant_n_per_a: float) -> list[str]:
    """Write `step(...)`, which reloads changed coefficients and moves the device by sub-steps."""
    params = terms.params
    heat = params.heating
    leaps = _leaps(terms)
    state = ", ".join([f"x{i}" for i in range(terms.n)] + (["celsius"] if heat else []))
    near = f"-{TOLERANCE_OHM!r} < residual_ohm - residual < {TOLERANCE_OHM!r}"
    drifted = f" or not {near}" if heat else ""
    return [
        "    def step(state, force_n, torque_n, active_damping_ns_per_m, n_substeps):",
        "        nonlocal level, residual",
        f"        {state} = state",
        *(_ohms(heat) if heat else []),
        f"        if active_damping_ns_per_m != level{drifted}:",
        "            level = active_damping_ns_per_m",
        f"            residual = {'residual_ohm' if heat else repr(params.residuals_ohm[0])}",
        "            load()",
        *(
            _error(params.noise, params.estimate_offset_m_per_s, substep_s)
            if "estimate" in params.columns
            else []
        ),
        *(_leaping(leaps) if leaps else ["        for _ in range(n_substeps):"]),
        *(f"{' ' * (16 if leaps else 12)}{line}" for line in _substep(terms, substep_s)),
        *(_warmed(terms, heat, substep_s, torque_constant_n_per_a) if heat else []),
        f"        return {state}",
        "",
    ]


def _leaping(leaps: list[str]) -> list[str]:
    """Write the loop over pieces: leap if possible, otherwise take `count` sub-steps one by one."""
    return [
        "        left = n_substeps",
        "        while left:",
        *leaps,
        "            else:",
        "                count = left",
        "            left -= count",
        "            for _ in range(count):",
    ]


def _leaps(terms: RowTerms) -> list[str]:
    """Write an `if` over the leaps.

    A leap ends with `continue`, or with `count` sub-steps to take one by one because an end of the
    workspace would be met.
    """
    lines: list[str] = []
    for count, letter in LEAPS.items() if len(terms.by_letter) > 1 else ():
        lines += [
            f"            {'elif' if lines else 'if'} leaping and left >= {count}:",
            *(f"                {line}" for line in _leap(terms, count, letter)),
            f"                count = {count}",
        ]
    return lines


def _leap(terms: RowTerms, count: int, letter: str) -> list[str]:
    """`count` sub-steps at once, unless the position at their end lies beyond an end of travel."""
    rows = [terms.row(letter, i, push="torque_n") for i in range(terms.n)]
    ends = terms.params.ends
    stretch = [_stretch(terms)] if len(terms.positions) == 2 else []
    if ends is None:
        return [*stretch, *_assigned(terms, rows), f"left -= {count}", "continue"]
    check = f"if {ends.lower_m!r} <= (end := {rows[ends.position]}) <= {ends.upper_m!r}:"
    rows[ends.position] = "end"
    return [
        *stretch,
        check,
        *(f"    {line}" for line in [*_assigned(terms, rows), f"left -= {count}", "continue"]),
    ]


def _substep(terms: RowTerms, substep_s: float) -> list[str]:
    """One sub-step, friction solved and ends of travel met."""
    params = terms.params
    lines = [_stretch(terms)] if len(terms.positions) == 2 else []
    lines += _pulled(params.rotor_forces, substep_s)
    push = "pull" if params.rotor_forces else "torque_n"
    if params.drive is not None:
        lines += _limited(terms, params.drive, push, substep_s)
    if not params.contacts:
        rows = [terms.row("a", i, push=push) for i in range(terms.n)]
    elif len(params.contacts) == 1:
        more, rows = _one_contact(terms, params.contacts[0], push)
        lines += more
    else:
        more, rows = _two_contacts(terms, push)
        lines += more
    lines += _assigned(terms, rows)
    return lines + ([] if params.ends is None else _stopped(params.ends))


def _limited(terms: RowTerms, limits: DriveLimits, push: str, substep_s: float) -> list[str]:
    """Write the limit of the motor force by current and voltage (`reach`), before friction."""
    force = limits.motor_force
    can = reach(limits, substep_s)
    return [
        f"free = {terms.row('a', force, push=push, rub='', over='')}",
        f"held = min(max(free, -{limits.limit_n!r}), {limits.limit_n!r})",
        f"kept = {can.keep!r} * x{force} - {can.drag_ns_per_m!r} * x{limits.velocity}",
        f"held = min(max(held, kept - {can.width_n!r}), kept + {can.width_n!r})",
        f"over = (held - free) / {terms.cell('a', force, 'amplifier')}",
    ]


def _one_contact(terms: RowTerms, contact: Contact, push: str) -> tuple[list[str], list[str]]:
    """Return (lines that find the friction force, rows that use it): `friction.stick_one`."""
    response = terms.cell("a", contact.velocity, f"friction_{contact.body}")
    level = repr(contact.level_n)
    lines = [
        f"v = {terms.row('a', contact.velocity, push=push, rub='')}",
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
    rows = [terms.row("a", i, **renamed) for i in range(terms.n)]
    rows[contact.velocity] = "v"
    rows[contact.position] = _unmoved(contact, "v", rows[contact.position])
    return lines, rows


def _two_contacts(terms: RowTerms, push: str) -> tuple[list[str], list[str]]:
    """Return (lines that find both friction forces, rows that use them). A body that sticks gets v
    = 0.0 exactly, without rounding error.
    """
    first, second = terms.params.contacts
    names = [f"friction_{contact.body}" for contact in (first, second)]
    w = [[terms.cell("a", contact.velocity, name) for name in names] for contact in (first, second)]
    free = [terms.row("a", contact.velocity, push=push, rub="") for contact in (first, second)]
    lines = [
        f"v = {free[0]}",
        f"u = {free[1]}",
        (
            f"friction, rub = stick_two(v, u, {w[0][0]}, {w[0][1]}, {w[1][0]}, {w[1][1]},"
            f" {first.level_n!r}, {second.level_n!r})"
        ),
        (
            f"v = 0.0 if -{first.level_n!r} < friction < {first.level_n!r} else v + {w[0][0]} *"
            f" friction + {w[0][1]} * rub"
        ),
        (
            f"u = 0.0 if -{second.level_n!r} < rub < {second.level_n!r} else u + {w[1][0]} *"
            f" friction + {w[1][1]} * rub"
        ),
        f"push = {push} + friction",
    ]
    rows = [terms.row("a", i) for i in range(terms.n)]
    rows[first.velocity] = "v"
    rows[second.velocity] = "u"
    for contact, after in ((first, "v"), (second, "u")):
        rows[contact.position] = _unmoved(contact, after, rows[contact.position])
    return lines, rows


def _unmoved(contact: Contact, after: str, moved: str) -> str:
    """Return the position of its body: unchanged if it stood and sticks, otherwise `moved`; see
    `friction`.
    """
    return f"x{contact.position} if x{contact.velocity} == 0.0 == {after} else {moved}"


def _assigned(terms: RowTerms, rows: list[str]) -> list[str]:
    """Assign all states at once, one row per line."""
    return [
        f"{', '.join(f'x{i}' for i in range(terms.n))} = (",
        *(f"    {row}," for row in rows),
        ")",
    ]


def _stretch(terms: RowTerms) -> str:
    first, second = terms.positions
    return f"stretch = x{first} - x{second}"


def _sine(x: str, v: str, amplitude_n: float, pitch_m: float, phase_rad: float) -> str:
    return f"{amplitude_n!r} * sin({tau / pitch_m!r} * {x} + {phase_rad!r})"


# law -> text of its force on the rotor [N], of the names of position [m] and velocity [m/s] and of
# the law's numbers
ROTOR_LAWS: dict[str, Callable[..., str]] = {"sine": _sine}


def _pulled(forces: Sequence[RotorForce], substep_s: float) -> list[str]:
    """Write the nonlinear forces, at mid sub-step: a conservative one stays nearly conservative."""
    if not forces:
        return []
    x = f"x{forces[0].position}"
    v = f"x{forces[0].velocity}"
    texts = [ROTOR_LAWS[force.law]("where", v, *force.numbers) for force in forces]
    return [
        f"where = {x} + {0.5 * substep_s!r} * {v}",
        f"pull = {' + '.join(['torque_n', *texts])}",
    ]


def _stopped(ends: Ends) -> list[str]:
    """Write an inelastic end: the position is reset to it, and velocity towards it is lost."""
    x = f"x{ends.position}"
    v = f"x{ends.velocity}"
    lines = []
    for stop_m, beyond in ((ends.upper_m, ">"), (ends.lower_m, "<")):
        lines += [
            f"if {x} {beyond} {stop_m!r}:",
            f"    {x} = {stop_m!r}",
            f"    if {v} {beyond} 0.0:",
            f"        {v} = 0.0",
        ]
    return lines


def _error(noise: Noise | None, offset_m_per_s: float, substep_s: float) -> Iterable[str]:
    """The input `estimate`: offset, and noise of variance S / (2 h) for a value held for h."""
    density = 0.0 if noise is None else noise.estimate_psd
    random = (
        f" + {sqrt(density / (2.0 * substep_s))!r} / n_substeps**0.5 * gauss(0.0, 1.0)"
        if density
        else ""
    )
    return [f"        error = {offset_m_per_s!r}{random}"]


def _compensate(heat: HeatingParams) -> list[str]:
    """Write `compensate(trim_ohm)`: the compensated resistance beyond that of count 0."""
    nominal = repr(heat.compensated_ohm)
    return [
        f"    compensated_ohm = {nominal}",
        "",
        "    def compensate(trim_ohm):",
        "        nonlocal compensated_ohm",
        f"        compensated_ohm = {nominal} + trim_ohm",
        "",
    ]


def _ohms(heat: HeatingParams) -> list[str]:
    """Write the true resistance of the winding and its uncompensated part."""
    kelvin = f"(celsius - {heat.reference_c!r})"
    return [
        f"        hot = {heat.resistance_ohm!r} * (1.0 + {COPPER_PER_K!r} * {kelvin})",
        "        residual_ohm = hot - compensated_ohm",
    ]


def _warmed(
    terms: RowTerms, heat: HeatingParams, substep_s: float, torque_constant_n_per_a: float
) -> list[str]:
    """Write the heating of the winding by the copper loss of the motor force at the end of the
    piece. Euler's rule is accurate enough: a piece is a ten-thousandth of the time constant.
    """
    force = output_text(terms, "motor_force", "active_damping_ns_per_m")
    per_w = heat.thermal_resistance_k_per_w / torque_constant_n_per_a**2
    return [
        f"        force = {force}",
        f"        rise = {heat.ambient_c!r} + {per_w!r} * hot * force * force - celsius",
        f"        celsius += {substep_s / heat.time_constant_s!r} * n_substeps * rise",
    ]


def composed_step(
    params: PlantParams, board: BoardParams, substep_s: float
) -> tuple[Step, RowTerms, Callable[[float], None] | None]:
    """Return the step of the composed device `params` of `board`, in sub-steps of `substep_s`, as
    `model.step.make_step` describes it; its terms; and the function that sets the resistance [ohm]
    added to the nominal compensation.

    The last is None if the winding keeps its temperature: its maps then hold for one residual
    resistance.
    """
    _check(params)
    lookup = Lookup(params)
    nodes = [blocks(params, node) for node in lookup.nodes]
    terms = RowTerms(params, nodes)
    ready = [{letter: terms.flat(letter, rows) for letter, rows in node.items()} for node in nodes]

    def coefficients(level: float, residual: float) -> dict[str, Row]:
        node = lookup.node(level, residual)
        return (
            {"a": terms.flat("a", lookup.between(level, residual))} if node is None else ready[node]
        )

    bind = compiled(composed_source(terms, substep_s, board.torque_constant_n_per_a), "plant step")[
        "bind"
    ]
    step, compensate = bind(coefficients, Random(board.seed).gauss, sin, stick_two)
    return step, terms, compensate


def rotor_response(params: PlantParams) -> Callable[[float], Response]:
    """Return `response(active_damping_ns_per_m)`: the response of the rotor to a force held for one
    sub-step, at the first residual resistance.
    """
    lookup = Lookup(params)
    column = len(params.states) + params.columns.index("torque")

    def response(level: float) -> Response:
        rows = lookup.between(level, params.residuals_ohm[0])
        return Response(rows[POSITION][column], rows[VELOCITY][column])

    return response


def rest(params: PlantParams, position_m: float) -> State:
    """Return the state at rest, every body at `position_m`, the winding as at the start."""
    state = tuple(position_m if name.endswith("_position") else 0.0 for name in params.states)
    return state if params.heating is None else (*state, params.heating.start_c)


def _check(params: PlantParams) -> None:
    n = len(params.states)
    m = len(params.columns)
    nodes = len(params.levels_ns_per_m) * len(params.residuals_ohm)
    if len(params.maps) != nodes or any(len(flat) != n * (n + m) for flat in params.maps):
        raise ConfigError(
            f"board.json must hold {nodes} plant maps of {n} x {n + m} numbers and does not;"
            " resolve the configuration again"
        )
    if len(params.contacts) > 2:
        raise ConfigError(
            f"friction at {len(params.contacts)} bodies: at most 2 can be solved; leave some out"
        )
