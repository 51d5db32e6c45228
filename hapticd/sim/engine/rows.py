"""How the text of a kernel names and adds things: rows of the state array, terms, sums, clamps."""

from collections.abc import Iterable, Iterator

from hapticd.sim.engine.shape import Term

LONG_SUM = 4


class Rows:
    """Names that the text uses, in the order in which it first does: rows of the state array, and
    coefficients.

    Coefficients are scalars, C[NAME], the same for all trials, or with `per_lane` rows like any
    other.
    """

    def __init__(self, first: Iterable[str], per_lane: bool) -> None:
        self.names, self.coefficients = list(first), list[str]()
        self._per_lane = per_lane

    def __call__(self, name: str) -> str:
        """A row."""
        if name not in self.names:
            self.names.append(name)
        return f"S[{name} + l]"

    def c(self, name: str) -> str:
        """A coefficient."""
        if self._per_lane:
            return self(name)
        if name not in self.coefficients:
            self.coefficients.append(name)
        return f"C[{name}]"


def term(present: bool, name: str, factor: str, row: Rows) -> list[str]:
    """Coefficient `name` times something, or nothing and no coefficient."""
    return [row.c(name) + factor] if present else []


def weighted(terms: Iterable[Term], letter: str, row: Rows) -> str:
    """Sum of states, each with its coefficient of `letter`."""
    return (
        " + ".join(
            f"x{t.state}" if t.one else f"{row.c(f'{letter}{t.state}')} * x{t.state}" for t in terms
        )
        or "ZERO"
    )


def total(name: str, terms: list[str]) -> Iterator[str]:
    """`name` = sum of `terms`; a long one as two chains, which halves the wait from sub-step to
    sub-step.
    """
    half = len(terms) // 2
    if len(terms) > LONG_SUM:
        yield f"{name} = ({' + '.join(terms[:half])}) + ({' + '.join(terms[half:])})"
    elif terms:
        yield f"{name} = {' + '.join(terms)}"


def clamped(name: str, value: str, limit: str) -> Iterator[str]:
    """`name` = `value` held inside +-`limit`, as minimum and maximum."""
    yield f"{name} = {value} if {value} < {limit} else {limit}"
    yield f"{name} = {name} if {name} > -{limit} else -{limit}"
