"""Spectra of many trials at once: those of `spa`, trial by trial, whatever the trials beside it."""

import numpy as np
import pytest
from test_analysis_batch_spectra import COUNTS, analysed, trials

from hapticd.core.arrays import aligned
from hapticd.signal import batch_spectra
from hapticd.signal.batch_spectra import LAG


def test_sections_together_are_those_one_by_one(monkeypatch):
    force, velocity = trials(9 * LAG + 700, COUNTS[np.float32])
    monkeypatch.setattr(batch_spectra, "TOGETHER", 1)
    one_by_one = analysed(force, velocity, np.float32)
    for together in (2, 3, 8, 11):
        monkeypatch.setattr(batch_spectra, "TOGETHER", together)
        some = analysed(force, velocity, np.float32)
        for found, expected in zip(some.spectra(), one_by_one.spectra(), strict=True):
            assert np.array_equal(found, expected)
        assert np.array_equal(some.squares, one_by_one.squares)


def test_a_section_after_the_end_is_refused():
    force, velocity = trials(2 * LAG, COUNTS[np.float64])
    sums = analysed(force, velocity, np.float64)
    with pytest.raises(ValueError, match="section 3: the record has 2"):
        sums.add(aligned(LAG * len(velocity), np.float64), np.arange(LAG) * 2)
