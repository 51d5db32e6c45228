"""What double precision can compute of a device's numbers, and a clear word where it cannot.

A number of a device file has the right sign and unit, and may still be 1e-308 kg: what is divided
by it is beyond the largest double. Then no answer of ours would be one.

What would break it: a computation of the composed model that is not inside `computable`.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hapticd.core.errors import ConfigError
from hapticd.model.model import Array


@contextmanager
def computable(name: str, what: str) -> Iterator[None]:
    """ConfigError where `what` of model `name` divides by zero, overflows or has no eigenvalues."""
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise beyond(name, what, str(error)) from error


def require_finite(name: str, what: str, *arrays: Array) -> None:
    """ConfigError if `what` of model `name` is not finite: Python multiplies into infinity."""
    if not all(np.isfinite(array).all() for array in arrays):
        raise beyond(name, what, "not finite")


def beyond(name: str, what: str, why: str) -> ConfigError:
    """The error for numbers out of reach."""
    return ConfigError(
        f"{name!r}: {what} cannot be computed ({why}): a number of the device or scene is beyond"
        " what double precision reaches (some 1e-308 to 1e308); correct the one that is far from"
        " the others"
    )
