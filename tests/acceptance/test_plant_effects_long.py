"""Effects one by one: closed forms of shaped damping, its passivity, and that it costs nothing
where it is not; motor figures of the paper, and copper.
"""

from math import tau

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_plant_effects import LEVEL, added, ideal, shaped_impedance


@given(
    st.floats(0.01, 2000.0),
    st.sampled_from([0.0, 0.3, 7.0, 90.0, 1e3]),
    st.sampled_from([0.0, 0.5, 12.0, 200.0, 5e3]),
)
def test_shaped_damper_alone_is_passive(hz, highpass_hz, lowpass_hz):
    """And Re Z is what the closed forms of the module say."""
    w = tau * hz
    low = tau * highpass_hz
    high = tau * lowpass_hz
    z = shaped_impedance(LEVEL, hz, highpass_hz, lowpass_hz)
    if low and high:
        real = (
            LEVEL
            * high
            * w**2
            * (low + high)
            / ((low * high - w**2) ** 2 + w**2 * (low + high) ** 2)
        )
    else:
        real = (
            LEVEL
            * (w**2 / (w**2 + low**2) if low else 1.0)
            * (high**2 / (w**2 + high**2) if high else 1.0)
        )
    assert z.real == pytest.approx(real, rel=1e-9)
    assert z.real > 0.0
    assert added(ideal(highpass_hz, lowpass_hz), hz).real == pytest.approx(real, rel=1e-6, abs=1e-9)
