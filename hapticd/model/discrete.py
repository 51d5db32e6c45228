"""Exact discretisation: held inputs, any step, and commands that change inside a step.

    x(h) = Phi x + Gamma u,   [Phi Gamma; 0 I] = exp([A B; 0 0] h)

A command that takes effect the fraction p of a step late splits its column: the old value acts for
p h, the new one for (1 - p) h, Gamma_new = integral over (1 - p) h, Gamma_old = Gamma - Gamma_new.
That is exact; it needs no sub-steps.

The exponential is computed by scaling, Taylor series and squaring, in extended precision:

    e^X = (e^(X / 2^s))^(2^s),   s such that the 1-norm of X / 2^s is at most 1/2

At norm 1/2 the series of 25 terms is complete to 1e-33, so only rounding remains, and the squarings
amplify that by 2^s at worst. numpy's long double has 64 bits of mantissa on x86 and 113 on ARM
Linux, which leaves the result correct to the last bits of a double. A Pade approximant would save a
few products but need a solver, which long double does not have. The matrix is balanced first by
powers of two (exact), because states in metres and in newtons differ by many orders.

Reference: Moler and Van Loan 2003, "Nineteen dubious ways to compute the exponential of a matrix",
method 3.

`computable` reports devices whose numbers double precision cannot handle: a value of a device file
may have the right sign and unit, and still be 1e-308 kg.

Computations of the composed model must be inside `computable`, and the input must be held over the
step. Limitations: a platform whose long double is a double (the last three digits are lost).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from math import ceil, exp, floor, log2

import numpy as np

from hapticd.core.errors import ConfigError
from hapticd.model.model import Array, DriveLimits, Map, Model, frozen

__all__ = ["discretise", "drive_response_s", "expm"]

TERMS = 25
LARGEST_NORM = 0.5
BALANCE_SWEEPS = 8
# of the amplifier's own response to its limits: minimum response of the motor force in a step
LEAST_SHARE = 0.25


@contextmanager
def computable(name: str, what: str) -> Iterator[None]:
    """Raise ConfigError if `what` of `name` divides by zero, overflows or lacks eigenvalues."""
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise beyond(name, what, str(error)) from error


def require_finite(name: str, what: str, *arrays: Array) -> None:
    """Raise ConfigError if `what` of model `name` is not finite: Python's product may overflow to
    infinity.
    """
    if not all(np.isfinite(array).all() for array in arrays):
        raise beyond(name, what, "not finite")


def beyond(name: str, what: str, why: str) -> ConfigError:
    """Return the error for numbers out of range."""
    return ConfigError(
        f"{name!r}: {what} cannot be computed ({why}): a number of the device or scene is beyond"
        " what double precision reaches (some 1e-308 to 1e308); correct the one that is far from"
        " the others"
    )


def expm(matrix: Array) -> Array:
    """Return e^matrix for a finite square float64 matrix (n, n). ValueError if it is not finite."""
    if not np.isfinite(matrix).all():
        raise ValueError("the exponential of a matrix that is not finite")
    scale = _balance(matrix)
    balanced = (matrix / scale[:, None] * scale).astype(np.longdouble)
    norm = float(abs(balanced).sum(axis=0).max())
    squarings = max(0, ceil(log2(norm / LARGEST_NORM))) if norm > 0.0 else 0
    result = _series(balanced / np.longdouble(2.0) ** squarings)
    for _ in range(squarings):
        result = result @ result
    return np.asarray(result * scale[:, None] / scale, dtype=np.float64)


def _series(
    small: "np.ndarray[tuple[int, ...], np.dtype[np.longdouble]]",
) -> "np.ndarray[tuple[int, ...], np.dtype[np.longdouble]]":
    identity = np.eye(len(small), dtype=np.longdouble)
    total = identity.copy()
    for k in range(TERMS, 0, -1):
        total = identity + small @ total / k
    return total


def _balance(matrix: Array) -> Array:
    """Powers of two d such that rows and columns of diag(d)^-1 M diag(d) are of like size."""
    size = len(matrix)
    scale = np.ones(size)
    off = abs(matrix) * (1.0 - np.eye(size))
    for _ in range(BALANCE_SWEEPS):
        before = scale.copy()
        scaled = off / scale[:, None] * scale
        for i in range(size):
            row = scaled[i].sum()
            column = scaled[:, i].sum()
            if row > 0.0 and column > 0.0:
                factor = 2.0 ** round(0.5 * log2(row / column))
                scale[i] *= factor
                scaled[i] /= factor
                scaled[:, i] *= factor
        if (scale == before).all():  # no later sweep changes it: powers of two are exact
            break
    return scale


SNAP = 1e-9  # of a step: a delay this close to a whole step is one


def discretise(model: Model, duration_s: float, active_damping_ns_per_m: float = 0.0) -> Map:
    """Return the exact map of `model` over `duration_s` at that damping level, inputs held.
    ConfigError if its numbers are out of range.
    """
    n, m = model.b0.shape
    whole = np.zeros((n + m, n + m))
    what = f"the map over {duration_s:g} s at {active_damping_ns_per_m:g} N s/m"
    with computable(model.name, what):
        whole[:n, :n] = model.a(active_damping_ns_per_m)
        whole[:n, n:] = model.b(active_damping_ns_per_m)
        response = expm(whole * duration_s)
    require_finite(model.name, what, response)
    return Map(
        duration_s, active_damping_ns_per_m, frozen(response[:n, :n]), frozen(response[:n, n:])
    )


def late_command(model: Model, whole: Map, fraction: float) -> tuple[Array, Array]:
    """Return columns (old, new), each (n,), of a command that changes within the step `whole`,
    `fraction` (0..1) of the step after its start.
    """
    column = model.inputs.command
    rest = discretise(model, (1.0 - fraction) * whole.duration_s, whole.active_damping_ns_per_m)
    return whole.b[:, column] - rest.b[:, column], rest.b[:, column]


def drive_response_s(limits: DriveLimits, column: int | None, whole: Map) -> float:
    """Return the motion of the motor force per input `column`, by which `limits` act, in the step
    of `whole`, N per N/s. ConfigError if that is too small to end the step inside the limits.
    """
    found = float(whole.b[limits.motor_force, column])
    alone_s = (1.0 - exp(-limits.amplifier_rad_s * whole.duration_s)) / limits.amplifier_rad_s
    if found < LEAST_SHARE * alone_s:
        raise ConfigError(
            f"active damping of {whole.active_damping_ns_per_m:g} N s/m moves the motor force"
            f" within a step of {1e6 * whole.duration_s:g} us more than the amplifier does, so"
            " 'amplifier_limits' cannot hold it; use more sub-steps, or a lower level"
        )
    return found


def delay_steps(delay_periods: float) -> tuple[int, float]:
    """Return (whole periods, fraction of one) from the sample to the effect of the command."""
    count = floor(delay_periods + SNAP)
    fraction = delay_periods - count
    return count, fraction if fraction > SNAP else 0.0
