"""Linear forms: the algebra in which effects write their equations. Standard library alone.

A form is a sum over states and inputs, each with a coefficient that may depend on the commanded damping level b and on the
residual winding resistance r, each at most to the first power: c = c1 + cb b + cr r + cbr b r. So the composed A and B
are affine in b and in r, which is what `Model` promises. A product that would leave this set is refused: it means that
two effects close an algebraic loop that needs a lag (an amplifier or a circuit with a bandwidth) to be solved.
"""

from collections.abc import Mapping

Coefficient = tuple[float, float, float, float]  # of 1, b, r, b r

ONE: Coefficient = (1.0, 0.0, 0.0, 0.0)
ZERO: Coefficient = (0.0, 0.0, 0.0, 0.0)


class Form:
    """Immutable sum of coefficient x symbol; symbols are names of states and inputs."""

    __slots__ = ("terms",)

    def __init__(self, terms: Mapping[str, Coefficient] | None = None) -> None:
        self.terms: Mapping[str, Coefficient] = terms or {}

    @classmethod
    def symbol(cls, name: str) -> "Form":
        """The state or input `name` itself."""
        return cls({name: ONE})

    def __add__(self, other: "Form") -> "Form":
        total = dict(self.terms)
        for name, (one, b, r, br) in other.terms.items():
            mine = total.get(name, ZERO)
            total[name] = (mine[0] + one, mine[1] + b, mine[2] + r, mine[3] + br)
        return Form(total)

    def __mul__(self, factor: float) -> "Form":
        return Form({name: (factor * c[0], factor * c[1], factor * c[2], factor * c[3]) for name, c in self.terms.items()})

    __rmul__ = __mul__

    def __neg__(self) -> "Form":
        return -1.0 * self

    def __sub__(self, other: "Form") -> "Form":
        return self + -other

    def __truediv__(self, divisor: float) -> "Form":
        return (1.0 / divisor) * self

    def times_level(self) -> "Form":
        """Multiplied by the damping level. ValueError if it depends on the level already."""
        if any(c[1] or c[3] for c in self.terms.values()):
            raise ValueError("a form of the second degree in the damping level")
        return Form({name: (0.0, c[0], 0.0, c[2]) for name, c in self.terms.items()})

    def times_residual(self) -> "Form":
        """Multiplied by the residual resistance. ValueError if it depends on it already."""
        if any(c[2] or c[3] for c in self.terms.values()):
            raise ValueError("a form of the second degree in the residual resistance")
        return Form({name: (0.0, 0.0, c[0], c[1]) for name, c in self.terms.items()})
