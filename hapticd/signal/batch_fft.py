"""FFT of sections of 2,048 samples for 16 trials at once, and the sums over them for
`batch_spectra`, the only module that imports it. It needs numba and llvmlite.

Vectors. numba leaves vectorisation to LLVM, which fails for a transform with its strides and many
arrays. Here a vector of 64 bytes, 16 float32 or 8 float64, stays in one register, or in a few where
registers are smaller. Each of its lanes is a trial, so scalar code processes 16 trials at once and
does not depend on LLVM's loop vectoriser:

    load(a, row)        the vector of the flat array `a` that begins at byte 64 row
    store(a, row, v)    store the vector v there
    + - *               lane by lane, with vectors or a number
    fma(x, y, z)        x y + z

Transforms. A section of real samples x, padded to 4,096, is a complex series z[n] = x[2n] + i
x[2n+1] of 2,048 points, half of them zero:

    gather     copy the interleaved samples of the trials into contiguous sections
    _columns   b = 0..63:  DFT of 32 points (16 of them zero) over n = 64 a + b,
               times exp(-2 pi i b k1 / 2048)  -> row k1
    _row       k1 = 0..32: DFT of 64 points over b  -> Z[k1 + 32 k2]
    _take      Z[k] and Z[2048-k] -> X[k] and X[2048-k] of the real series -> sums over sections

Caches. Arithmetic alone would take a quarter of the time of a trial; the rest is memory traffic.
The sums of a vector take 1 MB. All pending sections are therefore summed for one vector before the
next. Even k1, which need half of the sums, come before odd ones, and each sum is loaded once for
two sections. Rows k1 and 32 - k1 are transformed in place and summed at once, while they are in the
first-level cache. The result of a trial does not depend on its neighbours in the vector.

Arrays must be aligned to 64 bytes (`arrays.aligned` makes such arrays), and llvmlite must have
typed pointers in its IR builder.
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

from hapticd.core.arrays import CACHE_LINE

arrayobj: Any = arrays  # neither module is typed
utils: Any = cgutils
FLAGS = ("contract", "nsz")
LLVM = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}

PITCH = 65  # of a row; a power of two would map all rows to the same cache lines
# vectors of half an intermediate section, of half a column
WORK = 2 * 16 * PITCH
PART = 2 * 16
# vectors of a pair of bins: for each bin velocity, forward, backward (complex), and the spectrum
# before
KEPT = 16
PAIRS = 1025  # of bins k and 2048 - k
AT_ONCE = 2  # sections for which the sums are loaded and stored once
ROOT_HALF = float(np.sqrt(0.5))


def intrinsic(code: Callable[..., Any]) -> Any:
    """numba's decorator of the same name, typed as its user sees it: without the first argument."""
    return extending.intrinsic(code)


class Vector(types.Type):
    """numba's type of a vector of `element` that fills 64 bytes."""

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
    """Return x y + z; at least one of the three is a vector; numbers are spread over its lanes."""
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
    """Return `value` itself if it is a vector, otherwise a vector with that number in all lanes."""
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

    @overload(python, strict=False)  # annotations of `found` are not part of its signature
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
def _butterfly(a, b, c, d):  # type: ignore[no-untyped-def]
    """Transform 2 points, a + i b and c + i d."""
    return a + c, b + d, a - c, b - d


