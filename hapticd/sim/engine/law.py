"""The one law, compiled for the kernels: `render.environment.render` itself, in double and in
single precision.

The code object is the servo's; only its literal numbers become numbers of the kernel's precision,
so that a 0.0 does not drag single precision into double. Bit-identical to CPython on equal inputs,
which needs `fastmath=False` said aloud: numba lets a callee without that word inherit the fastmath
of the kernel that it is inlined into (measured: without it most forces differ in the last bit).

Imports numba: only kernels import this module.
"""

from types import FunctionType
from typing import Any

import numpy as np
from numba import njit

from hapticd.render import environment, fields, limits

HELPERS = (fields.wall_force, fields.end_force, limits.clamp)


def compiled_law(scalar: type[np.floating[Any]]) -> Any:
    """`render` jitted in the precision of `scalar`, with its helpers."""
    helpers = {helper.__name__: _compiled(helper, scalar, {}) for helper in HELPERS}
    return _compiled(environment.render, scalar, helpers)


def _compiled(function: Any, scalar: type[np.floating[Any]], names: dict[str, Any]) -> Any:
    code = function.__code__
    constants = tuple(
        scalar(value) if isinstance(value, float) else value for value in code.co_consts
    )
    twin = FunctionType(
        code.replace(co_consts=constants), {**function.__globals__, **names}, function.__name__
    )
    return njit(fastmath=False, error_model="numpy")(twin)


law_f32 = compiled_law(np.float32)
law_f64 = compiled_law(np.float64)
