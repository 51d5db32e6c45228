"""Filter design against scipy and against the continuous prototype."""

import math
import re

import numpy as np
import pytest
from scipy import signal

from hapticd.core.errors import ConfigError
from hapticd.render.law import design, scaled, steady


@pytest.mark.parametrize(
    ("corner_hz", "rate_hz"), [(100.0, 1000.0), (72.0, 1000.0), (10.0, 8000.0), (450.0, 1000.0)]
)
def test_default_design_is_scipy_butterworth(corner_hz, rate_hz):
    b, a = signal.butter(2, corner_hz, fs=rate_hz)
    assert design(corner_hz, math.sqrt(0.5), "prewarped", rate_hz) == pytest.approx(
        (*b, *a[1:]), rel=1e-12, abs=1e-14
    )


@pytest.mark.parametrize("zeta", [0.3, 0.7071, 1.0, 1.63])
def test_plain_bilinear_equals_scipy(zeta):
    w = 2 * math.pi * 100.0
    b, a = signal.bilinear([w * w], [1.0, 2 * zeta * w, w * w], fs=1000.0)
    assert design(100.0, zeta, "bilinear", 1000.0) == pytest.approx((*b, *a[1:]), rel=1e-12)


@pytest.mark.parametrize("zeta", [0.3, 1.0, 1.63])
def test_matched_poles_are_the_sampled_continuous_poles(zeta):
    w = 2 * math.pi * 100.0
    continuous = np.roots([1.0, 2 * zeta * w, w * w])
    *b, a1, a2 = design(100.0, zeta, "matched", 1000.0)
    expected = np.poly(np.exp(continuous / 1000.0)).real
    assert (1.0, a1, a2) == pytest.approx(tuple(expected), rel=1e-9)
    assert sum(b) == pytest.approx(1.0 + a1 + a2)


@pytest.mark.parametrize("mapping", ["prewarped", "bilinear", "matched"])
def test_gain_is_one_at_dc(mapping):
    b0, b1, b2, a1, a2 = design(72.0, 0.9, mapping, 1000.0)
    assert (b0 + b1 + b2) / (1 + a1 + a2) == pytest.approx(1.0, rel=1e-12)


def test_prewarped_corner_is_three_decibels_down():
    *b, a1, a2 = design(100.0, math.sqrt(0.5), "prewarped", 1000.0)
    _, h = signal.freqz(b, [1, a1, a2], worN=[100.0], fs=1000.0)
    assert abs(h[0]) == pytest.approx(math.sqrt(0.5), rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            (500.0, 0.7, "prewarped", 1000.0),
            "filter corner 500.0 Hz: must lie between 0 and 500.0 Hz, half the servo rate",
        ),
        ((0.0, 0.7, "prewarped", 1000.0), "filter corner 0.0 Hz: must lie"),
        ((math.nan, 0.7, "prewarped", 1000.0), "filter corner nan Hz"),
        (
            (100.0, 0.0, "prewarped", 1000.0),
            "damping ratio 0.0: must lie between 0 and 100; 0.7071 is Butterworth",
        ),
        (
            (100.0, 0.7, "magic", 1000.0),
            "filter mapping 'magic': use one of prewarped, bilinear, matched",
        ),
    ],
)
def test_impossible_design_is_refused(arguments, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        design(*arguments)


def run(biquad, z, inputs):
    b0, b1, b2, a1, a2 = biquad
    outputs = []
    for u in inputs:
        y = b0 * u + z[0]
        z = (b1 * u - a1 * y + z[1], b2 * u - a2 * y)
        outputs.append(y)
    return outputs, z


@pytest.mark.parametrize("mapping", ["prewarped", "bilinear", "matched"])
@pytest.mark.parametrize("hz", [0.1, 30.0, 450.0])
def test_steady_filter_stays_where_it_is(hz, mapping):
    filter_ = scaled(design(hz, 1.2, mapping, 1000.0), 1000.0)
    outputs, _ = run(filter_, steady(filter_, 0.3), [0.3 / 1000.0] * 200)
    assert outputs == pytest.approx([0.3] * 200, rel=1e-6)