@njit(forceinline=True)
def _dft8(  # type: ignore[no-untyped-def]
    a0, b0, a1, b1, a2, b2, a3, b3, a4, b4, a5, b5, a6, b6, a7, b7
):
    """Transform 8 points, real part a and imaginary part b, in natural order."""
    p0, q0, p4, q4 = _butterfly(a0, b0, a4, b4)
    p1, q1, p5, q5 = _butterfly(a1, b1, a5, b5)
    p2, q2, p6, q6 = _butterfly(a2, b2, a6, b6)
    p3, q3, p7, q7 = _butterfly(a3, b3, a7, b7)
    r0, s0, r2, s2 = _butterfly(p0, q0, p2, q2)
    r1, s1, r3, s3 = _butterfly(p1, q1, p3, q3)
    t0, u1, t1, u0 = _butterfly(p4, q4, q6, p6)
    v0, w1, v1, w0 = _butterfly(p5, q5, q7, p7)
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
def _columns(section, odd, work, part, by32, by2048):  # type: ignore[no-untyped-def]
    """Compute the first half of a section's transform for the even k1, or for the odd ones."""
    for b in range(64):
        for a in range(8):
            n = 2 * (64 * a + b)
            xr = load(section, n)
            xi = load(section, n + 1)
            yr = load(section, n + 1024)
            yi = load(section, n + 1025)
            if odd:
                _turned(part, a, xr + yi, xi - yr, by32[1, a, 0], by32[1, a, 1])
                _turned(part, 8 + a, xr - yi, xi + yr, by32[3, a, 0], by32[3, a, 1])
            else:
                _kept(part, a, xr + yr, xi + yi)
                _turned(part, 8 + a, xr - yr, xi - yi, by32[2, a, 0], by32[2, a, 1])
        for i in range(2):
            j = 2 * i + odd
            x0, y0, x1, y1, x2, y2, x3, y3, x4, y4, x5, y5, x6, y6, x7, y7 = _eight(part, 8 * i, 1)
            _turned(work, i * PITCH + b, x0, y0, by2048[b, j, 0], by2048[b, j, 1])
            _turned(work, (i + 2) * PITCH + b, x1, y1, by2048[b, j + 4, 0], by2048[b, j + 4, 1])
            _turned(work, (i + 4) * PITCH + b, x2, y2, by2048[b, j + 8, 0], by2048[b, j + 8, 1])
            _turned(work, (i + 6) * PITCH + b, x3, y3, by2048[b, j + 12, 0], by2048[b, j + 12, 1])
            _turned(work, (i + 8) * PITCH + b, x4, y4, by2048[b, j + 16, 0], by2048[b, j + 16, 1])
            _turned(work, (i + 10) * PITCH + b, x5, y5, by2048[b, j + 20, 0], by2048[b, j + 20, 1])
            _turned(work, (i + 12) * PITCH + b, x6, y6, by2048[b, j + 24, 0], by2048[b, j + 24, 1])
            _turned(work, (i + 14) * PITCH + b, x7, y7, by2048[b, j + 28, 0], by2048[b, j + 28, 1])


@njit(nogil=True)
def _row(work, at, by64):  # type: ignore[no-untyped-def]
    """Compute the second half in place for the row that begins at `at`: Z[k1 + 32 k2] is left at 8
    (k2 mod 8) + k2 // 8.
    """
    for b in range(8):
        x0, y0, x1, y1, x2, y2, x3, y3, x4, y4, x5, y5, x6, y6, x7, y7 = _eight(work, at + b, 8)
        _kept(work, at + b, x0, y0)
        _turned(work, at + 8 + b, x1, y1, by64[1, b, 0], by64[1, b, 1])
        _turned(work, at + 16 + b, x2, y2, by64[2, b, 0], by64[2, b, 1])
        _turned(work, at + 24 + b, x3, y3, by64[3, b, 0], by64[3, b, 1])
        _turned(work, at + 32 + b, x4, y4, by64[4, b, 0], by64[4, b, 1])
        _turned(work, at + 40 + b, x5, y5, by64[5, b, 0], by64[5, b, 1])
        _turned(work, at + 48 + b, x6, y6, by64[6, b, 0], by64[6, b, 1])
        _turned(work, at + 56 + b, x7, y7, by64[7, b, 0], by64[7, b, 1])
    for q in range(at, at + 64, 8):
        x0, y0, x1, y1, x2, y2, x3, y3, x4, y4, x5, y5, x6, y6, x7, y7 = _eight(work, q, 1)
        _kept(work, q, x0, y0)
        _kept(work, q + 1, x1, y1)
        _kept(work, q + 2, x2, y2)
        _kept(work, q + 3, x3, y3)
        _kept(work, q + 4, x4, y4)
        _kept(work, q + 5, x5, y5)
        _kept(work, q + 6, x6, y6)
        _kept(work, q + 7, x7, y7)


@njit(forceinline=True)
def _added(sums, pr, pi, xr, xi, sign, force, n, p, first):  # type: ignore[no-untyped-def]
    """Add section n's X[k] = xr + i xi to the sums of its bin: velocity with the section before,
    force ahead and behind, force[n, p, first : first + 4].
    """
    vr, vi, ar, ai, br, bi = sums
    gr = force[n, p, first]
    gi = force[n, p, first + 1]
    hr = force[n, p, first + 2]
    hi = force[n, p, first + 3]
    tr = fma(xr, sign, pr)
    ti = fma(xi, sign, pi)
    return (
        fma(pr, tr, fma(pi, ti, vr)),
        vi + (pr * ti - pi * tr),
        fma(xr, gr, fma(xi, gi, ar)),
        ai + (xr * gi - xi * gr),
        fma(xr, hr, fma(xi, hi, br)),
        bi + (xr * hi - xi * hr),
    )


@njit(forceinline=True)
def _six(sums, at):  # type: ignore[no-untyped-def]
    """Load the sums of a bin."""
    return (
        load(sums, at),
        load(sums, at + 1),
        load(sums, at + 2),
        load(sums, at + 3),
        load(sums, at + 4),
        load(sums, at + 5),
    )


