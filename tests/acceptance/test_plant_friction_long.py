"""Set-valued friction: the box problem against brute force, and motion against closed forms."""

from itertools import product
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.model.friction import stick_two


def brute_force(v, w, levels):
    """The one of the nine combinations of stick and slide that is consistent."""
    for modes in product((-1, 0, 1), repeat=2):
        f = [mode * level for mode, level in zip(modes, levels, strict=True)]
        loose = [k for k in (0, 1) if modes[k] == 0]
        if loose:
            rest = [-v[k] - sum(w[k][j] * f[j] for j in (0, 1) if j not in loose) for k in loose]
            for k, force in zip(
                loose, np.linalg.solve([[w[k][j] for j in loose] for k in loose], rest), strict=True
            ):
                f[k] = force
        after = [v[k] + w[k][0] * f[0] + w[k][1] * f[1] for k in (0, 1)]
        held = all(abs(f[k]) <= levels[k] * (1 + 1e-12) for k in loose)
        if held and all(after[k] * modes[k] <= 1e-15 for k in (0, 1)):
            return f
    raise AssertionError("no consistent combination")


@settings(derandomize=True, max_examples=400)
@given(
    v=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    share=st.floats(0.0, 0.99),
    ratio=st.floats(0.1, 10.0),
    levels=st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 0.5)),
)
def test_two_contacts_equal_brute_force(v, share, ratio, levels):
    w12 = share * sqrt(ratio)
    w = ((1.0, w12), (w12, ratio))
    f = stick_two(*v, *w[0], *w[1], *levels)
    assert f == pytest.approx(brute_force(v, w, levels), abs=1e-9)
