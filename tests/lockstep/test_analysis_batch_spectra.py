"""Spectra of many trials at once: those of `spa`, trial by trial, whatever the trials beside it."""

import numpy as np
import pytest

from hapticd.core.arrays import aligned
from hapticd.signal.batch_spectra import LAG, BatchSections, shared_force
from hapticd.signal.spectra import spa

COUNTS = {np.float32: 32, np.float64: 16}  # two vectors of each
WIDTH = 3  # vectors between samples hold something else


def trials(n_samples, count, drift=0.01, seed=1):
    """A force record, and velocities with an offset and a trend of their own (count, n)."""
    random = np.random.default_rng(seed)
    force = random.standard_normal(n_samples) + 0.1
    mixed = [np.convolve(force, random.standard_normal(3))[:n_samples] for _ in range(count)]
    k = np.arange(n_samples) / n_samples
    noise = 0.1 * random.standard_normal((count, n_samples))
    return force, np.stack(mixed) + noise + drift * np.arange(count)[:, None] * (1.0 - 2.0 * k)


def analysed(force, velocity, scalar):
    """Feed sections as the engine leaves them: rows of all trials, every WIDTH-th row a sample."""
    count = len(velocity)
    sums = BatchSections(shared_force(force, scalar), count, scalar)
    block = aligned(LAG * WIDTH * count, scalar)
    rows = block.reshape(-1, count)
    place = np.arange(LAG) * WIDTH * (count * np.dtype(scalar).itemsize // 64)
    for start in range(0, force.size, LAG):
        part = velocity[:, start : start + LAG]
        rows[:] = 7.0
        rows[::WIDTH] = 0.0
        rows[: WIDTH * part.shape[1] : WIDTH] = part.T
        sums.add(block, place)
    return sums


@pytest.mark.parametrize("n_samples", [LAG + 1, 2 * LAG, 2 * LAG + 1, 5 * LAG - 1, 9 * LAG + 700])
def test_spectra_equal_those_of_single_records(n_samples):
    force, velocity = trials(n_samples, COUNTS[np.float64])
    shared = shared_force(force, np.float64)
    power, cross = analysed(force, velocity, np.float64).spectra()
    for trial, record in enumerate(velocity):
        exact = spa(force, record)
        assert np.abs(power[trial] - exact.velocity).max() < 1e-12 * exact.velocity.max()
        assert np.abs(cross[trial] - exact.cross).max() < 1e-12 * np.abs(exact.cross).max()
        assert np.abs(shared.spectrum - exact.force).max() < 1e-12 * exact.force.max()


def test_single_precision_costs_less_than_a_hundred_thousandth():
    force, velocity = trials(20 * LAG + 5, COUNTS[np.float32], drift=0.0)
    power, cross = analysed(force, velocity.astype(np.float32), np.float32).spectra()
    for trial, record in enumerate(velocity[:5]):
        exact = spa(force, record)
        assert np.abs(power[trial] - exact.velocity).max() < 1e-5 * exact.velocity.max()
        assert np.abs(cross[trial] - exact.cross).max() < 1e-5 * np.abs(exact.cross).max()


@pytest.mark.parametrize("scalar", [np.float32, np.float64])
def test_neighbours_in_a_vector_change_no_bit(scalar):
    force, velocity = trials(3 * LAG, COUNTS[scalar])
    alone = analysed(force, velocity, scalar).spectra()
    loud = 1e6 * velocity
    loud[4] = velocity[4]
    for one, other in zip(alone, analysed(force, loud, scalar).spectra(), strict=True):
        assert one[4].tobytes() == other[4].tobytes()


def test_a_broken_neighbour_stays_alone():
    force, velocity = trials(3 * LAG, COUNTS[np.float64])
    expected = analysed(force, velocity, np.float64).spectra()
    velocity[3] = np.nan
    power, cross = analysed(force, velocity, np.float64).spectra()
    assert np.isnan(power[3]).all()
    assert power[2].tobytes() == expected[0][2].tobytes()
    assert cross[4].tobytes() == expected[1][4].tobytes()


def test_squares_are_those_of_each_section():
    force, velocity = trials(2 * LAG + 100, COUNTS[np.float64])
    squares = analysed(force, velocity, np.float64).squares
    parts = np.split(velocity, [LAG, 2 * LAG], axis=1)
    assert np.allclose(squares, [(part**2).sum(axis=1) for part in parts], rtol=1e-12)
