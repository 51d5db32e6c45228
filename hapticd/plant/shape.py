"""Which products the rows of a composed device's maps need, over all of its nodes, and how they are written.

What is 0 at every node is left out. Of a device that floats freely only the difference of its two positions appears
(`stretch`). The forces on the rotor, perturbation, what is not linear and its friction, have equal columns: they are added
before they are multiplied (`push`). Coefficients have names made of the letter of their block (`lookup.blocks`) and a number.
"""

from collections.abc import Iterable

from hapticd.params import PlantParams
from hapticd.plant.lookup import Blocks, Map, Row

Term = tuple[str, int, float]  # variable, column of the map, sign
ON_ROTOR = ("torque", "rotor_force", "friction_rotor")
SIGNALS = {"command": "force_n", "torque": "push", "estimate": "error", "friction_slider": "rub"}


class Shape:
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
