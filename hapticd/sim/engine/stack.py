"""A stack frame that begins on a cache line.

A kernel has more coefficients than there are vector registers; the rest lives on the stack and is
read from there by every instruction that needs it. numba's functions keep the alignment of 16 bytes
that they are called with, so three of four times such a read crosses a cache line and costs double
(measured: 1.5 to 1.7 times the time of the whole kernel, by chance of the caller's depth). One
variable that asks for 64 bytes makes LLVM align the frame.

Imports numba and llvmlite: only kernels import this module. Results do not depend on it.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from hapticd.analysis.arrays import CACHE_LINE


@intrinsic
def begin_on_cache_line(typing_context: Any) -> Any:
    """In a jitted function: align its frame."""
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
