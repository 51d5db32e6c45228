"""Linear forms: their arithmetic, and the products that would leave the set."""

import pytest

from hapticd.model.blueprint import Form


def test_arithmetic_is_by_symbol():
    x = Form.symbol("x")
    y = Form.symbol("y")
    assert (2 * x - y / 4 + x).terms == {"x": (3.0, 0.0, 0.0, 0.0), "y": (-0.25, 0.0, 0.0, 0.0)}


def test_level_and_residual_multiply_once():
    form = 3.0 * Form.symbol("x")
    assert form.times_level().terms == {"x": (0.0, 3.0, 0.0, 0.0)}
    assert form.times_residual().terms == {"x": (0.0, 0.0, 3.0, 0.0)}
    assert (
        form.times_level().times_residual().terms
        == form.times_residual().times_level().terms
        == {"x": (0.0, 0.0, 0.0, 3.0)}
    )


def test_second_degree_is_refused():
    x = Form.symbol("x")
    with pytest.raises(ValueError, match="second degree in the damping level"):
        x.times_level().times_level()
    with pytest.raises(ValueError, match="second degree in the residual resistance"):
        x.times_residual().times_residual()
