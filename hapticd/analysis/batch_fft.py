"""The FFT of sections of 2,048 samples for 16 trials at once, and the sums over it for
`batch_spectra`. It needs numba and llvmlite and is imported by `batch_spectra` alone.

Vectors. numba leaves it to LLVM whether a loop becomes vector instructions; a transform with its
strides and many arrays loses that game. Here a vector of 64 bytes, 16 float32 or 8 float64, stays
in one register, or in a few where registers are smaller. Each of its lanes is a trial, so the text
of a scalar algorithm does 16 trials at once, whatever LLVM thinks of its loops:

    load(a, row)        the vector of the flat array `a` that begins at byte 64 row
    store(a, row, v)    store the vector v there
    + - *               lane by lane, with vectors or a number
    fma(x, y, z)        x y + z

Transforms. A section of real samples x, padded to 4,096, is a complex series z[n] = x[2n] + i
x[2n+1] of 2,048 points, half of them zero:

    columns    b = 0..63:  DFT of 32 points (16 of them zero) over n = 64 a + b,
               times exp(-2 pi i b k1 / 2048)  -> row k1
    row        k1 = 0..32: DFT of 64 points over b  -> Z[k1 + 32 k2]
    take       Z[k] and Z[2048-k] -> X[k] and X[2048-k] of the real series -> sums over sections

Rows k1 and 32 - k1 are transformed together and summed at once, so spectra never leave the
first-level cache. What one trial gets does not depend on its neighbours in the vector.

What would break it: arrays that do not begin on a border of 64 bytes (`arrays.aligned` makes those
that do), or llvmlite without typed pointers in its IR builder.
"""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, njit, types
from numba.core import cgutils
from numba.extending import models, overload, register_model
from numba.np import arrayobj as arrays

from hapticd.analysis.arrays import CACHE_LINE

arrayobj: Any = arrays  # neither module is typed
utils: Any = cgutils
FLAGS = ("contract", "nsz")
LLVM = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}

PITCH = 65  # of a row: not a power of two, whose lines would fall on the same places of the cache
# vectors of an intermediate section, of a row
WORK = 2 * 32 * PITCH
PART = 2 * 64
# vectors of a pair of bins: for each bin velocity, forward, backward (complex), and the spectrum
# before
KEPT = 16
PAIRS = 1025  # of bins k and 2048 - k
ROOT_HALF = float(np.sqrt(0.5))


def intrinsic(code: Callable[..., Any]) -> Any:
    """numba's decorator of the same name, typed as its user sees it: without the first argument."""
    return extending.intrinsic(code)


class Vector(types.Type):
    """numba's type of a vector of `element`, as many as fit into 64 bytes."""

    def __init__(self, element: Any) -> None:
        self.element = element
        self.count = 8 * CACHE_LINE // element.bitwidth
        super().__init__(name=f"Vector({element})")

    @property
    def llvm(self) -> Any:
        """The LLVM type of such a vector."""
        return ir.VectorType(LLVM[self.element], self.count)


@register_model(Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, kind.llvm)  # type: ignore[no-untyped-call]


@intrinsic
def load(typing: Any, array: Any, row: Any) -> Any:
    """Load the vector at `row` of the flat array `array` (see the module)."""
    kind = Vector(array.dtype)

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        value = builder.load(_pointer(context, builder, signature, given, kind))
        value.align = CACHE_LINE
        return value

    return kind(array, row), code


@intrinsic
def store(typing: Any, array: Any, row: Any, value: Any) -> Any:
    """Store `value` at `row` of the flat array `array` (see the module)."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        builder.store(
            given[2], _pointer(context, builder, signature, given, value)
        ).align = CACHE_LINE
        return context.get_dummy_value()

    return types.void(array, row, value), code


@intrinsic
def fma(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute x y + z; at least one of the three is a vector, numbers are spread over its lanes."""
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
    """Return the pointer to the 64 bytes at a row of an array."""
    data = arrayobj.make_array(signature.args[0])(context, builder, given[0]).data
    row = context.cast(builder, given[1], signature.args[1], types.intp)
    return builder.gep(builder.bitcast(data, kind.llvm.as_pointer()), [row])


