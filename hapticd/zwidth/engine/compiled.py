"""The functions that kernels call, in numba: the one law, and a stack frame that begins on a cache
line.

The law is `render.law.render` itself, in double and in single precision. The code object is the
servo's; only its literal numbers take the kernel's precision, so that a 0.0 does not promote single
to double. It is bit-identical to CPython on equal inputs. This needs an explicit `fastmath=False`:
otherwise numba lets a callee inherit the fastmath of the kernel that it is inlined into (measured:
most forces then differ in the last bit).

A kernel has more coefficients than there are vector registers; the rest is on the stack, where
every instruction that needs it reads it. numba's functions keep the 16-byte alignment of their
call. Three of four times such a read then crosses a cache line and costs double (measured: 1.5 to
1.7 times the time of the whole kernel, depending on the caller's depth). One variable with 64-byte
alignment makes LLVM align the frame. Results do not depend on it.

The module imports numba and llvmlite, and only kernels import it, so that the rest is light to
import. Every helper of the law must be in HELPERS (numba would otherwise not find it).
"""

from types import FunctionType
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from hapticd.core.arrays import CACHE_LINE
from hapticd.render import law
from hapticd.zwidth.engine.parts import CONTROLLERS, ESTIMATORS

HELPERS = (law.wall_force, law.end_force, law.clamp)


def compiled_law(scalar: type[np.floating[Any]]) -> Any:
    """Return `render` jitted in the precision of `scalar`, with its helpers."""
    helpers = {helper.__name__: _compiled(helper, scalar, {}) for helper in HELPERS}
    return _compiled(law.render, scalar, helpers)


def compiled_part(kind: str, scalar: type[np.floating[Any]]) -> Any:
    """A part of the law jitted in the precision of `scalar`."""
    function: Any = (ESTIMATORS | CONTROLLERS)[kind]
    return _compiled(function, scalar, {"clamp": _compiled(law.clamp, scalar, {})})


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


@intrinsic
def begin_on_cache_line(typing_context: Any) -> Any:
    """Align the frame of the enclosing jitted function."""
    return types.void(), _code


def _code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    with builder.goto_entry_block():
        slot = builder.alloca(ir.IntType(64))
        slot.align = CACHE_LINE
    keep = ir.InlineAsm(
        ir.FunctionType(ir.VoidType(), [slot.type]), "", "r,~{memory}", side_effect=True
    )
    builder.call(keep, [slot])
    return context.get_dummy_value()
