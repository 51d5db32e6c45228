"""Narrow modes: a prediction does not step over them, and pays at most twice for that."""

import numpy as np
import pytest
from support.analysis_narrow import DENSE, DEVICES, GRID, drawn, resistance

from hapticd.model import predict as module
from hapticd.model.predict import predict


@pytest.mark.slow
def test_no_flexible_device_is_falsely_called_passive():
    """4,000 environments, 40 % of them active; on the grid alone 1 in 40 of those goes unseen."""
    unseen = active = 0
    for seed in range(DEVICES):
        model, points = drawn(seed)
        truth = resistance(model, points, DENSE[::2]).min(axis=1)
        margin = predict(model, points).margin_ns_per_m
        assert not (margin[truth < 0.0] >= 0.0).any()
        assert (margin < truth + 1e-3 + 0.01 * np.abs(truth)).all()
        active += (truth < 0.0).sum()
        unseen += (
            resistance(model, points[truth < 0.0], GRID[GRID >= 2.0]).min(axis=1) >= 0.0
        ).sum()
    assert active > 0.3 * 20 * DEVICES
    assert unseen > 0.02 * active


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


def test_looking_between_lines_costs_less_than_the_lines(computed):
    """On average over devices with a narrow mode; a computed loop counts as an environment."""
    before = 0
    for seed in range(0, DEVICES, 10):
        model, points = drawn(seed)
        predict(model, np.tile(points, (50, 1)))
        before += (1000 + 1) * GRID.size
    assert sum(computed.values()) < 1.2 * before