def _spread(context: Any, builder: Any, value: Any, kind: Any, wanted: Vector) -> Any:
    """Return `value` itself if it is a vector, else a vector with that number in all lanes."""
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


def twiddles() -> tuple[Any, ...]:
    """Return exp(-2 pi i j k / n) as arrays (j, k, 2) of real and imaginary part, for n = 32, 64
    and 2,048.
    """

    def turns(points: int, rows: int, columns: int) -> Any:
        turn = np.exp(-2j * np.pi * np.outer(np.arange(rows), np.arange(columns)) / points)
        return np.stack((turn.real, turn.imag), axis=-1)

    return turns(32, 4, 8), turns(64, 8, 8), turns(2048, 64, 32)


def pair_order() -> tuple[Any, Any]:
    """Return (first, count) of the pairs of each k1 = 0..16, and the lower bin k (PAIRS,) of
    each pair; the upper one is 2048 - k.
    """
    counts = [33, *[64] * 15, 32]
    first = np.concatenate(([0], np.cumsum(counts)[:-1]))
    bins = np.concatenate([k1 + 32 * np.arange(count) for k1, count in enumerate(counts)])
    return np.stack((first, counts), axis=1), bins


@njit(forceinline=True)
def _dft8(  # type: ignore[no-untyped-def]
    a0, b0, a1, b1, a2, b2, a3, b3, a4, b4, a5, b5, a6, b6, a7, b7
):
    """Transform 8 points, real part a and imaginary part b, in natural order."""
    p0 = a0 + a4
    q0 = b0 + b4
    p4 = a0 - a4
    q4 = b0 - b4
    p1 = a1 + a5
    q1 = b1 + b5
    p5 = a1 - a5
    q5 = b1 - b5
    p2 = a2 + a6
    q2 = b2 + b6
    p6 = a2 - a6
    q6 = b2 - b6
    p3 = a3 + a7
    q3 = b3 + b7
    p7 = a3 - a7
    q7 = b3 - b7
    r0 = p0 + p2
    s0 = q0 + q2
    r2 = p0 - p2
    s2 = q0 - q2
    r1 = p1 + p3
    s1 = q1 + q3
    r3 = p1 - p3
    s3 = q1 - q3
    t0 = p4 + q6
    u0 = q4 - p6
    t1 = p4 - q6
    u1 = q4 + p6
    v0 = p5 + q7
    w0 = q5 - p7
    v1 = p5 - q7
    w1 = q5 + p7
    h = ROOT_HALF
    e = (v0 + w0) * h
    f = (w0 - v0) * h
    g = (w1 - v1) * h
    k = (v1 + w1) * h
    return (
        r0 + r1, s0 + s1, t0 + e, u0 + f, r2 + s3, s2 - r3, t1 + g, u1 - k,
        r0 - r1, s0 - s1, t0 - e, u0 - f, r2 - s3, s2 + r3, t1 - g, u1 + k,
    )  # fmt: skip


@njit(forceinline=True)
def _turned(target, row, x, y, c, s):  # type: ignore[no-untyped-def]
    """Store (x + i y) (c + i s)."""
    store(target, 2 * row, x * c - y * s)
    store(target, 2 * row + 1, fma(y, c, x * s))


@njit(forceinline=True)
def _kept(target, row, x, y):  # type: ignore[no-untyped-def]
    store(target, 2 * row, x)
    store(target, 2 * row + 1, y)


@njit(forceinline=True)
def _eight(source, row, step):  # type: ignore[no-untyped-def]
    """Transform 8 complex values that are `step` rows apart."""
    i = 2 * row
    d = 2 * step
    return _dft8(
        load(source, i),
        load(source, i + 1),
        load(source, i + d),
        load(source, i + d + 1),
        load(source, i + 2 * d),
        load(source, i + 2 * d + 1),
        load(source, i + 3 * d),
        load(source, i + 3 * d + 1),
        load(source, i + 4 * d),
        load(source, i + 4 * d + 1),
        load(source, i + 5 * d),
        load(source, i + 5 * d + 1),
        load(source, i + 6 * d),
        load(source, i + 6 * d + 1),
        load(source, i + 7 * d),
        load(source, i + 7 * d + 1),
    )


