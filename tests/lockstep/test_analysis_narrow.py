"""Narrow modes: a prediction does not step over them, and pays at most twice for that."""

import numpy as np
import pytest
from support.analysis_devices import display
from support.analysis_narrow import DENSE, GRID, flexible, resistance

from hapticd.model import predict as module
from hapticd.model.angles import min_between_lines, mode_lines
from hapticd.model.linearise import Perturbation
from hapticd.model.predict import predict


def test_mode_between_two_lines_is_seen():
    """Held, the slider swings at 302 Hz: Re Z < 0 over 8 Hz between lines 18 Hz apart."""
    model = flexible(0.00368, 0.00102, 0.00102 * (2 * np.pi * 302.0) ** 2, 0.00533, 1.55)
    point = [[645.9, 0.651, -0.003]]
    dense = resistance(model, point, DENSE)[0]
    assert resistance(model, point, GRID[GRID >= 2.0]).min() > 0.19
    assert 7.0 < 0.05 * (dense < 0.0).sum() < 9.0
    found = predict(model, point)
    assert found.margin_ns_per_m[0] == pytest.approx(dense.min(), abs=1e-5)
    assert found.worst_hz[0] == pytest.approx(DENSE[np.argmin(dense)], abs=0.05)
    assert not found.passive[0]


@pytest.fixture
def computed(monkeypatch):
    """Counts of impedances computed on shared lines and one by one, and of frequencies of loops."""
    count = {"shared": 0, "single": 0, "lines": 0}
    linearise = module.linearise
    single = module.impedance_each
    close = module.close_loop

    def counted(name, made, of):
        def call(*given):
            count[name] += of(*given)
            return made(*given)

        return call

    def shared(loop, points, *_):
        return len(points) * loop.frequency_hz.size

    monkeypatch.setattr(module, "linearise", counted("shared", linearise, shared))
    monkeypatch.setattr(
        module, "impedance_each", counted("single", single, lambda _, line, *__: len(line))
    )
    monkeypatch.setattr(module, "close_loop", counted("lines", close, lambda _, f, *__: f.size))
    return count


def test_device_without_a_narrow_mode_gets_no_lines(computed):
    model = display()
    points = np.random.default_rng(1).uniform((0, 0, 0), (900, 7, 0.02), (1000, 3))
    assert mode_lines(model, 1.74, GRID).size == 0
    predict(model, points, 1.74, perturbation=Perturbation())
    assert computed["single"] < 2 * len(points)


def test_undamped_mode_has_lines_but_none_upon_it():
    model = flexible(0.004, 0.004, 0.004 * (2 * np.pi * 100.0) ** 2, 0.0, 0.0)
    near = mode_lines(model, 0.0, GRID)
    held = near[np.abs(near - 100.0) < 1.0]
    assert held.size >= 6
    assert np.abs(held - 100.0).min() > 1e-3


@pytest.mark.parametrize("seed", range(40))
def test_dip_of_one_pole_is_found_from_three_lines(seed):
    random = np.random.default_rng(seed)
    constant, residue = random.normal(size=2) + 1j * random.normal(size=2)
    pole = random.uniform(99.0, 101.0) + 1j * np.exp(random.uniform(-5.0, 1.0)) * random.choice(
        (-1, 1)
    )
    f = np.array([98.0, 100.3, 103.0])
    dense = np.linspace(98.0, 103.0, 500_001)

    def z(hz):
        return constant + residue / (hz - pole)

    where, least = min_between_lines(f, z(f))
    lowest = np.argmin(z(dense).real)
    if 0 < lowest < dense.size - 1:
        assert where == pytest.approx(dense[lowest], abs=1e-4)
        assert least == pytest.approx(z(dense).real[lowest], rel=1e-5, abs=1e-6)
    else:
        assert least == np.inf or least > z(dense).real.min() - 1e-9
