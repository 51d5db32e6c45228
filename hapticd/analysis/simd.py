"""Vectors of 64 bytes in numba: 16 float32 or 8 float64 that stay in one register, or in a few
where registers are smaller.

numba leaves it to LLVM whether a loop becomes vector instructions; a transform with its strides and
many arrays loses that game. Here a lane of a vector is a trial, so the text of a scalar algorithm
does 16 trials at once, whatever LLVM thinks of its loops.

    load(a, row)      16 values of the flat array `a` from `row` * 64 bytes on    store(a, row, v)
    + - *             lane by lane, with vectors or a number                      fma(x, y, z) = x y
                      + z

Arrays must begin on a 64 byte border (`arrays.aligned`). What would break it: llvmlite without
typed pointers in its IR builder.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.extending import models, overload, register_model
from numba.np import arrayobj as arrays

from hapticd.analysis.arrays import CACHE_LINE

arrayobj: Any = arrays
utils: Any = cgutils
FLAGS = ("contract", "nsz")
LLVM = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}


def intrinsic(code: Callable[..., Any]) -> Any:
    """numba's, as what its user sees: without the first argument."""
    return extending.intrinsic(code)


class Vector(types.Type):
    """numba's type of a vector of `element`."""

    def __init__(self, element: Any) -> None:
        self.element = element
        self.count = 8 * CACHE_LINE // element.bitwidth
        super().__init__(name=f"Vector({element})")

    @property
    def llvm(self) -> Any:
        """Its LLVM type."""
        return ir.VectorType(LLVM[self.element], self.count)


@register_model(Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, kind.llvm)  # type: ignore[no-untyped-call]


@intrinsic
def load(typing: Any, array: Any, row: Any) -> Any:
    """See the module."""
    kind = Vector(array.dtype)

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        value = builder.load(_pointer(context, builder, signature, given, kind))
        value.align = CACHE_LINE
        return value

    return kind(array, row), code


@intrinsic
def store(typing: Any, array: Any, row: Any, value: Any) -> Any:
    """See the module."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        builder.store(
            given[2], _pointer(context, builder, signature, given, value)
        ).align = CACHE_LINE
        return context.get_dummy_value()

    return types.void(array, row, value), code


@intrinsic
def fma(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """See the module; at least one of them is a vector."""
    kind = next(given for given in (x, y, z) if isinstance(given, Vector))

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        width = "f32" if kind.element == types.float32 else "f64"
        function = ir.FunctionType(kind.llvm, [kind.llvm] * 3)
        muladd = utils.get_or_insert_function(
            builder.module, function, f"llvm.fmuladd.v{kind.count}{width}"
        )
        return builder.call(
            muladd,
            [_spread(context, builder, *pair, kind) for pair in zip(given, (x, y, z), strict=True)],
        )

    return kind(x, y, z), code


def _pointer(context: Any, builder: Any, signature: Any, given: Any, kind: Vector) -> Any:
    """To 64 bytes of an array."""
    data = arrayobj.make_array(signature.args[0])(context, builder, given[0]).data
    row = context.cast(builder, given[1], signature.args[1], types.intp)
    return builder.gep(builder.bitcast(data, kind.llvm.as_pointer()), [row])


def _spread(context: Any, builder: Any, value: Any, kind: Any, wanted: Vector) -> Any:
    """`value` itself, or a number in all lanes."""
    if isinstance(kind, Vector):
        return value
    number = context.cast(builder, value, kind, wanted.element)
    zero = ir.Constant(ir.IntType(32), 0)
    first = builder.insert_element(ir.Constant(wanted.llvm, ir.Undefined), number, zero)
    everywhere = ir.Constant(ir.VectorType(ir.IntType(32), wanted.count), [0] * wanted.count)
    return builder.shuffle_vector(first, ir.Constant(wanted.llvm, ir.Undefined), everywhere)


def _operator(python: Any, llvm: str) -> None:
    @intrinsic
    def lanewise(typing: Any, x: Any, y: Any) -> Any:
        kind = x if isinstance(x, Vector) else y

        def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            values = [
                _spread(context, builder, *pair, kind) for pair in zip(given, (x, y), strict=True)
            ]
            return getattr(builder, llvm)(*values, flags=FLAGS)

        return kind(x, y), code

    @overload(python, strict=False)  # annotations of `found` are no part of its signature
    def found(x: Any, y: Any) -> Any:
        if any(isinstance(given, Vector) for given in (x, y)):
            return lambda x, y: lanewise(x, y)
        return None


for _python, _llvm in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _operator(_python, _llvm)