@njit(nogil=True)
def columns(samples, place, offset, work, part, by32, by2048):  # type: ignore[no-untyped-def]
    """Do the first half of a section's transform; sample t of the section is vector place[t] +
    offset of `samples`.
    """
    for b in range(64):
        for a in range(8):
            n = 2 * (64 * a + b)
            xr = load(samples, place[n] + offset)
            xi = load(samples, place[n + 1] + offset)
            yr = load(samples, place[n + 1024] + offset)
            yi = load(samples, place[n + 1025] + offset)
            _kept(part, a, xr + yr, xi + yi)
            _turned(part, 8 + a, xr + yi, xi - yr, by32[1, a, 0], by32[1, a, 1])
            _turned(part, 16 + a, xr - yr, xi - yi, by32[2, a, 0], by32[2, a, 1])
            _turned(part, 24 + a, xr - yi, xi + yr, by32[3, a, 0], by32[3, a, 1])
        for j in range(4):
            x0, y0, x1, y1, x2, y2, x3, y3, x4, y4, x5, y5, x6, y6, x7, y7 = _eight(part, 8 * j, 1)
            _turned(work, j * PITCH + b, x0, y0, by2048[b, j, 0], by2048[b, j, 1])
            _turned(work, (j + 4) * PITCH + b, x1, y1, by2048[b, j + 4, 0], by2048[b, j + 4, 1])
            _turned(work, (j + 8) * PITCH + b, x2, y2, by2048[b, j + 8, 0], by2048[b, j + 8, 1])
            _turned(work, (j + 12) * PITCH + b, x3, y3, by2048[b, j + 12, 0], by2048[b, j + 12, 1])
            _turned(work, (j + 16) * PITCH + b, x4, y4, by2048[b, j + 16, 0], by2048[b, j + 16, 1])
            _turned(work, (j + 20) * PITCH + b, x5, y5, by2048[b, j + 20, 0], by2048[b, j + 20, 1])
            _turned(work, (j + 24) * PITCH + b, x6, y6, by2048[b, j + 24, 0], by2048[b, j + 24, 1])
            _turned(work, (j + 28) * PITCH + b, x7, y7, by2048[b, j + 28, 0], by2048[b, j + 28, 1])


@njit(nogil=True)
def row(work, k1, part, out, by64):  # type: ignore[no-untyped-def]
    """Do the second half for one k1: Z[k1 + 32 k2] into rows k2 of `out`."""
    for b in range(8):
        x0, y0, x1, y1, x2, y2, x3, y3, x4, y4, x5, y5, x6, y6, x7, y7 = _eight(
            work, k1 * PITCH + b, 8
        )
        _kept(part, b, x0, y0)
        _turned(part, 8 + b, x1, y1, by64[1, b, 0], by64[1, b, 1])
        _turned(part, 16 + b, x2, y2, by64[2, b, 0], by64[2, b, 1])
        _turned(part, 24 + b, x3, y3, by64[3, b, 0], by64[3, b, 1])
        _turned(part, 32 + b, x4, y4, by64[4, b, 0], by64[4, b, 1])
        _turned(part, 40 + b, x5, y5, by64[5, b, 0], by64[5, b, 1])
        _turned(part, 48 + b, x6, y6, by64[6, b, 0], by64[6, b, 1])
        _turned(part, 56 + b, x7, y7, by64[7, b, 0], by64[7, b, 1])
    for q in range(8):
        x0, y0, x1, y1, x2, y2, x3, y3, x4, y4, x5, y5, x6, y6, x7, y7 = _eight(part, 8 * q, 1)
        _kept(out, q, x0, y0)
        _kept(out, q + 8, x1, y1)
        _kept(out, q + 16, x2, y2)
        _kept(out, q + 24, x3, y3)
        _kept(out, q + 32, x4, y4)
        _kept(out, q + 40, x5, y5)
        _kept(out, q + 48, x6, y6)
        _kept(out, q + 56, x7, y7)


