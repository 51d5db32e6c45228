"""What is seen of a composed device: its outputs as generated functions, and how generated source is compiled.

Source stays in `linecache`, so that a traceback shows it.
"""

import linecache
from collections.abc import Callable
from itertools import count
from typing import Any

from hapticd.params import OutputParams
from hapticd.plant.shape import Shape

State = tuple[float, ...]
View = Callable[[State, float, float], float]

_serial = count(1)


def viewer(shape: Shape, name: str) -> View:
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


def output_text(shape: Shape, name: str, level: str = "level") -> str:
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
