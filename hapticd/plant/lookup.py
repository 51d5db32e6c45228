"""The maps of a composed device at any damping level and residual resistance, and what follows from them. Standard library.

A map is the n rows of [Phi Gamma] for one sub-step, inputs held. At a node of both axes it is exact, and a device without
friction, rotor forces or heating then has its leaps as well: maps over two and four sub-steps. Between nodes the map of one
sub-step is interpolated linearly.
"""

from bisect import bisect_right
from collections.abc import Sequence

from hapticd.params import PlantParams

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