@njit(forceinline=True)
def _put(sums, at, six):  # type: ignore[no-untyped-def]
    """Store the sums of a bin."""
    vr, vi, ar, ai, br, bi = six
    store(sums, at, vr)
    store(sums, at + 1, vi)
    store(sums, at + 2, ar)
    store(sums, at + 3, ai)
    store(sums, at + 4, br)
    store(sums, at + 5, bi)


@njit(nogil=True)
def _take(work, lower, upper, k1, first, pairs, sums, force, turn):  # type: ignore[no-untyped-def]
    """Sum the pairs of one k1, whose rows begin at `lower`, and its partner, `upper`, over the
    sections in `work`. `force` (sections, PAIRS, 8) holds for each bin Y of a section with the one
    after it, and with the one before it.
    """
    one = force[0, 0, 0] * 0 + 1
    sign = one if k1 % 2 == 0 else -one
    for k2 in range(pairs):
        other = (64 - k2) % 64 if k1 == 0 else 63 - k2
        p = first + k2
        c = turn[p, 0]
        s = turn[p, 1]
        low = _six(sums, KEPT * p)
        high = _six(sums, KEPT * p + 6)
        lr = load(sums, KEPT * p + 12)
        li = load(sums, KEPT * p + 13)
        hr = load(sums, KEPT * p + 14)
        hi = load(sums, KEPT * p + 15)
        for n in range(len(force)):
            z = WORK * n + 2 * (lower + 8 * (k2 % 8) + k2 // 8)
            v = WORK * n + 2 * (upper + 8 * (other % 8) + other // 8)
            zr = load(work, z)
            zi = load(work, z + 1)
            vr = load(work, v)
            vi = load(work, v + 1)
            er = zr + vr
            ei = zi - vi
            dr = zi + vi
            di = vr - zr
            wr = dr * c - di * s
            wi = fma(di, c, dr * s)
            xr = er + wr
            xi = ei + wi
            low = _added(low, lr, li, xr, xi, sign, force, n, p, 0)
            lr = xr
            li = xi
            xr = er - wr
            xi = wi - ei
            high = _added(high, hr, hi, xr, xi, sign, force, n, p, 4)
            hr = xr
            hi = xi
        _put(sums, KEPT * p, low)
        _put(sums, KEPT * p + 6, high)
        store(sums, KEPT * p + 12, lr)
        store(sums, KEPT * p + 13, li)
        store(sums, KEPT * p + 14, hr)
        store(sums, KEPT * p + 15, hi)


@njit(nogil=True, cache=True)
def gather(samples, place, waiting, number, moments):  # type: ignore[no-untyped-def]
    """Copy a section of every vector, whose sample t is vector place[t] + its own number, to
    waiting[:, number] (vectors, sections, 2048 * 16), and the sums of x, t x and x^2 over it to
    `moments` (vectors, 3 * 16); t counts from the section's beginning.
    """
    for vector in range(len(waiting)):
        section = waiting[vector, number]
        total = load(samples, place[0] + vector) * 0.0
        moment = total
        square = total
        for t in range(len(place)):
            x = load(samples, place[t] + vector)
            store(section, t, x)
            total = total + x
            moment = fma(x, t, moment)
            square = fma(x, x, square)
        store(moments[vector], 0, total)
        store(moments[vector], 1, moment)
        store(moments[vector], 2, square)


@njit(nogil=True, cache=True)
def add_sections(  # type: ignore[no-untyped-def]
    waiting, count, sums, force, work, part, by32, by64, by2048, turn, order
):
    """Add the first `count` pending sections to the `sums` of every vector (vectors, PAIRS * KEPT *
    16). `force` (count, PAIRS, 8): see `_take`.
    """
    for vector in range(len(sums)):
        for odd in range(2):
            for begin in range(0, count, AT_ONCE):
                end = min(begin + AT_ONCE, count)
                for n in range(begin, end):
                    _columns(waiting[vector, n], odd, work[n - begin], part, by32, by2048)
                for k1 in range(odd, 17, 2):
                    lower = (k1 // 2) * PITCH
                    upper = ((32 - k1) % 32 // 2) * PITCH
                    for n in range(end - begin):
                        _row(work[n], lower, by64)
                        if upper != lower:
                            _row(work[n], upper, by64)
                    _take(
                        work.reshape(-1),
                        lower,
                        upper,
                        k1,
                        order[k1, 0],
                        order[k1, 1],
                        sums[vector],
                        force[begin:end],
                        turn,
                    )
