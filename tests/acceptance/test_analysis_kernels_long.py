"""Local polynomials: compiled or not, they are what least squares over a window's bins give."""

import numpy as np
import pytest
from support.analysis_kernels import ALL, fitted, record

from hapticd.signal import covariances as kernel_module
from hapticd.signal.covariances import local_fits


@pytest.mark.parametrize("shifts", [ALL, ALL[:1], ALL[:0]], ids=["3 images", "1 image", "none"])
@pytest.mark.parametrize("noise", [1.0, 1e-6])
def test_compiled_fits_equal_the_plain_ones(noise, shifts):
    assert kernel_module.kernels() is not kernel_module, "numba is part of the test environment"
    whole = record(noise, shifts)
    plain = fitted(local_fits, whole)
    compiled = fitted(kernel_module.kernels().local_fits, whole)
    size = np.abs(plain.z)
    assert (np.abs(compiled.z - plain.z) < 1e-10 * size).all()
    assert (np.abs(np.sqrt(compiled.variance) - np.sqrt(plain.variance)) < 1e-9 * size).all()
    assert compiled.power == pytest.approx(plain.power, rel=1e-13)
    assert compiled.ends == pytest.approx(plain.ends, rel=1e-9)
