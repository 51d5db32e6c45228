"""Forces on the rotor that are not linear, as the lanes of a kernel compute them.

A law writes lines that leave a force [N] in the variable `force`, from the names of a position [m],
a velocity [m/s] and of its numbers, `number(0)` and so on. `numbers` makes these of the parameters
of the effect, before the kernel runs, so that no lane divides. The lines become vector
instructions: no branch and no loop, only conditional expressions; constants are T(...), in the
precision of the kernel.

What would break it: a name that the text of a sub-step has already (`substep`); a law keeps to z,
r and its force.
"""

from collections.abc import Callable, Iterator
from math import tau
from typing import NamedTuple

SINE_TERMS = 9

Number = Callable[[int], str]


class Law(NamedTuple):
    """`numbers(*parameters)`, and `lines(force, position, velocity, number)`."""

    numbers: Callable[..., tuple[float, ...]]
    lines: Callable[[str, str, str, Number], Iterator[str]]


def _turns(amplitude_n: float, pitch_m: float, phase_rad: float) -> tuple[float, ...]:
    return amplitude_n, 1.0 / pitch_m, phase_rad / tau


def _sine(force: str, position: str, velocity: str, number: Number) -> Iterator[str]:
    """Sine of a turn by its series on a quarter of it."""
    yield f"z = {position} * {number(1)} + {number(2)}"
    yield "z = z - np.floor(z + HALF)"
    yield "r = z if z > ZERO else -z"
    yield "r = r if r < HALF - r else HALF - r"
    yield "r = r * TURN"
    yield f"{force} = r * ({_series('r * r')}) * {number(0)}"
    yield f"{force} = {force} if z > ZERO else -{force}"


def _series(square: str) -> str:
    """sin(r) / r by Horner's rule; complete to double precision on a quarter turn."""
    coefficients = []
    factorial = 1
    for k in range(SINE_TERMS):
        coefficients.append((-1) ** k / factorial)
        factorial *= (2 * k + 2) * (2 * k + 3)
    text = f"T({coefficients.pop()!r})"
    for value in reversed(coefficients):
        text = f"T({value!r}) + ({square}) * ({text})"
    return text


ROTOR_LAWS = {"sine": Law(_turns, _sine)}
