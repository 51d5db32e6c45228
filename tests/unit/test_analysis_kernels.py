"""Local polynomials: compiled or not, they are what least squares over a window's bins give."""

import numpy as np
import pytest
from support.analysis_kernels import ALL, HALF, PLACES, SAMPLES, fitted, record

from hapticd.signal import covariances as kernel_module
from hapticd.signal.covariances import TERMS, Transforms


def columns_about(place: int, whole: Transforms):
    """As the theory of the module writes them, of the full spectrum."""
    force = np.fft.fft(np.fft.irfft(whole.force))
    bins = np.arange(max(1, place - HALF), min(SAMPLES // 2, place + HALF) + 1)
    r = (bins - place) / HALF
    x = bins / place
    powers = [r**k for k in range(TERMS)]
    images = [x * force[(bins + shift) % SAMPLES] for shift in whole.shifts]
    moved = [whole.velocity[bins] * one for one in powers]
    return np.array([*moved, *powers, *images]).T, x * force[bins]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("place", PLACES)
def test_fit_is_that_of_least_squares(place, compiled):
    whole = record(0.1)
    kernels = kernel_module.kernels() if compiled else kernel_module
    found = fitted(kernels.local_fits, whole, np.array([place]))
    columns, force = columns_about(place, whole)
    solution, *_ = np.linalg.lstsq(columns, force, rcond=None)
    left = np.sum(np.abs(force - columns @ solution) ** 2) / max(len(force) - columns.shape[1], 1)
    per_noise = np.linalg.inv(columns.conj().T @ columns)[0, 0].real
    ends = np.sum(np.abs(columns[:, TERMS : 2 * TERMS] @ solution[TERMS : 2 * TERMS]) ** 2)
    assert found.z[0] == pytest.approx(solution[0], rel=1e-8)
    assert found.variance[0] == pytest.approx(left * per_noise, rel=1e-8)
    assert found.ends[0] == pytest.approx(ends / np.sum(np.abs(force) ** 2), rel=1e-8)
    assert found.power[0] == pytest.approx(np.mean(np.abs(columns[:, 0]) ** 2), rel=1e-12)


@pytest.mark.parametrize("compiled", [False, True])
def test_channel_without_power_says_nothing(compiled):
    kernels = kernel_module.kernels() if compiled else kernel_module
    whole = record(0.0)
    still = Transforms(whole.force, np.zeros_like(whole.velocity), SAMPLES, HALF, ALL)
    found = fitted(kernels.local_fits, still)
    assert (found.z == 0.0).all()
    assert (found.variance > 1e100).all()
    assert (found.power == 0.0).all()
    assert np.isfinite(found.ends).all()
