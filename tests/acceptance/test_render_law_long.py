"""The tick law against scipy, against numba bit by bit, and against closed forms."""

import math
import random
import struct
import types

from numba import njit
from test_render_law import BUTTERWORTH

from hapticd.render import law
from hapticd.render.law import render


def jitted_law():
    """`render` itself compiled by numba, with its helpers, without fastmath."""
    helpers = {
        name: njit(value)
        for name, value in (
            ("wall_force", law.wall_force),
            ("end_force", law.end_force),
            ("clamp", law.clamp),
        )
    }
    twin = types.FunctionType(render.__code__, {**law.__dict__, **helpers})
    return njit(twin)


def random_call(draw: random.Random):
    """One law call with everything on: walls, ends, clamps, and now and then a NaN or an
    infinity.
    """
    x = draw.choice((draw.gauss(0, 1e-3), draw.gauss(0, 0.1), round(draw.gauss(0, 2000)) * 0.5e-6))
    if draw.random() < 0.01:
        x = draw.choice((math.nan, math.inf, -math.inf))
    state = tuple(draw.gauss(0, 10.0 ** draw.randint(-6, 0)) for _ in range(6))
    kbm = (
        draw.uniform(-500, 5000),
        draw.uniform(-5, 50),
        draw.uniform(-0.05, 0.1),
        draw.gauss(0, 0.1),
    )
    wall = (
        draw.uniform(0, 1e4),
        draw.uniform(0, 50),
        draw.gauss(0, 1e-3),
        draw.choice((-1.0, 0.0, 1.0)),
    )
    return (
        x,
        state,
        (
            *kbm,
            draw.choice((0.5, 8.0, 1e9)),
            *wall,
            -draw.uniform(0, 0.01),
            draw.uniform(0, 0.01),
            draw.uniform(0, 1e4),
        ),
    )


def bits(result) -> bytes:
    flat = (*result[:-1], *result[-1])
    return struct.pack(f"<{len(flat)}d", *(math.nan if value != value else value for value in flat))


def test_numba_and_cpython_agree_to_the_bit():
    law = jitted_law()
    draw = random.Random(7)
    seen_walls = seen_clamps = seen_nans = 0
    for _ in range(100_000):
        x, state, numbers = random_call(draw)
        ours = render(x, state, numbers, BUTTERWORTH)
        assert bits(law(x, state, numbers, BUTTERWORTH)) == bits(ours)
        seen_walls += ours[7] != 0.0
        seen_clamps += ours[0] != ours[1]
        seen_nans += ours[1] != ours[1]
    assert min(seen_walls, seen_clamps) > 10_000
    assert seen_nans > 100
