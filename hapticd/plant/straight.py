"""Straight-line Python for a composed device: the text of its step, with nothing in it that the device does not have.

    sub-step   every state's new value in one expression; friction as a clamp on the velocity row (as `friction.stick_one`)
    leap       four or two sub-steps at once where nothing has to be decided in between: no friction, force that is not linear or
               heating, and no end of the workspace met

Coefficients are cells of the closure, loaded when the damping level changes; between the nodes of the table there are
no leaps. A winding that heats up has its temperature as the last value of the state.

What would break it: friction on more than two bodies, or coefficients loaded in another order than `Shape.flat`.
"""

from collections.abc import Callable, Iterable, Sequence
from math import sqrt, tau

from hapticd.params import Contact, Ends, HeatingParams, Noise, RotorForce
from hapticd.plant.shape import Shape
from hapticd.plant.views import output_text
from hapticd.units import COPPER_PER_K

TOLERANCE_OHM = 1e-4  # drift of the winding before its maps are loaded anew: 0.02 K of 1.6 ohm
LEAPS = {4: "d", 2: "b"}  # sub-steps of a leap, and its block of coefficients


def step_source(shape: Shape, substep_s: float, torque_constant_n_per_a: float) -> str:
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


def _leaps(shape: Shape) -> list[str]:
    """An `if` over the pieces that can be leapt, each left by `continue` or with `count` sub-steps to take one by one."""
    lines: list[str] = []
    for count, letter in LEAPS.items() if len(shape.terms) > 1 else ():
        lines += [
            f"            {'elif' if lines else 'if'} leaping and left >= {count}:",
            *(f"                {line}" for line in _leap(shape, count, letter)),
            f"                count = {count}",
        ]
    return lines


def _leap(shape: Shape, count: int, letter: str) -> list[str]:
    rows, ends = [shape.row(letter, i, push="torque_n") for i in range(shape.n)], shape.params.ends
    stretch = [_stretch(shape)] if len(shape.positions) == 2 else []
    if ends is None:
        return [*stretch, *_assigned(shape, rows), f"left -= {count}", "continue"]
    check = f"if {ends.lower_m!r} <= (end := {rows[ends.position]}) <= {ends.upper_m!r}:"
    rows[ends.position] = "end"
    return [*stretch, check, *(f"    {line}" for line in [*_assigned(shape, rows), f"left -= {count}", "continue"])]


def _substep(shape: Shape, substep_s: float) -> list[str]:
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


def _one_contact(shape: Shape, contact: Contact, push: str) -> tuple[list[str], list[str]]:
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


def _two_contacts(shape: Shape, push: str) -> tuple[list[str], list[str]]:
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


def _assigned(shape: Shape, rows: list[str]) -> list[str]:
    """All states at once, a row to a line."""
    return [f"{', '.join(f'x{i}' for i in range(shape.n))} = (", *(f"    {row}," for row in rows), ")"]


def _stretch(shape: Shape) -> str:
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


def _warmed(shape: Shape, heat: HeatingParams, substep_s: float, torque_constant_n_per_a: float) -> list[str]:
    """Copper loss of the motor force at the end of the piece; a piece is a ten-thousandth of the time constant."""
    force = output_text(shape, "motor_force", "damping_ns_per_m")
    per_w = heat.thermal_resistance_k_per_w / torque_constant_n_per_a**2
    return [
        f"        force = {force}",
        f"        rise = {heat.ambient_c!r} + {per_w!r} * hot * force * force - celsius",
        f"        celsius += {substep_s / heat.time_constant_s!r} * n_substeps * rise",
    ]
