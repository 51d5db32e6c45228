"""The directed search on oracles whose boundary is known: how many trials it needs, with and
without noise and a prior.
"""

import numpy as np
import pytest
from support.analysis_search import BOX, INSIDE, SAMPLES, Oracle, W, directed_search, error

from hapticd.analysis.search import (
    Search,
)


@pytest.mark.slow
@pytest.mark.parametrize("inside", [INSIDE, (0.0, 0.0, 0.0), (100.0, 1.0, 0.005)])
def test_bent_device_within_sixty_trials_at_two_percent(inside):
    oracle = Oracle(bend=1.0)
    found = directed_search(oracle, Search(BOX), inside, budget=50)
    assert oracle.asked == 50
    assert error(found, oracle) <= 0.02


def foretold(points):
    """A model of the bent device that knows nothing of its bend, and 0.3 N s/m too much damping
    at high frequencies.
    """
    return Oracle().exact(points) + 0.3 / (1.0 + (2.0 * np.pi * 100.0 / W) ** 2)


def test_search_with_noisy_trials_beats_the_prior_that_it_began_from():
    oracle = Oracle(bend=0.5, noise=0.005)
    truth = oracle.passive(SAMPLES)
    before = np.mean((foretold(SAMPLES).min(axis=1) >= 0.0) != truth) / truth.mean()
    assert before > 0.1
    with_prior = directed_search(oracle, Search(BOX, foretold), INSIDE, budget=24)
    assert error(with_prior, oracle) < 0.5 * before
    without = directed_search(Oracle(bend=0.5, noise=0.005), Search(BOX), INSIDE, budget=24)
    assert error(with_prior, oracle) < error(without, oracle)