@njit(forceinline=True)
def _bin(sums, at, before, xr, xi, sign, gr, gi, hr, hi):  # type: ignore[no-untyped-def]
    """Add a section's X[k] = xr + i xi to the sums of its bin: velocity with what came before,
    force ahead and behind.
    """
    pr = load(sums, before)
    pi = load(sums, before + 1)
    tr = fma(xr, sign, pr)
    ti = fma(xi, sign, pi)
    store(sums, at, fma(pr, tr, fma(pi, ti, load(sums, at))))
    store(sums, at + 1, load(sums, at + 1) + (pr * ti - pi * tr))
    store(sums, at + 2, fma(xr, gr, fma(xi, gi, load(sums, at + 2))))
    store(sums, at + 3, load(sums, at + 3) + (xr * gi - xi * gr))
    store(sums, at + 4, fma(xr, hr, fma(xi, hi, load(sums, at + 4))))
    store(sums, at + 5, load(sums, at + 5) + (xr * hi - xi * hr))
    store(sums, before, xr)
    store(sums, before + 1, xi)


@njit(nogil=True)
def take(lower, upper, k1, first, count, sums, force, turn):  # type: ignore[no-untyped-def]
    """Sum the pairs of one k1 and its partner. `force` (PAIRS, 8) holds for each bin Y of this
    section with the one after it, and with the one before it.
    """
    one = force[0, 0] * 0 + 1
    sign = one if k1 % 2 == 0 else -one
    for k2 in range(count):
        other = (64 - k2) % 64 if k1 == 0 else 63 - k2
        p = first + k2
        zr = load(lower, 2 * k2)
        zi = load(lower, 2 * k2 + 1)
        vr = load(upper, 2 * other)
        vi = load(upper, 2 * other + 1)
        er = zr + vr
        ei = zi - vi
        dr = zi + vi
        di = vr - zr
        c = turn[p, 0]
        s = turn[p, 1]
        wr = dr * c - di * s
        wi = fma(di, c, dr * s)
        f = force[p]
        _bin(sums, KEPT * p, KEPT * p + 12, er + wr, ei + wi, sign, f[0], f[1], f[2], f[3])
        _bin(sums, KEPT * p + 6, KEPT * p + 14, er - wr, wi - ei, sign, f[4], f[5], f[6], f[7])


@njit(nogil=True, cache=True)
def add_sections(  # type: ignore[no-untyped-def]
    samples, place, sums, force, work, part, lower, upper, by32, by64, by2048, turn, order
):
    """Add sections of the trials of every vector to their `sums` (vectors, PAIRS * KEPT * 16):
    sample t of section n is vector place[n, t] + its own number. `force` (n, PAIRS, 8): see `take`.
    """
    for vector in range(len(sums)):
        # section by section: the vector's sums, 1 MB, stay in the second-level cache meanwhile
        for n in range(len(place)):
            columns(samples, place[n], vector, work, part, by32, by2048)
            for k1 in range(17):
                row(work, k1, part, lower, by64)
                partner = (32 - k1) % 32
                if partner != k1:
                    row(work, partner, part, upper, by64)
                take(
                    lower,
                    lower if partner == k1 else upper,
                    k1,
                    order[k1, 0],
                    order[k1, 1],
                    sums[vector],
                    force[n],
                    turn,
                )


@njit(nogil=True, cache=True)
def moments(samples, place, vectors, found):  # type: ignore[no-untyped-def]
    """Write the sums of x, t x and x^2 over each section of every vector into `found` (n, 3,
    vectors, 16), flat; t counts from the beginning of the section.
    """
    for n in range(len(place)):
        for vector in range(vectors):
            x = load(samples, place[n, 0] + vector)
            total = x
            moment = x * 0.0
            square = x * x
            for t in range(1, place.shape[1]):
                x = load(samples, place[n, t] + vector)
                total = total + x
                moment = fma(x, t, moment)
                square = fma(x, x, square)
            store(found, 3 * n * vectors + vector, total)
            store(found, (3 * n + 1) * vectors + vector, moment)
            store(found, (3 * n + 2) * vectors + vector, square)
